"""Catches: two robots mixed into one, a camera that does not hang on the hand, and a hand that is
only known by its name.
"""

from __future__ import annotations

import copy
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dgeval.recording.namespaces import differ, of_camera
from dgeval.robots.loading import load_description
from tests.recording.recorders import (
    COLOUR,
    DEPTH,
    INFO,
    JOINTS,
    TYPES,
    Message,
    contents,
    opened,
    write,
)

CAMERA = "camera_color_optical_frame"


def second_robot(messages: list[Message], own: str, other: str) -> list[Message]:
    """All topics in a namespace, and another robot's joints, reversed in time, in its own."""
    out = [[m[0], m[1] if m[1].startswith("/dgeval") else own + m[1], *m[2:]] for m in messages]
    joints = [m for m in messages if m[1] == JOINTS]
    for at, value in zip(joints, reversed(joints), strict=True):
        moved = copy.deepcopy(value[3])
        moved.header = at[3].header
        out.append([at[0] + 1000, other + JOINTS, at[2], moved])
    return out


@pytest.mark.parametrize(("own", "other"), [("/robot1", "/robot2"), ("/robot2", "/robot1")])
def test_the_cameras_robot_counts(
    tmp_path: Path, messages: list[Message], original: list[Any], own: str, other: str
) -> None:
    """Fails where the first by alphabet wins: 0.27 m/s for 0.08."""
    trial = opened(write(tmp_path / "a.mcap", second_robot(messages, own, other)))
    assert contents(trial) == original
    assert not trial.checks
    assert any("another robot" in note for note in trial.notes)


def test_robots_that_nothing_tells_apart_fail_a_check(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where one of them is taken without a word."""
    mixed = second_robot(messages, "/robot1", "/robot2")
    mixed = [[m[0], m[1].replace("/robot1/camera", "/eye/camera"), *m[2:]] for m in mixed]
    path = write(tmp_path / "a.mcap", mixed)
    assert [c.name for c in opened(path).checks] == ["robots"]
    assert not opened(path, "frames.namespace=/robot1").checks


def test_a_relay_of_the_same_joints_is_no_second_robot() -> None:
    """Fails where the arm's own topic beside a merged one is called another robot's."""
    times = np.arange(0, 100) * 10_000_000
    a = times, np.sin(times[:, None] * 1e-9)
    later = times + 1_000_000, np.sin(times[:, None] * 1e-9)
    assert not differ(a, later, 0.02)
    assert differ(a, (times, -a[1]), 0.02)
    assert of_camera(["", "/arm"], lambda *_: False, "/camera/color", None) == (["", "/arm"], [])


def test_the_camera_on_the_hand_goes_before_one_on_a_stand(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    """Fails where the first by name is taken: no frame could be registered, without a word."""
    out = [[m[0], m[1].replace("/camera/", "/wrist/"), *m[2:]] for m in messages]
    first = min(m[0] for m in messages)
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=first // 10**9, nanosec=first % 10**9)
    vector, rotation = TYPES["geometry_msgs/msg/Vector3"], TYPES["geometry_msgs/msg/Quaternion"]
    mount = TYPES["geometry_msgs/msg/TransformStamped"](
        header=TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link"),
        child_frame_id="head_camera",
        transform=TYPES["geometry_msgs/msg/Transform"](
            translation=vector(x=1.0, y=0.0, z=1.0), rotation=rotation(x=0.0, y=0.0, z=0.0, w=1.0)
        ),
    )
    tf = TYPES["tf2_msgs/msg/TFMessage"](transforms=[mount])
    out.append([first, "/tf_static", "tf2_msgs/msg/TFMessage", tf])
    for m in messages:
        if m[1] in (COLOUR, DEPTH, INFO):
            value = copy.deepcopy(m[3])
            value.header.frame_id = "head_camera"
            out.append([m[0], m[1].replace("/camera/", "/ahead/"), m[2], value])
    trial = opened(write(tmp_path / "a.mcap", out))
    assert trial.roles.colour == COLOUR.replace("/camera/", "/wrist/")
    assert contents(trial) == original
    assert any("could be it too" in note for note in trial.notes)


def test_the_hand_is_found_where_chains_part(
    tmp_path: Path, messages: list[Message], demo: Path
) -> None:
    """Fails where no frame is named as a hand, and the hand's pose is silently not known."""
    palm = opened(demo).robot.palm_frame
    out = []
    for m in messages:
        value = m[3]
        if m[1] == "/robot_description":
            text = value.data.replace("palm_link", "link_7").replace("hand_base", "part_x")
            value = TYPES["std_msgs/msg/String"](data=text)
        out.append([*m[:3], value])
    robot = opened(write(tmp_path / "a.mcap", out)).robot
    assert palm == "palm_link"
    assert robot.palm_frame in ("link_7", "part_x")
    assert len(robot.hand_links) == 7


def test_two_arms_part_at_the_base_and_that_is_no_hand() -> None:
    """Fails where the torso of two arms is called a hand."""

    def joint(name: str, parent: str, child: str) -> str:
        return (
            f'<link name="{child}"/><joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" '
            'velocity="1"/></joint>'
        )

    parts = [joint("a", "base", "la"), joint("b", "base", "ra"), joint("c", "la", "lh")]
    parts += [joint("f1", "lh", "lf1"), joint("f2", "lh", "lf2")]
    text = '<robot name="r"><link name="base"/>' + "".join(parts) + "</robot>"
    assert load_description(text, "test", [], 0.01).branches() == ["lh"]
    one = '<robot name="r"><link name="base"/>' + joint("a", "base", "l1") + "</robot>"
    assert load_description(one, "test", [], 0.01).branches() == []


def two_hands(messages: list[Message], demo: Path, way: float, on_hand: bool) -> list[Message]:
    """The demo with a second hand, `a_palm`, that goes the first one's way back, or stands still.

    way: share of the first one's way that it goes. on_hand: the camera hangs on the demo's hand;
    else it looks from the base.
    """
    out = copy.deepcopy(messages)
    robot = opened(demo).robot
    edge, turn = TYPES["geometry_msgs/msg/Transform"], TYPES["geometry_msgs/msg/Quaternion"]
    vector, kind = TYPES["geometry_msgs/msg/Vector3"], TYPES["geometry_msgs/msg/TransformStamped"]

    def transforms(header: Any, child: str, xyz: Any) -> Any:
        header = copy.deepcopy(header)
        header.frame_id = "base_link"
        x, y, z = (float(v) for v in xyz)
        pose = edge(translation=vector(x=x, y=y, z=z), rotation=turn(x=0.0, y=0.0, z=0.0, w=1.0))
        one = kind(header=header, child_frame_id=child, transform=pose)
        return TYPES["tf2_msgs/msg/TFMessage"](transforms=[one])

    colours = [m for m in out if m[1] == COLOUR]
    stamps = [m[3].header.stamp.sec * 10**9 + m[3].header.stamp.nanosec for m in colours]
    places = [T[:3, 3] for t in stamps if (T := robot.T_base_palm(t)) is not None]
    assert len(places) == len(stamps)
    for m, place in zip(colours, reversed(places), strict=True):
        at = np.array([0.0, -0.6, 0.4]) + way * (place - places[0])
        value = transforms(m[3].header, "a_palm", at)
        out.append([m[0] + 1, "/tf", "tf2_msgs/msg/TFMessage", value])
    if not on_hand:
        first = colours[0]
        value = transforms(first[3].header, "head", [0.5, 0.0, 1.2])
        out.append([first[0], "/tf_static", "tf2_msgs/msg/TFMessage", value])
        for m in out:
            if getattr(getattr(m[3], "header", None), "frame_id", "") == CAMERA:
                m[3].header.frame_id = "head"
    return out


def test_a_camera_that_nothing_carried_comes_after_the_one_that_moved(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    """Fails where the camera below most joints is taken, though the other arm, whose it is, stands
    still: 0.0 m/s for 0.08, without a word.
    """
    links = ["base_link", *(f"a_{k}" for k in range(12))]
    chain = "".join(
        f'<link name="{child}"/><joint name="j_{child}" type="revolute"><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="9" '
        'velocity="1"/></joint>'
        for parent, child in pairwise(links)
    )
    out = []
    for m in copy.deepcopy(messages):
        if m[1] == "/robot_description":
            m[3].data = m[3].data.replace("</robot>", f"{chain}</robot>")
        if m[1] == JOINTS:
            m[3].name = [*m[3].name, *(f"j_{child}" for child in links[1:])]
            m[3].position = np.append(m[3].position, np.full(len(links) - 1, 0.3))
        out.append(m)
        if m[1] in (COLOUR, DEPTH, INFO):
            value = copy.deepcopy(m[3])
            value.header.frame_id = links[-1]
            out.append([m[0], m[1].replace("/camera/", "/a_camera/"), m[2], value])
    trial = opened(write(tmp_path / "a.mcap", out))
    assert trial.roles.colour == COLOUR
    assert contents(trial) == original


@pytest.mark.parametrize(
    ("way", "on_hand", "palm"),
    [(1.0, True, "palm_link"), (0.0, False, "palm_link"), (1.0, False, None)],
)
def test_of_two_hands_the_one_that_grasps(
    tmp_path: Path, messages: list[Message], demo: Path, way: float, on_hand: bool, palm: str | None
) -> None:
    """Fails where the first of two hands by alphabet, or by its name, is judged."""
    path = write(tmp_path / "a.mcap", two_hands(messages, demo, way, on_hand))
    trial = opened(path)
    assert trial.robot.palm_frame == palm
    assert ("hands" in [c.name for c in trial.checks]) == (palm is None)
    assert "hands" not in [c.name for c in opened(path, "frames.palm=palm_link").checks]
