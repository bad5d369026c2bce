"""What `dgeval replay` prints of its trials."""

from __future__ import annotations

from pathlib import Path

import pytest
from dgeval.cli.replay import MOST_WITH_NOTES, _print_summary
from dgeval.runs.folder import TrialResult


def printed(capsys: pytest.CaptureFixture[str], n_trials: int) -> list[str]:
    row = {
        "n_frames": 9, "n_lost": 0, "n_predicted": 0, "outcome": "failure", "evidence": "why",
        "notes": "check measured: none | a hand; mark it | stand-in: x",
    }  # fmt: skip
    messages = ["check measured: none"]
    results = [TrialResult(f"t{k}", row, 3, messages, "0") for k in range(n_trials)]
    _print_summary(Path("run"), results, False)
    return capsys.readouterr().out.splitlines()


def test_each_note_has_its_line_and_none_is_said_twice(capsys: pytest.CaptureFixture[str]) -> None:
    """Catches one paragraph of fifteen notes, a note cut at its own semicolon, and what standard
    error has said said again.
    """
    assert printed(capsys, 1) == [
        "t0: failure, 9 frames, 0 lost, 0 predicted",
        "  why",
        "  note: a hand; mark it",
        "  note: stand-in: x",
        "tables: run",
    ]


def test_of_many_trials_the_notes_stay_in_the_tables(capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a thousand lines of notes for a campaign, and no word of where they are."""
    lines = printed(capsys, MOST_WITH_NOTES + 1)
    assert len(lines) == 2 * (MOST_WITH_NOTES + 1) + 2
    assert lines[-2] == "notes of each: dgeval show run TRIAL"
