"""One paired frame: what the stages get to work on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Box, Intrinsics
from dgeval.robots.description import LinkShape


@dataclass(frozen=True, slots=True)
class MarkedThing:
    """One thing that the log marks in a picture: as a mask, as a box, or by its pose.

    box: x0 y0 x1 y1 px, of the picture as frames hold it. name: what the log calls it in every
    picture; "" where it doesn't. pixels (h, w): of the box, of a mask only. T_camera_object (4, 4):
    of a pose only. is_point: the box is around the pose's origin and says nothing of the size.
    score: 0 to 1, of a detector that gives one.
    """

    box: Box
    name: str = ""
    pixels: NDArray[np.bool_] | None = None
    T_camera_object: Array | None = None
    is_point: bool = False
    score: float | None = None


@dataclass(frozen=True)
class Frame:
    """Colour and depth at a time, with the state of the robot.

    colour: (H, W, 3) uint8 RGB. depth: (H, W) float32, m, aligned to colour, 0 = no reading. hand:
    its solids with T_camera_shape; None where the hand's geometry is not known. colour_file: the
    image's bytes as recorded where it was compressed, for the review recording. marked: what the
    log marks in it, where the tracker asks for that. accepted: whether the robot merged it into its
    model, where that is asked for and recorded.
    """

    index: int
    t_ns: int
    colour: NDArray[np.uint8]
    depth: NDArray[np.float32]
    camera: Intrinsics
    T_base_camera: Array | None
    T_base_palm: Array | None
    hand: list[tuple[LinkShape, Array]] | None = None
    colour_file: bytes | None = None
    marked: tuple[MarkedThing, ...] = ()
    accepted: bool | None = None
