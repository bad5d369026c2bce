"""Gauss-Newton on one rigid pose: depth (point to plane) and image features (reprojection).

Both terms have robust weights.
"""

from __future__ import annotations

import numpy as np

from dgeval.geometry import Array, Intrinsics, cross, increment

SIGMA_PIXEL = 0.5  # px, standard deviation of a feature's position
# Neighbouring depth pixels share their errors, because the camera's matching window spans several
# of them, so n pixels give less information than n independent ones. Measured on synthetic
# recordings with correlated noise; see benchmarks/registration.py.
DEPTH_WEIGHT = 0.1


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
