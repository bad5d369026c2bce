"""What is known of one trial, in lines for a person and as a figure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from dgeval.errors import Place, UsageError
from dgeval.failure_rule import CLASSES
from dgeval.report.figures import trial_figure
from dgeval.report.summary import LABELS
from dgeval.runs.files import file_name
from dgeval.runs.results import Run
from dgeval.schema import TRIALS, notes_of


def only_trial(run: Run) -> str:
    """The id of a run's one trial; UsageError, with the ids, where it holds another number."""
    names = list(map(str, run.trials["trial"]))
    if len(names) != 1:
        what = f"the run holds {len(names)} trials, and which one is meant is not said"
        raise UsageError(what, Place(str(run.folder)), f"name one: {', '.join(names)}")
    return names[0]


def row_of(run: Run, trial: str) -> dict[str, Any]:
    """A trial's row, nulls as None. UsageError names the trials where it is none of the run."""
    rows = run.trials[run.trials["trial"] == trial].to_dict("records")
    if not rows:
        listed = ", ".join(map(str, run.trials["trial"])) or "none: nothing was replayed"
        raise UsageError(f"no trial {trial!r}", Place(str(run.folder)), f"there are {listed}")
    row: dict[str, Any] = {str(k): None if pd.isna(v) else v for k, v in rows[0].items()}
    # a column with nulls comes back as floats
    integers = {c.name for c in TRIALS if c.kind == "int"}
    return {k: int(v) if k in integers and v is not None else v for k, v in row.items()}


def figure_of(run: Run, trial: str) -> Figure:
    """Errors, velocity and scores of a trial over time, as in the papers' Figures 4 and 5."""
    row, frames = row_of(run, trial), run.frames(trial)
    events = {"close": row["t_close_ns"], "execute": row["t_execute_ns"]}
    return trial_figure(frames, run.hindsight(trial), events, row.get("c_e"), row["speed"])


def lines_of(run: Run, trial: str) -> list[str]:
    """The answer, why, when, and where to look; one paragraph each."""
    row = row_of(run, trial)
    cause, seen = row["failure_class"], row.get("observed_class")
    head = [trial, row["outcome"]]
    if cause is not None:
        p = row[f"p_{cause}"]
        head.append(LABELS[cause] + ("" if p is None or cause == "unknown" else f" {p:.0%}"))
    if row["outcome_source"] is not None:
        head.append(f"({row['outcome_source']})")
    out = ["  ".join(head), row["evidence"] or ""]
    if cause is not None:
        chances = ", ".join(f"{LABELS[c]} {row[f'p_{c}'] or 0:.0%}" for c in (*CLASSES, "unknown"))
        sub = f"; sub-cause: {row['sub_cause']}" if row["sub_cause"] else ""
        out.append(f"cause: {chances}{sub}")
        if seen is not None:
            p = row[f"p_observed_{seen}"]
            sure = "" if p is None or seen == "unknown" else f" ({p:.0%})"
            out.append(f"a person at the video would write: {LABELS[seen]}{sure}")
        if row["blame"] is not None:
            out.append(f"blame: {row['blame']}")
    start_ns = int(run.frames(trial)["t_ns"].iloc[0])
    for name, column in (
        ("close", "t_close_ns"),
        ("the replay would have closed", "t_execute_ns"),
        ("look at", "t_decisive_ns"),
    ):
        if row[column] is not None:
            at_s = (row[column] - start_ns) * 1e-9
            out.append(f"{name}: {at_s:+.2f} s ({int(row[column]) * 1e-9:.3f})")
    out += [f"note: {note}" for note in notes_of(row["notes"])]
    review = Path("review") / f"{file_name(trial)}.rrd"
    if (run.folder / review).is_file():
        out.append(f"see it: dgeval view {run.folder} {trial}")
    return out
