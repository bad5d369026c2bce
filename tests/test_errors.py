"""Catches: an internal error with exit code 1 ("regression"), a lost traceback.

Also an error message where the reader of standard output closed the pipe.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from dgeval.cli import app
from dgeval.cli.boundary import command
from dgeval.config import load_config
from dgeval.errors import EXIT_CODES, Place, UsageError
from dgeval.recording.manifest import TrialSpec
from dgeval.runs.folder import finish_run
from dgeval.runs.trial_job import replay_trial
from typer.testing import CliRunner

Dgeval = Callable[..., "subprocess.CompletedProcess[str]"]
REPORT, COMPARE = "dgeval.report.html.write_report", "dgeval.compare.comparison.compare_runs"
INSPECT, CONFIG = "dgeval.recording.inspection.inspect_recording", "dgeval.config.load_config"


def broken(*_: Any, **__: Any) -> None:
    raise KeyError("nobody foresaw this")


def test_every_command_has_the_boundary() -> None:
    """A new command without it would leave with Python's 1, which means a regression."""
    for info in app.registered_commands:
        assert info.callback is not None
        assert info.callback.__code__ is command(lambda: None).__code__, info.name


@pytest.mark.parametrize(
    ("function", "arguments"),
    [
        (REPORT, ("report", "RUN")),
        (COMPARE, ("compare", "RUN", "RUN", "--out", "RUN/compared")),
        (COMPARE, ("compare", "RUN", "RUN")),
        (INSPECT, ("inspect", "DEMO")),
        (INSPECT, ("inspect", "DEMO", "--json")),
        (CONFIG, ("config", "show")),
        (CONFIG, ("regress", "DEMO", "--baseline", "none.zip", "--out", "RUN/gate")),
        (CONFIG, ("replay", "DEMO", "--out", "RUN/again")),
        ("dgeval.simulation.scenario.load_scenario", ("simulate", "static", "--out", "RUN/made")),
        ("dgeval.training.vfas.train_all", ("train", "vfas", "--out", "RUN/trained")),
        ("subprocess.call", ("view", "RUN", "demo")),
    ],
)
def test_an_unforeseen_error_is_one_line_exit_4_and_a_traceback_in_the_log(
    monkeypatch: pytest.MonkeyPatch,
    demo_run: Path,
    demo: Path,
    tmp_path: Path,
    function: str,
    arguments: tuple[str, ...],
) -> None:
    run = tmp_path / "run"
    run.mkdir()
    for name in ("run.json", "trials.parquet", "timings.parquet", "review"):
        (run / name).symlink_to(demo_run / name)
    monkeypatch.setattr(function, broken)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    options = [a.replace("RUN", str(run)).replace("DEMO", str(demo)) for a in arguments]
    done = CliRunner().invoke(app, options)
    assert done.exit_code == 4, done.output
    lines = done.stderr.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(
        "error: internal error: KeyError: 'nobody foresaw this' at test_errors.py:"
    )
    log = Path(lines[0].split("the traceback is in ")[1])
    assert log.is_relative_to(tmp_path)
    entry = json.loads(log.read_text().splitlines()[-1])
    assert "Traceback" in entry["traceback"]
    assert "nobody foresaw this" in entry["traceback"]
    if "--json" in options:
        assert json.loads(done.stdout)["exit_code"] == 4


def test_a_log_that_cannot_be_written_goes_elsewhere(tmp_path: Path) -> None:
    """The folder itself may be the reason of the error."""
    (tmp_path / "file").touch()

    @command
    def fails(out: Path) -> None:
        broken()

    done = CliRunner().invoke(_single(lambda: fails(out=tmp_path / "file")))
    assert done.exit_code == 4
    assert Path(done.stderr.strip().split("the traceback is in ")[1]).is_file()


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (
            UsageError("no such scenario", Place("x.toml"), "try static"),
            2,
            "error: no such scenario; try static [file x.toml]",
        ),
        (PermissionError(13, "denied", "locked.mcap"), 2, "error: no permission (locked.mcap)"),
    ],
)
def test_known_errors_keep_their_code(error: Exception, code: int, message: str) -> None:
    @command
    def fails() -> None:
        raise error

    done = CliRunner().invoke(_single(fails))
    assert done.exit_code == code
    assert done.stderr.strip() == message


def _single(function: Callable[[], None]) -> Any:
    import typer

    one = typer.Typer(rich_markup_mode=None)
    one.command()(lambda: function())
    return one


def test_a_crashed_trial_has_its_traceback_in_the_log(
    monkeypatch: pytest.MonkeyPatch, demo: Path, tmp_path: Path
) -> None:
    monkeypatch.setattr("dgeval.runs.trial_job.open_trial", broken)
    config = load_config("dynamic", ())
    result = replay_trial(TrialSpec("a", demo), config, tmp_path, None, True)
    assert finish_run(tmp_path, [result], config) == 4
    assert "\n" not in result.messages[0]
    entries = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert "nobody foresaw this" in entries[1]["traceback"]


@pytest.mark.parametrize(
    "arguments", [["--help"], ["config", "show"], ["inspect", "DEMO", "--json"]]
)
def test_a_closed_pipe_is_quiet(demo: Path, arguments: list[str]) -> None:
    options = [str(demo) if a == "DEMO" else a for a in arguments]
    command = [sys.executable, "-m", "dgeval", *options]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
        assert process.wait() == 0


def test_the_table_of_exit_codes_is_told(dgeval: Dgeval) -> None:
    help_text = " ".join(dgeval("--help").stdout.split())
    for code, meaning in EXIT_CODES.items():
        assert f"{code} {meaning}" in help_text
