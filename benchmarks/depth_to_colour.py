"""Registers the depth image of an unregistered camera pair to the colour camera.

The optical axes are taken as parallel, as in the first Kinect. So one focal length and one shift
along x describe the colour camera.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from dgeval.geometry import Array, Intrinsics
from numpy.typing import NDArray


@dataclass(frozen=True)
class ColourCamera:
    """The colour camera: focal length, px, and position on the depth camera's x axis, m."""

    focal: float
    baseline: float

    def intrinsics(self, depth_camera: Intrinsics) -> Intrinsics:
        return replace(depth_camera, fx=self.focal, fy=self.focal)

    def T_depth_colour(self) -> Array:
        T = np.eye(4)
        T[0, 3] = self.baseline
        return T

    def register(self, depth: NDArray[np.float32], camera: Intrinsics) -> NDArray[np.uint16]:
        """Depth (H, W) m of the depth camera -> depth (H, W) mm in the colour camera.

        0 where there is none. Of several points on one pixel the nearest is kept.
        """
        v, u = np.nonzero(depth)
        z = depth[v, u].astype(np.float64)
        x = ((u - camera.cx) / camera.fx * z - self.baseline) / z * self.focal + camera.cx
        y = (v - camera.cy) / camera.fy * self.focal + camera.cy
        column, row = np.rint(x).astype(int), np.rint(y).astype(int)
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        out = np.full(depth.shape, np.inf)
        np.minimum.at(out, (row[inside], column[inside]), z[inside])
        return np.where(np.isfinite(out), np.round(out * 1000), 0).astype(np.uint16)
