"""Whether to close the fingers now: the evaluator's score of the recorded palm pose against c_e (paper III-B.5)."""

from __future__ import annotations

from dgeval.config import ExecutionConfig


def execute(hand_score: float | None, config: ExecutionConfig) -> bool | None:
    """True above the threshold, strictly; None without a score (no evaluator ran and none was recorded)."""
    return None if hand_score is None else hand_score > config.c_e
