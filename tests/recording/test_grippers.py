"""Catches: a close that only the gripper's own topics show, missed, or taken at another time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.recording.closes import close_of
from dgeval.recording.contract import CLOSE_EVENT
from dgeval.recording.events import Events
from dgeval.recording.grippers import (
    GripperTrack,
    is_command_topic,
    is_effort_topic,
    is_gripper_topic,
    number_of,
)
from dgeval.recording.messages import event_of
from tests.recording.recorders import EVENTS, JOINTS, TYPES, Message, opened, write

S = 1_000_000_000


def track(values: list[float], command: bool = False, step_s: float = 0.1) -> GripperTrack:
    times = (np.arange(len(values)) * step_s * S).astype(np.int64)
    return GripperTrack("/gripper", "command" if command else "width", times, np.array(values))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_motion_in_either_direction(sign: float) -> None:
    """Fails where the joint of a gripper that grows in closing is said never to close."""
    values = [0.08] * 10 + [0.08 - 0.015 * k for k in range(1, 5)] + [0.02] * 10
    ((start, end),) = track([sign * v for v in values]).changes()
    assert abs(start - 1.0 * S) <= 0.1 * S
    assert abs(end - 1.4 * S) <= 0.15 * S


def test_slow_creep_and_noise_are_no_motion() -> None:
    noise = np.random.default_rng(0).normal(0, 1e-4, 60)
    values = [0.08 - 0.0001 * k + e for k, e in enumerate(noise)]
    wide = track([*values, 0.0, *[0.0] * 20])
    assert len(wide.changes()) == 1


def test_a_width_that_only_trembles_never_moves() -> None:
    """Fails where the noise of a joint that stays where it is makes a hundred closes."""
    noise = np.random.default_rng(0).normal(0.04, 1e-4, 700)
    assert track(noise.tolist(), step_s=0.01).changes() == []
    slow = [0.04 - 2e-5 * min(max(0, k - 300), 100) for k in range(700)]  # 2 mm in 1 s
    assert len(track([v + e / 100 for v, e in zip(slow, noise, strict=True)]).changes()) <= 1


def test_commands_count_when_they_change_or_stand_alone() -> None:
    """Fails where each message of a stream of equal commands is a close."""
    assert track([0.08] * 20 + [0.0] * 20, True).changes() == [(2 * S, 2 * S)]
    assert track([0.08] * 20, True).changes() == []
    assert track([0.01], True).changes() == [(0, 0)]


@pytest.mark.parametrize(
    ("message", "value"),
    [
        (SimpleNamespace(data=0.04), 0.04),
        (SimpleNamespace(position=0.3, max_effort=5.0), 0.3),
        (SimpleNamespace(goal=SimpleNamespace(command=SimpleNamespace(position=0.2))), 0.2),
        (SimpleNamespace(goal=SimpleNamespace(width=0.05, speed=0.1)), 0.05),
        (SimpleNamespace(rPR=255, rSP=1), 255.0),
        (SimpleNamespace(data="close"), None),
        (SimpleNamespace(data=float("nan")), None),
    ],
)
def test_where_a_message_has_its_number(message: Any, value: float | None) -> None:
    assert number_of(message) == value


def test_a_command_that_is_a_ramp() -> None:
    """Fails where a close that is told in small steps is none."""
    ramp = [0.0] * 20 + [255.0 * k / 15 for k in range(16)] + [255.0] * 20
    ((start, _), (released, _)) = track([*ramp, *[0.0] * 20], True, 0.02).changes()
    assert abs(start - 0.4 * S) < 0.07 * S
    assert abs(released - 1.12 * S) < 0.03 * S


def test_topics_of_grippers() -> None:
    assert not is_gripper_topic("/gripper/speed_command", "std_msgs/msg/Float64")
    assert not is_gripper_topic("/gripper/temperature", "std_msgs/msg/Float32")
    assert is_effort_topic("/gripper/force")
    assert not is_effort_topic("/force_gripper/width")
    assert is_gripper_topic("/gripper/width", "std_msgs/msg/Float64")
    for whole in ("UInt8", "Int16", "UInt64"):  # a Robotiq's request is 0 to 255
        assert is_gripper_topic("/gripper/command", f"std_msgs/msg/{whole}")
    for order in ("/gripper/close", "/hand/cmd"):
        assert is_gripper_topic(order, "std_msgs/msg/Bool")
        assert is_command_topic(order, "std_msgs/msg/Bool")
    assert not is_gripper_topic("/gripper/is_grasped", "std_msgs/msg/Bool")
    assert is_gripper_topic("/franka_gripper/grasp/goal", "franka_gripper/msg/GraspActionGoal")
    assert not is_gripper_topic("/gripper/image", "sensor_msgs/msg/Image")
    assert not is_gripper_topic("/battery", "std_msgs/msg/Float64")
    assert is_command_topic("/gripper/command", "control_msgs/msg/GripperCommand")
    assert is_command_topic("/gripper/grasp/goal", "franka_gripper/msg/GraspActionGoal")
    assert not is_command_topic("/gripper/width", "std_msgs/msg/Float64")


def without_fingers(messages: list[Message], *more: Message) -> list[Message]:
    """The demo as a robot whose fingers nobody records and nobody marks."""
    out = []
    for log_ns, topic, kind, value in messages:
        if topic == EVENTS and event_of(value.data, log_ns).kind in (CLOSE_EVENT, "lift"):
            continue
        if topic == JOINTS:
            cut = 7
            value = TYPES[kind](
                header=value.header,
                name=value.name[:cut],
                position=value.position[:cut],
                velocity=value.velocity[:0],
                effort=value.effort[:0],
            )
        out.append([log_ns, topic, kind, value])
    return [*out, *more]


def recorded_close(messages: list[Message]) -> int:
    events = [event_of(m[3].data, m[0]) for m in messages if m[1] == EVENTS]
    found = Events(tuple(events)).first_ns(CLOSE_EVENT)
    assert found is not None
    return found


def test_a_width_topic_tells_the_close(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where a recorded width is no sign of a grasp."""
    first, close_ns = min(m[0] for m in messages), recorded_close(messages)
    kind = "std_msgs/msg/Float64"
    width = []
    for t in range(first, max(m[0] for m in messages), 20_000_000):
        metres = float(np.interp(t - close_ns, [0, 0.3 * S], [0.08, 0.03]))
        width.append([t, "/gripper/width", kind, TYPES[kind](data=metres)])
    trial = opened(write(tmp_path / "a.mcap", without_fingers(messages, *width)))
    assert trial.close.source == "width"
    found = trial.event_ns(CLOSE_EVENT)
    assert found is not None
    assert abs(found - close_ns) < 50_000_000


def test_a_width_that_grows_again_before_the_palm_rises_is_no_close(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where letting go, which a failed grasp ends with, is taken for the close."""
    first, close_ns = min(m[0] for m in messages), recorded_close(messages)
    kind = "std_msgs/msg/Float64"
    width = []
    for t in range(first, max(m[0] for m in messages), 20_000_000):
        after_s = [-0.5 * S, -0.3 * S, 0.0, 0.2 * S]
        metres = float(np.interp(t - close_ns, after_s, [0.08, 0.03, 0.03, 0.08]))
        width.append([t, "/gripper/width", kind, TYPES[kind](data=metres)])
    trial = opened(write(tmp_path / "a.mcap", without_fingers(messages, *width)))
    found = trial.event_ns(CLOSE_EVENT)
    assert found is None or abs(found - (close_ns - S // 2)) < 50_000_000


def test_a_command_after_which_the_fingers_part_is_no_close(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where the command that opens the hand, after the last one that closes it, decides."""
    close_ns = recorded_close(messages)
    kind = "std_msgs/msg/Float64"
    told = [
        [close_ns - 80_000_000, "/gripper/command", kind, TYPES[kind](data=0.0)],
        [close_ns + S // 4, "/gripper/command", kind, TYPES[kind](data=1.0)],
    ]
    listed = []
    for log_ns, topic, type_, value in messages:
        if topic == EVENTS and event_of(value.data, log_ns).kind in (CLOSE_EVENT, "lift"):
            continue
        if topic == JOINTS and log_ns > close_ns + S // 4:
            moved = np.array(value.position)
            moved[7:] *= max(0.0, 1 - (log_ns - close_ns - S / 4) / (0.3 * S))
            value = replace(value, position=moved)
        listed.append([log_ns, topic, type_, value])
    trial = opened(write(tmp_path / "a.mcap", [*listed, *told]))
    assert trial.event_ns(CLOSE_EVENT) in (None, close_ns - 80_000_000)


def test_a_command_goes_before_what_the_fingers_show(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where the delay between command and motion is lost: a hand that reacts late."""
    close_ns = recorded_close(messages)
    kind = "std_msgs/msg/Float64"
    told = [[close_ns - 80_000_000, "/gripper/command", kind, TYPES[kind](data=0.0)]]
    marked = [
        m
        for m in messages
        if m[1] != EVENTS or event_of(m[3].data, m[0]).kind not in (CLOSE_EVENT, "lift")
    ]
    trial = opened(write(tmp_path / "a.mcap", [*marked, *told]))
    assert trial.close.source == "command"
    assert trial.event_ns(CLOSE_EVENT) == close_ns - 80_000_000
    assert trial.close.fingers_ns is not None
    assert abs(trial.close.fingers_ns - close_ns) < 100_000_000


def test_a_goal_of_a_ros_2_action_is_a_command(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where the goals of an action, of which ROS 2 records only the states, tell nothing.

    A first goal opens the hand, a second one closes it; each state is repeated.
    """
    first, close_ns = min(m[0] for m in messages), recorded_close(messages)
    kind, told = "action_msgs/msg/GoalStatusArray", []
    stamps = [first + 100_000_000, close_ns]
    for t in (*stamps, close_ns + 400_000_000):
        states = []
        for k, stamp in enumerate(stamps):
            if stamp > t:
                continue
            goal = TYPES["action_msgs/msg/GoalInfo"](
                goal_id=TYPES["unique_identifier_msgs/msg/UUID"](
                    uuid=np.full(16, k + 1, dtype=np.uint8)
                ),
                stamp=TYPES["builtin_interfaces/msg/Time"](
                    sec=stamp // 10**9, nanosec=stamp % 10**9
                ),
            )
            states.append(TYPES["action_msgs/msg/GoalStatus"](goal_info=goal, status=2))
        told.append([t + 3_000_000, "/gripper_controller/gripper_cmd/_action/status", kind,
                     TYPES[kind](status_list=states)])  # fmt: skip
    trial = opened(write(tmp_path / "a.mcap", without_fingers(messages, *told)))
    assert (trial.close.source, trial.event_ns(CLOSE_EVENT)) == ("command", close_ns)


def test_an_effort_that_rises_before_the_lift(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where a gripper that records its motor's current alone shows no close, or where noise
    is one.
    """
    close_ns = recorded_close(messages)
    rng = np.random.default_rng(0)
    listed, quiet = [], []
    for m in without_fingers(messages):
        for out, most in ((listed, 1.0), (quiet, 0.0)):
            value = m[3]
            if m[1] == JOINTS:
                after = float(np.clip((m[0] - close_ns) / (0.2 * S), 0.0, 1.0))
                value = TYPES[m[2]](
                    header=value.header,
                    name=[*value.name, "gripper_motor"],
                    position=np.append(value.position, np.nan),
                    velocity=value.velocity,
                    effort=np.array([0.0] * len(value.name) + [most * after + 0.01 * rng.normal()]),
                )
            out.append([*m[:3], value])
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert trial.close.source == "effort"
    found = trial.event_ns(CLOSE_EVENT)
    assert found is not None
    assert abs(found - close_ns) < 150_000_000
    assert opened(write(tmp_path / "b.mcap", quiet)).close.source is None


@pytest.mark.parametrize(
    ("topic", "values", "opens"),
    [
        ("/gripper/command", [0.0, 0.0, 1.0, 1.0, 0.0], []),  # which of two opens is not known
        ("/gripper/command", [1.0, 0.0], []),
        ("/gripper/width_command", [0.02, 0.08], [1]),
        ("/gripper/close_cmd", [1.0, 0.0], [1]),
        ("/gripper/open", [0.0, 1.0], [1]),
        ("/gripper/command", [500.0, 500.0], []),
    ],
)
def test_commands_that_open_are_no_closes(
    topic: str, values: list[float], opens: list[int]
) -> None:
    """Fails where the last command before the palm rises is a close, whatever it says."""
    times = np.arange(len(values), dtype=np.int64) * S
    track = GripperTrack(topic, "command", times, np.array(values))
    assert track.openings() == {int(times[k]) for k in opens}
    is_stream = len(values) > 3 and values[0] != values[2]
    assert track.returns() == ({int(times[4])} if is_stream else set())


@pytest.mark.parametrize(("carried", "close_s"), [(True, 2.0), (False, 3.0)])
def test_a_stream_that_goes_back_to_where_it_began(carried: bool, close_s: float) -> None:
    """Fails where what is put down is closed on: open, close, lift, open and away; or where a hand
    that is closed at rest, opens and closes, is told to close when it opens.
    """
    heights = [(0, 0.3), (1.5, 0.1), (2.5, 0.1), (2.9, 0.3 if carried else 0.1)]
    heights += [(2.95, 0.1), (3.4, 0.1), (3.9, 0.3), (6, 0.3)]

    def T_base_palm(t_ns: int) -> np.ndarray:
        T = np.eye(4)
        T[2, 3] = np.interp(t_ns * 1e-9, *zip(*heights, strict=True))
        return T

    robot = SimpleNamespace(T_base_palm=T_base_palm, description=None)
    times = np.arange(0, 6 * S, S // 10, dtype=np.int64)
    values = np.where((times >= 2 * S) & (times < 3 * S), 1.0, 0.0)
    track = GripperTrack("/gripper/command", "command", times, values)
    found = close_of(Events(()), robot, 0, 6 * S, grippers=(track,))  # type: ignore[arg-type]
    assert found.source == "command"
    assert found.events.first_ns("close") == pytest.approx(close_s * S)


@pytest.mark.parametrize(
    ("topic", "values", "told"),
    [
        ("/gripper/command", [1.0, 0.0], None),
        ("/gripper/close_cmd", [1.0, 0.0], 1.0),
        ("/gripper/close_cmd", [1.0, 0.0, 1.0], 3.5),
    ],
)
def test_which_of_two_commands_closes(topic: str, values: list[float], told: float | None) -> None:
    """Fails where the last command is the close though the palm rises after each, as it does after
    a grasp and after the thing is put down; or where a second attempt is no longer one.
    """
    heights = [(0, 0.1), (1.2, 0.1), (1.7, 0.3), (2.0, 0.1), (2.6, 0.1), (3.0, 0.3), (3.3, 0.1)]
    heights += [(3.8, 0.1), (4.3, 0.3), (6, 0.3)]

    def T_base_palm(t_ns: int) -> np.ndarray:
        T = np.eye(4)
        T[2, 3] = np.interp(t_ns * 1e-9, *zip(*heights, strict=True))
        return T

    times = np.array([1.0, 2.3, 3.5])[: len(values)] * S
    track = GripperTrack(topic, "command", times.astype(np.int64), np.array(values))
    robot = SimpleNamespace(T_base_palm=T_base_palm, description=None)
    found = close_of(Events(()), robot, 0, 6 * S, grippers=(track,))  # type: ignore[arg-type]
    assert found.events.first_ns("close") == (None if told is None else told * S)
    if told is None:
        assert found.missing is not None
        assert "which of them closes? --close +1.00 or --close +2.30" in found.missing
