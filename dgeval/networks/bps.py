"""Basis point sets: a cloud as its distances from fixed points (Prokudin et al., ICCV 2019; PAPERS section 2)."""

from __future__ import annotations

from functools import cache

import numpy as np
import small_gicp
from numpy.typing import NDArray

SEED = 13  # of the bps library


@cache
def basis(n: int = 4096, radius: float = 0.2) -> NDArray[np.float32]:
    """Basis points (n, 3), m, uniform in a ball: `random_uniform` of the bps library, bit by bit. FFHNet: 4096 in 0.2 m.

    Its SHA-256 as float32 bytes is d1e7f6d3…; the array is shared and read-only.
    """
    stream = np.random.RandomState(
        SEED
    )  # legacy, as the library draws: all normals before the radii
    points = stream.normal(size=(n, 3))
    points /= np.sqrt(np.square(points).sum(axis=1))[:, None]
    points *= radius * np.power(stream.uniform(size=(n, 1)), 1 / 3)
    out = points.astype(np.float32)
    out.flags.writeable = False
    return out


def encode(cloud: NDArray[np.floating], points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Distance (n,) m from each basis point (n, 3) to the nearest of a cloud (m, 3), which the caller has centred.

    ValueError for an empty cloud.
    """
    if len(cloud) == 0:
        raise ValueError("an empty cloud has no encoding")
    # the fastest of four, benchmarks/results/ffhnet.md; it gives squared distances
    _, squared = small_gicp.KdTree(
        np.asarray(cloud, dtype=np.float64)
    ).batch_nearest_neighbor_search(points.astype(np.float64))
    return np.asarray(np.sqrt(squared), dtype=np.float32)
