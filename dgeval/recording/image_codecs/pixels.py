"""What an image codec returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Pixels:
    """Decoded pixels (H, W) or (H, W, C) and their encoding by sensor_msgs (rgb8, 16UC1, …).

    unit: m per unit of depth where the file states it, else None.
    """

    array: NDArray[Any]
    encoding: str
    unit: float | None = None
