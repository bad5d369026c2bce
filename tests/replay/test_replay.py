"""End to end on the demo recording, whose truth is known.

Catches frames that are mixed up, the hand fused into the target, results that depend on file name,
number of processes or chance, runs that can't be resumed, and text on standard output beside JSON.
"""

from __future__ import annotations

import itertools
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from dgeval import api
from dgeval.config import FILES, load_config
from dgeval.geometry import matrix_from_pose, transform
from dgeval.recording.containers.opening import open_container
from dgeval.recording.manifest import TrialSpec, find_trials
from dgeval.recording.scan import scan
from dgeval.recording.trials import open_trial
from dgeval.runs.trial_job import resume_key

Run = Callable[..., subprocess.CompletedProcess[str]]
DIGESTS = [
    f"digest_{s}"
    for s in (
        "input",
        "tracking",
        "registration",
        "fusion",
        "estimation",
        "grasps",
        "servo",
        "execution",
    )
]


def trials(folder: Path) -> pd.DataFrame:
    """The trial table of a run."""
    return pd.read_parquet(folder / "trials.parquet")


@pytest.fixture(scope="module")
def frames(demo_run: Path) -> pd.DataFrame:
    """The frame table of the demo."""
    return pd.read_parquet(demo_run / "frames" / "demo.parquet")


def test_velocity_of_the_belt_is_found(frames: pd.DataFrame) -> None:
    """Catches a velocity in the wrong frame or unit: the belt moves at 0.08 m/s along base y."""
    known = frames["icp_accepted"].fillna(False).to_numpy(dtype=bool)
    tracked = frames[known & (frames["frame"] > 6)]
    assert len(tracked) > 20
    assert np.abs(tracked["velocity_y"] - 0.08).max() < 0.006
    assert np.abs(tracked[["velocity_x", "velocity_z"]]).to_numpy().max() < 0.006


def test_feature_moves_with_the_true_object(demo: Path, frames: pd.DataFrame) -> None:
    """Catches an error over 2 mm in joints, description, hand–eye, tracking or registration."""
    truth = scan(open_container(demo)).poses["/truth/object_pose"]
    T0 = matrix_from_pose(truth[0].pose)
    accepted = frames[
        frames["icp_accepted"].fillna(False).to_numpy(dtype=bool) & (frames["n_observed"] > 900)
    ]
    local = []
    for row in accepted.to_dict("records"):
        T = matrix_from_pose(truth[row["frame"]].pose)
        point = np.array([[row["feature_px"], row["feature_py"], row["feature_pz"]]])
        local.append(transform(np.linalg.inv(T), point)[0])
    assert len(local) > 25
    assert np.linalg.norm(np.array(local) - np.median(local, axis=0), axis=1).max() < 0.002
    assert np.allclose(T0[2, 3], 0.035)


def test_the_hand_is_not_fused_into_the_target(demo_run: Path) -> None:
    """Catches a finger in the model: it would make the box, 90 x 56 x 70 mm, longer."""
    data = (demo_run / "models" / "demo.ply").read_bytes()
    points = np.frombuffer(data[data.index(b"end_header\n") + 11 :], "<f4").reshape(-1, 6)[:, :3]
    centred = points - points.mean(axis=0)
    spread = np.linalg.norm(centred, axis=1)
    assert np.quantile(spread, 0.999) < 0.5 * np.linalg.norm([0.09, 0.056, 0.07]) + 0.012
    assert spread.max() < 0.08


def test_frames_without_depth_have_a_box_and_no_pose_of_their_own(frames: pd.DataFrame) -> None:
    """Catches a target without depth, in full view, told as lost, and a pose that is kept for over
    1 s or dropped at once.
    """
    blind = frames[frames["mask_area"] == 0]
    assert len(blind) > 20
    assert blind["predicted"].all()
    assert (blind["icp_reject_reason"] == "too_few_points").all()
    assert (blind["box_y1"] == 240).all(), "it reaches to the lower edge of the image"
    assert (blind["box_x1"] - blind["box_x0"]).min() > 200
    start = blind["t_ns"].iloc[0]
    after = frames[frames["t_ns"] > start + 1_050_000_000]
    assert after[["model_px", "feature_px", "velocity_x"]].isna().to_numpy().all()
    within = blind[blind["t_ns"] < start + 800_000_000]
    assert within["model_px"].notna().all()


@pytest.mark.parametrize(("policy", "speed"), [("zero", 0.0), ("constant_velocity", 0.08)])
def test_a_lost_target_goes_on_or_stands_still(demo: Path, policy: str, speed: float) -> None:
    """Fails where the first frames without it move a target that is held out, 0.08 m/s before."""
    trial = api.open_trial(demo, load_config("dynamic", (f"estimation.loss_policy={policy}",)))
    last, lost = None, []
    for step in api.replay_trial(trial):
        if step.T_camera_model is None:
            break
        T_base_model = step.T_base_camera @ step.T_camera_model
        if step.accepted:
            last, lost = (step.frame.t_ns, T_base_model[:3, 3]), []
        else:
            lost.append((step.frame.t_ns, T_base_model[:3, 3]))
    assert len(lost) == 15, "15 Hz, and after 1 s nothing is known"
    assert last is not None
    for t_ns, place in lost:
        apart = np.linalg.norm(place - last[1])
        assert apart == pytest.approx(speed * (t_ns - last[0]) * 1e-9, abs=0.006)
        assert speed > 0 or apart < 1e-9


def test_control_runs_at_the_rate_of_the_states(demo: Path) -> None:
    """Fails where control runs at frames alone, or a state is left out or taken twice."""
    trial = api.open_trial(demo)
    steps = list(itertools.islice(api.replay_trial(trial), 12))
    times = [step.frame.t_ns for step in steps]
    stamps = [t for t in trial.robot.palm_stamps(0.008) if times[0] <= t < times[-1]]
    assert [c.t_ns for step in steps for c in step.periods] == stamps
    assert len(stamps) > 3 * len(steps)
    for before, step in itertools.pairwise(steps):
        assert all(before.frame.t_ns <= c.t_ns < step.frame.t_ns for c in step.periods)
        assert step.control is not None
        assert step.control.t_ns == step.frame.t_ns


def test_servo_and_execution_follow_the_recorded_grasp(frames: pd.DataFrame) -> None:
    """Catches an error to another pose, a threshold off by a frame, a twist away from the grasp."""
    assert (frames["n_grasps"] == 1).all()
    late = frames[frames["t_ns"] > frames["t_ns"].iloc[0] + 3_000_000_000]
    assert late["error_linear"].max() < 0.002
    crossed = frames.loc[frames["execute"].fillna(False).to_numpy(dtype=bool), "frame"].iloc[0]
    assert frames.loc[crossed, "hand_score"] > 0.7 >= frames.loc[crossed - 1, "hand_score"]
    # far from the grasp the commanded velocity points to it, plus the belt's own
    first = frames.iloc[10]
    to_grasp = np.array([first[f"grasp_p{a}"] - first[f"hand_p{a}"] for a in "xyz"])
    twist = np.array([first["twist_vx"], first["twist_vy"], first["twist_vz"]])
    assert (twist - [0, 0.08, 0]) @ to_grasp > 0


def test_trial_row_says_what_ran_and_what_is_known(demo_run: Path) -> None:
    """Catches an outcome without its source, and a stand-in that no note names."""
    row = trials(demo_run).iloc[0]
    assert (row["outcome"], row["outcome_source"], row["self_filter"], row["base_frame"]) == (
        "success", "label", "geometry", "base_link",
    )  # fmt: skip
    assert "TransT-M" in row["notes"]
    assert "FFHNet" in row["notes"]
    assert row["target_source"] == "automatic"
    about = json.loads((demo_run / "run.json").read_text())
    assert about["schema_version"] == 1
    assert about["config"]["fusion"]["n_s"] == 5


@pytest.fixture(scope="module")
def two_trials(demo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A manifest of two short trials, one for each of two processes."""
    folder = tmp_path_factory.mktemp("manifest")
    text = 'name = "pair"\n'
    for name, a, b in (("early", 0, 14), ("later", 14, 26)):
        text += f'[[trial]]\nid = "{name}"\nrecording = "{demo}"\nframes = [{a}, {b}]\n'
    (folder / "pair.toml").write_text(text)
    return folder / "pair.toml"


def digests(folder: Path) -> list[list[str]]:
    """The digests of each trial of a run, in the order of `DIGESTS`."""
    table = trials(folder).sort_values("trial")
    return table[DIGESTS].to_numpy().tolist()


@pytest.mark.slow
def test_same_digests_for_any_jobs_name_and_repetition(
    dgeval: Run, demo: Path, two_trials: Path, tmp_path: Path
) -> None:
    """Catches results that depend on processes, file name or chance, and a seed without effect."""
    outs = []
    for i, extra in enumerate((["--jobs", "1"], ["--jobs", "2"])):
        out = tmp_path / f"r{i}"
        done = dgeval("replay", two_trials, "--out", out, "--no-review", *extra)
        assert done.returncode == 0, done.stderr
        outs.append(digests(out))
    assert outs[0] == outs[1]
    renamed = tmp_path / "another name é.mcap"
    shutil.copy(demo, renamed)
    done = dgeval(
        "replay",
        renamed,
        "--frames",
        "0:14",
        "--out",
        tmp_path / "r2",
        "--no-review",
        "--check-determinism",
    )
    assert done.returncode == 0, done.stderr
    assert "same bytes twice" in done.stderr
    assert digests(tmp_path / "r2")[0] == outs[0][0]
    done = dgeval(
        "replay",
        renamed,
        "--frames",
        "0:14",
        "--out",
        tmp_path / "r3",
        "--no-review",
        "--set",
        "seed=1",
    )
    other = digests(tmp_path / "r3")[0]
    assert other[2] != outs[0][0][2]
    assert other[0] == outs[0][0][0]


@pytest.mark.parametrize("key", FILES)
def test_other_content_of_a_named_file_is_another_result(tmp_path: Path, key: str) -> None:
    """Catches a trial that is kept though a file that the configuration names has changed."""
    path = tmp_path / "own.pth"
    needed = {"vfas.flow_weights": "vfas.flow=gmflow", "tracking.weights": "tracking.method=transt"}
    more = (needed[key],) if key in needed else ()
    config = load_config("vfas", (f"{key}={path}", *more))
    keys = []
    for content in (b"first", b"second", b"first"):
        path.write_bytes(content)
        keys.append(resume_key(TrialSpec("a", tmp_path / "a.mcap"), config, "sha"))
    assert keys[0] == keys[2] != keys[1]


@pytest.mark.slow
def test_finished_trials_are_kept_and_interrupted_ones_done_again(
    dgeval: Run, two_trials: Path, tmp_path: Path
) -> None:
    """Catches a finished trial replayed, and one kept that is incomplete or of other settings."""
    out = tmp_path / "run"
    assert dgeval("replay", two_trials, "--out", out, "--no-review").returncode == 0
    before = digests(out)
    (out / "trials" / "later.json").unlink()
    (out / "frames" / "later.parquet").write_bytes(b"half a file")
    again = dgeval("replay", two_trials, "--out", out, "--no-review")
    assert "kept from before" in next(
        line for line in again.stdout.splitlines() if line.startswith("early:")
    )
    assert "kept from before" not in next(
        line for line in again.stdout.splitlines() if line.startswith("later:")
    )
    assert digests(out) == before
    changed = dgeval("replay", two_trials, "--out", out, "--no-review", "--set", "fusion.n_s=3")
    assert "kept from before" not in changed.stdout
    assert not list(out.rglob("*.part"))


@pytest.mark.slow
def test_json_is_the_only_thing_on_standard_output(dgeval: Run, demo: Path, tmp_path: Path) -> None:
    """Catches progress or messages that a program that reads the JSON stumbles over."""
    done = dgeval(
        "replay", demo, "--frames", "0:4", "--out", tmp_path / "r", "--no-review", "--json"
    )
    assert json.loads(done.stdout)["trials"][0]["n_frames"] == 4
    bad = dgeval("replay", tmp_path / "absent.mcap", "--out", tmp_path / "r", "--json")
    assert bad.returncode == 2
    assert json.loads(bad.stdout)["exit_code"] == 2
    assert "absent.mcap" in bad.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ("--bbox", "1,2,3"),
        ("--bbox", "9,9,1,1"),
        ("--frames", "5"),
        ("--close", "nan"),
        ("--frames", "0:9999"),
        ("--set", "traking.method=csrt"),
        ("--pipeline", "vfa"),
        ("--set", "roles.colour=/nothing"),
    ],
)
def test_wrong_calls_end_with_2_and_a_sentence(
    dgeval: Run, demo: Path, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    """Catches a wrong argument that is ignored, or that ends in a traceback."""
    done = dgeval("replay", demo, "--out", tmp_path / "r", "--no-review", *arguments)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip()) > 20


@pytest.mark.slow
def test_a_box_in_a_later_frame_starts_there(demo: Path, dgeval: Run, tmp_path: Path) -> None:
    """Catches a box used in the first frame in spite of its time."""
    from dgeval.config import load_config

    trial = open_trial(find_trials([demo])[0], load_config())
    when = trial.pairs[8][0]
    box = ("--bbox", "195,43,272,97", "--bbox-time", str(when))
    done = dgeval("replay", demo, "--frames", "0:12", "--out", tmp_path / "r", "--no-review", *box)
    assert done.returncode == 0, done.stderr
    table = pd.read_parquet(tmp_path / "r" / "frames" / "demo.parquet")
    assert (table["tracking"] == "not_started").sum() == 8
    assert (table["tracking"] == "tracked").sum() == 4


@pytest.mark.slow
def test_box_tracker_runs_the_same_path(dgeval: Run, demo: Path, tmp_path: Path) -> None:
    """Catches stages that need the model tracker's pose: CSRT gives only a box."""
    done = dgeval(
        "replay",
        demo,
        "--frames",
        "0:20",
        "--out",
        tmp_path / "r",
        "--no-review",
        "--set",
        "tracking.method=csrt",
    )
    assert done.returncode == 0, done.stderr
    table = pd.read_parquet(tmp_path / "r" / "frames" / "demo.parquet")
    assert table["icp_accepted"].sum() >= 15
    assert "CSRT" in trials(tmp_path / "r").iloc[0]["notes"]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["open3d", "kiss_icp"])
def test_other_registration_libraries_reach_the_same_velocity(
    dgeval: Run, demo: Path, tmp_path: Path, method: str
) -> None:
    """Catches a registration library whose pose is used inverted or in another frame."""
    done = dgeval(
        "replay",
        demo,
        "--frames",
        "0:24",
        "--out",
        tmp_path / "r",
        "--no-review",
        "--set",
        f"registration.method={method}",
    )
    assert done.returncode == 0, done.stderr
    table = pd.read_parquet(tmp_path / "r" / "frames" / "demo.parquet")
    assert abs(table["velocity_y"].iloc[-1] - 0.08) < 0.008


def test_config_show_loads_again(dgeval: Run, demo: Path, tmp_path: Path) -> None:
    """Catches a printed configuration that can't be loaded or loses a setting."""
    shown = dgeval("config", "show", "--set", "fusion.n_s=3")
    (tmp_path / "mine.toml").write_text(shown.stdout)
    again = dgeval("config", "show", "--pipeline", tmp_path / "mine.toml")
    assert again.stdout == shown.stdout
    assert "n_s = 3" in shown.stdout


def test_help_of_every_command_has_examples(dgeval: Run) -> None:
    """Catches a command whose help has no example."""
    for name in ("replay", "report", "inspect", "view"):
        done = dgeval(name, "--help")
        assert done.returncode == 0
        assert "dgeval " + name in done.stdout


def test_inspect_names_roles_events_and_answers(dgeval: Run, demo: Path) -> None:
    """Catches a wrong role, a lost event, and a question that is said to have no answer."""
    done = dgeval("inspect", demo, "--json")
    report = json.loads(done.stdout)
    assert report["roles"]["colour"] == "/camera/color/image_raw/compressed"
    assert report["roles"]["camera_pose"] == "base_link → camera_color_optical_frame"
    assert [e["event"] for e in report["events"]] == [
        "trial_start",
        "close",
        "lift",
        "label",
        "trial_end",
    ]
    assert [e.get("after_s") for e in report["events"]][:2] == [-0.033, 3.167]
    # the demo has no belief of where its target is
    assert [a["missing"] for a in report["answers"] if not a["can"]] == [
        ["/dgeval/belief/target_pose"]
    ]
    assert "CRC-32" in report["checksums"]
