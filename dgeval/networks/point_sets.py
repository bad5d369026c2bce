"""PointNet++'s operations on point sets, on the CPU: farthest points, ball query, crop of a cloud.

Results equal those of the CUDA operations (docs/papers.md, "Point set operations"), except for
ties, which CUDA decides by its thread layout.
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
    """Farthest point sampling: indices (b, n) into points (b, m, 3), starting with index 0.

    Each next index is of the point farthest from all points chosen before. Points with
    |p|^2 <= skipped (m^2) are never chosen. The CUDA code skips up to 1e-3, against padding with
    zeros; a negative value skips none.
    """
    b, m = points.shape[:2]
    out = np.zeros((b, n), np.int64)
    nearest = np.empty(m, np.float32)
    x, y, z = np.empty(m, np.float32), np.empty(m, np.float32), np.empty(m, np.float32)
    for i in range(b):
        for k in range(m):
            x[k], y[k], z[k] = points[i, k, 0], points[i, k, 1], points[i, k, 2]
            # a negative distance is never the largest, so the point is never chosen
            nearest[k] = (
                np.float32(-1.0)
                if x[k] * x[k] + y[k] * y[k] + z[k] * z[k] <= skipped
                else np.float32(1e10)
            )
        old = 0
        for j in range(1, n):
            ox, oy, oz = x[old], y[old], z[old]
            # a loop of its own, apart from the search for the largest, so that it is vectorised
            for k in range(m):
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
    """Ball query: indices (b, c, n) of points (b, m, 3) within radius (m) of centres (b, c, 3).

    Of each centre the first n such points, by index. If there are fewer, the first one fills the
    rest; if there are none, all indices are 0.
    """
    b, m = points.shape[:2]
    c = centres.shape[1]
    out = np.zeros((b, c, n), np.int64)
    r2 = np.float32(radius) * np.float32(radius)
    for i in range(b):
        for j in range(c):
            x, y, z = centres[i, j, 0], centres[i, j, 1], centres[i, j, 2]
            count = 0
            for k in range(m):
                dx, dy, dz = x - points[i, k, 0], y - points[i, k, 1], z - points[i, k, 2]
                if dx * dx + dy * dy + dz * dz < r2:
                    if count == 0:
                        out[i, j, :] = k
                    out[i, j, count] = k
                    count += 1
                    if count == n:
                        break
    return out


@njit(cache=True)
def gathered(values: Points, offsets: Points, neighbours: Indices) -> Points:
    """max(0, values of the neighbours - offset of the centre): (b, c, n, w) float32.

    values (b, m, w) of the points, offsets (b, c, w) of the centres, neighbours (b, c, n) indices.
    """
    b, c, n = neighbours.shape
    w = values.shape[2]
    out = np.empty((b, c, n, w), np.float32)
    for i in range(b):
        for j in range(c):
            for k in range(n):
                row = neighbours[i, j, k]
                for q in range(w):
                    out[i, j, k, q] = max(values[i, row, q] - offsets[i, j, q], np.float32(0.0))
    return out


@njit(cache=True)
def crop(
    points: Array, T_grasp_cloud: Array, low: Array, high: Array, n: int
) -> tuple[Points, Indices]:
    """Crop points (m, 3) to the box from low to high, each (3,) m, of each grasp's frame.

    T_grasp_cloud (b, 4, 4). Returns the first n points in the box, in the grasp's frame,
    (b, n, 3) float32 m, and how many of them there are (b,), at most n. If there are fewer than n,
    they are repeated in order; if there are none, all are zero. Shuffle the points first, or the
    first n may all lie in one corner.
    """
    b = len(T_grasp_cloud)
    out = np.zeros((b, n, 3), np.float32)
    counts = np.zeros(b, np.int64)
    p = np.empty(3)
    for i in range(b):
        T = T_grasp_cloud[i]
        count = 0
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
                    out[i, count, r] = p[r]
                count += 1
                if count == n:
                    break
        counts[i] = count
        if count:
            for k in range(count, n):
                out[i, k] = out[i, k % count]
    return out, counts
