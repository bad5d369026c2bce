"""Catches: a run that leaves with 0 although something was lost, or with the wrong one of several
codes.

`exit_code_of` over every combination of the trials' codes: 0 all is well, 2 nothing could be read,
3 some data was lost, 4 an internal error. A trial with a row has results; one without has none.
"""

from __future__ import annotations

from itertools import combinations

import pytest
from dgeval.runs.folder import TrialResult, exit_code_of


def result(code: int, row: bool) -> TrialResult:
    return TrialResult(f"{code}{row}", {} if row else None, code, [], None)


# As they come from replay_trial: a trial that was replayed has a row, and 0, or 3 where data of it
# was lost. One that was not has no row: 2 for one that can't be opened, 3 for one that can't be
# decoded, 4 for an internal error.
KINDS = {
    "whole": (0, True), "damaged": (3, True), "unreadable": (2, False), "undecodable": (3, False),
    "internal": (4, False),
}  # fmt: skip


def expected(kinds: tuple[str, ...]) -> int:
    """The rule in words, from the most serious on."""
    if "internal" in kinds:
        return 4
    if kinds and not {"whole", "damaged"} & set(kinds):
        return 2 if "unreadable" in kinds else 3
    return 0 if set(kinds) <= {"whole"} else 3


SETS = [s for n in range(len(KINDS) + 1) for s in combinations(KINDS, n)]


@pytest.mark.parametrize("kinds", SETS, ids="+".join)
def test_the_exit_code_of_a_run(kinds: tuple[str, ...]) -> None:
    """Catches a code that depends on the order of the trials, and 2 although one trial was
    replayed.
    """
    results = [result(*KINDS[k]) for k in kinds]
    assert exit_code_of(results) == expected(kinds)
    assert exit_code_of(results[::-1]) == expected(kinds)
    assert exit_code_of([r for r in results for _ in range(2)]) == expected(kinds)


@pytest.mark.parametrize(
    ("codes", "code"),
    [
        ((0,), 0),
        ((2,), 2),
        ((3,), 3),
        ((4,), 4),
        ((2, 3), 2),
        ((2, 4), 4),
        ((3, 4), 4),
        ((2, 3, 4), 4),
    ],
)
def test_when_no_trial_has_results(codes: tuple[int, ...], code: int) -> None:
    """Catches the largest code: an input that can't be read is 2, whatever else was lost."""
    assert exit_code_of([result(c, False) for c in codes]) == code


@pytest.mark.parametrize(
    ("codes", "code"),
    [
        ((0,), 0),
        ((0, 2), 3),
        ((0, 3), 3),
        ((0, 4), 4),
        ((0, 2, 3), 3),
        ((0, 2, 4), 4),
        ((0, 3, 4), 4),
        ((0, 2, 3, 4), 4),
    ],
)
def test_when_one_trial_has_results(codes: tuple[int, ...], code: int) -> None:
    """Catches 2 for a run of which a part is there: it is 3, as the rest was done."""
    assert exit_code_of([result(c, c == 0) for c in codes]) == code


def test_no_trials_are_no_fault() -> None:
    """Catches an exception over an empty run."""
    assert exit_code_of([]) == 0
