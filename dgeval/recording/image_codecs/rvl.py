"""RVL, the run-length code of depth images (Wilson, 2017), as image_transport stores it.

Runs of zeros and of readings take turns; readings are differences, zigzag coded. All numbers are
written three bits at a time in nibbles, high nibbles first in 32-bit little-endian words.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def readings(data: bytes, count: int) -> NDArray[np.uint16]:
    """(count,) depth codes. ValueError where the words end early, or hold more than `count`."""
    if len(data) % 4:
        data = data[: len(data) // 4 * 4]
    out = np.zeros(count, np.uint16)
    if _fill(np.frombuffer(data, "<u4").astype(np.uint32), out) != count:
        raise ValueError(f"the RVL words do not hold {count} readings")
    return out


@njit(cache=True)
def _fill(words: NDArray[np.uint32], out: NDArray[np.uint16]) -> int:
    """Fill `out`; how many were filled, -1 where the words end early or a run is too long."""
    n_nibbles, at, k, previous, zeros = 8 * len(words), 0, 0, 0, True
    left = 0
    while k < len(out):
        value, shift = 0, 0
        while True:
            if at >= n_nibbles or shift > 30:
                return -1
            nibble = (words[at >> 3] >> np.uint32(28 - 4 * (at & 7))) & np.uint32(0xF)
            at += 1
            value |= (int(nibble) & 7) << shift
            shift += 3
            if not nibble & 8:
                break
        if left > 0:
            previous += (value >> 1) ^ -(value & 1)
            out[k] = previous & 0xFFFF
            k += 1
            left -= 1
            continue
        if value > len(out) - k:
            return -1
        if zeros:
            k += value
        else:
            left = value
        zeros = not zeros
    return k
