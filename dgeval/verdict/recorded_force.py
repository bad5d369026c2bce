"""How hard a described hand grips, by the efforts that its drives give at the end of the trial.

An effort is in Nm or N by the format, and in amperes or per cent in many a log. Only what is a
possible force of a fingertip narrows what is drawn, and not by much.
"""

from __future__ import annotations

import numpy as np

from dgeval.recording.messages import JointSample
from dgeval.robots.described_hand import LEAST_FORCE_N, MOST_FORCE_N, DescribedHand

WITHIN = 1.5  # times more or less than the recorded effort says; ours
BEFORE_S, LAST_S = 0.5, 0.5  # s before the close, for the zero of the efforts, and of the end
LEAST_SAMPLES = 5


def recorded_force(
    hand: DescribedHand, samples: list[JointSample], close_ns: int, last_ns: int
) -> tuple[float, float] | None:
    """Least and most force of a fingertip, N; None where efforts show no possible one.

    samples: the trial's joint states in time order. The drive that gives most counts: one that
    meets nothing gives little, whatever it could.
    """
    zero = [s for s in samples if close_ns - BEFORE_S * 1e9 <= s.t_ns <= close_ns]
    end = [s for s in samples if last_ns - LAST_S * 1e9 <= s.t_ns <= last_ns]
    forces = []
    for joint, lever in zip(hand.geometry.joints, hand.geometry.levers, strict=True):
        given = [
            np.array([s.efforts[joint.name] for s in part if joint.name in s.efforts])
            for part in (zero, end)
        ]
        if min(len(part) for part in given) >= LEAST_SAMPLES:
            before, after = (float(np.median(part)) for part in given)
            forces.append(abs(after - before) / lever)
    most = max(forces, default=0.0)
    if not LEAST_FORCE_N <= most <= MOST_FORCE_N:
        return None
    return max(LEAST_FORCE_N, most / WITHIN), min(MOST_FORCE_N, most * WITHIN)
