"""Filtering by previous observations and merging into the model cloud (paper equations 1 and 2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from small_gicp import KdTree

from dgeval.config import FusionConfig
from dgeval.geometry import Array, transform
from dgeval.perception.neighbours import nearest
from dgeval.perception.types import Model, Observation

CUBE_M, LEAST_IN_CUBE = 0.01, 6  # m, edge of a cube, and points of a model that it keeps; ours
LEAST_KEPT = 0.7  # share of a model's points; a frame that sees through more of it is wrong
HALF_CELLS = 1 << 20  # cubes to each side of the origin


def supported(points: Array, previous: Sequence[KdTree], epsilon: float) -> NDArray[np.bool_]:
    """Equation 1: which points (n, 3) lie within epsilon m of all previous observations.

    Strictly: the nearest point of each observation is nearer than epsilon.
    """
    keep = np.ones(len(points), dtype=bool)
    for tree in previous:
        if not keep.any():
            break
        _, distance = nearest(tree, points[keep])
        keep[np.nonzero(keep)[0]] = distance < epsilon
    return keep


def thinned(points: Array, n: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Rows, in order, of a random n of the points (m, 3) m, m >= n, that forgets no part of them.

    Of each cube of CUBE_M at least LEAST_IN_CUBE stay, as far as it has so many and all of them fit
    in: else a part that is out of view would be thinned away by what is merged elsewhere.
    """
    cells = np.floor(points / CUBE_M).astype(np.int64) + HALF_CELLS
    key = (cells[:, 0] * 2 * HALF_CELLS + cells[:, 1]) * 2 * HALF_CELLS + cells[:, 2]
    order = np.lexsort((rng.random(len(points)), key))
    starts = np.flatnonzero(np.diff(key[order], prepend=key[order[0]] - 1))
    counts = np.diff(starts, append=len(points))
    rank = np.arange(len(points)) - np.repeat(starts, counts)
    # of a model that is larger than all of these the cubes share what there is
    fit = int(np.searchsorted(np.cumsum(np.bincount(rank)), n, side="right"))
    least = min(LEAST_IN_CUBE, fit)
    kept, rest = order[rank < least], order[rank >= least]
    return np.sort(np.concatenate([kept, rng.choice(rest, n - len(kept), replace=False)]))


class Fusion:
    """Q_t and the last n_s accepted observations, in the model frame, which moves with the object.

    This equals moving them into each new camera frame, but rounding errors don't add up.
    """

    def __init__(self, config: FusionConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        self.model: Model | None = None
        self._previous: list[KdTree] = []

    def step(
        self,
        observation: Observation,
        T_model_camera: Array,
        rng: np.random.Generator,
        seen_through: NDArray[np.bool_] | None = None,
    ) -> int:
        """Merge an accepted observation; returns the number of points of P″_t.

        Points without a normal are not merged. rng thins a model of too many points. seen_through:
        of the model's points those that are taken out, while enough others remain.
        """
        if self.model is not None and seen_through is not None:
            stays = ~seen_through
            if stays.sum() >= LEAST_KEPT * len(stays):
                self.model = Model(self.model.points[stays], self.model.normals[stays])
        has_normal = np.einsum("ij,ij->i", observation.normals, observation.normals) > 0.5
        points = transform(T_model_camera, observation.points)
        normals = observation.normals @ T_model_camera[:3, :3].T
        keep = supported(points, self._previous, self.config.epsilon)
        self._previous = [*self._previous, KdTree(points)][-self.config.n_s :]
        merged = keep & has_normal
        if self.model is not None:
            points = np.concatenate([self.model.points, points[merged]])
            normals = np.concatenate([self.model.normals, normals[merged]])
        else:
            points, normals = points[merged], normals[merged]
        if len(points) > self.config.max_model_points:
            chosen = thinned(points, self.config.max_model_points, rng)
            points, normals = points[chosen], normals[chosen]
        self.model = Model(points, normals)
        return int(keep.sum())
