"""Two runs side by side: the first difference, changed facts of the log, the better replay."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd

from dgeval.compare.divergence import TrialDifference, difference
from dgeval.compare.paired import ALPHA, METRICS, Result, answers, timing, trial_metrics
from dgeval.errors import UsageError
from dgeval.geometry import Array
from dgeval.runs.results import Run
from dgeval.schema import SCHEMA_VERSION, STAGES

# Columns of the trial table that state facts of the log. New code should not change them; where
# it does, one of the two runs is wrong.
FACTS = (
    "outcome",
    "outcome_source",
    "failure_class",
    "observed_class",
    "sub_cause",
    "blame",
    "gap_sided",
    "n_frames",
    "t_close_ns",
)
Conclusion = Literal[
    "identical", "within tolerance", "better", "same", "inconclusive", "disagreement", "worse"
]


@dataclass(frozen=True)
class Comparison:
    """Run `new` against run `old`.

    trials: ids in both runs, sorted. config, versions: (field, old value, new value) of each
    difference. facts: (trial, column of FACTS, old value, new value) of each difference. values:
    (n,) arrays of METRICS by name, of the old and of the new run, in the order of `trials`.
    timings: (stage, factor of the median time, p). Where every digest is equal, `values` and
    `results` are empty: there is nothing to measure.
    """

    old: Run
    new: Run
    trials: tuple[str, ...]
    only_old: tuple[str, ...]
    only_new: tuple[str, ...]
    config: tuple[tuple[str, Any, Any], ...]
    versions: tuple[tuple[str, Any, Any], ...]
    differences: tuple[TrialDifference, ...]
    facts: tuple[tuple[str, str, Any, Any], ...]
    values: tuple[dict[str, Array], dict[str, Array]]
    results: tuple[Result, ...]
    timings: tuple[tuple[str, float, float], ...]

    @property
    def conclusion(self) -> Conclusion:
        """The worst answer of any metric, where a difference is beyond its tolerance.

        A changed fact of the log is a disagreement, also where every stage gives the same bytes
        (then the verdict changed): one of the two runs is wrong, and no metric says which.
        """
        metric_answers = {
            r.answer for r in self.results if any(not d.within for d in self.differences)
        }
        if self.facts and "worse" not in metric_answers:
            return "disagreement"
        if not self.differences:
            return "identical"
        if not metric_answers:
            return "within tolerance"
        order: tuple[Conclusion, ...] = ("worse", "inconclusive", "better", "same")
        return next(answer for answer in order if answer in metric_answers or answer == "same")

    @property
    def first(self) -> TrialDifference | None:
        """The earliest difference: by frame, then stage, then trial; beyond tolerance if any is."""
        beyond = [d for d in self.differences if not d.within] or list(self.differences)
        return min(
            beyond,
            key=lambda d: (d.first.frame, STAGES.index(d.first.stage), d.trial),
            default=None,
        )


def compare_runs(old: Run, new: Run, alpha: float = ALPHA) -> Comparison:
    """Compare two runs, trials paired by id.

    alpha: level of the metrics' tests. UsageError where the runs have no trial in common, or where
    the tables of a run have another schema version.
    """
    for run in (old, new):
        if run.about["schema_version"] != SCHEMA_VERSION:
            what = (
                f"{run.folder}: tables of schema {run.about['schema_version']}, this dgeval "
                f"compares {SCHEMA_VERSION}"
            )
            raise UsageError(what, hint="replay the recordings again with this version")
    rows = [run.trials.set_index("trial") for run in (old, new)]
    trials = sorted(set(rows[0].index) & set(rows[1].index))
    if not trials:
        raise UsageError(
            f"{old.folder} and {new.folder} have no trial in common",
            hint="trials are paired by their id",
        )
    # a fact that was added since the older run is in one of the tables alone
    stated = [fact for fact in FACTS if all(fact in table for table in rows)]
    differences: list[TrialDifference] = []
    facts: list[tuple[str, str, Any, Any]] = []
    before, after = [], []
    same_digests = all(
        (rows[0].loc[trials, f"digest_{s}"] == rows[1].loc[trials, f"digest_{s}"]).all()
        for s in STAGES
    )
    for trial in trials:
        a, b = rows[0].loc[trial], rows[1].loc[trial]
        facts += [(trial, f, a[f], b[f]) for f in stated if not _equal(a[f], b[f])]
        if same_digests:
            continue
        hindsight = old.hindsight(trial)
        close_ns, was_ns, now_ns = (
            None if pd.isna(t) else int(t)
            for t in (a["t_close_ns"], a["t_execute_ns"], b["t_execute_ns"])
        )
        frames = old.frames(trial)
        before.append(trial_metrics(frames, hindsight, close_ns, was_ns))
        after.append(before[-1])
        if any(a[f"digest_{s}"] != b[f"digest_{s}"] for s in STAGES):
            new_frames = new.frames(trial)
            if (trial_difference := difference(trial, frames, new_frames)) is not None:
                differences.append(trial_difference)
                after[-1] = trial_metrics(new_frames, hindsight, close_ns, now_ns)
    values = tuple(
        {m.name: np.array([row[m.name] for row in side]) for m in METRICS}
        for side in (before, after)
    )
    about = [{"dgeval": run.about["dgeval"], **run.about["fingerprint"]} for run in (old, new)]
    return Comparison(
        old=old,
        new=new,
        trials=tuple(trials),
        only_old=tuple(sorted(set(rows[0].index) - set(trials))),
        only_new=tuple(sorted(set(rows[1].index) - set(trials))),
        config=tuple(changed(old.about["config"], new.about["config"])),
        versions=tuple(changed(about[0], about[1])),
        differences=tuple(differences),
        facts=tuple(facts),
        values=(values[0], values[1]),
        results=tuple(answers(values[0], values[1], alpha)),
        timings=tuple(_timings(old, new, trials)),
    )


def changed(
    old: dict[str, Any], new: dict[str, Any], prefix: str = ""
) -> list[tuple[str, Any, Any]]:
    """Fields of nested dictionaries that are not equal: (dotted name, old value, new value).

    A value is None where the field is missing.
    """
    out = []
    for key in sorted(set(old) | set(new)):
        a, b = old.get(key), new.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            out += changed(a, b, f"{prefix}{key}.")
        elif a != b:
            out.append((f"{prefix}{key}", a, b))
    return out


def _equal(a: Any, b: Any) -> bool:
    """Equal values; two nulls are equal."""
    return bool(a == b) or bool(pd.isna(a) and pd.isna(b))


def _timings(old: Run, new: Run, trials: list[str]) -> list[tuple[str, float, float]]:
    """By stage: factor of the median time per frame, new over old, and p (see paired.timing)."""
    kept = [run.timings[run.timings["trial"].isin(trials)] for run in (old, new)]
    out = []
    for stage in kept[0]["stage"].drop_duplicates():
        a, b = (t.loc[t["stage"] == stage, "seconds"].to_numpy(dtype=float) for t in kept)
        if len(a) and len(b):
            out.append((str(stage), *timing(a, b)))
    return out
