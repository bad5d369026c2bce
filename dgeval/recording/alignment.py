"""Depth of one camera brought into the image of another, as librealsense's align does it.

Each depth pixel is a small square: its corners are projected into the colour image, and the pixels
between them get its depth. Where several fall on one pixel the nearest counts, so what the colour
camera can't see does not shine through.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dgeval.geometry import Array, Intrinsics

WIDEST_PX = 8  # px; a depth pixel that would cover more is at a pole of the projection


@dataclass(frozen=True)
class Alignment:
    """From the depth camera's image into the colour camera's.

    T_colour_depth (4, 4) m: maps points of the depth camera's frame into the colour camera's.
    """

    depth: Intrinsics
    colour: Intrinsics
    T_colour_depth: Array

    def apply(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Depth (Hd, Wd) m, 0 for none -> (H, W) m in the colour image, 0 for none.

        ValueError for an image of another size than the depth camera's.
        """
        if depth.shape != (self.depth.height, self.depth.width):
            size = f"{self.depth.width}x{self.depth.height}"
            raise ValueError(f"depth {depth.shape[1]}x{depth.shape[0]} is not {size}")
        d, c = self.depth, self.colour
        out = np.zeros((c.height, c.width), np.float32)
        _fill(
            np.ascontiguousarray(depth),
            np.array([d.fx, d.fy, d.cx, d.cy]),
            np.array([c.fx, c.fy, c.cx, c.cy]),
            np.ascontiguousarray(self.T_colour_depth[:3, :4]),
            out,
        )
        return out


@njit(cache=True)
def _fill(
    depth: NDArray[np.float32], kd: Array, kc: Array, T: Array, out: NDArray[np.float32]
) -> None:
    """Nearest depth on each colour pixel that a depth pixel covers."""
    height, width = out.shape
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            if z <= 0.0:
                continue
            # the pixel's first corner in the colour camera's frame, and its two sides
            x, y = (u - 0.5 - kd[2]) / kd[0], (v - 0.5 - kd[3]) / kd[1]
            X = (T[0, 0] * x + T[0, 1] * y + T[0, 2]) * z + T[0, 3]
            Y = (T[1, 0] * x + T[1, 1] * y + T[1, 2]) * z + T[1, 3]
            Z = (T[2, 0] * x + T[2, 1] * y + T[2, 2]) * z + T[2, 3]
            a, b = z / kd[0], z / kd[1]
            left = top = np.inf
            right = bottom = -np.inf
            middle, in_front = 0.0, True
            for corner in range(4):
                p, q = a * (corner % 2), b * (corner // 2)
                there = Z + T[2, 0] * p + T[2, 1] * q
                if there <= 0.01:
                    in_front = False
                    break
                near = 1.0 / there
                uc = (X + T[0, 0] * p + T[0, 1] * q) * near * kc[0] + kc[2]
                vc = (Y + T[1, 0] * p + T[1, 1] * q) * near * kc[1] + kc[3]
                left, right = min(left, uc), max(right, uc)
                top, bottom = min(top, vc), max(bottom, vc)
                middle += there / 4
            if not in_front:
                continue
            if right - left > WIDEST_PX or bottom - top > WIDEST_PX:
                continue
            # the pixels whose middle lies inside; where none does, the nearest one
            first_u, last_u = int(np.ceil(left)), int(np.ceil(right)) - 1
            first_v, last_v = int(np.ceil(top)), int(np.ceil(bottom)) - 1
            if last_u < first_u:
                first_u = last_u = int(np.rint((left + right) / 2))
            if last_v < first_v:
                first_v = last_v = int(np.rint((top + bottom) / 2))
            nearness = np.float32(middle)
            for row in range(max(first_v, 0), min(last_v, height - 1) + 1):
                for column in range(max(first_u, 0), min(last_u, width - 1) + 1):
                    if out[row, column] == 0.0 or nearness < out[row, column]:
                        out[row, column] = nearness
