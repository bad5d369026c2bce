"""The data that pass between the stages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgeval.failure_rule import Tracking
from dgeval.geometry import Array
from dgeval.perception.plane import Plane

Window = tuple[int, int, int, int]  # x0, y0, x1, y1 px


@dataclass(frozen=True, slots=True)
class Model:
    """The model cloud Q, model frame: points (n, 3) m and unit normals (n, 3).

    Normals point to the side from which the point was observed.
    """

    points: Array
    normals: Array


@dataclass(frozen=True, slots=True)
class Features:
    """Image features on the target: points (n, 3) m, model frame, and their pixels (n, 2) now."""

    points: Array
    pixels: Array


@dataclass(frozen=True)
class Tracked:
    """The tracker's result for one frame.

    box: x0, y0, x1, y1 px, inside the image. mask: the target's pixels with usable depth in
    `window`; mask_area: their number. T_camera_model (4, 4): the tracker's own pose, if it has one.
    confidence: that box and mask are the target's, 0 to 1; None where the tracker doesn't say.
    pose_stands: that pose is a recorded one, which registration leaves as it is.
    occluded: something in front hides at least half of it. reacquired: it was lost in the frame
    before.
    """

    state: Tracking
    box: tuple[float, float, float, float] | None = None
    window: Window | None = None
    mask: NDArray[np.bool_] | None = None
    mask_area: int = 0
    T_camera_model: Array | None = None
    features: Features | None = None
    plane: Plane | None = None
    confidence: float | None = None
    occluded: bool = False
    reacquired: bool = False
    pose_stands: bool = False


@dataclass(frozen=True, slots=True)
class Observation:
    """P_t, camera frame: points (n, 3) m with unit normals (n, 3), zero where there is none."""

    points: Array
    normals: Array


@dataclass(frozen=True, slots=True)
class Registration:
    """One registration: T_camera_model (4, 4), its fit, rmse m, and the gate's decision.

    reject_reason: None if it is accepted.
    """

    T_camera_model: Array
    fitness: float
    gate_fitness: float
    rmse: float | None
    reject_reason: str | None

    @property
    def accepted(self) -> bool:
        return self.reject_reason is None


@dataclass(frozen=True, slots=True)
class Fused:
    """The model after a frame's registration and fusion.

    accepted: the frame was merged: it is the first, or its registration passed the gate.
    reject_reason: why there is no accepted registration; None where there is one, in the first
    frame, and before it. n_filtered: number of points of P''_t, of an accepted frame only.
    residual_translation: m, motion of the centred clouds, of an accepted registration only.
    model: Q_t. T_camera_model (4, 4): accepted, else predicted. centroid (3,): of the model, m,
    camera frame; None where the pose is not known or is older than `null_after_s`.
    """

    accepted: bool
    reject_reason: str | None = None
    n_filtered: int | None = None
    residual_translation: float | None = None
    model: Model | None = None
    T_camera_model: Array | None = None
    centroid: Array | None = None
