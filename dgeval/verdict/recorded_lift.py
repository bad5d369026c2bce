"""How the hand followed and lifted after its close, as the log has it."""

from __future__ import annotations

import numpy as np

from dgeval.geometry import Array, rotation_vector
from dgeval.worlds.closing import CONTROL_S, Finish

LOOK_S = 8.0  # after the close, in which a lift is looked for; ours
LEAST_RISE_M = (
    0.05  # of the hand's base; less is no lift, or one that the log does not hold to its end
)
LIFTED_S, LIFTED_M = 0.3, 0.005  # a hand that rises no further than this in that time has lifted
SMOOTHED_TICKS = 5  # control periods; the poses of a log tremble by tenths of a millimetre


def recorded_lift(poses: Array) -> Finish | None:
    """The motion of the hand from the close to the end of its lift; None where it has no lift.

    poses (n, 4, 4): of the hand's base in the support frame, at the close and at the control
    periods after it, as far as recorded.
    """
    rises = poses[:, 2, 3] - poses[0, 2, 3]
    wait = round(LIFTED_S / CONTROL_S)
    for k in np.flatnonzero(rises >= LEAST_RISE_M):
        ahead = rises[k : k + wait + 1]
        if len(ahead) > wait and ahead.max() - rises[k] < LIFTED_M:
            return _motion(poses[: k + 1])
    return None


def _motion(poses: Array) -> Finish:
    step = np.diff(poses[:, :3, 3], axis=0)
    pairs = zip(poses[:-1, :3, :3], poses[1:, :3, :3], strict=True)
    turn = np.array([rotation_vector(b @ a.T) for a, b in pairs])
    half = SMOOTHED_TICKS // 2
    padded = np.pad(np.hstack([step, turn]) / CONTROL_S, ((half, half), (0, 0)), mode="edge")
    window = np.ones(SMOOTHED_TICKS) / SMOOTHED_TICKS
    twists = np.stack([np.convolve(column, window, mode="valid") for column in padded.T], axis=1)
    return Finish(twists)
