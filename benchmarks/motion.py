"""Known rigid motions M(t) of the whole scene in the base frame.

Times s, lengths m, angles rad.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dgeval.geometry import Array, increment

STAND_S, GO_S = 1.0, 1.0  # s, of the motion stop-and-go
MODES: dict[str, tuple[str, float]] = {
    # name: (kind, m/s or rad/s)
    "still": ("linear", 0.0),
    "50mm/s": ("linear", 0.050),
    "200mm/s": ("linear", 0.200),
    "stop-and-go": ("steps", 0.100),
    "slow-yaw": ("yaw", float(np.deg2rad(10.0))),
}


@dataclass(frozen=True)
class Motion:
    """M(t): a shift along `direction` (unit, base axes), or a turn about base z at `pivot`, m."""

    mode: str
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)
    pivot: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def at(self, t: float) -> Array:
        """M(t) (4, 4), identity at t = 0."""
        kind, rate = MODES[self.mode]
        if kind == "yaw":
            M = increment(np.array([0, 0, 0, 0, 0, rate * t]))
            pivot = np.array(self.pivot)
            M[:3, 3] = pivot - M[:3, :3] @ pivot
            return M
        distance = rate * (t if kind == "linear" else steps(t))
        return increment(np.concatenate([distance * np.array(self.direction), np.zeros(3)]))

    def velocity(self, t: float, point: Array) -> Array:
        """Velocity (3,) m/s at t of a point that moves with M and is at `point` (3,) m.

        Both in the base frame.
        """
        kind, rate = MODES[self.mode]
        if kind == "yaw":
            return np.cross([0.0, 0.0, rate], point - np.array(self.pivot))
        moving = kind == "linear" or t % (STAND_S + GO_S) >= STAND_S
        return np.array(self.direction) * (rate if moving else 0.0)

    def starts(self, duration: float) -> list[float]:
        """Times, s, at which the motion starts after a stand, within the duration."""
        if MODES[self.mode][0] != "steps":
            return []
        return [float(t) for t in np.arange(STAND_S, duration, STAND_S + GO_S)]


def steps(t: float) -> float:
    """Seconds spent moving until t: stand, go, stand, go, …"""
    whole, rest = divmod(t, STAND_S + GO_S)
    return float(whole * GO_S + max(0.0, rest - STAND_S))
