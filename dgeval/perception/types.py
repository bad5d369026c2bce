"""What passes between the stages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgeval.failure_rule import Tracking
from dgeval.geometry import Array
from dgeval.perception.plane import Plane

Window = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Model:
    """The model cloud Q in the model frame: points (n, 3) m, unit normals (n, 3), towards where they were seen from."""

    points: Array
    normals: Array


@dataclass(frozen=True, slots=True)
class Features:
    """Image features followed on the target: model points (n, 3) m and where they are seen now (n, 2) px."""

    points: Array
    pixels: Array


@dataclass(frozen=True)
class Tracked:
    """The image tracker's word on one frame.

    `box` x0 y0 x1 y1 px (inside the image), `mask` the target's pixels with usable depth inside `window`
    (x0, y0, x1, y1), T_camera_model the tracker's own pose where it has one.
    """

    state: Tracking
    box: tuple[float, float, float, float] | None = None
    window: Window | None = None
    mask: NDArray[np.bool_] | None = None
    mask_area: int = 0
    T_camera_model: Array | None = None
    features: Features | None = None
    plane: Plane | None = None


@dataclass(frozen=True, slots=True)
class Observation:
    """P_t in the camera frame: points (n, 3) m with unit normals (n, 3); zero normals where none could be had."""

    points: Array
    normals: Array


@dataclass(frozen=True, slots=True)
class Registration:
    """One registration and the gate's word on it. `reject_reason` is None when accepted."""

    T_camera_model: Array
    fitness: float
    gate_fitness: float
    rmse: float | None
    reject_reason: str | None

    @property
    def accepted(self) -> bool:
        return self.reject_reason is None
