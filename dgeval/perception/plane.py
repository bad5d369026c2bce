"""The dominant plane around the target (table, belt, shelf).

It keeps the surface that the target stands on out of the model cloud.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgeval.config import PlaneConfig
from dgeval.geometry import Array, cross, depth_sigma


@dataclass(frozen=True, slots=True)
class Plane:
    """The plane n·p + d = 0, camera frame, with n (3,) of length 1 towards the camera, d > 0 m.

    support: share of the points that lie in it.
    """

    n: Array
    d: float
    support: float

    def height(self, points: Array) -> Array:
        """Signed distance (...) m of points (..., 3) m, positive on the camera's side."""
        return np.asarray(points @ self.n + self.d)

    def moved(self, T_a_b: Array) -> Plane:
        """This plane of frame b, expressed in frame a."""
        n = T_a_b[:3, :3] @ self.n
        return Plane(n, self.d - float(n @ T_a_b[:3, 3]), self.support)


def fit_plane(points: Array, rng: np.random.Generator, config: PlaneConfig) -> Plane | None:
    """Plane with the most points (n, 3) m, from seeded hypotheses and two least-squares fits.

    None if its support is too small, or with too few points.
    """
    n = len(points)
    if n < 50:
        return None
    picks = points[rng.integers(0, n, (config.hypotheses, 3))]
    normals = cross(picks[:, 1] - picks[:, 0], picks[:, 2] - picks[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    good = lengths > 1e-9
    if not good.any():
        return None
    normals = normals[good] / lengths[good, None]
    offsets = -np.einsum("ij,ij->i", normals, picks[good, 0])
    tolerance = config.tolerance_sigmas * depth_sigma(points[:, 2])
    inside = np.abs(normals @ points.T + offsets[:, None]) < tolerance
    best = int(np.argmax(inside.sum(axis=1)))
    normal, offset, mask = normals[best], float(offsets[best]), inside[best]
    for _ in range(2):
        chosen = points[mask]
        if len(chosen) < 10:
            return None
        centre = chosen.mean(axis=0)
        _, _, axes = np.linalg.svd((chosen - centre).T @ (chosen - centre))
        normal = axes[2]
        offset = -float(normal @ centre)
        mask = np.abs(points @ normal + offset) < tolerance
    if offset < 0:
        normal, offset = -normal, -offset
    support = float(mask.mean())
    return Plane(normal, offset, support) if support >= config.min_support else None
