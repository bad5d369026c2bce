"""Reading finished run folders."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from dgeval.errors import Place, UsageError
from dgeval.runs.files import file_name

WRITTEN = {"dgeval", "config", "fingerprint", "inputs", "failed"}  # keys of run.json


@dataclass(frozen=True)
class Run:
    """One run folder: its metadata and tables."""

    folder: Path
    about: dict[str, Any]
    trials: pd.DataFrame
    timings: pd.DataFrame

    def frames(self, trial: str) -> pd.DataFrame:
        """The frame table of a trial, by the trial's id."""
        return pd.read_parquet(self.folder / "frames" / f"{file_name(trial)}.parquet")

    def hindsight(self, trial: str) -> pd.DataFrame | None:
        """The hindsight table; None where the object was never tracked or there was no grasp."""
        path = self.folder / "hindsight" / f"{file_name(trial)}.parquet"
        rows = pd.read_parquet(path) if path.is_file() else None
        return None if rows is None or not len(rows) else rows


def read_run(folder: Path) -> Run:
    """Read a run folder; UsageError where it is not a finished run."""
    try:
        about = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        trials = pd.read_parquet(folder / "trials.parquet")
        timings = pd.read_parquet(folder / "timings.parquet")
        if not (isinstance(about, dict) and about.keys() >= WRITTEN):
            raise ValueError("run.json is not what a run writes")
    except (OSError, ValueError) as error:
        hint = "run `dgeval replay … --out` first, or again if it was interrupted"
        raise UsageError(
            f"not a finished run ({type(error).__name__})", Place(str(folder)), hint
        ) from error
    return Run(folder, about, trials, timings)
