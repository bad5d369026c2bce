"""Catches: results of the Python functions that differ from those of `dgeval replay`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from dgeval.api import judge_trial, load_run, look_back, open_trial, replay_trial
from dgeval.config import load_config
from dgeval.errors import UsageError
from dgeval.perception.pipeline import Perception
from dgeval.recording.manifest import find_trials
from dgeval.runs.folder import finish_run
from dgeval.runs.workers import replay_trials

FRAMES = 6


@pytest.fixture
def manifest(demo: Path, tmp_path: Path) -> Path:
    """Two trials of a few frames each of the demo recording."""
    trials = [
        f'[[trial]]\nid = "{name}"\nrecording = "{demo}"\nframes = [{first}, {first + FRAMES}]\n'
        for name, first in (("first", 0), ("second", 10))
    ]
    path = tmp_path / "trials.toml"
    path.write_text("\n".join(trials), encoding="utf-8")
    return path


def test_functions_give_what_replay_writes(manifest: Path, tmp_path: Path) -> None:
    """Catches another order of calls, a default that differs, and a table read wrongly."""
    config = load_config()
    specs = [s for s in find_trials([manifest]) if s.id == "first"]
    out = tmp_path / "run"
    results = replay_trials(specs, config, out, None, False, 1, lambda _: None)
    finish_run(out, results, config)
    run = load_run(out)

    trial = open_trial(manifest, trial="first")
    perception = Perception(trial.config)
    rows: list[dict[str, Any]] = []

    def noted() -> Any:
        for step in replay_trial(trial, perception):
            rows.append(step.row)
            yield step

    hindsight = look_back(trial, noted(), perception)
    judgement = judge_trial(trial, hindsight)

    table = run.frames("first")
    assert list(table["frame"]) == list(range(FRAMES))
    written = [{k: v for k, v in row.items() if not _null(v)} for row in table.to_dict("records")]
    assert written == [{k: v for k, v in row.items() if not _null(v)} for row in rows]
    (row,) = run.trials.to_dict("records")
    assert row["trial"] == "first"
    assert len(row["digest_tracking"]) == 64
    for column, value in asdict(judgement.row).items():
        assert row[column] == value or (_null(row[column]) and _null(value)), column


def _null(value: Any) -> bool:
    return bool(pd.isna(value))


@pytest.mark.parametrize(
    ("trial", "message"),
    [(None, "several trials"), ("third", "no trial 'third'")],
)
def test_a_trial_that_is_not_clear_is_refused(
    manifest: Path, trial: str | None, message: str
) -> None:
    """Catches the first of several trials taken in silence; the error names those there are."""
    with pytest.raises(UsageError, match=message) as caught:
        open_trial(manifest, trial=trial)
    assert "name one of first, second" in str(caught.value)


def test_a_configuration_is_used(manifest: Path) -> None:
    """Catches a configuration that is dropped for the default."""
    config = load_config("dynamic", ("tracking.method=csrt",))
    assert open_trial(manifest, config, "second").config == config


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    """Catches a traceback in place of an error that says what to do."""
    with pytest.raises(UsageError, match="not a finished run"):
        load_run(tmp_path)
