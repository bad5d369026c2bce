"""Which part is blamed, for every exit of the cascade, from hand-made draws and beliefs.

Catches: a part blamed though several would do, or though its error is smaller than grasps
survive; an order of steps in which the servo's law hides a huge error or the other way round; a
hand that closed early blamed on its servo; a probability that is not the share of draws it rests
on; sizes that are not the errors' lengths.
"""

from __future__ import annotations

import numpy as np
import pytest
from dgeval.failure_rule import CLASSES, Facts, FailureClass, Unknown, Verdict
from dgeval.verdict.beliefs import Beliefs
from dgeval.verdict.decide import Blame, Decision, Draw, Draws, blame_of

SUB_CAUSES: dict[FailureClass, str] = {
    "imprecise_pose": "missed",
    "collision": "displaced",
    "timing": "late",
}
RIGHT_LAW, WRONG_LAW = (0.8, 0.8), (0.8, 3.2)  # gains level and upright, 1/s
STATED = 0.7  # probability where a part is blamed without a share of draws
DIRECTION = np.array([2.0, -1.0, 2.0]) / 3


def draw(
    failure_class: FailureClass = "imprecise_pose",
    restored: tuple[str, ...] = (),
    weight: float = 1.0,
    closed: bool = True,
) -> Draw:
    """One draw; `restored`: without which error it holds the object."""
    facts = Facts(closed, 0.0, 0.0, (), None, 0.0)
    verdict = Verdict(failure_class, SUB_CAUSES[failure_class])
    return Draw(verdict, facts, True, weight, dict.fromkeys(restored, True), None, None)


def failed(*draws: Draw, sub_cause: str | None = None, shift_s: float | None = None) -> Decision:
    """A decision for the first draw's class, 80 % sure."""
    found = draws[0].verdict
    p = [0.1, 0.1, 0.0]
    p[CLASSES.index(found.failure_class)] = 0.8
    answer = Verdict(found.failure_class, sub_cause or found.sub_cause, shift_s)
    return Decision(answer, (p[0], p[1], p[2], 0.0), Draws(draws, 1.0, "twin"))


def doubted(*draws: Draw) -> Decision:
    """A decision for no class, 80 % unsure."""
    answer = Unknown("the draws disagree")
    return Decision(answer, (0.1, 0.1, 0.0, 0.8), Draws(draws, 1.0, "twin"))


def believed(
    gains: tuple[float, float] | None = RIGHT_LAW, goal: bool = True, **errors_mm: float
) -> Beliefs:
    """Beliefs with errors of these lengths, mm, in a slanted direction."""
    errors = {part: mm * 0.001 * DIRECTION for part, mm in errors_mm.items()}
    return Beliefs(errors, np.eye(4) if goal else None, gains)


def term_of(blame: Blame) -> str:
    return "unknown" if isinstance(blame.part, Unknown) else blame.part


def why_unknown(blame: Blame) -> str | None:
    """None where a part is blamed."""
    return blame.part.reason if isinstance(blame.part, Unknown) else None


def check(
    blame: Blame, term: str, probability: float, why: str | None = None, **sizes_mm: float
) -> None:
    """Term, probability, reason; sizes in mm."""
    assert (term_of(blame), why_unknown(blame)) == (term, why)
    assert blame.probability == pytest.approx(probability)
    assert blame.sizes == pytest.approx({part: mm * 0.001 for part, mm in sizes_mm.items()})


# nothing to blame


def test_an_unknown_class_has_no_part_to_blame() -> None:
    """Catches beliefs asked before the class."""
    for beliefs in (believed(servo=50.0), Unknown("beliefs not recorded")):
        blame = blame_of(doubted(draw()), beliefs)
        check(blame, "unknown", 0.0, "the class is unknown")
        assert blame.source is None


@pytest.mark.parametrize("failure_class", ["imprecise_pose", "collision", "timing"])
def test_without_beliefs_the_reason_is_theirs(failure_class: FailureClass) -> None:
    """Catches a part blamed by the class alone."""
    blame = blame_of(failed(draw(failure_class)), Unknown("beliefs not recorded"))
    check(blame, "unknown", 0.0, "beliefs not recorded")
    assert blame.source is None


# collisions


def test_a_collision_with_a_wrong_law_is_the_servos() -> None:
    """Catches a probability taken from the class, and sizes left out."""
    blame = blame_of(
        failed(draw("collision", ("tracking",))), believed(WRONG_LAW, servo=9.0, tracking=40.0)
    )
    check(blame, "servo", STATED, servo=9.0, tracking=40.0)
    assert blame.source == "recorded"


def test_a_collision_says_nothing_else() -> None:
    """Catches a part blamed though from the push on the robot's beliefs followed it."""
    blame = blame_of(failed(draw("collision", ("tracking",))), believed(servo=9.0, tracking=40.0))
    why = "the object was pushed, and the robot believed what was pushed"
    check(blame, "unknown", 0.0, why, servo=9.0, tracking=40.0)
    assert blame.source == "recorded"


@pytest.mark.parametrize(
    ("gains", "wrong"),
    [
        (None, False),
        ((0.8, 0.8), False),
        ((1.0, 1.59), False),
        ((1.0, 1.6), True),
        ((1.0, 0.63), False),
        ((1.0, 0.62), True),
        ((0.16, 0.8), True),
        ((0.15, 0.8), False),  # too slow level to tell a law
        ((0.0, 0.8), False),
        ((0.8, -0.8), True),
    ],
)
def test_what_counts_as_a_wrong_law(gains: tuple[float, float] | None, wrong: bool) -> None:
    """Catches level and upright mixed up, a ratio that is only looked at one way, and a division by
    0.
    """
    blame = blame_of(failed(draw("collision")), believed(gains, servo=1.0))
    assert term_of(blame) == ("servo" if wrong else "unknown")


# a hand that closed


@pytest.mark.parametrize("part", ["servo", "tracking", "velocity"])
def test_the_one_part_without_which_it_holds(part: str) -> None:
    """Catches a probability of 1, or unweighted: 3 of 4 by weight, 1 of 2 by number."""
    draws = (draw(restored=(part,), weight=0.75), draw(weight=0.25))
    sizes = {"servo": 8.0, "tracking": 8.0, "velocity": 8.0}
    blame = blame_of(failed(*draws), believed(**sizes))  # type: ignore[arg-type]
    check(blame, part, 0.75, **sizes)
    assert blame.source == "recorded"


def test_only_draws_of_the_class_are_asked() -> None:
    """Catches shares over draws that say something else failed."""
    others = [draw("timing", ("velocity",), 5.0), draw("collision", ("velocity",), 5.0)]
    decision = failed(draw(restored=("tracking",)), *others)
    check(
        blame_of(decision, believed(tracking=20.0, velocity=20.0)),
        "tracking",
        1.0,
        tracking=20.0,
        velocity=20.0,
    )


def test_half_of_the_draws_are_not_enough() -> None:
    """Catches `>=` for `>`."""
    beliefs = believed(servo=1.0, tracking=20.0)
    half = failed(draw(restored=("tracking",)), draw())
    why = "no part alone explains it, the largest is tracking with 20 mm"
    check(blame_of(half, beliefs), "unknown", 0.0, why, servo=1.0, tracking=20.0)
    more = failed(draw(restored=("tracking",), weight=1.1), draw())
    check(blame_of(more, beliefs), "tracking", 1.1 / 2.1, servo=1.0, tracking=20.0)


@pytest.mark.parametrize(("size_mm", "term"), [(6.9, "synthesis"), (7.1, "tracking")])
def test_a_part_within_what_grasps_survive_is_not_blamed(size_mm: float, term: str) -> None:
    """Catches a tolerance that is not looked at where the twin holds without the part."""
    decision = failed(draw(restored=("tracking",), weight=0.6), draw(weight=0.4))
    check(
        blame_of(decision, believed(tracking=size_mm)),
        term,
        0.6 if term == "tracking" else 0.4,
        tracking=size_mm,
    )


@pytest.mark.parametrize(("second_mm", "term"), [(13.0, "tracking"), (14.0, "unknown")])
def test_of_two_that_would_do_the_one_half_as_large_again(second_mm: float, term: str) -> None:
    """Catches the first of a list blamed, whatever its size: 20 mm are 1.5 times 13.3 mm."""
    both = failed(draw(restored=("velocity", "tracking"), weight=0.9), draw(weight=0.1))
    blame = blame_of(both, believed(velocity=second_mm, tracking=20.0))
    why = None if term == "tracking" else "removing any of tracking, velocity alone would do"
    check(blame, term, 0.9 if term == "tracking" else 0.0, why, velocity=second_mm, tracking=20.0)


def test_where_several_would_do_they_are_named_in_order() -> None:
    """Catches names in the order of a set or of their sizes."""
    parts = ("velocity", "servo", "tracking")
    beliefs = believed(servo=9.0, tracking=10.0, velocity=11.0)
    why = "removing any of servo, tracking, velocity alone would do"
    check(
        blame_of(failed(draw(restored=parts)), beliefs),
        "unknown",
        0.0,
        why,
        servo=9.0,
        tracking=10.0,
        velocity=11.0,
    )


def test_where_only_all_together_restore_the_one_large_part_is_blamed() -> None:
    """Catches the part's own share, which is 0, for its probability."""
    decision = failed(draw(restored=("all",), weight=0.8), draw(weight=0.2))
    beliefs = believed(servo=3.0, tracking=20.0, velocity=6.9)
    check(blame_of(decision, beliefs), "tracking", 0.8, servo=3.0, tracking=20.0, velocity=6.9)


@pytest.mark.parametrize(("second_mm", "term"), [(9.9, "tracking"), (10.1, "unknown")])
def test_where_only_all_together_restore_one_must_be_twice_the_next(
    second_mm: float, term: str
) -> None:
    """Catches the factor of parts that restore alone."""
    blame = blame_of(failed(draw(restored=("all",))), believed(tracking=20.0, servo=second_mm))
    why = (
        None
        if term == "tracking"
        else "no part alone explains it, the largest is tracking with 20 mm"
    )
    check(blame, term, 1.0 if term == "tracking" else 0.0, why, tracking=20.0, servo=second_mm)


def test_all_together_restoring_in_half_of_the_draws_says_nothing() -> None:
    """Catches `>=` for `>`."""
    blame = blame_of(failed(draw(restored=("all",)), draw()), believed(tracking=20.0))
    assert term_of(blame) == "unknown"


def test_the_largest_may_be_blamed_though_smaller_ones_restore_alone() -> None:
    """Catches the two questions asked in the other order, or only of parts that restore alone."""
    decision = failed(draw(restored=("velocity", "servo", "all")))
    beliefs = believed(tracking=30.0, velocity=14.0, servo=13.0)
    check(blame_of(decision, beliefs), "tracking", 1.0, tracking=30.0, velocity=14.0, servo=13.0)
    # one that restores alone goes before it
    decision = failed(
        draw(restored=("velocity", "all"), weight=0.6), draw(restored=("all",), weight=0.4)
    )
    check(blame_of(decision, beliefs), "velocity", 0.6, tracking=30.0, velocity=14.0, servo=13.0)


# a wrong law where the hand closed


def test_a_wrong_law_goes_before_small_errors() -> None:
    """Catches a tracking error that follows from the law blamed instead of it."""
    decision = failed(draw(restored=("tracking",)))
    check(blame_of(decision, believed(WRONG_LAW, tracking=13.9)), "servo", STATED, tracking=13.9)
    check(
        blame_of(failed(draw()), believed(WRONG_LAW, tracking=20.0)), "servo", STATED, tracking=20.0
    )


def test_a_wrong_law_does_not_hide_a_part_that_restores_and_is_twice_the_tolerance() -> None:
    """Catches the law asked first: 14 mm and more that restore success are blamed."""
    decision = failed(draw(restored=("tracking",), weight=0.8), draw(weight=0.2))
    check(blame_of(decision, believed(WRONG_LAW, tracking=14.1)), "tracking", 0.8, tracking=14.1)


def test_a_wrong_law_does_not_hide_a_huge_error() -> None:
    """Catches the law asked before the size: 36 mm are more than five tolerances."""
    check(
        blame_of(failed(draw()), believed(WRONG_LAW, tracking=36.0)),
        "tracking",
        STATED,
        tracking=36.0,
    )
    check(
        blame_of(failed(draw()), believed(WRONG_LAW, tracking=34.0)), "servo", STATED, tracking=34.0
    )


# huge errors


@pytest.mark.parametrize(
    ("largest_mm", "second_mm", "huge"),
    [(34.9, 1.0, False), (35.1, 1.0, True), (40.0, 19.9, True), (40.0, 20.1, False)],
)
def test_a_huge_error_is_blamed_though_nothing_restores(
    largest_mm: float, second_mm: float, huge: bool
) -> None:
    """Catches a size that is not compared with the next, and a probability that is a share of
    nothing.
    """
    blame = blame_of(failed(draw()), believed(velocity=second_mm, tracking=largest_mm))
    why = (
        None
        if huge
        else f"no part alone explains it, the largest is tracking with {largest_mm:.0f} mm"
    )
    check(
        blame,
        "tracking" if huge else "unknown",
        STATED if huge else 0.0,
        why,
        velocity=second_mm,
        tracking=largest_mm,
    )


def test_a_huge_error_is_blamed_before_execution() -> None:
    """Catches a close at the wrong time blamed where the palm was far off."""
    check(
        blame_of(failed(draw("timing"), shift_s=-0.3), believed(tracking=60.0)),
        "tracking",
        STATED,
        tracking=60.0,
    )


# timing


def test_a_close_at_the_wrong_time_is_executions() -> None:
    """Catches a shift with its sign, and sizes of other parts beside it."""
    blame = blame_of(failed(draw("timing"), shift_s=-0.3), believed(tracking=20.0, servo=3.0))
    assert (term_of(blame), blame.sizes, blame.source) == (
        "execution",
        {"execution": 0.3},
        "recorded",
    )
    assert blame.probability == pytest.approx(0.8), "that of the class"
    assert why_unknown(blame) is None


def test_a_close_at_the_wrong_time_without_a_shift() -> None:
    """Catches an absolute value of nothing."""
    assert blame_of(failed(draw("timing")), believed(servo=3.0)).sizes == {"execution": 0.0}


def test_a_part_that_restores_a_timing_failure_goes_before_execution() -> None:
    """Catches execution asked first: a velocity that is wrong closes the hand at the wrong time."""
    decision = failed(draw("timing", ("velocity",)), shift_s=-0.3)
    check(blame_of(decision, believed(velocity=20.0)), "velocity", 1.0, velocity=20.0)
    # several that restore it are not told apart, nor is it execution
    decision = failed(draw("timing", ("velocity", "tracking")), shift_s=-0.3)
    assert term_of(blame_of(decision, believed(velocity=20.0, tracking=20.0))) == "unknown"


def test_a_hand_that_closed_early_is_off_its_grasp_because_of_that() -> None:
    """Catches the servo blamed for being on its way; of a late close it may be."""
    restored = draw("timing", ("servo",))
    beliefs = believed(servo=60.0)
    early = blame_of(failed(restored, sub_cause="early", shift_s=0.2), beliefs)
    assert (term_of(early), early.sizes) == ("execution", {"execution": 0.2})
    check(
        blame_of(failed(restored, sub_cause="late", shift_s=-0.2), beliefs),
        "servo",
        1.0,
        servo=60.0,
    )
    # what is left is compared without it
    beliefs = believed(servo=60.0, tracking=20.0)
    tracking = failed(draw("timing", ("servo", "tracking")), sub_cause="early", shift_s=0.2)
    check(blame_of(tracking, beliefs), "tracking", 1.0, servo=60.0, tracking=20.0)


# nothing off


def test_where_no_part_is_off_what_the_robot_was_after_fails_too() -> None:
    """Catches a certainty of 1: what restores some draws is taken from it."""
    sizes = {"servo": 2.0, "tracking": 6.9, "velocity": 1.0}
    beliefs = believed(**sizes)  # type: ignore[arg-type]
    check(blame_of(failed(draw()), beliefs), "synthesis", 1.0, **sizes)
    some = failed(
        draw(restored=("all", "servo"), weight=0.3),
        draw(restored=("all",), weight=0.1),
        draw(weight=0.6),
    )
    check(blame_of(some, beliefs), "synthesis", 0.6, **sizes)


# a hand that never closed


def never(*restored: str, weight: float = 1.0) -> Decision:
    """A hand that never closed; in the rest of the weight nothing restores success."""
    draws = [draw(restored=restored, weight=weight, closed=False)]
    if weight < 1:
        draws.append(draw(weight=1 - weight, closed=False))
    return failed(*draws)


def test_never_closed_at_a_grasp_that_would_have_held_is_executions() -> None:
    """Catches a share that is not the goal's, and other parts' errors asked first."""
    sizes = {"servo": 6.9, "tracking": 30.0, "velocity": 30.0}
    check(
        blame_of(never("goal", weight=0.8), believed(WRONG_LAW, **sizes)), "execution", 0.8, **sizes
    )


def test_never_closed_the_goal_must_hold_in_more_than_half() -> None:
    """Catches `>=` for `>`."""
    check(blame_of(never("goal", weight=0.5), believed(servo=3.0)), "synthesis", 0.5, servo=3.0)


def test_never_closed_and_not_at_its_grasp_is_not_executions() -> None:
    """Catches execution blamed for a hand that did not come to its grasp."""
    blame = blame_of(never("goal"), believed(servo=7.1))
    why = "the hand came no nearer to its grasp than 7 mm, and no part stands out"
    check(blame, "unknown", 0.0, why, servo=7.1)


@pytest.mark.parametrize("part", ["tracking", "velocity"])
@pytest.mark.parametrize(("size_mm", "blamed"), [(11.9, False), (12.1, True)])
def test_never_closed_the_one_part_that_is_off(part: str, size_mm: float, blamed: bool) -> None:
    """Catches the tolerance of a hand that closed, 7 mm."""
    sizes = {"servo": 30.0, part: size_mm}
    blame = blame_of(never(), believed(**sizes))  # type: ignore[arg-type]
    why = (
        None
        if blamed
        else "the hand came no nearer to its grasp than 30 mm, and no part stands out"
    )
    check(blame, part if blamed else "unknown", STATED if blamed else 0.0, why, **sizes)


def test_never_closed_with_a_wrong_law() -> None:
    """Catches the distance to the grasp, which any part may leave, taken for the servo's fault."""
    check(blame_of(never(), believed(WRONG_LAW, servo=30.0)), "servo", STATED, servo=30.0)
    check(blame_of(never(), believed(WRONG_LAW, servo=3.0)), "servo", STATED, servo=3.0)


def test_never_closed_with_several_parts_off() -> None:
    """Catches the largest of them blamed."""
    beliefs = believed(WRONG_LAW, servo=30.0, tracking=60.0, velocity=13.0)
    why = "tracking, velocity, servo are all off"
    check(blame_of(never(), beliefs), "unknown", 0.0, why, servo=30.0, tracking=60.0, velocity=13.0)


def test_never_closed_at_a_grasp_that_would_not_have_held_is_synthesis() -> None:
    """Catches a grasp of which nothing is known called bad."""
    check(blame_of(never("goal", weight=0.3), believed(servo=3.0)), "synthesis", 0.7, servo=3.0)
    why = "the hand came no nearer to its grasp than 3 mm, and no part stands out"
    check(blame_of(never(), believed(servo=3.0, goal=False)), "unknown", 0.0, why, servo=3.0)


def test_never_closed_is_asked_of_timing_too() -> None:
    """Catches execution blamed by the class, though the hand was not at its grasp."""
    decision = failed(draw("timing", closed=False), sub_cause="never", shift_s=-0.5)
    blame = blame_of(decision, believed(servo=30.0, tracking=20.0))
    check(blame, "tracking", STATED, servo=30.0, tracking=20.0)
