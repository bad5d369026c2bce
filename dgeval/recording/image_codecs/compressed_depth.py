"""compressedDepth of ROS image_transport: 12 bytes of configuration, then a PNG or RVL.

They hold 16UC1 as it is, or 32FC1 as quantised inverse depth. The format text varies between ROS
versions ("16UC1; compressedDepth", "… png", "… rvl"), so the PNG is found by its signature.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgeval.recording.image_codecs import rvl
from dgeval.recording.image_codecs.depth_png import PNG_START, decoded
from dgeval.recording.image_codecs.pixels import Pixels

MOST_PIXELS = 16384  # a side; a larger claim is damage
HEADER_BYTES = 12  # ConfigHeader of compressed_depth_image_transport: format, a, b


ORDER = 20  # kinds with a lower number are asked first


def accepts(message: Any) -> bool:
    return hasattr(message, "format") and "compresseddepth" in message.format.lower()


def decode(message: Any) -> Pixels:
    """16UC1 as stored; 32FC1, m, from inverse depth: z = a / (code - b), code 0 = no reading.

    ValueError where the PNG, the RVL words or the header are missing or cut.
    """
    data = bytes(memoryview(message.data))
    start = data.find(PNG_START, 0, 64)
    codes = _rvl(message.format, data) if start < 0 else _png(message.format, data, start)
    if not message.format.strip().startswith("32FC1"):
        return Pixels(codes, "16UC1")
    if 0 <= start < HEADER_BYTES:
        raise ValueError(f"format {message.format!r}: the configuration header is missing")
    a, b = struct.unpack_from("<ff", data, 4)
    with np.errstate(divide="ignore", invalid="ignore"):
        metres = np.where(codes > 0, a / (codes.astype(np.float32) - b), 0.0)
    return Pixels(metres.astype(np.float32), "32FC1")


def _png(stated: str, data: bytes, start: int) -> NDArray[np.uint16]:
    codes = decoded(data[start:])
    if codes is None or codes.ndim != 2 or codes.dtype != np.uint16:
        raise ValueError(
            f"format {stated!r}: the PNG inside is damaged, or not of one channel and 16 bits"
        )
    return np.asarray(codes, dtype=np.uint16)


def _rvl(stated: str, data: bytes) -> NDArray[np.uint16]:
    """RVL is known by the format's word, or, where that names nothing, by a size that fits."""
    if len(data) < HEADER_BYTES + 8 or "png" in stated.lower():
        raise ValueError(f"format {stated!r}: neither a PNG nor RVL inside")
    width, height = struct.unpack_from("<ii", data, HEADER_BYTES)
    if not (0 < width <= MOST_PIXELS and 0 < height <= MOST_PIXELS):
        raise ValueError(f"format {stated!r}: no PNG inside, and RVL of {width}x{height} pixels")
    return rvl.readings(data[HEADER_BYTES + 8 :], width * height).reshape(height, width)
