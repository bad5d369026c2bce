"""What was seen through is not the target: model points where the camera sees farther things."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Intrinsics, depth_sigma

BEHIND_M, BEHIND_SIGMAS = 0.012, 4.0  # what is farther than a point by both is behind it; ours


def seen_through(
    points: Array, depth: NDArray[np.float32], camera: Intrinsics
) -> NDArray[np.bool_]:
    """Which of points (n, 3) m, camera frame, the camera sees through, in depth (H, W) m.

    A point outside the image, or at a pixel without a reading, is none of them.
    """
    out = np.zeros(len(points), dtype=bool)
    front = np.flatnonzero(points[:, 2] > 0.05)
    pixels = np.rint(camera.project(points[front])).astype(int)
    u, v = pixels.T
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    front, z = front[inside], depth[v[inside], u[inside]]
    expected = points[front, 2]
    margin = np.maximum(BEHIND_M, BEHIND_SIGMAS * depth_sigma(expected))
    out[front] = z > expected + margin
    return out
