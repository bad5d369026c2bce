"""A run's verdicts beside people's words: `cause` of the trials in its manifest."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from dgeval.errors import Place, UsageError
from dgeval.evaluate.agreement import Judged
from dgeval.runs.results import read_run


def judged_by_people(run: Path) -> list[Judged]:
    """The trials of a finished run for which a manifest gave a cause, each of them a failure.

    The word stands for both labels: what would have had to be different, and what a person at the
    video sees. UsageError where no trial has one.
    """
    trials = read_run(run).trials
    rows = trials[trials["cause_given"].notna()].to_dict("records")
    if not rows:
        raise UsageError(
            f"none of its {len(trials)} trials has a person's word for its cause",
            Place(str(run)),
            'give cause = "imprecise_pose", "collision" or "timing" to trials of the manifest, and '
            "replay it again",
        )
    out = []
    for row in rows:
        said = {str(k): None if pd.isna(v) else v for k, v in row.items()}
        word = str(said["cause_given"])
        true = {"outcome": "failure", "failure_class": word, "observed_class": word}
        out.append(Judged(str(said["trial"]), "beside people's words", said, true))
    return out
