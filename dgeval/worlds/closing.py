"""How the hand closes, follows, lifts, and when it holds something.

The simulator, the grasp search and the twin use the same rule.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgeval.geometry import Array
from dgeval.robots.hand import LIFT_AFTER_S
from dgeval.worlds.scene import TIMESTEP

CONTROL_S = 0.010  # s, period of the control loop; ours
SUBSTEPS = round(CONTROL_S / TIMESTEP)  # physics steps in a control period
# All values below are ours; docs/simulation.md says what they do.
SETTLE_S = 0.1  # s, wait after the closing ramp
CLOSE_S = LIFT_AFTER_S - SETTLE_S  # s, that every known hand has to close
LIFT_S = 0.7  # s, duration of the lift
LIFT_HEIGHT = 0.20  # m
HOLD_S = 1.0  # s after the lift, through which a success must hold the object
MIN_LIFT = 0.10  # m over its support: a lifted object is at least as high
MAX_FROM_HAND = 0.15  # m, at most, from the grasp centre to the centre of a held object
SHAKE_S = 0.3  # s of the hold in which a shaken grasp is shaken, one and a half periods
# From this share of the lift's time on, a rise below this, m, means that the hand left the object
# behind: the hand has risen by 0.08 m then, after a lift as recorded by GIVEN_UP_RISE of the whole.
GIVEN_UP_SHARE, LEFT_BEHIND_M, GIVEN_UP_RISE = 0.45, 0.01, 0.4
AFTER_CLOSE_S = 0.6  # s after the real close, until which other close times are tried
TRUTH_STEP = 3  # control periods between the close times tried, 30 ms


@dataclass(frozen=True)
class Finish:
    """How a hand went on after its close command, as a log has it.

    twists (n, 6): of its base by control period, m/s and rad/s, base axes; after them it rests.
    """

    twists: Array

    @property
    def rises(self) -> Array:
        """(n,) m, of its base at the end of each period; the last is the lift's."""
        return np.asarray(np.cumsum(self.twists[:, 2]) * CONTROL_S)

    @property
    def needed_m(self) -> float:
        """How far an object must have risen to be held: by half of the lift, at most MIN_LIFT."""
        return min(MIN_LIFT, 0.5 * float(self.rises[-1]))

    @property
    def given_up(self) -> int:
        """Control periods after which an object that has not risen was left behind."""
        return int(np.argmax(self.rises > GIVEN_UP_RISE * self.rises[-1]))


def finishing_twist(
    since_close: float, velocity: Array, lift_after_s: float = LIFT_AFTER_S
) -> Array:
    """Palm twist (6,) m/s, rad/s, a time in s after the close command.

    The hand follows the object at its velocity (3,) m/s, then lifts straight up; the following dies
    out during the lift.
    """
    twist = np.zeros(6)
    lift = since_close - (lift_after_s - SETTLE_S) - SETTLE_S
    share = float(np.clip(lift / LIFT_S, 0.0, 1.0))
    twist[:3] = velocity * (1 - share)
    if 0 < share < 1:
        twist[2] += LIFT_HEIGHT / LIFT_S * 6 * share * (1 - share)
    return twist


def swing(since: float, travel_m: float) -> Array:
    """Sideways offset (2,) m of a shake at 5 Hz, a time in s after it began.

    The palm starts at rest and moves by travel_m and back in each period. Its peak acceleration is
    travel_m * 493 / s^2.
    """
    return np.asarray(travel_m * (1 - np.cos(2 * np.pi * since / 0.2)) / 2 * np.array([0.8, 0.6]))
