"""The numbers of a campaign: success with intervals by speed, object and scenario, failure shares, and against truth."""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import pandas as pd

from dgeval.recording.containers.opening import open_container
from dgeval.recording.contract import TRUTH_VERDICT_TOPIC
from dgeval.recording.manifest import find_trials
from dgeval.statistics import confusion, macro_f1, wilson

CLASSES = ("imprecise_pose", "collision", "timing")
WORDS = {
    "imprecise_pose": "imprecise pose",
    "collision": "collision",
    "timing": "timing",
    "unknown": "unknown",
}


@dataclass(frozen=True)
class Share:
    """k of n with the Wilson 95 % interval, and what a paper reports for the same thing, as 'k/n', or None."""

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
    """The papers' tables as counts, by scenario."""
    text = (resources.files("dgeval.report") / "published" / "papers.json").read_text(
        encoding="utf-8"
    )
    return dict(json.loads(text))


def share(name: str, k: int, n: int, paper: str | None = None) -> Share:
    return Share(name, k, n, *wilson(k, n), paper)


def success_by(trials: pd.DataFrame, column: str) -> list[Share]:
    """Success among trials that ended in success or failure, per value of a column, beside the paper's counts."""
    decided = trials[trials["outcome"].isin(["success", "failure"])].dropna(subset=[column])
    out = []
    for value, group in decided.groupby(column, sort=True):
        name, known = str(value), None
        scenarios = group["scenario"].dropna().unique()
        table = published().get(scenarios[0]) if len(scenarios) == 1 else None
        if column == "speed":
            name = f"{1000 * float(str(value)):.0f} mm/s"
            if table and str(round(1000 * float(str(value)))) in table.get("speed_mm_s", {}):
                known = f"{table['speed_mm_s'][str(round(1000 * float(str(value))))]}/{table['n_per_speed']}"
        elif column == "object" and table and name in table.get("object", {}):
            known = f"{table['object'][name]}/{table['n_per_object']}"
        elif column == "scenario" and table and "object" in table:
            known = (
                f"{sum(table['object'].values())}/{table['n_per_object'] * len(table['object'])}"
            )
        out.append(share(name, int((group["outcome"] == "success").sum()), len(group), known))
    return out


def failure_shares(trials: pd.DataFrame) -> list[Share]:
    """Share of each class among failures, `unknown` too, beside the paper's where all trials are of one of its scenarios."""
    failed = trials[trials["outcome"] == "failure"]
    scenarios = trials["scenario"].dropna().unique()
    table = published().get(scenarios[0], {}).get("failures") if len(scenarios) == 1 else None
    out = []
    for c in (*CLASSES, "unknown"):
        known = f"{table[c]}/{sum(table.values())}" if table and c in table else None
        out.append(share(WORDS[c], int((failed["failure_class"] == c).sum()), len(failed), known))
    return out


def what_first(trials: pd.DataFrame) -> list[str]:
    """What to fix first, in words: causes by how many trials they cost, each with where it is worst."""
    failed = trials[trials["outcome"] == "failure"]
    out = []
    for c in failed["failure_class"].value_counts().index:
        group = failed[failed["failure_class"] == c]
        if c == "unknown":
            continue
        said = f"{WORDS[str(c)]}: {len(group)} of {len(failed)} failures"
        sub = group["sub_cause"].dropna().value_counts()
        if len(sub):
            said += f", mostly {sub.index[0]} ({sub.iloc[0]})"
        worst = group["object"].dropna().value_counts()
        if len(worst) and worst.iloc[0] > 1:
            said += f"; most often with {worst.index[0]} ({worst.iloc[0]})"
        blamed = group["blame"].dropna()
        blamed = blamed[blamed != "unknown"].value_counts()
        if len(blamed):
            said += f"; blamed on {blamed.index[0]} in {blamed.iloc[0]}"
        out.append(said)
    return out


def read_truth(paths: list[Path]) -> dict[str, dict[str, Any]]:
    """What simulated recordings say for certain, by trial id. Read only when somebody asks to score verdicts."""
    out = {}
    for spec in find_trials(paths):
        opened = open_container(spec.recording)
        if TRUTH_VERDICT_TOPIC not in opened.topics:
            continue
        for message in opened.messages(frozenset({TRUTH_VERDICT_TOPIC})):
            out[spec.id] = dict(json.loads(opened.decode(message).data))
    return out


def against_truth(trials: pd.DataFrame, truth: dict[str, dict[str, Any]]) -> dict[str, Any] | None:
    """Outcome accuracy, and of the failures: confusion with `unknown` as a column, macro-F1, abstentions, by gap."""
    known = [(r, truth[r["trial"]]) for r in trials.to_dict("records") if r["trial"] in truth]
    if not known:
        return None
    decided = [
        (r["outcome"], t["outcome"]) for r, t in known if r["outcome"] in ("success", "failure")
    ]
    failed = [(r, t) for r, t in known if t["outcome"] == "failure"]
    said = [
        str(r["failure_class"]) if r["outcome"] == "failure" else "no failure" for r, _ in failed
    ]
    true = [str(t["failure_class"]) for _, t in failed]
    columns = (*CLASSES, "unknown", "no failure")
    matrix = confusion(true, said, columns)[: len(CLASSES)]
    sure = [(a, b) for a, b in zip(true, said, strict=True) if b in CLASSES]
    out: dict[str, Any] = {
        "n": len(known),
        "outcome": share("outcome", sum(a == b for a, b in decided), len(decided)),
        "columns": [WORDS.get(c, c) for c in columns],
        "rows": [(WORDS[c], row) for c, row in zip(CLASSES, matrix.tolist(), strict=True)],
        "right": share("class, where one is given", sum(a == b for a, b in sure), len(sure)),
        "abstained": share("no class given", sum(b not in CLASSES for b in said), len(failed)),
        "f1": macro_f1(true, said, CLASSES) if failed else None,
        "f1_given": macro_f1([a for a, _ in sure], [b for _, b in sure], CLASSES) if sure else None,
        "by_gap": [],
    }
    for sided, name in (
        ("none", "no gap"),
        ("one", "gap, seen before only"),
        ("two", "gap, seen on both sides"),
    ):
        rows = zip(failed, true, said, strict=True)
        group = [(a, b) for (r, _), a, b in rows if r["gap_sided"] == sided and b in CLASSES]
        if group:
            out["by_gap"].append(share(name, sum(a == b for a, b in group), len(group)))
    return out
