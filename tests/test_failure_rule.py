"""The rule that turns facts into a class, on its own.

Catches: a push that is called a collision though it did not matter, a single lucky close time that
is taken for a window, thresholds compared the wrong way round.
"""

from __future__ import annotations

import pytest
from dgeval.failure_rule import Facts, Needs, Thresholds, Verdict, classify

FAIL = tuple((round(0.03 * k, 3), False) for k in range(-20, 21) if k)


def curve(*good: float) -> tuple[tuple[float, bool], ...]:
    return tuple((offset, offset in good) for offset, _ in FAIL)


def facts(**changed: object) -> Facts:
    values: dict[str, object] = {
        "closed": True,
        "displacement_m": 0.0,
        "displacement_deg": 0.0,
        "curve": FAIL,
        "contact_s": None,
        "height_m": 0.0,
    }
    return Facts(**{**values, **changed})  # type: ignore[arg-type]


def test_nothing_else_works_is_imprecise() -> None:
    assert classify(facts()) == Verdict("imprecise_pose", "missed")
    assert classify(facts(height_m=0.08)) == Verdict("imprecise_pose", "unstable")


@pytest.mark.parametrize(
    ("good", "expected"),
    [
        ((0.06, 0.09), Verdict("timing", "early", 0.06)),
        ((-0.15, -0.12), Verdict("timing", "late", -0.12)),
        ((-0.3, -0.27, 0.09, 0.12), Verdict("timing", "early", 0.09)),
    ],
)
def test_two_other_closes_in_a_row_are_timing(good: tuple[float, ...], expected: Verdict) -> None:
    assert classify(facts(curve=curve(*good))) == expected


def test_a_lucky_tick_is_no_window() -> None:
    assert classify(facts(curve=curve(0.09))) == Verdict("imprecise_pose", "missed")
    assert classify(facts(curve=curve(-0.3, -0.03, 0.03, 0.3))) == Verdict(
        "imprecise_pose", "missed"
    ), "the real one failed"


def test_a_push_is_a_collision_only_if_it_mattered() -> None:
    moved = {"displacement_m": 0.02, "contact_s": -0.5}
    assert classify(facts(**moved)) == Needs("put_back")
    assert classify(facts(**moved, put_back=True)) == Verdict("collision", "displaced")
    assert classify(facts(**moved, put_back=False)) == Verdict("imprecise_pose", "missed")
    late = classify(facts(**moved, put_back=False, curve=curve(-0.15, -0.12)))
    assert late == Verdict("timing", "late", -0.12), "a late close after harmless pushing"
    assert classify(facts(**moved, put_back=True, curve=curve(-0.15, -0.12))) == Verdict(
        "collision", "displaced"
    )
    assert classify(facts(displacement_deg=6.0, put_back=True)) == Verdict(
        "collision", "displaced"
    ), "turning counts"


def test_overlap_proves_nothing() -> None:
    """The object put back at the close overlaps the hand.

    Then only closes before the contact, or a free pose nearby, decide.
    """
    inside = {"displacement_m": 0.02, "contact_s": -0.3, "overlap_m": 0.01, "put_back": True}
    assert classify(facts(**inside)) == Needs("free_pose")
    assert classify(facts(**inside, free_pose=True)) == Verdict("collision", "displaced")
    assert classify(facts(**inside, free_pose=False)) == Verdict("imprecise_pose", "missed")
    assert classify(facts(**inside, curve=curve(-0.36, -0.33))) == Verdict("timing", "late", -0.33)
    assert classify(facts(**inside, curve=curve(-0.15, -0.12))) == Needs("free_pose"), (
        "closes after the contact don't count"
    )


def test_never_closed() -> None:
    never = {"closed": False, "curve": curve(-0.3, -0.27)}
    assert classify(facts(**never)) == Verdict("timing", "never", -0.27)
    assert classify(facts(closed=False)) == Verdict("imprecise_pose", "missed")
    pushed = {"closed": False, "displacement_m": 0.1}
    assert classify(facts(**pushed)) == Needs("put_back")
    assert classify(facts(**pushed, put_back=True)) == Verdict("collision", "displaced")
    assert classify(facts(**pushed, put_back=False)) == Verdict("imprecise_pose", "missed")


def test_thresholds_are_settings() -> None:
    near = facts(displacement_m=0.0055, put_back=True)
    assert classify(near) == Verdict("collision", "displaced")
    assert classify(near, Thresholds().scaled("moved_m", 1.2)) == Verdict(
        "imprecise_pose", "missed"
    )
    assert classify(facts(displacement_m=0.005), Thresholds()) == Verdict(
        "imprecise_pose", "missed"
    ), "strictly more than"
