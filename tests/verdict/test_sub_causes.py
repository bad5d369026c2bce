"""The table of sub-causes against the two that read it: the failure rule and the sentence.

Catches: a new sub-cause that no facts reach, one whose sentence names a field that is not filled
in, two of one name, facts for which the rule finds no row, and a sub-cause without a sentence that
ends in a wrong sentence instead of an error.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from string import Formatter

import pytest
from dgeval.failure_rule import (
    CLASSES,
    HANDED_OVER,
    SUB_CAUSES,
    Facts,
    FailureClass,
    SubCause,
    Thresholds,
    Verdict,
    classify,
    sub_cause_named,
)
from dgeval.verdict.decide import Decision, Draw, Draws
from dgeval.verdict.outcome import Ended
from dgeval.verdict.sentence import Times, fields_of, sentence

SECOND = 1_000_000_000
ENDED = Ended("failure", "label", "an operator's label says so")
EARLIER, LATER = ((-0.15, True), (-0.12, True)), ((0.06, True), (0.09, True))
FAILED = ((-0.12, False), (0.12, False))
EACH_ROW = pytest.mark.parametrize("row", SUB_CAUSES, ids=lambda row: row.name)


def all_facts() -> Iterator[Facts]:
    """Failures on both sides of every line of the rule; every question is answered."""
    for closed, moved, overlaps, put_back, free_pose, lifted in product([True, False], repeat=6):
        for curve, contact_s in product([(), FAILED, EARLIER, LATER], [None, -0.1]):
            yield Facts(
                closed,
                0.02 if moved else 0.0,
                0.0,
                curve,
                contact_s,
                0.03 if lifted else 0.0,
                0.01 if overlaps else 0.0,
                put_back,
                free_pose,
            )


def decision(
    failure_class: FailureClass, sub_cause: str, curve: tuple[tuple[float, bool], ...]
) -> Decision:
    """One draw's failure that was seen with as little as may be: no shift and no displacement."""
    answer = Verdict(failure_class, sub_cause)
    facts = Facts(True, 0.0, 0.0, curve, None, 0.0)
    draw = Draw(answer, facts, True, 1.0, {}, None, None)
    return Decision(answer, (0.4, 0.3, 0.3, 0.0), Draws((draw,), 1.0, "twin"))


def least_of(row: SubCause) -> Decision:
    """A failure of a row's class: of a collision alone no other close need have been tried."""
    return decision(row.failure_class, row.name, () if row.failure_class == "collision" else FAILED)


def times(closed: bool) -> Times:
    return Times(0, 4 * SECOND, 2 * SECOND if closed else None, None)


def test_names_are_unique() -> None:
    """Catches a second row of a name, whose sentence and hint would never be read."""
    names = [row.name for row in SUB_CAUSES]
    assert len(set(names)) == len(names)
    assert [sub_cause_named(name) for name in names] == list(SUB_CAUSES)


@pytest.mark.parametrize("failure_class", CLASSES)
def test_the_last_row_of_a_class_always_holds(failure_class: FailureClass) -> None:
    """Catches a class for whose rarer facts the rule would end without a row."""
    rows = [row for row in SUB_CAUSES if row.failure_class == failure_class]
    for facts in all_facts():
        for shift_s, thresholds in product([None, -0.3, 0.0, 0.3], [Thresholds(), HANDED_OVER]):
            assert rows[-1].when(facts, shift_s, thresholds), (facts, shift_s)


def test_every_failure_has_a_sub_cause_of_its_class() -> None:
    """Catches a row of another class taken, and a rule that asks again for what is known."""
    for facts in all_facts():
        verdict = classify(facts)
        assert isinstance(verdict, Verdict), facts
        assert sub_cause_named(verdict.sub_cause).failure_class == verdict.failure_class


@EACH_ROW
def test_every_row_is_reached(row: SubCause) -> None:
    """Catches a new row below one that always holds."""
    wanted = (row.failure_class, row.name)
    found = [v for v in map(classify, all_facts()) if isinstance(v, Verdict)]
    assert wanted in {(v.failure_class, v.sub_cause) for v in found}


@EACH_ROW
@pytest.mark.parametrize("closed", [True, False])
def test_the_fields_of_a_sentence_are_given(row: SubCause, closed: bool) -> None:
    """Catches a field that `fields_of` gives another class, or only where more is known."""
    named = {name for _, name, _, _ in Formatter().parse(row.sentence) if name is not None}
    assert named <= set(fields_of(times(closed), least_of(row), None))
    assert "{" not in sentence(times(closed), ENDED, least_of(row), None)


@pytest.mark.parametrize("failure_class", CLASSES)
def test_a_sub_cause_without_a_row_has_no_sentence(failure_class: FailureClass) -> None:
    """Catches a future sub-cause that is told as another one of its class."""
    with pytest.raises(KeyError, match="jammed"):
        sentence(times(True), ENDED, decision(failure_class, "jammed", FAILED), "thumb_2")
