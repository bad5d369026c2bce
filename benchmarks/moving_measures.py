"""Errors of one variant's frame table against the known motion. mm, mm/s, s, degrees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from dgeval.geometry import Array, invert, matrix_from_pose, rotation_angle, transform
from scipy.stats import chi2

from benchmarks.rebase import Written

SETTLE_S = 1.0  # s from the start, after which the velocity estimate counts as settled
MODEL = ["model_px", "model_py", "model_pz", "model_qx", "model_qy", "model_qz", "model_qw"]
FEATURE = ["feature_px", "feature_py", "feature_pz"]
VELOCITY = ["velocity_x", "velocity_y", "velocity_z"]


@dataclass(frozen=True)
class Velocity:
    """Errors of the estimated velocity.

    known: frames with a velocity. sd: median velocity_sd after SETTLE_S, mm/s. rmse_all, rmse: over
    all frames, and after SETTLE_S, mm/s. median: of |error| after SETTLE_S, mm/s. coverage, lag_s:
    see `velocity`.
    """

    known: int
    sd: float
    rmse_all: float
    rmse: float
    median: float
    coverage: float
    lag_s: float


def velocity(frames: pd.DataFrame, written: Written, truth: Array) -> Velocity:
    """`truth` (n, 3) m/s per frame at the feature point.

    Coverage: share of settled frames with |error|^2 / velocity_sd^2 below the 95 % point of
    chi-square with 3 degrees of freedom. velocity_sd, the standard deviation of the largest axis,
    is taken for all three axes, which makes the coverage optimistic. Lag: median time from a start
    of the motion to 90 % of its speed along its direction.
    """
    estimate = frames[VELOCITY].to_numpy(dtype=float)
    error = np.linalg.norm(estimate - truth, axis=1) * 1e3
    with_velocity = np.isfinite(error)
    settled = with_velocity & (written.seconds - written.seconds[0] >= SETTLE_S)
    sd = frames["velocity_sd"].to_numpy(dtype=float) * 1e3
    inside = error[settled] ** 2 / sd[settled] ** 2 < chi2.ppf(0.95, 3)
    return Velocity(
        int(with_velocity.sum()),
        _median(sd[settled]),
        _rms(error[with_velocity]),
        _rms(error[settled]),
        _median(error[settled]),
        float(inside.mean()) if settled.any() else float("nan"),
        _lag(estimate, truth, written),
    )


def _lag(estimate: Array, truth: Array, written: Written) -> float:
    lags = []
    for start in written.motion.starts(float(written.seconds[-1]) - 0.9):
        moving = (written.seconds >= start) & (np.linalg.norm(truth, axis=1) > 0.01)
        speed = np.linalg.norm(truth[moving], axis=1).max(initial=0.0)
        along = estimate @ np.array(written.motion.direction)
        reached = np.nonzero(moving & (along >= 0.9 * speed) & (written.seconds < start + 1.0))[0]
        if speed > 0:
            lags.append(written.seconds[reached[0]] - start if len(reached) else np.inf)
    return float(np.median(lags)) if lags else float("nan")


def rebased_truth(frames: pd.DataFrame, written: Written) -> Array:
    """True velocity (n, 3) m/s of the feature point, base frame of the variant.

    The object must stand still in the source.
    """
    positions = frames[FEATURE].to_numpy(dtype=float)
    start = written.seconds[0]
    return np.array(
        [
            written.motion.velocity(t - start, p)
            for t, p in zip(written.seconds, positions, strict=True)
        ]
    )


def camera_frame_truth(frames: pd.DataFrame, written: Written) -> Array:
    """True velocity (n, 3) m/s in the camera frame, for variants without camera poses.

    By central differences of the positions that follow from the recorded camera poses.
    """
    positions = frames[FEATURE].to_numpy(dtype=float)
    good = np.nonzero(np.isfinite(positions[:, 0]))[0]
    if not len(good) or any(T is None for T in written.T_source):
        return np.full((len(frames), 3), np.nan)
    T = [t for t in written.T_source if t is not None]
    world = np.median([transform(T[i], positions[i][None])[0] for i in good], axis=0)
    path = np.array([transform(invert(t), world[None])[0] for t in T])
    return np.asarray(np.gradient(path, written.seconds, axis=0))


def drift(frames: pd.DataFrame, written: Written) -> float:
    """95th percentile of the feature point's distance from its median position, mm.

    In the base frame of the source, in which the object stands still.
    """
    positions = frames[FEATURE].to_numpy(dtype=float)
    back = [
        transform(invert(M), p[None])[0]
        for M, p in zip(written.M, positions, strict=True)
        if np.isfinite(p[0])
    ]
    if not back:
        return float("nan")
    return float(
        np.quantile(np.linalg.norm(np.array(back) - np.median(back, axis=0), axis=1), 0.95) * 1e3
    )


def gap(frames: pd.DataFrame, written: Written) -> tuple[float, float, float]:
    """Errors at the first frame after the longest pause: (predicted mm, table mm, seconds).

    predicted: error of the feature point as predicted from the last frame before the pause. table:
    error of the feature point in the frame table. seconds: until the next accepted registration.
    """
    positions, speeds = (
        frames[FEATURE].to_numpy(dtype=float),
        frames[VELOCITY].to_numpy(dtype=float),
    )
    i = int(np.argmax(np.diff(written.seconds)))
    dt = float(written.seconds[i + 1] - written.seconds[i])
    true = transform(written.M[i + 1] @ invert(written.M[i]), positions[i][None])[0]
    predicted = float(np.linalg.norm(positions[i] + speeds[i] * dt - true) * 1e3)
    in_table = float(np.linalg.norm(positions[i + 1] - true) * 1e3)
    accepted = np.nonzero(~frames["predicted"].to_numpy(dtype=bool)[i + 1 :])[0]
    again_s = (
        float(written.seconds[i + 1 + accepted[0]] - written.seconds[i + 1])
        if len(accepted)
        else float("inf")
    )
    return predicted, in_table, again_s


def pose_errors(frames: pd.DataFrame, T_camera_object: list[Array]) -> tuple[Array, Array]:
    """Errors of T_camera_model: position of the object's centre (n,) mm, and angle (n,) deg.

    After one constant alignment of the model frame with the object frame.
    """
    rows = np.nonzero(frames["model_px"].notna().to_numpy())[0]
    estimated = [matrix_from_pose(frames.loc[i, MODEL].to_numpy(dtype=float)) for i in rows]
    relative = np.array(
        [invert(T_camera_object[i]) @ T for i, T in zip(rows, estimated, strict=True)]
    )
    if not len(relative):
        return np.zeros(0), np.zeros(0)
    U, _, Vt = np.linalg.svd(relative[:, :3, :3].sum(axis=0))
    A = np.eye(4)
    A[:3, :3] = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    # position of the object's centre in the model frame, and the shift that fits the mean rotation
    centres = np.array([transform(invert(T), np.zeros((1, 3)))[0] for T in relative])
    A[:3, 3] = -A[:3, :3] @ np.median(centres, axis=0)
    aligned = [T @ invert(A) for T in estimated]
    position_mm = [
        float(np.linalg.norm(b[:3, 3] - T_camera_object[i][:3, 3])) * 1e3
        for i, b in zip(rows, aligned, strict=True)
    ]
    angle_deg = [
        np.rad2deg(rotation_angle(b[:3, :3].T @ T_camera_object[i][:3, :3]))
        for i, b in zip(rows, aligned, strict=True)
    ]
    return np.array(position_mm), np.array(angle_deg)


def box_iou(frames: pd.DataFrame, boxes: list[tuple[float, float, float, float]]) -> Array:
    """Intersection over union of the tracked and the true box, of frames with a tracked box."""
    out = []
    for row, true in zip(
        frames[["box_x0", "box_y0", "box_x1", "box_y1"]].to_numpy(dtype=float), boxes, strict=True
    ):
        if np.isfinite(row[0]):
            w, h = (
                min(row[2], true[2]) - max(row[0], true[0]),
                min(row[3], true[3]) - max(row[1], true[1]),
            )
            both = max(w, 0.0) * max(h, 0.0)
            areas = (row[2] - row[0]) * (row[3] - row[1]) + (true[2] - true[0]) * (
                true[3] - true[1]
            )
            out.append(both / (areas - both))
    return np.array(out)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _median(values: Array) -> float:
    return float(np.median(values)) if len(values) else float("nan")
