"""The views: a review recording and a report.

Catches: a review that Rerun refuses or that differs from run to run, a report that needs the
network.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from dgeval.recording.copies import COUNTS_TWICE

Run = Callable[..., subprocess.CompletedProcess[str]]


def test_review_is_accepted_by_rerun_and_small(demo_run: Path, demo: Path) -> None:
    file = demo_run / "review" / "demo.rrd"
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(file)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert file.stat().st_size < demo.stat().st_size


@pytest.mark.slow
def test_review_content_is_the_same_twice(
    demo_run: Path, demo: Path, dgeval: Run, tmp_path: Path
) -> None:
    from dgeval.rerun_view import content_digest

    done = dgeval("replay", demo, "--out", tmp_path / "again")
    assert done.returncode == 0, done.stderr
    first, second = (
        content_digest(p / "review" / "demo.rrd") for p in (demo_run, tmp_path / "again")
    )
    assert first == second


def test_view_names_the_file_or_what_is_there(demo_run: Path, dgeval: Run) -> None:
    done = dgeval("view", demo_run, "demo", "--path")
    assert done.stdout.strip().endswith("demo.rrd")
    missing = dgeval("view", demo_run, "nothing")
    assert missing.returncode == 2
    assert "no trial 'nothing' in this run; its trials: demo" in missing.stderr


def test_a_run_whose_metadata_are_damaged_is_no_internal_error(
    demo_run: Path, dgeval: Run, tmp_path: Path
) -> None:
    for name in ("trials.parquet", "timings.parquet"):
        (tmp_path / name).symlink_to(demo_run / name)
    for text in ("[]", "{}", "null"):
        (tmp_path / "run.json").write_text(text)
        done = dgeval("report", tmp_path)
        assert done.returncode == 2
        assert "not a finished run" in done.stderr


def test_names_with_bars_keep_their_columns_and_copies_are_told(
    demo_run: Path, dgeval: Run, tmp_path: Path
) -> None:
    """Catches a table of report.md that an object's name takes apart."""
    run = tmp_path / "run"
    shutil.copytree(demo_run, run)
    rows = pd.read_parquet(run / "trials.parquet")
    rows["object"] = "box|red"
    rows["notes"] = f"a | this file is the same bytes as b.mcap: {COUNTS_TWICE} | c"
    rows.to_parquet(run / "trials.parquet")
    assert dgeval("report", run, "--out", tmp_path).returncode == 0
    page = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "| box\\|red |" in page
    told = f"demo: this file is the same bytes as b.mcap: {COUNTS_TWICE}"
    assert told in page
    assert told in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_report_stands_alone_and_tells_the_trial(
    demo_run: Path, dgeval: Run, tmp_path: Path
) -> None:
    done = dgeval("report", demo_run, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert not re.findall(r"(?:src|href)=\"(?!data:|#)", page)
    assert "https://" not in page
    for text in ("demo", "success", "target lost", "TransT-M", "dgeval view", "<img"):
        assert text in page


def test_report_of_no_run_is_a_usage_error(tmp_path: Path, dgeval: Run) -> None:
    done = dgeval("report", tmp_path)
    assert done.returncode == 2
    assert "not a finished run" in done.stderr
