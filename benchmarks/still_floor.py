"""How still a still object is in a recording: its apparent motion from raw depth and recorded camera poses, no tracker.

What comes out is the recording's own error (poses, intrinsics, lens, clocks), the floor under every velocity measured on it.
"""

from __future__ import annotations

import numpy as np
from dgeval.geometry import Array, transform
from dgeval.recording.trials import Trial
from scipy.spatial import cKDTree

ABOVE_M = 0.02  # m over the table, to count as the object's
REACH_M = 0.01  # m, matches farther apart are not used


def apparent_speed(trial: Trial, centre: Array, radius: float) -> tuple[float, float]:
    """Of the points within `radius` m of `centre` (3,) m, base frame: speed mm/s of the straight line through their
    places over time, and their largest distance from the middle frame's place, mm. Places by alignment in translation."""
    clouds, times = [], []
    for frame in trial.frames():
        if frame.T_base_camera is None:
            continue
        v, u = np.nonzero(frame.depth)
        seen = frame.camera.backproject(
            u.astype(float), v.astype(float), frame.depth[v, u].astype(float)
        )
        clouds.append(transform(frame.T_base_camera, seen))
        times.append(frame.t_ns * 1e-9)
    middle = len(clouds) // 2
    normal, offset = _table(clouds[middle], centre)
    objects = []
    for cloud in clouds:
        near = cloud[np.linalg.norm(cloud - centre, axis=1) < radius]
        height = near @ normal - offset
        objects.append(near[np.abs(height) > ABOVE_M])
    tree = cKDTree(objects[middle])
    places = np.array([_shift(points, objects[middle], tree) for points in objects])
    good = np.isfinite(places[:, 0])
    if good.sum() < 3:
        return float("nan"), float("nan")
    slope = np.polyfit(np.array(times)[good] - times[0], places[good], 1)[0]
    return float(np.linalg.norm(slope) * 1e3), float(
        np.linalg.norm(places[good], axis=1).max() * 1e3
    )


def _table(cloud: Array, centre: Array) -> tuple[Array, float]:
    """The plane around the object: n·p = offset, by seeded hypotheses and one refinement."""
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
    """Place (3,) m of the points relative to the reference's."""
    if len(points) < 50:
        return np.full(3, np.nan)
    shift = np.zeros(3)
    for _ in range(60):
        found = tree.query(points + shift)
        distance, index = np.asarray(found[0]), np.asarray(found[1])
        used = distance < REACH_M
        if not used.any():
            return np.full(3, np.nan)
        shift += (reference[index[used]] - (points + shift)[used]).mean(axis=0)
    return -shift
