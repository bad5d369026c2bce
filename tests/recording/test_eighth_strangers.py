"""Catches: what an eighth stranger's logs had and nobody was told, or told for an untrue reason."""

from __future__ import annotations

import copy
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.errors import UnreadableError, UsageError
from dgeval.recording.depth_edges import depth_off
from dgeval.recording.depth_unit import cut_at
from dgeval.recording.events import Events
from dgeval.recording.messages import Event, event_of
from dgeval.recording.transforms import TransformTree
from dgeval.recording.trials import Trial
from dgeval.robots.loading import load_description
from tests.recording.recorders import (
    DEPTH,
    EVENTS,
    JOINTS,
    TYPES,
    Message,
    contents,
    depth_codes,
    image,
    opened,
    write,
)
from tests.recording.test_seventh_strangers import moving


def with_states(messages: list[Message], change: Any) -> list[Message]:
    """The messages with each joint state changed."""
    made = []
    for m in messages:
        if m[1] == JOINTS:
            m = [*m[:3], copy.deepcopy(m[3])]
            change(m[3])
        made.append(m)
    return made


def test_efforts_of_another_number_than_the_joints_are_nobodys(
    tmp_path: Path, messages: list[Message]
) -> None:
    def cut(state: Any) -> None:
        state.effort = np.full(len(state.name) - 2, 0.5)

    def without(state: Any) -> None:
        state.effort = np.zeros(0)

    trial = opened(write(tmp_path / "a.mcap", with_states(messages, cut)))
    other = opened(write(tmp_path / "b.mcap", with_states(messages, without)))
    assert not any(s.efforts for s in trial.robot.samples)
    assert any(f"efforts of {JOINTS} are left out" in n for n in trial.notes)
    assert not any("efforts" in n and "left out" in n for n in other.notes)
    assert contents(trial) == contents(other)


def test_positions_of_another_number_than_the_joints_are_damage(
    tmp_path: Path, messages: list[Message]
) -> None:
    def longer(state: Any) -> None:
        state.position = np.append(state.position, 0.0)

    trial = opened(write(tmp_path / "a.mcap", with_states(messages, longer)))
    assert any("positions for" in str(d) and JOINTS in str(d) for d in trial.damage)


def test_what_a_tree_keeps_of_one_time_is_not_of_the_next() -> None:
    tree = TransformTree()
    for t in range(3):
        for child, x in (("a", t), ("b", 2 * t)):
            pose = np.array([x, 0, 0, 0, 0, 0, 1.0])
            tree.add_moving(t * 100_000_000, "world", child, pose)
    for t in range(3):
        for _ in range(2):
            T = tree.lookup("a", "b", t * 100_000_000)
            assert T is not None
            assert T[0, 3] == t


@pytest.fixture(scope="module")
def demo_trial(demo: Path) -> Trial:
    return opened(demo)


def odometry(messages: list[Message], base: str, speed: float) -> list[Message]:
    """Of a base that drives along x at a speed, m/s; on a topic, and not on /tf."""
    out: list[Message] = []
    states = [m for m in messages if m[1] == JOINTS]
    for m in states:
        x = speed * (m[0] - states[0][0]) * 1e-9
        like = TYPES["nav_msgs/msg/Odometry"]
        zero = TYPES["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        pose = TYPES["geometry_msgs/msg/Pose"](
            position=TYPES["geometry_msgs/msg/Point"](x=x, y=0.0, z=0.0),
            orientation=TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        )
        message = like(
            header=TYPES["std_msgs/msg/Header"](stamp=m[3].header.stamp, frame_id="odom"),
            child_frame_id=base,
            pose=TYPES["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
            twist=TYPES["geometry_msgs/msg/TwistWithCovariance"](
                twist=TYPES["geometry_msgs/msg/Twist"](linear=zero, angular=zero),
                covariance=np.zeros(36),
            ),
        )
        out.append([m[0] + 1, "/odom", "nav_msgs/msg/Odometry", message])
    return out


@pytest.mark.parametrize("speed", [0.0, 0.08])
def test_a_base_that_drives_by_odometry_alone_is_told(
    tmp_path: Path, messages: list[Message], demo_trial: Trial, speed: float
) -> None:
    """Fails where a base that no transform moves is taken for the floor."""
    base = demo_trial.robot.base_frame or ""
    path = write(tmp_path / "a.mcap", [*messages, *odometry(messages, base, speed)])
    trial = opened(path)
    told = [n for n in trial.notes if "frames.base=odom" in n]
    assert len(told) == (speed > 0)
    assert contents(trial) == contents(demo_trial)
    if speed:
        moved = opened(path, "frames.base=odom")
        at = [p.t_ns for p in moved.pairs][:: len(moved.pairs) - 1]
        apart = []
        for trial in (moved, demo_trial):
            poses = [trial.robot.T_base_camera(t) for t in at]
            assert poses[0] is not None
            assert poses[1] is not None
            apart.append(poses[1][:3, 3] - poses[0][:3, 3])
        driven = speed * (at[1] - at[0]) * 1e-9
        np.testing.assert_allclose(apart[0] - apart[1], [driven, 0, 0], atol=1e-3)


def test_depth_that_ends_at_one_value_is_told(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where depth that a driver cuts is taken for what is there."""

    def cut(m: Message) -> Message:
        codes = np.minimum(depth_codes(m[3]), 400)
        return [m[0], m[1], "sensor_msgs/msg/Image", image(m[3], codes, "16UC1")]

    made = [cut(m) if m[1] == DEPTH else m for m in messages]
    trial = opened(write(tmp_path / "a.mcap", made))
    assert any("of the depth readings are exactly 0.400 m" in n for n in trial.notes)
    uncut = opened(write(tmp_path / "b.mcap", messages))
    assert not any("of the depth readings" in n for n in uncut.notes)


def test_the_farthest_reading_alone_is_no_cut() -> None:
    depth = np.full((20, 30), 0.4, np.float32)
    depth[0, 0] = 2.0
    frame = SimpleNamespace(depth=depth)
    assert cut_at([frame] * 4) is None  # type: ignore[list-item]
    depth[:10] = 2.0
    assert cut_at([frame] * 4) == (2.0, 0.5)  # type: ignore[list-item]
    assert cut_at([frame] * 2) is None  # type: ignore[list-item]


# events


@pytest.mark.parametrize(("unit", "factor"), [("", 1), ("us", 10**3), ("ms", 10**6), ("s", 10**9)])
def test_times_of_events_in_another_unit_are_told(unit: str, factor: int) -> None:
    """Fails where milliseconds are taken for ns, so that the trial lies in 1970."""
    at_ns = 1_780_000_003_000_000_000
    text = json.dumps({"event": "close", "t_ns": at_ns // factor})
    event = event_of(text, at_ns + 200_000_000)
    assert (event.t_ns, event.unit) == (at_ns, unit)
    years_ago = event_of(json.dumps({"event": "close", "t_ns": 12_300_000_000}), at_ns)
    assert (years_ago.t_ns, years_ago.unit) == (12_300_000_000, ""), "simulated time"


def test_a_unit_of_events_is_noted(tmp_path: Path, messages: list[Message]) -> None:
    def in_ms(m: Message) -> Message:
        fields = json.loads(m[3].data)
        fields["t_ns"] = fields.get("t_ns", m[0]) // 10**6
        return [*m[:3], TYPES[m[2]](data=json.dumps(fields))]

    made = [in_ms(m) if m[1] == EVENTS else m for m in messages]
    trial = opened(write(tmp_path / "a.mcap", made))
    assert any("t_ns of events is in ms" in n for n in trial.notes)
    assert trial.close.source == "event"


def test_a_label_one_level_down_is_read() -> None:
    """Fails where a state machine's own result is dropped without a word."""
    event = event_of('{"event": "result", "data": {"success": false, "reason": "slipped"}}', 5)
    assert Events((event,)).label() == "failure"
    outer = event_of('{"event": "result", "success": true, "data": {"success": false}}', 5)
    assert Events((outer,)).label() == "success"


def test_labels_that_contradict_each_other_are_none() -> None:
    """Fails where the label of the trial before, typed too late, is this one's."""
    said = [Event(k, "label", {"label": word}) for k, word in enumerate(("failure", "success"))]
    assert Events(tuple(said)).label() is None
    assert Events(tuple(said[1:])).label() == "success"


# joints


@pytest.mark.parametrize("moved", [True, False])
def test_a_joint_that_moves_and_is_fixed_in_the_description_fails_its_check(
    tmp_path: Path, messages: list[Message], moved: bool
) -> None:
    """Fails where a planner's description, in which the arm stands still, doubles the speed."""
    joint = "gantry_x"

    def fixed(m: Message) -> Message:
        text = re.sub(f'(<joint name="{joint}" type=)"[a-z]+"', r'\1"fixed"', m[3].data)
        assert text != m[3].data
        return [*m[:3], TYPES[m[2]](data=text)]

    def still(state: Any) -> None:
        state.position = state.position.copy()
        state.position[list(state.name).index(joint)] = 0.3

    made = messages if moved else with_states(messages, still)
    made = [fixed(m) if m[1].endswith("robot_description") else m for m in made]
    trial = opened(write(tmp_path / "a.mcap", made))
    told = [c for c in trial.checks if "fixed in the description" in c.what]
    assert len(told) == moved


def test_the_best_place_at_the_border_of_the_search_is_none() -> None:
    """Fails where ground full of edges, from a camera that stands still, makes depth lie 48 px
    beside colour: the score rises on past what was searched.
    """
    rng = np.random.default_rng(3)
    frames = []
    for k in range(12):
        depth = np.full((240, 320), 1.2, np.float32)
        depth[100:140, 100 + 2 * k : 130 + 2 * k] = 1.0
        colour = np.full((240, 320, 3), 90, np.uint8)
        colour[40:80, 160 + 2 * k : 190 + 2 * k] = 200  # 60 px right, 60 px up
        colour = np.clip(colour + rng.normal(0, 2, colour.shape), 0, 255).astype(np.uint8)
        frames.append(SimpleNamespace(colour=colour, depth=depth))
    found = depth_off(frames)  # type: ignore[arg-type]
    assert found is None or found.turned


# names that say what a number or a frame is


def test_disparity_is_no_depth(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where px are taken for metres, and two mends go in a circle."""
    listed = [m for m in messages if m[1] != DEPTH]
    name = "/camera/stereo/disparity_raw"
    made = [
        [m[0], name, "sensor_msgs/msg/Image", image(m[3], 40.0 / depth_m(m), "32FC1")]
        for m in messages
        if m[1] == DEPTH
    ]
    with pytest.raises(UnreadableError) as refused:
        opened(write(tmp_path / "a.mcap", [*listed, *made]))
    assert f"{name}: disparity, in px, and not depth" in refused.value.what
    both = opened(write(tmp_path / "b.mcap", [*messages, *made]))
    assert both.roles.depth == DEPTH
    assert opened(tmp_path / "a.mcap", f"roles.depth={name}").roles.depth == name


def depth_m(message: Message) -> np.ndarray:
    return np.maximum(depth_codes(message[3]), 200).astype(np.float32) * np.float32(0.001)


@pytest.mark.parametrize(("base", "told"), [("tag36h11:5", True), ("stage_link", False)])
def test_a_tag_at_the_top_of_the_tree_is_told(
    tmp_path: Path, messages: list[Message], demo_trial: Trial, base: str, told: bool
) -> None:
    """Fails where a tag that lies on the target is the floor, against which nothing moves."""
    listed = [m for m in messages if m[1] != JOINTS and not m[1].endswith("robot_description")]
    optical = demo_trial.robot.camera_frame
    listed += moving(messages, demo_trial, base, optical)
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert trial.robot.base_frame == base
    assert any("the top of the tree" in n for n in trial.notes) == told


def test_a_xacro_is_named_as_one() -> None:
    text = (
        '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:property name="h" '
        'value="1"/><link name="a"/><link name="b"/><joint name="j" type="fixed"><parent link="a"/>'
        '<child link="b"/><origin xyz="0 0 ${h}"/></joint></robot>'
    )
    with pytest.raises(UsageError, match="a xacro that was not expanded"):
        load_description(text, "/robot_description", (), 0.01)
