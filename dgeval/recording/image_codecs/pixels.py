"""What an image codec returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Pixels:
    """Decoded pixels (H, W) or (H, W, C) and their encoding by sensor_msgs (rgb8, 16UC1, …).

    unit: m per unit of depth where the file states it, else None.
    """

    array: NDArray[Any]
    encoding: str
    unit: float | None = None


def eight_bit(array: NDArray[Any]) -> NDArray[np.uint8]:
    """8-bit values of a picture of 8 or 16 bits, white for white."""
    if array.dtype == np.uint8:
        return array
    return np.asarray((array.astype(np.uint32) * 255 + 32767) // 65535, dtype=np.uint8)
