"""How the hand closes, follows, lifts, and when it has something: the same in the simulator, the grasp search and the twin."""

from __future__ import annotations

import numpy as np

from dgeval.geometry import Array
from dgeval.worlds.scene import TIMESTEP

CONTROL_S = 0.010  # period of the control loop
SUBSTEPS = round(CONTROL_S / TIMESTEP)
# s, s, s, m: what every hand is given to close, then a wait, then the lift
CLOSE_S, SETTLE_S, LIFT_S, LIFT_HEIGHT = (
    0.4,
    0.1,
    0.7,
    0.20,
)  # wait after the closing ramp, lift (m)
MIN_LIFT, MAX_FROM_HAND = 0.10, 0.15  # m: over its support; object's centre from the grasp's centre
AFTER_CLOSE_S = 0.6  # close times are tried until this long after the real one
TRUTH_STEP = 3  # control periods between the close times tried, 30 ms
NEAR = 0.08  # m; hand to object, where the window of other close times begins


def finishing_twist(since_close: float, velocity: Array) -> Array:
    """Palm twist (6,) after the close command: follow the object, then lift straight up while the following dies out."""
    twist = np.zeros(6)
    lift = since_close - CLOSE_S - SETTLE_S
    share = float(np.clip(lift / LIFT_S, 0.0, 1.0))
    twist[:3] = velocity * (1 - share)
    if 0 < share < 1:
        twist[2] += LIFT_HEIGHT / LIFT_S * 6 * share * (1 - share)
    return twist


def swing(since: float, metres: float) -> Array:
    """Sideways offset (2,) m of a shake at 5 Hz, to and fro by so much, begun at rest; its peak is metres * 493 / s^2."""
    return np.asarray(metres * (1 - np.cos(2 * np.pi * since / 0.2)) / 2 * np.array([0.8, 0.6]))
