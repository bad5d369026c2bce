"""One paired frame as the stages see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Intrinsics
from dgeval.robots.description import LinkShape


@dataclass(frozen=True, slots=True)
class RecordedGrasp:
    """The robot's own belief at a time: its chosen grasp T_base_palm (4, 4), score of the hand pose or None."""

    T_base_palm: Array
    score: float | None


@dataclass(frozen=True)
class Frame:
    """Colour (H, W, 3) uint8 RGB and depth (H, W) float32 m aligned to it, 0 = none, with the robot at that time.

    `hand` are the hand's solids with T_camera_shape; None where hand geometry is not known. `colour_file` is the image as
    recorded where it was compressed, for the review recording.
    """

    index: int
    t_ns: int
    colour: NDArray[np.uint8]
    depth: NDArray[np.float32]
    camera: Intrinsics
    T_base_camera: Array | None
    T_base_palm: Array | None
    hand: list[tuple[LinkShape, Array]] | None = None
    grasp: RecordedGrasp | None = None
    colour_file: bytes | None = None
