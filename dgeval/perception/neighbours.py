"""Nearest neighbours by small_gicp's KD-tree.

It takes half the time of scipy's and gives equal distances (docs/papers.md, "Nearest neighbours").
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from small_gicp import KdTree

from dgeval.geometry import Array


def nearest(tree: KdTree, points: Array) -> tuple[NDArray[np.int64], Array]:
    """Index and distance m (n,) of the nearest neighbour of each point (n, 3) m; one thread."""
    index, squared = tree.batch_nearest_neighbor_search(points, num_threads=1)
    return np.asarray(index, dtype=np.int64), np.sqrt(np.asarray(squared, dtype=np.float64))
