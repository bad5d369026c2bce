"""One paired frame: what the stages get to work on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Intrinsics
from dgeval.robots.description import LinkShape


@dataclass(frozen=True, slots=True)
class RecordedGrasp:
    """The grasp that the robot had chosen: T_base_palm (4, 4), and its score of the hand pose."""

    T_base_palm: Array
    score: float | None


@dataclass(frozen=True)
class Frame:
    """Colour and depth at a time, with the state of the robot.

    colour: (H, W, 3) uint8 RGB. depth: (H, W) float32, m, aligned to colour, 0 = no reading. hand:
    its solids with T_camera_shape; None where the hand's geometry is not known. grasp: the newest
    one in the log, or None. colour_file: the image's bytes as recorded where it was compressed, for
    the review recording.
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
