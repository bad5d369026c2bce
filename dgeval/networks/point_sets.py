"""PointNet++'s operations on point sets, on the CPU: farthest points, neighbours in a ball, and crops of a cloud.

As the CUDA operations do them (PAPERS section 4.1), ties apart, which there depend on the layout of threads.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dgeval.geometry import Array

Indices = NDArray[np.int64]
Points = NDArray[np.float32]


@njit(cache=True)
def farthest_points(points: Points, n: int, skipped: float) -> Indices:
    """Indices (b, n) of points (b, m, 3), each the farthest from those before it, from index 0 on.

    Points with |p|^2 <= skipped are never chosen (the CUDA code's guard against padding: 1e-3; negative: none skipped).
    """
    b, m = points.shape[:2]
    out = np.zeros((b, n), np.int64)
    nearest = np.empty(m, np.float32)
    x, y, z = np.empty(m, np.float32), np.empty(m, np.float32), np.empty(m, np.float32)
    for i in range(b):
        for k in range(m):
            x[k], y[k], z[k] = points[i, k, 0], points[i, k, 1], points[i, k, 2]
            # below zero a point stays below every other one's distance
            nearest[k] = (
                np.float32(-1.0)
                if x[k] * x[k] + y[k] * y[k] + z[k] * z[k] <= skipped
                else np.float32(1e10)
            )
        old = 0
        for j in range(1, n):
            ox, oy, oz = x[old], y[old], z[old]
            for k in range(m):  # apart from the search for the largest, so that it runs in vectors
                d = (
                    (x[k] - ox) * (x[k] - ox)
                    + (y[k] - oy) * (y[k] - oy)
                    + (z[k] - oz) * (z[k] - oz)
                )
                nearest[k] = min(nearest[k], d)
            best, old = np.float32(-1.0), 0
            for k in range(m):
                if nearest[k] > best:
                    best, old = nearest[k], k
            out[i, j] = old
    return out


@njit(cache=True)
def neighbours_in_ball(points: Points, centres: Points, radius: float, n: int) -> Indices:
    """Indices (b, c, n) of the first n points (b, m, 3) nearer than radius to each centre (b, c, 3), in their order.

    Fewer are filled up with the first; none: index 0.
    """
    b, m = points.shape[:2]
    c = centres.shape[1]
    out = np.zeros((b, c, n), np.int64)
    r2 = np.float32(radius) * np.float32(radius)
    for i in range(b):
        for j in range(c):
            x, y, z = centres[i, j, 0], centres[i, j, 1], centres[i, j, 2]
            found = 0
            for k in range(m):
                dx, dy, dz = x - points[i, k, 0], y - points[i, k, 1], z - points[i, k, 2]
                if dx * dx + dy * dy + dz * dz < r2:
                    if found == 0:
                        out[i, j, :] = k
                    out[i, j, found] = k
                    found += 1
                    if found == n:
                        break
    return out


@njit(cache=True)
def gathered(values: Points, offsets: Points, near: Indices) -> Points:
    """max(0, values[near] - offsets): (b, c, n, w) of values (b, m, w) and offsets (b, c, w)."""
    b, c, n = near.shape
    w = values.shape[2]
    out = np.empty((b, c, n, w), np.float32)
    for i in range(b):
        for j in range(c):
            for k in range(n):
                row = near[i, j, k]
                for q in range(w):
                    out[i, j, k, q] = max(values[i, row, q] - offsets[i, j, q], np.float32(0.0))
    return out


@njit(cache=True)
def crop(
    points: Array, T_grasp_cloud: Array, low: Array, high: Array, n: int
) -> tuple[Points, Indices]:
    """The first n points (m, 3) inside a box low..high (3,) of each grasp's frame, (b, n, 3), and how many there were (b,).

    Fewer are repeated from the first on; none leaves zeros. Shuffle the points before, or the first are from one corner.
    """
    b = len(T_grasp_cloud)
    out = np.zeros((b, n, 3), np.float32)
    counts = np.zeros(b, np.int64)
    p = np.empty(3)
    for i in range(b):
        T = T_grasp_cloud[i]
        found = 0
        for k in range(len(points)):
            inside = True
            for r in range(3):
                p[r] = (
                    T[r, 0] * points[k, 0]
                    + T[r, 1] * points[k, 1]
                    + T[r, 2] * points[k, 2]
                    + T[r, 3]
                )
                if not low[r] < p[r] < high[r]:
                    inside = False
                    break
            if inside:
                for r in range(3):
                    out[i, found, r] = p[r]
                found += 1
                if found == n:
                    break
        counts[i] = found
        if found:
            for k in range(found, n):
                out[i, k] = out[i, k % found]
    return out, counts
