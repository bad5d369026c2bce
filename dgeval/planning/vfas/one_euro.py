"""The 1€ filter (Casiez, Roussel, Vogel, CHI 2012), of numbers and of poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgeval.config import OneEuroConfig
from dgeval.geometry import (
    Array,
    interpolate_pose,
    matrix_from_pose,
    pose_from_matrix,
    rotation_angle,
)


def smoothing(cutoff: float | Array, seconds: float) -> float | Array:
    """Smoothing factor alpha of a first-order low-pass with a cutoff in Hz, over a period in s."""
    return 1.0 / (1.0 + 1.0 / (2 * np.pi * cutoff * seconds))


@dataclass
class OneEuroFilter:
    """1€ filter of numbers or arrays, each entry by itself.

    min_cutoff and d_cutoff in Hz, beta in s per unit of x: cutoff = min_cutoff + beta |speed|.
    """

    min_cutoff: float = 1.0
    beta: float = 0.0
    d_cutoff: float = 1.0
    value: Array | None = None
    speed: Array | None = None

    def step(self, x: Array, seconds: float) -> Array:
        """Filtered x, `seconds` after the previous sample; the first sample is not changed."""
        x = np.asarray(x, dtype=float)
        if self.value is None or self.speed is None:
            self.value, self.speed = x, np.zeros_like(x)
            return x
        # as in the author's later code: the speed is against the previous FILTERED value
        a = smoothing(self.d_cutoff, seconds)
        self.speed = a * (x - self.value) / seconds + (1 - a) * self.speed
        alpha = smoothing(self.min_cutoff + self.beta * np.abs(self.speed), seconds)
        self.value = alpha * x + (1 - alpha) * self.value
        return self.value


class PoseFilter:
    """1€ filter of a pose: position by axis, rotation by slerp with a cutoff from the angular
    speed.

    Ours: the paper says "a simple low pass filter" of the pose and gives no parameters
    (docs/papers.md, "Low pass").
    """

    def __init__(self, config: OneEuroConfig) -> None:
        self._config = config
        self._position = OneEuroFilter(
            config.position_cutoff, config.position_beta, config.d_cutoff
        )
        self._rotation: Array | None = None
        self._angular_speed = 0.0

    def shift(self, offset: Array) -> None:
        """Carry the state along with an object that is known to have moved by offset (3,) m."""
        if self._position.value is not None:
            self._position.value = self._position.value + offset

    def step(self, T: Array, seconds: float) -> Array:
        """Filtered pose (4, 4), `seconds` after the one before it."""
        out = np.eye(4)
        out[:3, 3] = self._position.step(T[:3, 3], seconds)
        if self._rotation is None:
            self._rotation = T[:3, :3]
        else:
            c = self._config
            a = smoothing(c.d_cutoff, seconds)
            self._angular_speed = float(
                a * rotation_angle(self._rotation.T @ T[:3, :3]) / seconds
                + (1 - a) * self._angular_speed
            )
            alpha = float(
                smoothing(c.rotation_cutoff + c.rotation_beta * self._angular_speed, seconds)
            )
            before, now = np.eye(4), np.eye(4)
            before[:3, :3], now[:3, :3] = self._rotation, T[:3, :3]
            between = interpolate_pose(pose_from_matrix(before), pose_from_matrix(now), alpha)
            self._rotation = matrix_from_pose(between)[:3, :3]
        out[:3, :3] = self._rotation
        return out
