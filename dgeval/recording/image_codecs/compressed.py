"""sensor_msgs/CompressedImage with JPEG, PNG, WebP or AVIF inside, colour or 16-bit depth."""

from __future__ import annotations

from typing import Any

import numpy as np

from dgeval.recording.image_codecs.depth_png import PNG_START, decoded
from dgeval.recording.image_codecs.pixels import Pixels, eight_bit

JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"
WEBP, AVIF = b"WEBP", b"ftypavif"  # from the 8th and from the 4th byte on


ORDER = 30  # kinds with a lower number are asked first


def accepts(message: Any) -> bool:
    return hasattr(message, "format") and "compresseddepth" not in message.format.lower()


def decode(message: Any) -> Pixels:
    """Pixels as OpenCV gives them, blue first; 16-bit single-channel images are depth.
    Colour of 16 bits is given with 8.

    ValueError where the bytes are not an image.
    """
    data = bytes(memoryview(message.data))
    if data.startswith(JPEG_START):
        if JPEG_END not in data[-64:]:
            raise ValueError("the JPEG is cut: no end marker")
    elif not (data.startswith(PNG_START) or data[8:12] == WEBP or data[4:12] == AVIF):
        what = "the bytes are neither JPEG, PNG, WebP nor AVIF"
        raise ValueError(f"format {message.format!r}: {what}")
    array = decoded(data)
    if array is None:
        raise ValueError(f"format {message.format!r}: the image can't be decoded")
    if array.ndim == 2:
        return Pixels(array, "16UC1" if array.dtype == np.uint16 else "mono8")
    array = eight_bit(array)
    return Pixels(array, "bgra8" if array.shape[2] == 4 else "bgr8")
