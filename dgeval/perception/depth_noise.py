"""The noise of depth between two frames, measured on the recording itself.

The last frame's points are carried into this one by the camera's motion. What their depth then
differs by, on smooth surfaces, is the noise of two readings.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Intrinsics, depth_sigma, invert, transform
from dgeval.recording.frame import Frame

NEAREST_M, FARTHEST_M, BIN_M = 0.2, 3.2, 0.2  # m, of the ranges in which noise is measured
STEP_PX = 6  # every so many pixels, in both directions
EVERY = 5  # frames; of these one pair is measured
SMOOTH_M = 0.020  # m, within 5 x 5 pixels: on slopes and at edges a pixel's place is worth more
MOST_M, LEVEL_M = 0.05, 5e-4  # m, of differences that count, and how finely they are counted
LEAST = 400  # differences, from which on the noise at a range is known
# times the noise of the sensor model, within which a measured one is believed: beyond it poses
# are wrong, or something else moves
BELIEVED = 1.0, 3.0
TOLD_M = 0.5  # m, at which a noise that is not measured is told


@dataclass
class DepthNoise:
    """Standard deviation of depth by range: the sensor model's until it is measured.

    counts (r, d): how often the depth at a range differed by so much between two frames.
    """

    counts: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros(
            (round((FARTHEST_M - NEAREST_M) / BIN_M), round(MOST_M / LEVEL_M)), np.int64
        )
    )
    _before: tuple[int, NDArray[np.float32], Array] | None = None

    def see(self, frame: Frame, T_base_camera: Array | None) -> None:
        """Take a frame in. Without the camera's pose (4, 4) nothing is measured."""
        before, self._before = self._before, None
        if T_base_camera is None:
            return
        if frame.index % EVERY == 0:
            self._before = frame.index, frame.depth, T_base_camera
        elif before is not None and before[0] == frame.index - 1:
            T_now_before = invert(T_base_camera) @ before[2]
            self._count(before[1], frame.depth, frame.camera, T_now_before)

    def _count(
        self,
        before: NDArray[np.float32],
        depth: NDArray[np.float32],
        camera: Intrinsics,
        T_now_before: Array,
    ) -> None:
        z = before[::STEP_PX, ::STEP_PX].astype(np.float64)
        v, u = np.nonzero(z > 0)
        points = camera.backproject(u * float(STEP_PX), v * float(STEP_PX), z[v, u])
        points = transform(T_now_before, points)
        points = points[points[:, 2] > NEAREST_M]
        at = np.rint(camera.project(points)).astype(int)
        inside = (at >= 0).all(axis=1) & (at[:, 0] < depth.shape[1]) & (at[:, 1] < depth.shape[0])
        points, at = points[inside], at[inside]
        square = np.ones((5, 5), np.uint8)
        low, high = cv2.erode(depth, square), cv2.dilate(depth, square)
        smooth = (low > 0) & (high - low < SMOOTH_M)
        on = smooth[at[:, 1], at[:, 0]]
        points, at = points[on], at[on]
        apart = np.abs(points[:, 2] - depth[at[:, 1], at[:, 0]])
        near = (apart < MOST_M) & (points[:, 2] < FARTHEST_M)
        row = ((points[near, 2] - NEAREST_M) / BIN_M).astype(int)
        np.add.at(self.counts, (row, (apart[near] / LEVEL_M).astype(int)), 1)

    def sigma(self, z: Array) -> Array:
        """Standard deviation (n,) m of depth at ranges (n,) m."""
        model = depth_sigma(z)
        return np.asarray(model * self.factor(z))

    def factor(self, z: Array) -> Array:
        """(n,) of the measured noise against the sensor model's; 1 where it is not measured."""
        known, factors = self.measured()
        if not len(known):
            return np.ones(len(z))
        return np.asarray(np.interp(z, known, factors))

    def told(self) -> str:
        """For a trial's notes: the noise where it is known, and by what."""
        known, factors = self.measured()
        if not len(known):
            z = TOLD_M
            return (
                f"depth noise: {depth_sigma(z) * 1e3:.1f} mm at {z:g} m by the sensor model, not "
                "measured: no camera poses, or too little that stands still and is smooth"
            )
        ends = sorted({0, len(known) - 1})
        sigmas = [
            f"{f * depth_sigma(z) * 1e3:.1f} mm at {z:.2f} m"
            for z, f in zip(known[ends], factors[ends], strict=True)
        ]
        return f"depth noise: {', '.join(sigmas)}, measured between frames by the camera's poses"

    def measured(self) -> tuple[Array, Array]:
        """Ranges (r,) m in which the noise is known, and its factor on the sensor model's (r,)."""
        enough = self.counts.sum(axis=1) >= LEAST
        ranges = NEAREST_M + BIN_M * (np.flatnonzero(enough) + 0.5)
        counts = self.counts[enough]
        below = np.cumsum(counts, axis=1)
        half = 0.5 * below[:, -1:]
        level = (below < half).sum(axis=1)
        rows = np.arange(len(level))
        under = below[rows, level] - counts[rows, level]
        share = (half[:, 0] - under) / np.maximum(counts[rows, level], 1)
        # the median of a normal deviation is 0.674 of its standard deviation, that of two readings
        # is the square root of two times as large
        sigmas = (level + share) * LEVEL_M / 0.6745 / np.sqrt(2)
        factors = np.clip(sigmas / depth_sigma(ranges), *BELIEVED)
        return np.asarray(ranges, dtype=np.float64), np.asarray(factors, dtype=np.float64)
