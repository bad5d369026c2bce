"""Catches: joint states dropped for a prefix of their names, or read under another robot's."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dgeval.recording.joint_names import as_described, as_published
from dgeval.recording.messages import JointSample
from dgeval.robots.description import Description
from dgeval.robots.loading import load_description
from tests.recording.recorders import JOINTS, Message, contents, opened, write
from tests.robots.urdf_texts import GRIPPER, PADS, robot

DESCRIPTION = load_description(robot(GRIPPER, PADS), "a test", (), 0.01)
NAMES = sorted(j.name for j in DESCRIPTION.joints.values() if j.kind != "fixed")


def named(*names: str) -> list[JointSample]:
    return [JointSample(0, dict.fromkeys(names, 0.01), dict.fromkeys(names, 2.0))]


@pytest.mark.parametrize("prefix", ["gripper/", "left_", "r1."])
def test_a_prefix_is_taken_off_positions_and_efforts(prefix: str) -> None:
    samples, note = as_described(named(*(prefix + n for n in NAMES), "wheel"), DESCRIPTION)
    assert sorted(samples[0].positions) == sorted([*NAMES, "wheel"])
    assert sorted(samples[0].efforts) == sorted([*NAMES, "wheel"])
    assert prefix in note


def test_a_prefix_of_the_description_is_put_before() -> None:
    text = robot(GRIPPER, PADS)
    for name in NAMES:
        text = text.replace(f'"{name}"', f'"a1_{name}"')
    description = load_description(text, "a test", (), 0.01)
    samples, note = as_described(named(*NAMES), description)
    assert sorted(samples[0].positions) == [f"a1_{name}" for name in NAMES]
    assert "a1_" in note


@pytest.mark.parametrize(
    "names",
    [
        [p + n for p in ("left_", "right_") for n in NAMES],  # two robots
        [f"my{n}" for n in NAMES],  # no mark ends the prefix
        [f"left_{NAMES[0]}"],  # one joint that may be another's
        NAMES,
        [],
    ],
)
def test_what_no_single_prefix_explains_stays(names: list[str]) -> None:
    """Fails where the left hand's states move the right one."""
    samples, note = as_described(named(*names), DESCRIPTION)
    assert sorted(samples[0].positions) == sorted(names)
    assert note == ""


def test_a_recording_whose_driver_has_a_prefix(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    listed = []
    for log_ns, topic, kind, value in messages:
        if topic == JOINTS:
            value = copy.deepcopy(value)
            value.name = [f"robot1/{name}" for name in value.name]
        listed.append([log_ns, topic, kind, value])
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert contents(trial) == original
    assert trial.checks == ()
    assert any("robot1/" in note for note in trial.notes)
    assert trial.robot.hand is not None
    assert np.isfinite(trial.robot.joints.values[trial.robot.hand.joints[0]]).all()


def links(description: Description) -> set[str]:
    return {name for j in description.joints.values() for name in (j.parent, j.child)}


@pytest.mark.parametrize("prefix", ["robot1/", "left_", "a.b."])
def test_a_frame_prefix_is_the_descriptions_too(prefix: str) -> None:
    """Fails where a robot_state_publisher's frame_prefix parts the description from /tf."""
    published, note = as_published(DESCRIPTION, {prefix + link for link in links(DESCRIPTION)})
    assert note.startswith(f"the recorded frames are called {prefix}")
    assert links(published) == {prefix + link for link in links(DESCRIPTION)}
    assert {j.name for j in published.joints.values()} == {
        j.name for j in DESCRIPTION.joints.values()
    }
    assert published.shapes.keys() == {prefix + link for link in DESCRIPTION.shapes}
    assert all(s.link == link for link, listed in published.shapes.items() for s in listed)


def test_the_images_frame_alone_tells_a_namespace() -> None:
    """Fails where a camera in robot1/ without any /tf stands alone, or a second camera, whose name
    ends as the first one's, is taken for it.
    """
    link = sorted(links(DESCRIPTION))[0]
    published, _ = as_published(DESCRIPTION, {f"robot1/{link}"})
    assert links(published) == {f"robot1/{each}" for each in links(DESCRIPTION)}
    assert as_published(DESCRIPTION, {f"wrist_{link}"}) == (DESCRIPTION, "")


def test_frames_that_are_the_descriptions_own_get_no_prefix() -> None:
    """Fails where a second robot of the same kind takes the description away from the first."""
    own = links(DESCRIPTION)
    for frames in (own, own | {f"other/{link}" for link in own}, {"camera_link"}, set()):
        assert as_published(DESCRIPTION, frames) == (DESCRIPTION, "")
    some = sorted(own)[:2]
    frames = (own - set(some)) | {f"other/{link}" for link in some}
    assert as_published(DESCRIPTION, frames) == (DESCRIPTION, "")
    two = {f"{prefix}/{link}" for prefix in ("a", "b") for link in own}
    assert as_published(DESCRIPTION, two)[1] == ""
