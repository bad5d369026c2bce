"""The report of one or more runs as one HTML file that needs no network and no other file.

The same contents as Markdown, CSV and figures.
"""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import pandas as pd

from dgeval import __version__
from dgeval.pages import as_data_uri, template_environment
from dgeval.report.figures import shares_figure, trial_figure
from dgeval.report.summary import (
    LABELLED,
    against_truth,
    counted_twice,
    failure_shares,
    read_truth,
    share,
    success_by,
    what_first,
)
from dgeval.report.tables import stage_times, trial_summary
from dgeval.runs.files import file_name, write_atomically
from dgeval.runs.results import Run, read_run

PROBABILITIES = ("p_imprecise_pose", "p_collision", "p_timing")


def write_report(folders: list[Path], out: Path, truth: list[Path] | None = None) -> Path:
    """Write report.html, report.md, trials.csv and the figures into `out`; returns report.html.

    truth: recordings or manifests to score the verdicts against. UsageError where a folder is not a
    finished run.
    """
    runs = [read_run(f) for f in folders]
    truths = read_truth(truth) if truth else {}
    environment = template_environment("report/templates")
    sections = [_run(r, truths) for r in runs]
    page = environment.get_template("report.html").render(version=__version__, runs=sections)
    path = out / "report.html"
    write_atomically(path, page)
    write_atomically(
        out / "report.md",
        environment.get_template("report.md").render(version=__version__, runs=sections),
    )
    tables = [r.trials.assign(run=str(r.folder)) for r in runs]
    write_atomically(out / "trials.csv", pd.concat(tables).to_csv(index=False))
    for k, run in enumerate(sections):
        for name, figure in run["figures"].items():
            stem = f"{name}-{k}" if len(sections) > 1 else name
            figure.savefig(out / f"{stem}.png", dpi=110, metadata={"Software": None})
            figure.savefig(out / f"{stem}.svg", metadata={"Date": None})
    return path


def _run(run: Run, truth: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """What the templates show of one run. truth: verdicts of the simulator by trial id."""
    by = (
        {name: success_by(run.trials, name) for name in ("speed", "object", "scenario")}
        if len(run.trials)
        else {}
    )
    classes = {}
    if len(run.trials):
        classes = {title: failure_shares(run.trials, c) for c, title in LABELLED.items()}
    figures = {
        f"success_by_{name}": shares_figure(f"success by {name}", s)
        for name, s in by.items()
        if len(s) > 1
    }
    causes = next(iter(classes.values()), [])
    if any(s.k for s in causes):
        figures["failure_classes"] = shares_figure("failures by cause", causes)
    trials = []
    for record in run.trials.to_dict("records"):
        row: dict[str, Any] = {str(k): None if pd.isna(v) else v for k, v in record.items()}
        frames = run.frames(row["trial"])
        events = {"close": row["t_close_ns"], "execute": row["t_execute_ns"]}
        trials.append(
            {
                **row,
                **trial_summary(frames),
                "figure": as_data_uri(
                    trial_figure(
                        frames, run.hindsight(row["trial"]), events, row.get("c_e"), row["speed"]
                    )
                ),
                "picture": _picture(run.folder / "pictures" / f"{file_name(row['trial'])}.jpg"),
                "decisive_s": None
                if row["t_decisive_ns"] is None
                else (row["t_decisive_ns"] - frames["t_ns"].iloc[0]) * 1e-9,
                "view": f"dgeval view {run.folder} {row['trial']}",
                "messages": [],
            }
        )
    outcomes = run.trials["outcome"].value_counts().to_dict() if len(run.trials) else {}
    return {
        "folder": str(run.folder),
        "about": run.about,
        # failures first, those with the most probable class before the others
        "trials": sorted(
            trials,
            key=lambda t: (
                t["outcome"] != "failure",
                -max(t[p] or 0 for p in PROBABILITIES),
                t["trial"],
            ),
        ),
        "success": share(
            "success",
            outcomes.get("success", 0),
            outcomes.get("success", 0) + outcomes.get("failure", 0),
        ),
        "by": by,
        "classes": classes,
        "figures": figures,
        "drawn": {name: as_data_uri(figure) for name, figure in figures.items()},
        "first": what_first(run.trials) if len(run.trials) else [],
        "twice": counted_twice(run.trials) if len(run.trials) else [],
        "scored": against_truth(run.trials, truth),
        "outcomes": outcomes,
        "failed": run.about["failed"],
        "log": _messages(run),
        "stages": stage_times(run.timings),
        "n_frames": int(run.trials["n_frames"].sum()) if len(run.trials) else 0,
    }


def _picture(path: Path) -> str | None:
    """The picture of the decisive moment as a data URI; None where the file is missing."""
    return (
        "data:image/jpeg;base64," + base64.b64encode(path.read_bytes()).decode()
        if path.is_file()
        else None
    )


def _messages(run: Run) -> list[dict[str, Any]]:
    """The entries of the run's log.jsonl; none where the file can't be read."""
    try:
        lines = (run.folder / "log.jsonl").read_text(encoding="utf-8").splitlines()
    except OSError:
        return []
    return [json.loads(line) for line in lines]
