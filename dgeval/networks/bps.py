"""Basis point sets: a cloud encoded as its distances from fixed points.

Method: Prokudin et al., ICCV 2019 (docs/papers.md, "Basis point set").
"""

from __future__ import annotations

from functools import cache

import numpy as np
import small_gicp
from numpy.typing import NDArray

SEED = 13  # default random seed of the authors' bps library


@cache
def basis(n: int = 4096, radius: float = 0.2) -> NDArray[np.float32]:
    """Basis points (n, 3) float32, m, drawn uniformly in a ball of `radius` m about the origin.

    The points are bit for bit those of `random_uniform` in the bps library. FFHNet uses 4096
    points in 0.2 m, the defaults; the SHA-256 of their float32 bytes begins with d1e7f6d3.
    The array is cached, shared by all callers, and read-only.
    """
    # the library draws from NumPy's legacy generator: first all directions, then all radii
    stream = np.random.RandomState(SEED)
    points = stream.normal(size=(n, 3))
    points /= np.sqrt(np.square(points).sum(axis=1))[:, None]
    points *= radius * np.power(stream.uniform(size=(n, 1)), 1 / 3)
    out = points.astype(np.float32)
    out.flags.writeable = False
    return out


def encode(cloud: NDArray[np.floating], points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Distances (n,) float32, m, from basis points (n, 3) to the nearest point of a cloud (m, 3).

    Both are in metres. The caller has subtracted the cloud's mean. Raises ValueError for an empty
    cloud.
    """
    if len(cloud) == 0:
        raise ValueError("an empty cloud has no encoding")
    # the fastest of four search trees (benchmarks/results/ffhnet.md); it returns squared distances
    _, squared = small_gicp.KdTree(
        np.asarray(cloud, dtype=np.float64)
    ).batch_nearest_neighbor_search(points.astype(np.float64))
    return np.asarray(np.sqrt(squared), dtype=np.float32)
