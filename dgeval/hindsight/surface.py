"""What the causal pass hands to the second: its frames, and all surface it ever accepted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgeval.geometry import Array
from dgeval.perception.plane import Plane
from dgeval.perception.types import Model
from dgeval.replay.causal import Step
from dgeval.worlds.shape import LEAST_POINTS, well_surrounded

CELL = 0.003  # m; edge of a voxel, of which the kept surface has one point each


class Surface:
    """The mean point and normal of every voxel of the model that was ever accepted, model frame.

    The paper's model keeps a random subset of points: after some tens of near frames it holds
    little but the last view. Voxels keep early views as well.
    """

    def __init__(self) -> None:
        self._cells = np.zeros(0, dtype=np.int64)
        self._sums = np.zeros((0, 7))  # by voxel: sums of position and normal, count

    def add(self, model: Model) -> None:
        """Add the model cloud of an accepted frame."""
        at = np.floor(model.points / CELL).astype(np.int64) + 2**20
        cells, inverse = np.unique(
            (at[:, 0] << 42) | (at[:, 1] << 21) | at[:, 2], return_inverse=True
        )
        sums = np.zeros((len(cells), 7))
        np.add.at(sums, inverse, np.column_stack([model.points, model.normals, np.ones(len(at))]))
        both = np.union1d(self._cells, cells)
        merged = np.zeros((len(both), 7))
        merged[np.searchsorted(both, self._cells)] = self._sums
        merged[np.searchsorted(both, cells)] += sums
        self._cells, self._sums = both, merged

    def model(self) -> Model | None:
        """Points and unit normals of the voxels; None where nothing was added.

        Points without neighbours are left out, if enough others remain: what a single frame took
        for the object stays in its voxels for ever.
        """
        if not len(self._cells):
            return None
        sums = self._sums
        kept = well_surrounded(sums[:, :3] / sums[:, 6:])
        if kept.sum() >= LEAST_POINTS:
            sums = sums[kept]
        points = sums[:, :3] / sums[:, 6:]
        normals = sums[:, 3:6]
        return Model(
            points, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        )


@dataclass(frozen=True)
class CausalFrame:
    """One frame of the causal pass.

    T_camera_model: by an accepted registration, or None. T_tracked: by the tracker where it had the
    target, from n_depth depth pixels or n_features colour features; else None. support: the plane
    the object stands on, base frame, or None.
    """

    index: int
    t_ns: int
    T_base_camera: Array
    T_camera_model: Array | None
    T_tracked: Array | None
    n_features: int
    n_depth: int
    support: Plane | None


def causal_frame_of(step: Step) -> CausalFrame | None:
    """What the second pass needs of a causal frame; None where the camera's pose is not known."""
    if step.T_base_camera is None:
        return None
    plane = step.tracked.plane
    support = None if plane is None else plane.moved(step.T_base_camera)
    accepted = step.T_camera_model if step.accepted else None
    tracked = step.tracked
    n_features = 0 if tracked.features is None else len(tracked.features.points)
    T_tracked = tracked.T_camera_model if tracked.state == "tracked" else None
    frame = step.frame
    return CausalFrame(
        frame.index,
        frame.t_ns,
        step.T_base_camera,
        accepted,
        T_tracked,
        n_features,
        tracked.mask_area,
        support,
    )
