"""Catches: truth with another hand than the file's, couplings lost, a stranger's log that tells."""

from __future__ import annotations

import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from dgeval.cli import app
from dgeval.config import Config, HandConfig, load_config
from dgeval.errors import UsageError
from dgeval.geometry import invert, transform
from dgeval.recording.containers.opening import open_container
from dgeval.recording.contract import OWN_PREFIXES
from dgeval.recording.found_config import found_config
from dgeval.recording.trials import find_trials, open_trial
from dgeval.robots.described_hand import DescribedHand
from dgeval.robots.hand_links import hand_links
from dgeval.robots.hand_links import poses as poses_of
from dgeval.robots.loading import load_description
from dgeval.robots.urdf import CAMERA_FRAME, robot_urdf
from dgeval.simulation.grasps import FlyingHand
from dgeval.simulation.imported_hand import read_hand
from dgeval.simulation.scenario import load_scenario, with_hand
from dgeval.worlds.hand_and_object import CloseAndLift, UnstableError
from dgeval.worlds.objects import ten_objects
from tests.robots.test_convex_pieces import bracket
from tests.robots.urdf_texts import GRIPPER, PADS, box, follows, joint, robot
from typer.testing import CliRunner

SCENARIO = """
name = "one"
grasps = "analytic"
objects = ["foam_brick"]
trials = 1
[camera]
width = 160
height = 120
rate = 15.0
"""


@pytest.fixture
def jaw(tmp_path: Path) -> Path:
    """The jaws of an arm with a gripper."""
    (tmp_path / "robot.urdf").write_text(robot(GRIPPER, PADS))
    path = tmp_path / "jaw.toml"
    path.write_text('urdf = "robot.urdf"\nroot = "hand"\n')
    return path


def test_a_files_hand(jaw: Path) -> None:
    """Catches jaws that open to close, a follower with its own drive, a centre in the palm."""
    hand = read_hand(jaw)
    assert hand.joints == ("jaw", "other_jaw")
    assert hand.drives == ("jaw",)
    assert hand.fingers == ("left", "right")
    assert (hand.open, hand.targets(1.0, hand.open)) == (0.04, 0.0)
    assert hand.positions(np.array([0.03])) == pytest.approx([0.03, 0.03])
    assert hand.centre == pytest.approx([0, 0, 0.085], abs=0.03)


def test_a_mesh_with_a_notch_is_taken_apart(tmp_path: Path, jaw: Path) -> None:
    """Fails where the truth's finger is its hull, which MuJoCo takes for a mesh."""
    finger = bracket()
    finger.export(tmp_path / "finger.stl")
    mesh = '<collision><geometry><mesh filename="finger.stl"/></geometry></collision>'
    (tmp_path / "robot.urdf").write_text(robot(GRIPPER, {**PADS, "left": mesh}))
    model = FlyingHand(ten_objects()["foam_brick"], read_hand(jaw)).model
    names = [model.geom(k).name for k in range(model.ngeom)]
    parts = [k for k, n in enumerate(names) if n.startswith("left_")]
    assert len(parts) >= 2
    middles = np.array([model.geom_pos[k] for k in parts])
    assert np.ptp(middles, axis=0).max() > 0.02


def test_joints_are_damped_by_their_speed_alone(jaw: Path) -> None:
    """Fails where MuJoCo's terms of the square and cube are set too, which break quick hands."""
    hand = read_hand(jaw)
    world = FlyingHand(ten_objects()["foam_brick"], hand)
    assert world.model.dof_damping[world.finger_dof] == pytest.approx([12.0, 12.0])
    assert not world.model.dof_dampingpoly.any()


def test_the_camera_sees_what_is_held(jaw: Path) -> None:
    """Fails where the grasp centre is outside of the picture of 42 degrees, or behind it."""
    hand = read_hand(jaw)
    x, y, z = transform(invert(hand.T_hand_camera), hand.centre[None])[0]
    assert z > 0
    assert np.degrees(np.arctan2(np.hypot(x, y), z)) < 21


def test_both_roads_give_the_same_hand(jaw: Path) -> None:
    """The importer's fingers against those that the twin reads from the recorded description."""
    hand = read_hand(jaw)
    text = robot_urdf(hand.T_hand_camera, hand)
    description = load_description(text, "recorded", (), 0.01)
    links = hand_links(description, "hand", {"jaw"})
    assert not isinstance(links, str)
    world = FlyingHand(ten_objects()["foam_brick"], hand)
    world.put(np.eye(4), np.array([0.02]))
    mujoco.mj_kinematics(world.model, world.data)
    twins = poses_of(description, links, {"jaw": 0.02, "other_jaw": 0.02})
    for link in ("left", "right"):
        assert world.data.body(link).xpos == pytest.approx(twins[link][:3, 3], abs=1e-9)


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ('palm = "flange"', "no link 'flange'"),
        ("[closed]\nthumb = 1.0", "no drive 'thumb'"),
        ("fingers = 2", "fingers"),
        ('mesh_dirs = ["$NO_SUCH_VARIABLE"]', "is not set"),
    ],
)
def test_a_wrong_file_is_told(jaw: Path, more: str, told: str) -> None:
    jaw.write_text(jaw.read_text() + more)
    with pytest.raises(UsageError, match=told):
        read_hand(jaw)


HAND = [
    joint("jaw", "hand", "left", "prismatic", "0 0 0.06", "0 1 0", (0.0, 0.04)),
    joint("other", "hand", "right", "prismatic", "0 0 0.06", "0 -1 0", (0.0, 0.04), follows("jaw")),
]
MESH = '<collision><geometry><mesh filename="{}"/></geometry></collision>'


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("<sdf/>", "not a URDF"),
        ("", "not a URDF"),
        (robot([joint("a", "hand", "cup", "fixed")], {"cup": box("0.1 0.1 0.1")}), "no joint"),
        (
            robot([HAND[0], HAND[1].replace('joint="jaw"', 'joint="index"')], PADS),
            "other mimics 'index'",
        ),
        (robot(HAND, {**PADS, "left": MESH.format("package://x/left.stl")}), "no mesh .*left.stl"),
        (robot(HAND, {**PADS, "left": MESH.format("left.dae")}), "MuJoCo reads no mesh left.dae"),
    ],
)
def test_a_hand_that_cant_be_simulated_is_told(tmp_path: Path, text: str, told: str) -> None:
    """Fails where a coupling that MuJoCo drops, or a link without its mesh, becomes truth."""
    (tmp_path / "hand.urdf").write_text(text)
    with pytest.raises(UsageError, match=told):
        read_hand(tmp_path / "hand.urdf")


def test_names_that_the_arm_has_already(tmp_path: Path) -> None:
    """A hand's base_link under the arm's: the recorded description must stay one tree."""
    text = robot(HAND, PADS).replace('"hand"', '"base_link"')
    (tmp_path / "hand.urdf").write_text(text)
    hand = read_hand(tmp_path / "hand.urdf")
    recorded = robot_urdf(hand.T_hand_camera, hand)
    description = load_description(recorded, "recorded", (), 0.01)
    assert description.joints["hand_base_link"].parent == "flange"
    assert CAMERA_FRAME in description.joints


def test_vfas_has_its_own_gripper(jaw: Path) -> None:
    with pytest.raises(UsageError, match="own gripper"):
        with_hand(load_scenario("turntable"), jaw)


def test_a_scenario_may_name_its_hand(tmp_path: Path, jaw: Path) -> None:
    """Fails where a network for another hand then proposes its grasps."""
    named = SCENARIO.replace('"analytic"', f'"ffhnet"\nhand = "{jaw.name}"')
    (tmp_path / "one.toml").write_text(named)
    scenario = load_scenario(str(tmp_path / "one.toml"))
    assert scenario.gripper.drives == ("jaw",)
    assert scenario.grasps == "analytic"


def test_a_strangers_log_tells_nothing(tmp_path: Path, jaw: Path) -> None:
    """Fails where a recording made to be a stranger's holds dgeval's topics, or another hand."""
    (tmp_path / "one.toml").write_text(SCENARIO)
    out = tmp_path / "out"
    asked = ["simulate", str(tmp_path / "one.toml"), "--hand", str(jaw), "--stranger", "--json"]
    first = CliRunner().invoke(app, [*asked, "--out", str(out)])
    assert first.exit_code == 0, first.output
    [recording] = sorted((out / "recordings").iterdir())
    topics = open_container(recording).topics
    assert not [t for t in topics if t.startswith(OWN_PREFIXES)]
    assert "/robot_description" in topics
    [truth] = sorted((out / "truth").iterdir())
    assert json.loads(truth.read_text())["verdict"]["hand"] == "imported:robot"
    trial = open_trial(find_trials([recording])[0], Config())
    assert isinstance(trial.robot.hand, DescribedHand)
    assert trial.robot.hand.geometry.names == ("jaw", "other_jaw")
    assert trial.robot.hand.centre == pytest.approx(read_hand(jaw).centre, abs=0.03)
    found = {}
    for given in ({"root": "tcp"}, {"root": "nowhere"}, {"closed": {"thumb": 1.0}}):
        config = Config(hand=HandConfig.model_validate(given))
        found[str(given)] = open_trial(find_trials([recording])[0], config).robot.hand_found
    assert "'nowhere' is not in the description" in str(found["{'root': 'nowhere'}"])
    assert "the hand's joints are jaw, other_jaw" in str(found["{'closed': {'thumb': 1.0}}"])
    assert isinstance(found["{'root': 'tcp'}"], DescribedHand)  # fixed to the palm: the same hand
    # what is written as found, with its comments taken off, leads to the same hand
    text = found_config(recording, Config())
    file = tmp_path / "robot.toml"
    file.write_text(re.sub(r"(?m)^# (?=(centre|approach|closed|close_s) = )", "", text))
    given = open_trial(find_trials([recording])[0], load_config(str(file), ())).robot.hand
    assert isinstance(given, DescribedHand)
    assert given.centre == pytest.approx(trial.robot.hand.centre, abs=1e-4)
    assert given.approach == pytest.approx(trial.robot.hand.approach, abs=1e-3)
    again = CliRunner().invoke(app, [*asked, "--out", str(tmp_path / "again"), "--jobs", "2"])
    sha = [json.loads(r.stdout)["trials"][0]["recording"]["sha256"] for r in (first, again)]
    assert sha[0] == sha[1]


def test_physics_that_breaks_is_no_outcome(jaw: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails where MuJoCo's new start after a huge value counts as a grasp that did not hold."""
    monkeypatch.chdir(jaw.parent)
    world = FlyingHand(ten_objects()["foam_brick"], read_hand(jaw))
    world.put(np.eye(4), np.array([0.02]))
    world.check_stable()
    world.data.qvel[:] = 1e15
    with pytest.raises(UnstableError):
        CloseAndLift(world, np.array([0.02]), np.zeros(3)).finish()
    assert not Path("MUJOCO_LOG.TXT").exists()  # MuJoCo's own, in a user's folder


def test_a_trial_whose_physics_breaks_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fails where it is recorded, or counts as a failure without a class."""

    def breaks(*_: object) -> None:
        raise UnstableError("hand")

    monkeypatch.setattr("dgeval.simulation.campaign._proved", breaks)
    (tmp_path / "one.toml").write_text(SCENARIO)
    done = CliRunner().invoke(
        app, ["simulate", str(tmp_path / "one.toml"), "--out", str(tmp_path / "out")]
    )
    assert done.exit_code == 0, done.output
    assert "left out, as their physics was unstable: foam_brick-000-0000" in done.output
    assert not list((tmp_path / "out").glob("*.mcap"))
