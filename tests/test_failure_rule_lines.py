"""The lines that the failure rule draws, just under and just over each, and runs of close times
at their ends.

Catches: `>` where `>=` is meant, a question asked of facts that don't need it, an overlapping
object that is judged by being put back, runs joined over the recorded failure, the far end of a
run taken for the near one. (`test_failure_rule.py` has the order of the questions.)
"""

from __future__ import annotations

import pytest
from dgeval.failure_rule import HANDED_OVER, Facts, Needs, Thresholds, Verdict, classify

MISSED = Verdict("imprecise_pose", "missed")
PUSHED = Verdict("collision", "displaced")


def facts(**changed: object) -> Facts:
    """A closed hand beside an object that nobody moved; no other close time was tried."""
    values: dict[str, object] = {
        "closed": True, "displacement_m": 0.0, "displacement_deg": 0.0,
        "curve": (), "contact_s": None, "height_m": 0.0,
    }  # fmt: skip
    return Facts(**{**values, **changed})  # type: ignore[arg-type]


def curve(*successes: float, failures: tuple[float, ...] = ()) -> tuple[tuple[float, bool], ...]:
    """Close times in order, s from the real close."""
    return tuple(sorted([*((t, True) for t in successes), *((t, False) for t in failures)]))


@pytest.mark.parametrize(
    ("displacement_m", "displacement_deg", "moved"),
    [(0.005, 5.0, False), (0.0051, 0.0, True), (0.0, 5.1, True), (0.0051, 5.1, True)],
)
@pytest.mark.parametrize("closed", [True, False])
def test_moved_is_strictly_more_than_5_mm_or_5_degrees(
    closed: bool, displacement_m: float, displacement_deg: float, moved: bool
) -> None:
    """Catches a line crossed by a displacement that only reaches it, and a turn that must come with
    a shift.
    """
    answer = classify(
        facts(closed=closed, displacement_m=displacement_m, displacement_deg=displacement_deg)
    )
    assert answer == (Needs("put_back") if moved else MISSED)


def test_a_handed_over_object_may_give_way_by_12_mm() -> None:
    """Catches a handover that is judged like an object on a table."""
    assert classify(facts(displacement_m=0.012), HANDED_OVER) == MISSED
    assert classify(facts(displacement_m=0.0121), HANDED_OVER) == Needs("put_back")
    assert classify(facts(displacement_deg=5.1), HANDED_OVER) == Needs("put_back"), (
        "only the shift has another line"
    )


@pytest.mark.parametrize(("overlap_m", "answer"), [(0.002, PUSHED), (0.0021, Needs("free_pose"))])
def test_up_to_2_mm_of_overlap_the_object_put_back_is_believed(
    overlap_m: float, answer: object
) -> None:
    """Catches `<` for `<=`, and an object put back into the hand that counts as held."""
    assert classify(facts(displacement_m=0.02, overlap_m=overlap_m, put_back=True)) == answer


def test_overlap_without_a_contact_leaves_no_closes_before_it() -> None:
    """Catches close times that are compared with no contact at all."""
    inside = facts(
        displacement_m=0.02, overlap_m=0.01, put_back=True, curve=curve(-0.6, -0.57), contact_s=None
    )
    assert classify(inside) == Needs("free_pose")


def test_a_close_at_the_last_tick_before_contact_counts_as_before_it() -> None:
    """Catches `<` for `<=` where closes before the contact are kept."""
    inside = {
        "displacement_m": 0.02,
        "overlap_m": 0.01,
        "put_back": True,
        "curve": curve(-0.36, -0.33),
    }
    assert classify(facts(**inside, contact_s=-0.33)) == Verdict("timing", "late", -0.33)
    assert classify(facts(**inside, contact_s=-0.34)) == Needs("free_pose"), (
        "one close alone is chance"
    )


@pytest.mark.parametrize(("free_pose", "answer"), [(True, PUSHED), (False, MISSED)])
def test_with_overlap_the_free_pose_decides_against_put_back_and_later_closes(
    free_pose: bool, answer: Verdict
) -> None:
    """Catches a later window of close times that is asked after the free pose has said no."""
    inside = {"displacement_m": 0.02, "overlap_m": 0.01, "contact_s": -0.3}
    later = curve(0.06, 0.09)
    asked = facts(**inside, put_back=not free_pose, free_pose=free_pose, curve=later)
    assert classify(asked) == answer


def test_a_push_that_did_not_matter_leaves_the_other_closes() -> None:
    """Catches a push without effect that hides an early close."""
    harmless = facts(displacement_m=0.02, put_back=False, curve=curve(0.06, 0.09))
    assert classify(harmless) == Verdict("timing", "early", 0.06)


@pytest.mark.parametrize(("height_m", "sub_cause"), [(0.0199, "missed"), (0.02, "unstable")])
@pytest.mark.parametrize("closed", [True, False])
def test_from_20_mm_on_it_was_lifted_and_lost(
    closed: bool, height_m: float, sub_cause: str
) -> None:
    """Catches `>` for `>=`, and missed taken for unstable."""
    assert classify(facts(closed=closed, height_m=height_m)) == Verdict("imprecise_pose", sub_cause)


def test_pushes_without_effect_keep_missed_and_unstable_apart() -> None:
    """Catches an exit of the rule that says missed of an object that was lifted."""
    unstable = Verdict("imprecise_pose", "unstable")
    lifted = {"displacement_m": 0.02, "height_m": 0.03}
    assert classify(facts(**lifted, put_back=False)) == unstable
    assert classify(facts(**lifted, closed=False, put_back=False)) == unstable
    assert classify(facts(**lifted, overlap_m=0.01, put_back=False, free_pose=False)) == unstable


def test_a_hand_that_never_closed_is_first_asked_for_another_close() -> None:
    """Catches a push that goes before a window of closes, as it does where the hand closed; there
    it must not.
    """
    never = facts(closed=False, displacement_m=0.1, put_back=True, curve=curve(-0.3, -0.27))
    assert classify(never) == Verdict("timing", "never", -0.27)
    closed = facts(displacement_m=0.1, put_back=True, curve=curve(-0.3, -0.27))
    assert classify(closed) == PUSHED


def test_overlap_says_nothing_of_a_hand_that_never_closed() -> None:
    """Catches a free pose that is asked for at a close that never was."""
    assert (
        classify(facts(closed=False, displacement_m=0.1, overlap_m=0.05, put_back=True)) == PUSHED
    )


def test_a_close_at_the_last_instant_counts_for_a_hand_that_never_closed() -> None:
    """Catches an offset of 0 taken for the recorded failure, and one taken for 'no run'."""
    assert classify(facts(closed=False, curve=curve(-0.03, 0.0))) == Verdict("timing", "never", 0.0)


@pytest.mark.parametrize(
    ("tried", "shift"),
    [
        (curve(-0.03, 0.03), None),  # the recorded close lies between them and failed
        (curve(-0.06, -0.03, 0.03), -0.03),
        (curve(-0.03, 0.03, 0.06), 0.03),
        (curve(-0.06, -0.03, 0.03, 0.06), -0.03),  # equally near: the first
        (curve(0.03, 0.09, failures=(0.06,)), None),
        (curve(0.12, 0.15, 0.18), 0.12),
        (curve(-0.18, -0.15, -0.12), -0.12),
        (curve(-0.15, -0.12, 0.06, 0.09, 0.3, 0.33, failures=(0.0, 0.2)), 0.06),
        (curve(0.54, 0.57, 0.6), 0.54),  # a run that lasts to the end of what was tried
        ((), None),
    ],
)
def test_the_nearest_close_of_a_run(
    tried: tuple[tuple[float, bool], ...], shift: float | None
) -> None:
    """Catches runs joined over the recorded failure, a run lost at the end of the curve, far ends
    taken for near ones.
    """
    expected = (
        MISSED if shift is None else Verdict("timing", "early" if shift > 0 else "late", shift)
    )
    assert classify(facts(curve=tried)) == expected


def test_how_many_closes_make_a_run_is_a_setting() -> None:
    """Catches a run length that is written into the rule."""
    two, three = facts(curve=curve(0.06, 0.09)), facts(curve=curve(0.06, 0.09, 0.12))
    assert classify(two, Thresholds(consecutive=3)) == MISSED
    assert classify(three, Thresholds(consecutive=3)) == Verdict("timing", "early", 0.06)
    assert classify(facts(curve=curve(0.06)), Thresholds(consecutive=1)) == Verdict(
        "timing", "early", 0.06
    )


@pytest.mark.parametrize("name", ["moved_m", "moved_deg", "overlap_m", "unstable_m"])
def test_scaling_a_threshold_leaves_the_others(name: str) -> None:
    """Catches a sweep that moves more than the line it names."""
    plain, scaled = Thresholds(), Thresholds().scaled(name, 1.5)
    for field in Thresholds.__slots__:
        factor = 1.5 if field == name else 1.0
        assert getattr(scaled, field) == pytest.approx(factor * getattr(plain, field))
