"""One HTML file for a run or several: trials, losses, velocities, plots. No network, no files beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd

from dgeval import __version__
from dgeval.report.figures import as_data_uri, trial_figure
from dgeval.report.tables import Run, read_run, stage_times, trial_summary


def write_report(folders: list[Path], out: Path) -> Path:
    """Write `report.html` into `out`; UsageError where a folder is not a finished run."""
    runs = [read_run(f) for f in folders]
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("dgeval", "report/templates"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    page = environment.get_template("report.html").render(version=__version__, runs=[_run(r) for r in runs])
    out.mkdir(parents=True, exist_ok=True)
    path = out / "report.html"
    part = path.with_suffix(".html.part")
    part.write_text(page, encoding="utf-8")
    part.replace(path)
    return path


def _run(run: Run) -> dict[str, Any]:
    trials = []
    for record in run.trials.to_dict("records"):
        row: dict[str, Any] = {str(k): None if pd.isna(v) else v for k, v in record.items()}
        frames = run.frames(row["trial"])
        events = {"close": row["t_close_ns"], "execute": row["t_execute_ns"]}
        trials.append(
            {
                **row,
                **trial_summary(frames),
                "figure": as_data_uri(trial_figure(frames, events)),
                "view": f"dgeval view {run.folder} {row['trial']}",
                "messages": [],
            }
        )
    outcomes = run.trials["outcome"].value_counts().to_dict() if len(run.trials) else {}
    return {
        "folder": str(run.folder),
        "about": run.about,
        "trials": sorted(trials, key=lambda t: -t["lost_s"] / max(t["duration_s"], 1e-9)),
        "outcomes": outcomes,
        "failed": run.about["failed"],
        "log": _messages(run),
        "stages": stage_times(run.timings),
        "n_frames": int(run.trials["n_frames"].sum()) if len(run.trials) else 0,
    }


def _messages(run: Run) -> list[dict[str, Any]]:

    try:
        lines = (run.folder / "log.jsonl").read_text(encoding="utf-8").splitlines()
    except OSError:
        return []
    return [json.loads(line) for line in lines]
