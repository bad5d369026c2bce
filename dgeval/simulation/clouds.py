"""Points that a depth camera measures of an object's surface, without an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, transform

FOCAL = 100.0  # px of the coarse image in which visibility is decided: 4 to 5 mm per px; ours
BEHIND = 0.006  # m behind the nearest point of its pixel, up to which a point is seen; ours
NOISE = 0.08 / (385.0 * 0.050)  # 1/m: sigma_z = NOISE z^2, a D435 (see `sensors`)
FLYING = 0.01  # share of points that lie up to 2 cm behind the surface; ours


def seen_from(
    surface: Array, T_camera_object: Array, rng: np.random.Generator
) -> tuple[NDArray[np.intp], Array]:
    """The points of a surface (n, 3) m, object frame, that a camera sees.

    Returns their rows (m,), and the points that the camera measures (m, 3) m, camera frame, with
    noise along the ray.
    """
    points = transform(T_camera_object, surface)
    z = np.maximum(points[:, 2], 1e-3)
    cell = np.rint(FOCAL * points[:, :2] / z[:, None]).astype(np.int64)
    cell -= cell.min(axis=0)
    flat = cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1]
    nearest = np.full(flat.max() + 1, np.inf)
    np.minimum.at(nearest, flat, z)
    rows = np.flatnonzero(z <= nearest[flat] + BEHIND)
    points, z = points[rows], z[rows]
    along = rng.normal(size=len(rows)) * NOISE * z**2
    along += (rng.random(len(rows)) < FLYING) * rng.uniform(0, 0.02, len(rows))
    return rows, np.asarray(points * (1 + along / z)[:, None])
