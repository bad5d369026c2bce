"""The numbers of a campaign.

Success with intervals by speed, object and scenario; shares of the failure classes; and the
verdicts against the simulator's truth.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import pandas as pd

from dgeval.failure_rule import CLASSES
from dgeval.recording.containers.opening import open_container
from dgeval.recording.contract import TRUTH_VERDICT_TOPIC
from dgeval.recording.copies import COUNTS_TWICE
from dgeval.recording.manifest import find_trials
from dgeval.schema import notes_of
from dgeval.statistics import confusion, macro_f1, wilson

LABELS = {
    "imprecise_pose": "imprecise pose",
    "collision": "collision",
    "timing": "timing",
    "unknown": "unknown",
}

# the two labels of a failure, and what each counts
LABELLED = {
    "failure_class": "by what would have had to be different",
    "observed_class": "as a person at the video would write",
}


@dataclass(frozen=True)
class Share:
    """A share k of n.

    low, high: Wilson 95 % interval of k / n. published: the paper's count for the same quantity as
    'k/n', or None.
    """

    name: str
    k: int
    n: int
    low: float
    high: float
    published: str | None = None

    @property
    def percent(self) -> float:
        return 100 * self.k / self.n if self.n else float("nan")


def published() -> dict[str, Any]:
    """The counts in the papers' tables, by scenario (published/papers.json)."""
    text = (resources.files("dgeval.report") / "published" / "papers.json").read_text(
        encoding="utf-8"
    )
    return dict(json.loads(text))


def share(name: str, k: int, n: int, paper: str | None = None) -> Share:
    """k of n with its Wilson interval. paper: 'k/n' or None."""
    return Share(name, k, n, *wilson(k, n), paper)


def success_by(trials: pd.DataFrame, column: str) -> list[Share]:
    """Share of success per value of a column, beside the paper's counts.

    Only trials that ended in success or failure count.
    """
    decided = trials[trials["outcome"].isin(["success", "failure"])].dropna(subset=[column])
    out = []
    for value, group in decided.groupby(column, sort=True):
        name, paper = str(value), None
        scenarios = group["scenario"].dropna().unique()
        table = published().get(scenarios[0]) if len(scenarios) == 1 else None
        if column == "speed":
            name = f"{1000 * float(str(value)):.0f} mm/s"
            mm_s = str(round(1000 * float(str(value))))
            if table and mm_s in table.get("speed_mm_s", {}):
                paper = f"{table['speed_mm_s'][mm_s]}/{table['n_per_speed']}"
        elif column == "object" and table and name in table.get("object", {}):
            paper = f"{table['object'][name]}/{table['n_per_object']}"
        elif column == "scenario" and table and "object" in table:
            paper = (
                f"{sum(table['object'].values())}/{table['n_per_object'] * len(table['object'])}"
            )
        out.append(share(name, int((group["outcome"] == "success").sum()), len(group), paper))
    return out


def failure_shares(trials: pd.DataFrame, column: str = "failure_class") -> list[Share]:
    """Share of each class among the failures, `unknown` included; none without the column.

    column: failure_class, or observed_class. Beside the latter, which counts as the paper does,
    stands the paper's count where all trials are of one scenario that the paper reports.
    """
    if column not in trials:
        return []
    failed = trials[trials["outcome"] == "failure"]
    scenarios = trials["scenario"].dropna().unique()
    counts_alike = column == "observed_class" and len(scenarios) == 1
    table = published().get(scenarios[0], {}).get("failures") if counts_alike else None
    out = []
    for c in (*CLASSES, "unknown"):
        paper = f"{table[c]}/{sum(table.values())}" if table and c in table else None
        out.append(share(LABELS[c], int((failed[column] == c).sum()), len(failed), paper))
    return out


def what_first(trials: pd.DataFrame) -> list[str]:
    """Sentences on what to fix first: causes by number of failures, each with its worst object."""
    failed = trials[trials["outcome"] == "failure"]
    out = []
    for c in failed["failure_class"].value_counts().index:
        group = failed[failed["failure_class"] == c]
        if c == "unknown":
            continue
        sentence = f"{LABELS[str(c)]}: {len(group)} of {len(failed)} failures"
        sub = group["sub_cause"].dropna().value_counts()
        if len(sub):
            sentence += f", mostly {sub.index[0]} ({sub.iloc[0]})"
        worst = group["object"].dropna().value_counts()
        if len(worst) and worst.iloc[0] > 1:
            sentence += f"; most often with {worst.index[0]} ({worst.iloc[0]})"
        blamed = group["blame"].dropna()
        blamed = blamed[blamed != "unknown"].value_counts()
        if len(blamed):
            sentence += f"; blamed on {blamed.index[0]} in {blamed.iloc[0]}"
        out.append(sentence)
    return out


def counted_twice(trials: pd.DataFrame) -> list[str]:
    """Sentences on trials whose file holds what another trial's holds, by their notes."""
    out = []
    for trial, notes in zip(trials["trial"], trials["notes"].fillna(""), strict=True):
        out += [f"{trial}: {note}" for note in notes_of(notes) if note.endswith(COUNTS_TWICE)]
    return out


def read_truth(paths: list[Path]) -> dict[str, dict[str, Any]]:
    """The simulator's verdict (topic TRUTH_TOPIC) by trial id; recordings without it are left out.

    Only the scoring of verdicts reads it.
    """
    out = {}
    for spec in find_trials(paths):
        opened = open_container(spec.recording, spec.parts)
        if TRUTH_VERDICT_TOPIC not in opened.topics:
            continue
        for message in opened.messages(frozenset({TRUTH_VERDICT_TOPIC})):
            out[spec.id] = dict(json.loads(opened.decode(message).data))
    return out


@dataclass(frozen=True)
class Scored:
    """One label of the failures, by verdict and by truth.

    column: failure_class or observed_class. rows: of each true class, how often each of `columns`
    was said. f1, f1_given: macro-F1 with its interval, `unknown` counted as wrong, and where a
    class is given; None where there is nothing to count.
    """

    column: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, list[int]], ...]
    right: Share
    abstained: Share
    f1: tuple[float, float, float] | None
    f1_given: tuple[float, float, float] | None
    by_gap: tuple[Share, ...]

    @property
    def shares(self) -> list[Share]:
        return [self.right, self.abstained, *self.by_gap]


def against_truth(trials: pd.DataFrame, truth: dict[str, dict[str, Any]]) -> dict[str, Any] | None:
    """Score the verdicts against truth, the simulator's verdicts by trial id.

    Accuracy of the outcome; for the failures each label that the truth holds. None where no trial
    has a truth.
    """
    scored = [(r, truth[r["trial"]]) for r in trials.to_dict("records") if r["trial"] in truth]
    if not scored:
        return None
    decided = [
        (r["outcome"], t["outcome"]) for r, t in scored if r["outcome"] in ("success", "failure")
    ]
    failed = [(r, t) for r, t in scored if t["outcome"] == "failure"]
    return {
        "n": len(scored),
        "outcome": share("outcome", sum(a == b for a, b in decided), len(decided)),
        "labels": [
            _scored(column, title, failed)
            for column, title in LABELLED.items()
            if all(t.get(column) for _, t in failed) and column in trials
        ],
    }


def _scored(column: str, title: str, failed: list[tuple[dict[Any, Any], dict[str, Any]]]) -> Scored:
    """One label of the failures (row, truth): confusion, macro-F1, and accuracy by blind gap."""
    predicted = [str(r[column]) if r["outcome"] == "failure" else "no failure" for r, _ in failed]
    true = [str(t[column]) for _, t in failed]
    columns = (*CLASSES, "unknown", "no failure")
    matrix = confusion(true, predicted, columns)[: len(CLASSES)]
    given = [(a, b) for a, b in zip(true, predicted, strict=True) if b in CLASSES]
    by_gap = []
    for sided, name in (
        ("none", "no gap"),
        ("one", "gap, seen before only"),
        ("two", "gap, seen on both sides"),
    ):
        rows = zip(failed, true, predicted, strict=True)
        group = [(a, b) for (r, _), a, b in rows if r["gap_sided"] == sided and b in CLASSES]
        if group:
            by_gap.append(share(name, sum(a == b for a, b in group), len(group)))
    return Scored(
        column,
        title,
        tuple(LABELS.get(c, c) for c in columns),
        tuple((LABELS[c], row) for c, row in zip(CLASSES, matrix.tolist(), strict=True)),
        share("class, where one is given", sum(a == b for a, b in given), len(given)),
        share("no class given", sum(b not in CLASSES for b in predicted), len(failed)),
        macro_f1(true, predicted, CLASSES) if failed else None,
        macro_f1([a for a, _ in given], [b for _, b in given], CLASSES) if given else None,
        tuple(by_gap),
    )
