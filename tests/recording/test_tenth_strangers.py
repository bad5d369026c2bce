"""Catches: what a tenth stranger's logs had that was lost, or was told of the wrong file."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.config import Config
from dgeval.errors import UnreadableError, UsageError
from dgeval.recording.containers.opening import open_container
from dgeval.recording.contract import ROBOT_DESCRIPTION
from dgeval.recording.joint_checks import joint_faults
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import open_trial
from tests.recording.recorders import DEPTH, TYPES, Message, contents, opened, write

STRING = "std_msgs/msg/String"
SEMANTIC = '<robot name="r"><group name="arm"><link name="a"/><joint name="b"/></group></robot>'


@pytest.mark.parametrize("name", ["/iiwa/urdf", "/robot_model", "/planner/scene"])
def test_a_description_on_a_topic_of_any_name(
    tmp_path: Path, messages: list[Message], original: Any, name: str
) -> None:
    """Fails where a robot's links are in the log, and the answer is that there are none."""
    moved = [
        (at, name if topic == ROBOT_DESCRIPTION else topic, kind, message)
        for at, topic, kind, message in messages
    ]
    trial = opened(write(tmp_path / "a.mcap", moved))
    assert contents(trial) == original
    assert trial.robot.description is not None


def test_the_description_by_its_name_goes_before_others(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a planner's simpler robot, or a semantic description, is taken for the robot."""
    at = messages[0][0]
    said = {m[1]: m[3].data for m in messages if m[1] == ROBOT_DESCRIPTION}
    simpler = said[ROBOT_DESCRIPTION].replace("<robot", "<robot planner='1'", 1)
    text = TYPES[STRING]
    more = [
        (at, "/a/urdf", STRING, text(data=simpler)),
        (at, "/robot_description_semantic", STRING, text(data=SEMANTIC)),
    ]
    trial = opened(write(tmp_path / "a.mcap", [*more, *messages]))
    assert sorted(trial.scan.descriptions) == ["/a/urdf", ROBOT_DESCRIPTION]
    assert any("the robot description is /robot_description;" in n for n in trial.notes)


def test_the_file_that_is_missing_is_named(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where of several files that are one recording the first one, which is there, "can't be
    opened".
    """
    first = write(tmp_path / "camera.mcap", messages)
    with pytest.raises(UnreadableError) as told:
        open_container(first, (first, tmp_path / "laptop.mcap"))
    assert told.value.place is not None
    assert told.value.place.file == str(tmp_path / "laptop.mcap")


@pytest.mark.parametrize(("lift_s", "is_refused"), [(1.0, True), (3.2, True), (4.0, False)])
def test_a_lift_before_the_close_is_refused(
    tmp_path: Path, messages: list[Message], lift_s: float, is_refused: bool
) -> None:
    """Fails where a lift that can't be is passed over without a word."""
    (spec,) = find_trials([write(tmp_path / "a.mcap", messages)])
    spec = replace(spec, close_after_s=3.2, lift_after_s=lift_s)
    if not is_refused:
        assert open_trial(spec, Config()).close.source == "manifest"
        return
    with pytest.raises(UsageError, match="is not after the close"):
        open_trial(spec, Config())


@pytest.mark.parametrize("name", ["confidence", "amplitude"])
def test_how_good_depth_is_is_no_depth(
    tmp_path: Path, messages: list[Message], original: Any, name: str
) -> None:
    """Fails where a depth camera's other 16-bit picture, beside the depth, is taken for it."""
    other = f"/camera/aligned_depth_to_color/{name}/compressedDepth"
    more = [(at, other, kind, message) for at, topic, kind, message in messages if topic == DEPTH]
    trial = opened(write(tmp_path / "a.mcap", [*messages, *more, *more]))
    assert trial.roles.depth == DEPTH
    assert contents(trial) == original


@pytest.mark.parametrize(
    ("way", "is_told"),
    [
        ("hangs", True),
        ("stops", False),
        ("moves", False),
        ("hangs for 0.1 s", False),
        ("is not recorded for 0.3 s", False),
    ],
)
def test_an_arm_whose_driver_hangs_while_it_moves(way: str, is_told: bool) -> None:
    """Fails where the hand stood elsewhere for 0.3 s and nobody says so; and where an arm that
    stops, and starts again, "hangs".
    """
    t = np.arange(0, 3, 0.01)
    at = t.copy()
    if way.startswith("hangs"):
        at[(t >= 1) & (t < (1.1 if "0.1" in way else 1.3))] = 1.0
    if way == "stops":
        at = np.where(t < 1, t, np.where(t < 1.5, 1.0, 1.0 + (t - 1.5)))
    if way.startswith("is not"):
        at[t >= 1] += 0.5
        at[(t >= 1) & (t < 1.03)] = at[99]
        t = np.where(t >= 1.02, t + 0.3, t)
    names = ("a", "b", "c", "finger")
    ns = (t * 1e9).astype(int).tolist()
    values = {n: (0.4 * at * k).tolist() for k, n in enumerate(names[:3], 1)}
    values["finger"] = np.sin(t).tolist()
    joints = {
        f"{n}_link": SimpleNamespace(
            name=n, kind="revolute", parent=f"{above}_link", lower=-9.0, upper=9.0
        )
        for above, n in pairwise(("base", *names))
    }
    joints["thumb_link"] = SimpleNamespace(
        name="thumb", kind="revolute", parent="c_link", lower=-9.0, upper=9.0
    )
    robot: Any = SimpleNamespace(
        joints=SimpleNamespace(times=dict.fromkeys(names, ns), values=values),
        samples=(),
        hand_links=("finger_link", "thumb_link"),
        description=SimpleNamespace(joints=joints),
    )
    told = joint_faults(robot)
    assert bool(told) == is_told
    assert not told or "does their driver hang?" in told[0][0]
