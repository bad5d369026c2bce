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

    def previous_are(self, observations: Sequence[Array]) -> None:
        """Take these, (n, 3) m, model frame, in place of the last accepted observations."""
        self._previous = [KdTree(points) for points in observations]

    def step(
        self, observation: Observation, T_model_camera: Array, rng: np.random.Generator
    ) -> int:
        """Merge an accepted observation; returns the number of points of P″_t.

        Points without a normal are not merged. rng thins a model of too many points.
        """
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
            chosen = np.sort(rng.choice(len(points), self.config.max_model_points, replace=False))
            points, normals = points[chosen], normals[chosen]
        self.model = Model(points, normals)
        return int(keep.sum())
