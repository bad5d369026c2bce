"""Whether to close the fingers now: the evaluator's score of the palm pose against c_e (paper III-B.5).

Ours where `arrived_m` is set: the hand must also be at the grasp. A score that rises along the approach passes a threshold
centimetres before its best, so that a rule by score alone closes early with any evaluator that isn't flat.
"""

from __future__ import annotations

import numpy as np

from dgeval.config import ExecutionConfig
from dgeval.geometry import Array, rotation_angle


def execute(
    hand_score: float | None,
    config: ExecutionConfig,
    T_base_palm: Array | None,
    T_base_grasp: Array,
) -> bool | None:
    """True above the threshold, strictly; None without a score (none was recorded), or where the palm's pose is asked for."""
    if hand_score is None:
        return None
    if config.arrived_m is not None:
        if T_base_palm is None:
            return None
        metres = float(np.linalg.norm(T_base_grasp[:3, 3] - T_base_palm[:3, 3]))
        turn = rotation_angle(T_base_palm[:3, :3].T @ T_base_grasp[:3, :3])
        if metres > config.arrived_m or np.degrees(turn) > config.arrived_deg:
            return False
    return hand_score > config.c_e
