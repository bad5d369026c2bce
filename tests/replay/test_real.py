"""On real recordings. Catches containers that disagree, a track that jumps or is never lost, and
recordings without images that are replayed or end in a traceback.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]

pytestmark = pytest.mark.slow


def frames(out: Path) -> pd.DataFrame:
    """The frame table of a run of one trial."""
    return pd.read_parquet(next((out / "frames").glob("*.parquet")))


@pytest.fixture(scope="module")
def mug(real_data: Path, dgeval: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("mug") / "run"
    done = dgeval(
        "replay",
        real_data / "kitchen_mug_mcap",
        "--bbox",
        "430,342,524,432",
        "--out",
        out,
        "--no-review",
    )
    assert done.returncode == 3, done.stderr
    assert "check measured" in done.stderr
    return out


def test_the_mug_is_followed_until_it_leaves_then_lost(mug: Path) -> None:
    """Catches a track that jumps or goes on after the mug has left, and a pose given without depth.

    The mug is nearer than the camera's 0.8 m, so it has no depth and is followed in colour.
    """
    table = frames(mug)
    assert len(table) == 96
    lost = table["tracking"] == "lost"
    first = int(np.argmax(lost.to_numpy()))
    assert 75 <= first <= 92
    assert lost.iloc[first:].all()
    centre = (table["box_x0"] + table["box_x1"]) / 2
    assert centre.iloc[:first].diff().abs().max() < 25
    assert (table["box_x0"].iloc[80] < 40) or lost.iloc[80]
    assert table["model_px"].isna().all()
    assert table["velocity_x"].isna().all()
    trial = pd.read_parquet(mug / "trials.parquet").iloc[0]
    assert trial["outcome"] == "unknown"
    assert "no usable depth" in trial["notes"]


def test_the_second_box_is_met(mug: Path) -> None:
    """Catches a track beside the mug: overlap (IoU) with a box drawn by hand in frame 35."""
    row = frames(mug).iloc[35]
    x0, y0, x1, y1 = (row[f"box_{c}"] for c in ("x0", "y0", "x1", "y1"))
    w, h = min(x1, 378) - max(x0, 290), min(y1, 465) - max(y0, 374)
    assert w * h / ((x1 - x0) * (y1 - y0) + 88 * 91 - w * h) > 0.8


def test_bag_and_mcap_of_the_same_frames_are_equal(
    real_data: Path, dgeval: Run, tmp_path: Path
) -> None:
    """Catches a container that drops frames, changes their times or decodes images differently."""
    # the mug has no depth, which is known of this recording
    known = ("--set", 'checks.accept=["measured"]')
    box = ("--bbox", "290,374,378,465", "--no-review", *known)
    a = dgeval("replay", real_data / "kitchen_mug.bag", *box, "--out", tmp_path / "bag")
    b = dgeval(
        "replay",
        real_data / "kitchen_mug_mcap",
        "--frames",
        "35:55",
        *box,
        "--out",
        tmp_path / "mcap",
    )
    assert (a.returncode, b.returncode) == (0, 0), a.stderr + b.stderr
    pd.testing.assert_frame_equal(frames(tmp_path / "bag"), frames(tmp_path / "mcap"))
    rows = [
        pd.read_parquet(tmp_path / n / "trials.parquet").filter(like="digest_").iloc[0].tolist()
        for n in ("bag", "mcap")
    ]
    assert rows[0] == rows[1]


def test_wrist_camera_folder_and_bare_file_run(
    real_data: Path, dgeval: Run, tmp_path: Path
) -> None:
    """Catches a db3 file that is read differently without its folder."""
    box = ("--bbox", "348,255,490,393", "--no-review")
    folder = dgeval("replay", real_data / "apc_wrist_db3", *box, "--out", tmp_path / "a")
    bare = dgeval(
        "replay", real_data / "apc_wrist_db3" / "apc_wrist_db3.db3", *box, "--out", tmp_path / "b"
    )
    assert (folder.returncode, bare.returncode) == (0, 0), folder.stderr + bare.stderr
    pd.testing.assert_frame_equal(frames(tmp_path / "a"), frames(tmp_path / "b"))
    assert len(frames(tmp_path / "a")) == 15


@pytest.mark.parametrize(
    "name", ["kuka_joint_states.bag", "tf_example.bag", "tf_example", "realsense_d435.bag"]
)
def test_logs_without_a_camera_are_inspected_and_refused(
    real_data: Path, dgeval: Run, tmp_path: Path, name: str
) -> None:
    """Catches a traceback, or a message without the file's name, where there are no images."""
    done = dgeval("inspect", real_data / name, "--json")
    assert done.returncode in (0, 3), done.stderr
    report = json.loads(done.stdout)
    assert "none in this format" in report["checksums"]
    assert not report["answers"][0]["can"]
    replayed = dgeval("replay", real_data / name, "--out", tmp_path / "r", "--no-review")
    assert replayed.returncode == 2
    assert "Traceback" not in replayed.stderr
    assert name in replayed.stderr
