"""Gauss-Newton on one rigid pose: depth (point to plane) and image features (reprojection).

Both terms have robust weights.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dgeval.config import TrackingConfig
from dgeval.geometry import (
    Array,
    Intrinsics,
    cross,
    depth_sigma,
    increment,
    rotation_angle,
    transform,
)
from dgeval.perception.types import Features, Model, Window

SIGMA_PIXEL = 0.5  # px, standard deviation of a feature's position
# Neighbouring depth pixels share their errors, because the camera's matching window spans several
# of them, so n pixels give less information than n independent ones. Measured on synthetic
# recordings with correlated noise; see benchmarks/registration.py.
DEPTH_WEIGHT = 0.1
# m: a point that is farther than what is seen by less agrees with it, by more is hidden by it; ours
AGREE_M, HIDDEN_M = 0.012, 0.025


def tukey(residual: Array, scale: float) -> Array:
    """Tukey's biweight of residuals: 1 at zero, 0 from `scale` (same unit) on."""
    return np.asarray(np.where(np.abs(residual) < scale, (1 - (residual / scale) ** 2) ** 2, 0.0))


def depth_normal_equations(
    points: Array, targets: Array, normals: Array, sigma: Array, cutoff: float
) -> tuple[Array, Array, int]:
    """H (6, 6), g (6,) of point-to-plane residuals n·(target − point), and the number in use.

    For a motion of `points` from the left, [translation m, rotation rad], camera frame. points,
    targets and normals are (n, 3), sigma (n,) m; the robust weight is 0 from `cutoff` m on.
    """
    residual = np.einsum("ij,ij->i", normals, targets - points)
    weight = tukey(residual, cutoff) * DEPTH_WEIGHT / sigma**2
    J = np.concatenate([normals, cross(points, normals)], axis=1)
    weighted = J * weight[:, None]
    return weighted.T @ J, weighted.T @ residual, int(np.count_nonzero(weight))


def feature_normal_equations(
    points: Array, pixels: Array, camera: Intrinsics, cutoff: float
) -> tuple[Array, Array, int]:
    """H (6, 6), g (6,) of reprojection residuals, and the number of features in use.

    For a motion of `points` (n, 3) m from the left, camera frame; pixels (n, 2) px; the robust
    weight is 0 from `cutoff` px on.
    """
    ahead = points[:, 2] > 0.05
    points, pixels = points[ahead], pixels[ahead]
    if not len(points):
        return np.zeros((6, 6)), np.zeros(6), 0
    residual = pixels - camera.project(points)
    weight = tukey(np.linalg.norm(residual, axis=1), cutoff) / SIGMA_PIXEL**2
    x, y, z = points.T
    zero = np.zeros_like(x)
    Ju = np.stack([camera.fx / z, zero, -camera.fx * x / z**2], axis=1)
    Jv = np.stack([zero, camera.fy / z, -camera.fy * y / z**2], axis=1)
    J = np.concatenate(
        [
            np.concatenate([Ju, cross(points, Ju)], axis=1),
            np.concatenate([Jv, cross(points, Jv)], axis=1),
        ]
    )
    w = np.concatenate([weight, weight])
    weighted = J * w[:, None]
    return (
        weighted.T @ J,
        weighted.T @ np.concatenate([residual[:, 0], residual[:, 1]]),
        int(np.count_nonzero(weight)),
    )


def solve(H: Array, g: Array) -> Array:
    """The increment (4, 4) of the step T <- increment * T; unconstrained directions don't move."""
    # translation in m and rotation about a point 1 m away have similar scales, so both get the same
    # damping
    damping = 1e-6 * np.trace(H) / 6 + 1e-9
    return increment(np.linalg.solve(H + damping * np.eye(6), g))


def align_to_image(
    depth: NDArray[np.float32],
    window: Window,
    free: NDArray[np.bool_],
    model: Model,
    features: Features,
    T: Array,
    camera: Intrinsics,
    config: TrackingConfig,
) -> tuple[Array, float, int, int]:
    """T_camera_model (4, 4) refined on a window of the image, and how well the model fits there.

    depth, free (h, w): m, and its pixels that may be the target's. features: of the target.

    Also returns the share of compared model points whose depth agrees, the number of compared
    points, and the number of features that agree.
    """
    step = max(1, len(model.points) // config.align_points)
    points, normals = model.points[::step], model.normals[::step]
    agree, used, n_features = 0.0, 0, 0
    n_depth = 0
    for i in range(config.iterations):
        late = i / max(1, config.iterations - 1)
        cutoff = 0.03 * (1 - late) + 0.008 * late
        p = transform(T, points)
        n = normals @ T[:3, :3].T
        facing = np.einsum("ij,ij->i", n, p) < -0.2 * np.linalg.norm(p, axis=1)
        p, n = p[facing], n[facing]
        uv = np.rint(camera.project(p)).astype(int) - np.array(window[:2])
        inside = (
            (uv[:, 0] >= 0)
            & (uv[:, 0] < depth.shape[1])
            & (uv[:, 1] >= 0)
            & (uv[:, 1] < depth.shape[0])
        )
        p, n, uv = p[inside], n[inside], uv[inside]
        valid = free[uv[:, 1], uv[:, 0]]
        p, n, uv = p[valid], n[valid], uv[valid]
        z = depth[uv[:, 1], uv[:, 0]].astype(np.float64)
        observed = camera.backproject(uv[:, 0] + float(window[0]), uv[:, 1] + float(window[1]), z)
        H, g, used = depth_normal_equations(p, observed, n, depth_sigma(z), cutoff)
        # what something nearer hides, as a mug's front does its back, tells nothing of the pose
        behind = p[:, 2] - z
        behind = behind[behind < HIDDEN_M]
        n_depth = len(behind)
        agree = float(np.mean(np.abs(behind) < AGREE_M)) if n_depth else 0.0
        if len(features.points):
            in_camera = transform(T, features.points)
            Hf, gf, n_features = feature_normal_equations(
                in_camera, features.pixels, camera, 10.0 * (1 - late) + 2.0 * late
            )
            H, g = H + Hf, g + gf
        if used + 2 * n_features < 10:
            break
        step_T = solve(H, g)
        T = step_T @ T
        if (
            late > 0.6
            and np.linalg.norm(step_T[:3, 3]) < 5e-5
            and rotation_angle(step_T[:3, :3]) < 1e-4
        ):
            break
    return T, agree, n_depth, n_features
