"""Apparent motion of a still object from raw depth and recorded camera poses, without a tracker.

It is the recording's own error (poses, intrinsics, lens, clocks) and so the lower bound of every
velocity error that is measured on the recording.
"""

from __future__ import annotations

import numpy as np
from dgeval.geometry import Array, transform
from dgeval.recording.trials import Trial
from scipy.spatial import cKDTree

ABOVE_M = 0.02  # m; points closer to the table plane are not the object's
REACH_M = 0.01  # m; matches farther apart are not used


def apparent_speed(trial: Trial, centre: Array, radius: float) -> tuple[float, float]:
    """Apparent speed mm/s, and largest distance from the position in the middle frame, mm.

    Of the points within `radius` m of `centre` (3,) m, base frame. A position is the translation
    that aligns a frame's points with the middle frame's. The speed is the slope of a straight line
    through the positions over time. NaN with fewer than three positions.
    """
    clouds, times = [], []
    for frame in trial.frames():
        if frame.T_base_camera is None:
            continue
        v, u = np.nonzero(frame.depth)
        points = frame.camera.backproject(
            u.astype(float), v.astype(float), frame.depth[v, u].astype(float)
        )
        clouds.append(transform(frame.T_base_camera, points))
        times.append(frame.t_ns * 1e-9)
    middle = len(clouds) // 2
    normal, offset = _table(clouds[middle], centre)
    objects = []
    for cloud in clouds:
        near = cloud[np.linalg.norm(cloud - centre, axis=1) < radius]
        height = near @ normal - offset
        objects.append(near[np.abs(height) > ABOVE_M])
    tree = cKDTree(objects[middle])
    positions = np.array([_shift(points, objects[middle], tree) for points in objects])
    good = np.isfinite(positions[:, 0])
    if good.sum() < 3:
        return float("nan"), float("nan")
    slope = np.polyfit(np.array(times)[good] - times[0], positions[good], 1)[0]
    return float(np.linalg.norm(slope) * 1e3), float(
        np.linalg.norm(positions[good], axis=1).max() * 1e3
    )


def _table(cloud: Array, centre: Array) -> tuple[Array, float]:
    """Plane n·p = offset around the object: RANSAC with a fixed seed and one least-squares fit."""
    near = cloud[np.linalg.norm(cloud - centre, axis=1) < 0.25]
    rng = np.random.default_rng(0)
    best, inliers = 0, near[:3]
    for _ in range(300):
        a, b, c = near[rng.integers(0, len(near), 3)]
        n = np.cross(b - a, c - a)
        length = float(np.linalg.norm(n))
        if length < 1e-9:
            continue
        inside = np.abs((near - a) @ (n / length)) < 0.005
        if inside.sum() > best:
            best, inliers = int(inside.sum()), near[inside]
    middle = inliers.mean(axis=0)
    normal = np.linalg.svd((inliers - middle).T @ (inliers - middle))[2][2]
    return normal, float(normal @ middle)


def _shift(points: Array, reference: Array, tree: cKDTree) -> Array:
    """Translation (3,) m of the points against the reference (ICP); NaN where they don't match."""
    if len(points) < 50:
        return np.full(3, np.nan)
    shift = np.zeros(3)
    for _ in range(60):
        matches = tree.query(points + shift)
        distance, index = np.asarray(matches[0]), np.asarray(matches[1])
        used = distance < REACH_M
        if not used.any():
            return np.full(3, np.nan)
        shift += (reference[index[used]] - (points + shift)[used]).mean(axis=0)
    return -shift
