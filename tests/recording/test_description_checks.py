"""Catches: a hand that is judged by another hand's description, which its /tf contradicts."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dgeval.geometry import pose_from_matrix
from dgeval.recording.messages import joints_of
from dgeval.recording.trials import Trial
from tests.recording.recorders import JOINTS, TYPES, Message, contents, opened, write

TF = "tf2_msgs/msg/TFMessage"
DESCRIPTION = "/robot_description"


def transforms(trial: Trial, message: Message) -> Message:
    """What a robot_state_publisher says of the hand at one message of its joint states."""
    robot = trial.robot
    description = robot.description
    assert description is not None
    sample = joints_of(message[3])
    stamped: list[Any] = []
    for link in robot.hand_links:
        joint = description.joints[link]
        if joint.follows not in sample.positions:
            continue
        x, y, z, *q = pose_from_matrix(joint.at(sample.positions[joint.follows])).tolist()
        stamped.append(
            TYPES["geometry_msgs/msg/TransformStamped"](
                header=replace(message[3].header, frame_id=joint.parent),
                child_frame_id=link,
                transform=TYPES["geometry_msgs/msg/Transform"](
                    translation=TYPES["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
                    rotation=TYPES["geometry_msgs/msg/Quaternion"](x=q[0], y=q[1], z=q[2], w=q[3]),
                ),
            )
        )
    return [message[0], "/tf", TF, TYPES[TF](transforms=stamped)]


@pytest.fixture
def published(messages: list[Message], tmp_path: Path) -> list[Message]:
    """The demo with the transforms of its fingers on /tf."""
    trial = opened(write(tmp_path / "plain.mcap", messages))
    said = [transforms(trial, m) for m in messages if m[1] == JOINTS]
    assert said[0][3].transforms
    return [*messages, *said]


def described(listed: list[Message], change: Callable[[str], str]) -> list[Message]:
    out = []
    for message in listed:
        if message[1] == DESCRIPTION:
            text = change(message[3].data)
            assert text != message[3].data
            message = [*message[:3], replace(message[3], data=text)]
        out.append(message)
    return out


def finger_turns_the_other_way(text: str) -> str:
    head, axis, tail = re.split(r"(<axis [^>]*>)(?=(?:(?!<axis).)*$)", text, flags=re.DOTALL)
    return head + re.sub(r"-?[\d.]+", lambda m: str(-float(m[0])), axis) + tail


def longer_fingers(text: str) -> str:
    """By 1.3, from the second joint of each on."""

    def longer(match: re.Match[str]) -> str:
        numbers = " ".join(str(1.3 * float(v)) for v in match[2].split())
        return match[1] + numbers

    return re.sub(r'(<joint name="(?!arm)[^>]*>(?:(?!</joint>).)*?xyz=")([^"]*)', longer, text,
                  flags=re.DOTALL)  # fmt: skip


def test_transforms_of_the_same_description_agree(
    tmp_path: Path, published: list[Message], original: list[Any]
) -> None:
    """Fails where a robot that publishes both is called another's."""
    trial = opened(write(tmp_path / "a.mcap", published))
    assert trial.checks == ()
    assert contents(trial) == original


@pytest.mark.parametrize("change", [finger_turns_the_other_way, longer_fingers])
def test_another_hands_description_is_told(
    tmp_path: Path, published: list[Message], change: Callable[[str], str]
) -> None:
    """Fails where a verdict is given with fingers that the robot does not have."""
    (told,) = opened(write(tmp_path / "a.mcap", described(published, change))).checks
    assert told.name == "description"
    assert "calibration.description" in told.mend


def test_without_transforms_of_the_hand_nothing_is_said(
    tmp_path: Path, messages: list[Message]
) -> None:
    trial = opened(write(tmp_path / "a.mcap", described(messages, longer_fingers)))
    assert "description" not in [c.name for c in trial.checks]
    assert np.isfinite(contents(trial)[0][1])
