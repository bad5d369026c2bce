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
from dgeval.recording.manifest import find_trials
from dgeval.statistics import confusion, macro_f1, wilson

LABELS = {
    "imprecise_pose": "imprecise pose",
    "collision": "collision",
    "timing": "timing",
    "unknown": "unknown",
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


def failure_shares(trials: pd.DataFrame) -> list[Share]:
    """Share of each class among the failures, `unknown` included.

    The paper's count stands beside it where all trials are of one scenario that the paper reports.
    """
    failed = trials[trials["outcome"] == "failure"]
    scenarios = trials["scenario"].dropna().unique()
    table = published().get(scenarios[0], {}).get("failures") if len(scenarios) == 1 else None
    out = []
    for c in (*CLASSES, "unknown"):
        paper = f"{table[c]}/{sum(table.values())}" if table and c in table else None
        out.append(share(LABELS[c], int((failed["failure_class"] == c).sum()), len(failed), paper))
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


def against_truth(trials: pd.DataFrame, truth: dict[str, dict[str, Any]]) -> dict[str, Any] | None:
    """Score the verdicts against truth, the simulator's verdicts by trial id.

    Accuracy of the outcome; for the failures a confusion matrix with `unknown` as a column,
    macro-F1, the share without a class, and accuracy by blind gap. None where no trial has a truth.
    """
    scored = [(r, truth[r["trial"]]) for r in trials.to_dict("records") if r["trial"] in truth]
    if not scored:
        return None
    decided = [
        (r["outcome"], t["outcome"]) for r, t in scored if r["outcome"] in ("success", "failure")
    ]
    failed = [(r, t) for r, t in scored if t["outcome"] == "failure"]
    predicted = [
        str(r["failure_class"]) if r["outcome"] == "failure" else "no failure" for r, _ in failed
    ]
    true = [str(t["failure_class"]) for _, t in failed]
    columns = (*CLASSES, "unknown", "no failure")
    matrix = confusion(true, predicted, columns)[: len(CLASSES)]
    classified = [(a, b) for a, b in zip(true, predicted, strict=True) if b in CLASSES]
    out: dict[str, Any] = {
        "n": len(scored),
        "outcome": share("outcome", sum(a == b for a, b in decided), len(decided)),
        "columns": [LABELS.get(c, c) for c in columns],
        "rows": [(LABELS[c], row) for c, row in zip(CLASSES, matrix.tolist(), strict=True)],
        "right": share(
            "class, where one is given", sum(a == b for a, b in classified), len(classified)
        ),
        "abstained": share("no class given", sum(b not in CLASSES for b in predicted), len(failed)),
        "f1": macro_f1(true, predicted, CLASSES) if failed else None,
        "f1_given": macro_f1([a for a, _ in classified], [b for _, b in classified], CLASSES)
        if classified
        else None,
        "by_gap": [],
    }
    for sided, name in (
        ("none", "no gap"),
        ("one", "gap, seen before only"),
        ("two", "gap, seen on both sides"),
    ):
        rows = zip(failed, true, predicted, strict=True)
        group = [(a, b) for (r, _), a, b in rows if r["gap_sided"] == sided and b in CLASSES]
        if group:
            out["by_gap"].append(share(name, sum(a == b for a, b in group), len(group)))
    return out
