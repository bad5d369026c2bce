"""The rule that turns facts into a class, on its own.

Catches: a push that is called a collision though it did not matter, a single lucky close time that
is taken for a window, thresholds compared the wrong way round.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from dgeval.failure_rule import (
    HANDED_OVER,
    Facts,
    Needs,
    Seen,
    Thresholds,
    Verdict,
    classify,
    observed,
)

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


# what a person at the video sees


def seen(*inside: tuple[float, float], **changed: object) -> Seen:
    """A close that comes to rest after 0.4 s on an object that is held by its end: it reaches just
    half-way into the closing region in these stretches of s, and just not else; its centre is
    outside all the time.
    """
    reach = tuple(
        (at, 0.5 if any(a <= at <= b for a, b in inside) else 0.49, -0.03)
        for at in (round(0.01 * k, 3) for k in range(-100, 61))
    )
    return replace(Seen(True, False, 0.0, 0.0, reach, 0.4), **changed)  # type: ignore[arg-type]


def test_a_push_before_the_close_is_seen_as_a_collision_whatever_it_mattered() -> None:
    """Catches a push without a touch, and a limit in other units or of another trial's kind."""
    assert observed(seen(touched=True, displacement_m=0.0051)) == "collision"
    assert observed(seen(touched=True, displacement_deg=5.1)) == "collision"
    assert observed(seen(touched=True, displacement_m=0.0049)) == "imprecise_pose"
    assert observed(seen(displacement_m=0.5)) == "imprecise_pose"
    held = seen(touched=True, displacement_m=0.011)
    assert observed(held, HANDED_OVER) == "imprecise_pose"
    assert observed(replace(held, displacement_m=0.013), HANDED_OVER) == "collision"
    assert observed(seen((-0.5, 0.6), touched=True, displacement_m=0.006)) == "collision"


@pytest.mark.parametrize(
    ("inside", "met_s", "named"),
    [
        (((-0.50, -0.40),), 0.40, "timing"),  # it was there, and had gone by
        (((0.45, 0.60),), 0.20, "timing"),  # it came after the fingers had met it
        (((-0.50, 0.60),), 0.40, "imprecise_pose"),  # there all along
        (((-0.50, -0.40), (0.35, 0.41)), 0.40, "imprecise_pose"),
        (((-0.50, -0.45),), 0.40, "imprecise_pose"),  # for 50 ms alone
        (((-0.50, -0.44),), 0.40, "timing"),  # for just 60 ms
        (((-0.51, -0.45),), 0.40, "timing"),  # whatever the floats say
        (((-0.60, -0.54),), 0.40, "timing"),
        (((-0.50, -0.45), (-0.43, -0.38)), 0.40, "imprecise_pose"),  # for 50 ms twice
        ((), 0.40, "imprecise_pose"),
    ],
)
def test_where_the_object_was_when_the_hand_closed(
    inside: tuple[tuple[float, float], ...], met_s: float, named: str
) -> None:
    """Catches stretches that are added up, a stretch that is not asked for, and another moment."""
    assert observed(seen(*inside, met_s=met_s)) == named


def test_a_hand_that_never_closed_at_an_object_that_was_there() -> None:
    """Catches a hand that waited for ever and is called imprecise."""
    assert observed(seen((-0.5, -0.4), closed=False, met_s=None)) == "timing"
    assert observed(seen(closed=False, met_s=None)) == "imprecise_pose"
    # it closed, and was lifted away before it met anything
    assert observed(seen((-0.5, 0.6), met_s=None)) == "imprecise_pose"
    assert observed(seen((-0.5, 0.5), met_s=None)) == "timing"
    assert observed(seen(closed=False, met_s=None, reach=())) == "imprecise_pose"
