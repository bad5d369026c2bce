"""PNG of one channel and 16 bits, as depth is stored: a half of OpenCV's time and less.

Inflated by libdeflate (`deflate`), the rows' filters undone by a kernel of ours. Only a whole file
of the plain form is read so; anything else, damage too, is left to OpenCV, which then decides.
"""

from __future__ import annotations

import struct
import zlib

import cv2
import deflate
import numpy as np
from numba import njit
from numpy.typing import NDArray

PNG_START = b"\x89PNG\r\n\x1a\n"
# chunks that say nothing of the readings; any other than these and the image's own is OpenCV's
WITHOUT_MEANING = frozenset({b"pHYs", b"tEXt", b"zTXt", b"iTXt", b"tIME"})
MOST_BYTES = 2**28  # of readings, 128 million; a larger claim is OpenCV's to refuse


def depth_codes(data: bytes) -> NDArray[np.uint16] | None:
    """(H, W) as `cv2.imdecode` with IMREAD_UNCHANGED gives it; None where this is no such PNG.

    Equal to OpenCV's in every bit (PNG specification, "Filtering").
    """
    packed = _packed(data)
    if packed is None:
        return None
    width, height, stream = packed
    try:
        rows = deflate.zlib_decompress(stream, height * (1 + 2 * width))
    except (deflate.DeflateError, ValueError):
        return None
    if len(rows) != height * (1 + 2 * width):
        return None
    out = np.empty((height, width), np.uint16)
    return out if _unfilter(np.frombuffer(rows, np.uint8).reshape(height, -1), out) else None


def decoded(data: bytes) -> NDArray[np.generic] | None:
    """A picture of any kind that OpenCV reads, unchanged; None where it reads none."""
    codes = depth_codes(data) if data.startswith(PNG_START) else None
    if codes is not None:
        return codes
    array: NDArray[np.generic] | None = cv2.imdecode(
        np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED
    )
    return array


def _packed(data: bytes) -> tuple[int, int, bytes] | None:
    """Width, height and the packed rows of a whole file of the plain form."""
    at, parts, size = len(PNG_START), [], None
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data):
            return None
        body = memoryview(data)[at + 4 : end - 4]
        if zlib.crc32(body) != int.from_bytes(data[end - 4 : end], "big"):
            return None
        if kind == b"IHDR" and size is None and length == 13:
            width, height, *rest = struct.unpack_from(">II5B", data, at + 8)
            if rest != [16, 0, 0, 0, 0] or not 0 < 2 * width * height <= MOST_BYTES:
                return None
            size = (width, height)
        elif kind == b"IDAT" and size is not None:
            parts.append(body[4:])
        elif kind == b"IEND":
            return None if size is None else (*size, b"".join(parts))
        elif kind not in WITHOUT_MEANING:
            return None
        at = end
    return None


@njit(cache=True)
def _paeth(left: np.int32, up: np.int32, corner: np.int32) -> np.int32:
    """Of the three the one nearest to left + up - corner; before all the left, then the upper."""
    by_left, by_up = abs(up - corner), abs(left - corner)
    by_corner = abs(left + up - 2 * corner)
    other = up if by_up <= by_corner else corner
    return left if (by_left <= by_up) & (by_left <= by_corner) else other


@njit(cache=True)
def _unfilter(rows: NDArray[np.uint8], out: NDArray[np.uint16]) -> bool:
    """Fill `out` (H, W) from rows of a filter's number and 2 W bytes; False: no such filter.

    A reading's high and low byte are filtered apart, each by its neighbours of the same kind.
    """
    height, width = out.shape
    above, zero = np.zeros(width, np.uint16), np.int32(0)
    for y in range(height):
        kind, row, now = rows[y, 0], rows[y, 1:], out[y]
        if kind == 0:
            for x in range(width):
                now[x] = (np.uint16(row[2 * x]) << 8) | row[2 * x + 1]
        elif kind == 1:
            high, low = zero, zero
            for x in range(width):
                high += row[2 * x]
                low += row[2 * x + 1]
                now[x] = ((high & 0xFF) << 8) | (low & 0xFF)
        elif kind == 2:
            for x in range(width):
                high, low = (above[x] >> 8) + row[2 * x], (above[x] & 0xFF) + row[2 * x + 1]
                now[x] = ((high & 0xFF) << 8) | (low & 0xFF)
        elif kind == 3:
            high, low = zero, zero
            for x in range(width):
                high = (((high + np.int32(above[x] >> 8)) >> 1) + np.int32(row[2 * x])) & 0xFF
                low = (((low + np.int32(above[x] & 0xFF)) >> 1) + np.int32(row[2 * x + 1])) & 0xFF
                now[x] = (high << 8) | low
        elif kind == 4:
            high, low, corner_high, corner_low = zero, zero, zero, zero
            for x in range(width):
                up_high, up_low = np.int32(above[x] >> 8), np.int32(above[x] & 0xFF)
                high = (_paeth(high, up_high, corner_high) + np.int32(row[2 * x])) & 0xFF
                low = (_paeth(low, up_low, corner_low) + np.int32(row[2 * x + 1])) & 0xFF
                corner_high, corner_low = up_high, up_low
                now[x] = (high << 8) | low
        else:
            return False
        above = now
    return True
