"""Catches a replay that is told to have closed at a good moment which nothing has tried."""

from __future__ import annotations

import pytest
from dgeval.failure_rule import Facts, Verdict
from dgeval.verdict.decide import Decision, Draw, Draws
from dgeval.verdict.judge import Judgement, VerdictRow, closes_of
from dgeval.verdict.sentence import Times

CLOSE_NS, MS = 5_000_000_000, 1_000_000


def judged(*curves: tuple[tuple[float, bool], ...], outcome: str = "failure") -> Judgement:
    """A judgement whose draws have these curves of close times, s from the close."""
    late = Verdict("timing", "late")
    draws = [
        Draw(late, Facts(True, 0.0, 0.0, curve, None, 0.0), True, 1.0, {}, None, None)
        for curve in curves
    ]
    decision = Decision(late, (0.0, 0.0, 1.0, 0.0), Draws(tuple(draws), 1.0, "twin"))
    times = Times(0, 9_000_000_000, CLOSE_NS, None)
    row = VerdictRow(outcome, "inferred", "")  # type: ignore[arg-type]
    return Judgement(row, CLOSE_NS, None, closes=closes_of(decision, times))


@pytest.mark.parametrize(
    ("at_ms", "expected"),
    [(-300, True), (-320, True), (-100, False), (0, False), (-200, None), (700, None)],
)
def test_a_replay_s_close_is_looked_up_among_those_tried(at_ms: int, expected: bool | None) -> None:
    """Fails where a moment between two tries, or after the last, is told as one of them."""
    curve = ((-0.3, True), (-0.1, False), (0.0, False))
    assert judged(curve, curve).holds_at(CLOSE_NS + at_ms * MS, CLOSE_NS) is expected
    assert judged(curve).holds_at(None, CLOSE_NS) is None


def test_half_of_the_draws_must_hold() -> None:
    """Fails where one lucky draw of three makes a good moment."""
    holds, drops = ((-0.3, True),), ((-0.3, False),)
    at = CLOSE_NS - 300 * MS
    assert judged(holds, drops, drops).holds_at(at, CLOSE_NS) is False
    assert judged(holds, holds, drops).holds_at(at, CLOSE_NS) is True


def test_the_close_of_a_success_is_one_that_holds() -> None:
    """Fails where another moment of a success, which nothing tried, is told to hold or not."""
    success = judged(outcome="success")
    assert success.holds_at(CLOSE_NS + 20 * MS, CLOSE_NS) is True
    assert success.holds_at(CLOSE_NS + 50 * MS, CLOSE_NS) is None
