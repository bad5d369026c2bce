"""From image messages to the arrays that the stages use: colour as RGB, depth in metres."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.errors import describe
from dgeval.recording.image_codecs import codecs
from dgeval.recording.image_codecs.pixels import Pixels

# conversion of each encoding that is colour but not RGB
TO_RGB = {
    "bgr8": cv2.COLOR_BGR2RGB,
    "8UC3": cv2.COLOR_BGR2RGB,
    "8UC4": cv2.COLOR_BGRA2RGB,
    "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB,
    "mono8": cv2.COLOR_GRAY2RGB,
    "8UC1": cv2.COLOR_GRAY2RGB,
}
NO_READING = np.iinfo(np.uint16).max  # as some drivers write it
DEPTH_ENCODINGS = frozenset({"16UC1", "mono16", "Z16", "32FC1"})


def decode_image(message: Any) -> Pixels:
    """Pixels of an image message of any supported kind; ValueError says what is wrong."""
    for codec in codecs():
        if codec.accepts(message):
            try:
                pixels: Pixels = codec.decode(message)
            except (TypeError, AttributeError, LookupError, OverflowError, cv2.error) as error:
                raise ValueError(f"its fields are not an image's ({describe(error)})") from error
            return pixels
    raise ValueError("not an image message")


# m, from which on a value may stand for no reading; share of the picture that has it at least; and
# of it, before which all readings lie; ours
LEAST_FILLER_M, LEAST_FILLED, BEFORE = 5.0, 0.02, 0.8


def colour_from(pixels: Pixels) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB; ValueError for encodings that are not colour."""
    if pixels.encoding == "rgb8":
        return pixels.array
    if pixels.encoding not in TO_RGB:
        raise ValueError(f"{pixels.encoding} is not a colour image")
    return np.asarray(cv2.cvtColor(pixels.array, TO_RGB[pixels.encoding]), dtype=np.uint8)


def depth_from(pixels: Pixels, scale: float | None) -> NDArray[np.float32]:
    """(H, W) float32 m, 0 where there is no reading (0, NaN, infinite, negative, 65535, one
    far value in many pixels).

    scale: m per unit; None is what the file states, else the ROS convention: millimetres in
    integers, metres in floats.
    """
    scale = pixels.unit if scale is None else scale
    if pixels.encoding not in DEPTH_ENCODINGS:
        raise ValueError(f"{pixels.encoding} is not a depth image")
    if pixels.array.dtype == np.uint16:
        depth = pixels.array.astype(np.float32)
        depth *= np.float32(0.001 if scale is None else scale)
        if pixels.array.max(initial=0) == NO_READING:
            depth[pixels.array == NO_READING] = 0.0
    else:
        depth = pixels.array.astype(np.float32) * np.float32(1.0 if scale is None else scale)
        depth[~(np.isfinite(depth) & (depth > 0))] = 0.0
    _drop_filler(depth)
    return depth


def _drop_filler(depth: NDArray[np.float32]) -> None:
    """Set to 0 what some drivers write where there is no reading: one value far behind all others,
    in many pixels.
    """
    farthest = float(depth.max(initial=0.0))
    if farthest < LEAST_FILLER_M:
        return
    filler = depth == farthest
    if filler.mean() >= LEAST_FILLED and depth.max(where=~filler, initial=0.0) < BEFORE * farthest:
        depth[filler] = 0.0
