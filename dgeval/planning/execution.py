"""Whether to close the fingers now: the evaluator's score of the palm pose against c_e.

Paper III-B.5. With `arrived_m` (ours) the hand must also be at the grasp: a score that rises along
the approach passes a threshold centimetres before its maximum, so a rule by score alone closes the
hand early with every evaluator that isn't flat.
"""

from __future__ import annotations

import numpy as np

from dgeval.config import ExecutionConfig
from dgeval.geometry import Array, pose_distance

PAPER_C_E = 0.7  # Table V; of the authors' evaluator


def execute(
    hand_score: float | None,
    c_e: float,
    config: ExecutionConfig,
    T_base_palm: Array | None,
    T_base_grasp: Array,
) -> bool | None:
    """True if the score is above the threshold, strictly; poses are (4, 4), base frame.

    c_e: threshold of whatever gave the score, where the configuration has none. None without a
    score (none was recorded), or without a palm pose if `arrived_m` needs one.
    """
    if hand_score is None:
        return None
    if config.arrived_m is not None:
        if T_base_palm is None:
            return None
        metres, turn = pose_distance(T_base_palm, T_base_grasp)
        if metres > config.arrived_m or np.degrees(turn) > config.arrived_deg:
            return False
    return hand_score > (c_e if config.c_e is None else config.c_e)
