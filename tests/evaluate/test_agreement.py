"""Verdicts beside what is so, from made-up trials.

Catches: a refused recording or a wrong outcome that is left out of the failures, a calibration
error without what chance gives, a `unknown` that counts as an answer, and words of people that
nobody gave.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from dgeval.cli import app
from dgeval.errors import UsageError
from dgeval.evaluate import words
from dgeval.evaluate.agreement import (
    Judged,
    document_of,
    groups_of,
    in_dispute,
    markdown_of,
    sentence_of,
)
from typer.testing import CliRunner

CLOSE_NS = 3_000_000_000


def text_of(trials: list[Judged]) -> str:
    return markdown_of("belt", trials, document_of(trials))


def said(outcome: str, cause: str | None = None, p: float = 0.0, **more: Any) -> dict[str, Any]:
    """A row of the table of trials."""
    rest = (0.5 if cause == "unknown" else 1.0) - p
    names = ("imprecise_pose", "collision", "timing")
    shares = {c: p if c == cause else rest / 2 for c in names}
    if cause == "unknown":
        shares = dict.fromkeys(names, 0.5 / 3)
    if outcome != "failure":
        shares = dict.fromkeys(names)  # type: ignore[arg-type]
    return {
        "outcome": outcome,
        "failure_class": cause,
        "observed_class": cause,
        "sub_cause": "early",
        "evidence": "why | so",
        "t_close_ns": CLOSE_NS,
        **{f"p_{c}": v for c, v in shares.items()},
        **{f"p_observed_{c}": v for c, v in shares.items()},
        **more,
    }


def so(cause: str | None, close_ns: int | None = CLOSE_NS) -> dict[str, Any]:
    outcome = "success" if cause is None else "failure"
    return {
        "outcome": outcome,
        "failure_class": cause,
        "observed_class": cause,
        "sub_cause": None if cause is None else "early",
        "t_close_ns": close_ns,
    }


TRIALS = [
    Judged("right", "belt", said("failure", "timing", 0.8), so("timing")),
    Judged("wrong", "belt", said("failure", "timing", 0.9), so("collision")),
    Judged("unknown", "belt", said("failure", "unknown"), so("timing")),
    Judged("unseen", "belt", said("success"), so("timing")),
    Judged("refused", "belt", None, so("collision"), ("no images",), 2),
    Judged("held", "belt", said("success", t_close_ns=CLOSE_NS + 60_000_000), so(None)),
]


def test_every_failure_counts() -> None:
    figures = document_of(TRIALS)
    assert (figures["trials"], figures["failures"]) == (6, 5)
    label = figures["labels"]["failure_class"]
    assert label["said"] == {
        "collision": {"timing": 1, "unknown": 0, "no failure": 0, "not replayed": 1},
        "timing": {"timing": 1, "unknown": 1, "no failure": 1, "not replayed": 0},
    }
    assert (label["right"]["k"], label["right"]["n"]) == (1, 5)
    assert (label["unknown"]["k"], label["unknown"]["n"]) == (1, 5)
    # timing: 1 of 3 found, 1 of 2 said rightly; collision: never
    assert label["macro_f1"]["value"] == pytest.approx((2 * 1 / (3 + 2) + 0.0) / 2)
    assert (figures["outcome"]["right"]["k"], figures["outcome"]["right"]["n"]) == (4, 6)
    assert figures["exit_codes"] == {"0": 5, "2": 1}
    assert (figures["sub_cause"]["k"], figures["sub_cause"]["n"]) == (1, 1)


def test_what_is_stated_is_held_against_how_often_it_holds() -> None:
    answered = document_of(TRIALS)["labels"]["failure_class"]["answered"]
    assert (answered["k"], answered["n"]) == (1, 2)
    assert answered["stated"] == pytest.approx(0.85)
    # bins of 0.8 and 0.9: one right, one wrong
    assert answered["calibration_error"] == pytest.approx((0.2 + 0.9) / 2)
    assert 0.1 < answered["calibration_error_of_a_perfect_verdict"] < 0.4


def test_the_brier_score() -> None:
    """0 of a sure right answer; the third that `unknown` leaves open costs too."""
    sure = [Judged("a", "belt", said("failure", "timing", 1.0), so("timing"))]
    assert document_of(sure)["labels"]["failure_class"]["brier"] == pytest.approx(0.0)
    doubt = [Judged("a", "belt", said("failure", "unknown"), so("timing"))]
    sixth = 0.5 / 3
    expected = 2 * sixth**2 + (1 - sixth) ** 2 + 0.5**2
    assert document_of(doubt)["labels"]["failure_class"]["brier"] == pytest.approx(expected)


def test_closes() -> None:
    never = Judged("never", "belt", said("failure", "timing", 0.8), so("timing", None))
    lost = Judged("lost", "belt", said("failure", "timing", 0.8, t_close_ns=None), so("timing"))
    close = document_of([*TRIALS, never, lost])["closes"]
    assert (close["near"]["k"], close["near"]["n"]) == (4, 6)  # one is 60 ms off, one not found
    assert (close["not_found"], close["invented"]) == (1, 1)


def test_the_surest_mistake_comes_first() -> None:
    text = text_of(TRIALS)
    listed = text[text.index("the surest first") :].splitlines()[4:]
    assert [row.split(" | ")[0].strip("| ") for row in listed] == [
        "wrong", "refused", "unknown", "unseen",
    ]  # fmt: skip
    assert "| wrong | collision, early | timing 90% | why / so |" in text
    assert "| refused | collision, early | not replayed | no images |" in text
    assert not in_dispute(TRIALS[0])
    assert not in_dispute(TRIALS[5])
    assert "No verdict is wrong or missing." in text_of(TRIALS[:1])


def test_groups_by_arm_and_condition() -> None:
    """Catches trials of two conditions counted as twice as many trials."""
    made = [
        Judged(f"t{k}", arm, said("success"), so(None), condition=condition)
        for k, (arm, condition) in enumerate(
            [("belt", "stranger"), ("belt", "labelled"), ("hand", "stranger")]
        )
    ]
    groups = {name: [t.trial for t in trials] for name, trials in groups_of(made)}
    assert groups == {
        "belt, stranger": ["t0"],
        "belt, labelled": ["t1"],
        "hand, stranger": ["t2"],
        "all, stranger": ["t0", "t2"],
        "all, labelled": ["t1"],
    }
    assert "hand/t2" not in text_of(made[:1])


def test_no_failures_are_no_error() -> None:
    assert (
        sentence_of(document_of([TRIALS[5]])) == "0 failures of 1 trials, outcome right in 1 of 1"
    )
    assert "0 failures" in text_of([TRIALS[5]])


def test_a_run_beside_peoples_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches trials without a word that count, and words of which nothing is made."""
    rows = [
        {"trial": "a", "cause_given": "timing", **said("failure", "timing", 0.8)},
        {"trial": "b", "cause_given": "collision", **said("failure", "timing", 0.9)},
        {"trial": "c", "cause_given": None, **said("success")},
    ]
    run = type("Run", (), {"trials": pd.DataFrame(rows)})
    monkeypatch.setattr(words, "read_run", lambda _: run)
    judged = words.judged_by_people(tmp_path)
    assert [(t.trial, in_dispute(t)) for t in judged] == [("a", False), ("b", True)]
    (tmp_path / "run.json").write_text("{}")
    done = CliRunner().invoke(app, ["evaluate", str(tmp_path), "--json"])
    assert done.exit_code == 0
    figures = json.loads(done.output)["groups"]["beside people's words"]
    assert figures["labels"]["failure_class"]["right"]["k"] == 1
    assert figures["closes"] is None
    assert "| b | collision | timing 90% |" in (tmp_path / "verdicts.md").read_text()
    run.trials = run.trials[2:]
    with pytest.raises(UsageError, match="none of its 1 trials has a person's word"):
        words.judged_by_people(tmp_path)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["nothing"], "there are paper-dynamic, paper-vfas, verdict; or give a run folder"),
        (["paper-vfas", "--condition", "stranger"], "go with the suite verdict"),
        (["verdict", "--condition", "x"], "there are recorded, stranger, labelled"),
        (["verdict", "--faultless"], "leaves nothing to judge"),
    ],
)
def test_what_does_not_go_together_is_told(options: list[str], told: str) -> None:
    done = CliRunner().invoke(app, ["evaluate", *options])
    assert done.exit_code == 2
    assert told in " ".join(done.output.split())
