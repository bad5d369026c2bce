"""Gauss-Newton on one rigid pose from depth (point to plane) and image features (reprojection), both robust."""

from __future__ import annotations

import numpy as np

from dgeval.geometry import Array, Intrinsics, cross, increment

SIGMA_PIXEL = 0.5
# Neighbouring depth pixels share their errors (the matching window of the camera spans several), so n of them tell less
# than n independent ones. Measured on made recordings with correlated noise; see benchmarks/registration.py.
DEPTH_WEIGHT = 0.1


def tukey(residual: Array, scale: float) -> Array:
    """Tukey's biweight: 1 at zero, 0 from `scale` on."""
    return np.asarray(np.where(np.abs(residual) < scale, (1 - (residual / scale) ** 2) ** 2, 0.0))


def depth_normal_equations(
    points: Array, targets: Array, normals: Array, sigma: Array, cutoff: float
) -> tuple[Array, Array, int]:
    """H (6, 6), g (6,) of point-to-plane residuals n·(target − point) for a left motion of `points`, camera frame.

    Unknowns are [translation m, rotation rad]; `cutoff` m is where the robust weight ends. Returns the number in use.
    """
    residual = np.einsum("ij,ij->i", normals, targets - points)
    weight = tukey(residual, cutoff) * DEPTH_WEIGHT / sigma**2
    J = np.concatenate([normals, cross(points, normals)], axis=1)
    weighted = J * weight[:, None]
    return weighted.T @ J, weighted.T @ residual, int(np.count_nonzero(weight))


def feature_normal_equations(
    points: Array, pixels: Array, camera: Intrinsics, cutoff: float
) -> tuple[Array, Array, int]:
    """H (6, 6), g (6,) of reprojection residuals for a left motion of `points` (n, 3), camera frame; cutoff in px."""
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
    """The step T <- increment * T; directions that nothing constrains do not move."""
    # translation in metres and rotation about a point ~1 m away differ little in scale, so one damping serves
    damping = 1e-6 * np.trace(H) / 6 + 1e-9
    return increment(np.linalg.solve(H + damping * np.eye(6), g))
