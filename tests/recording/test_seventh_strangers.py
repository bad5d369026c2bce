"""Catches: what a seventh stranger's logs had and nobody was told, or told for an untrue reason."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.geometry import Array, pose_from_matrix
from dgeval.recording.contract import TRIAL_START_EVENT
from dgeval.recording.depth_unit import bytes_swapped
from dgeval.recording.events import pressed_once, started_twice
from dgeval.recording.frame_reader import LostFrames
from dgeval.recording.manifest import find_trials
from dgeval.recording.messages import Event, joints_of
from dgeval.recording.trials import Trial
from rosbags.typesys import get_types_from_msg
from tests.recording.recorders import (
    COLOUR,
    DEPTH,
    EVENTS,
    INFO,
    JOINTS,
    STORE,
    TYPES,
    Message,
    contents,
    depth_codes,
    image,
    names,
    opened,
    write,
)

TF, OPTICAL = "tf2_msgs/msg/TFMessage", "camera_color_optical_frame"
DYNAMIC = "control_msgs/msg/DynamicJointState"
STORE.register(
    get_types_from_msg(
        "string[] interface_names\nfloat64[] values", "control_msgs/msg/InterfaceValue"
    )
)
STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\nstring[] joint_names\n"
        "control_msgs/InterfaceValue[] interface_values",
        DYNAMIC,
    )
)


def transform(stamp: Any, parent: str, child: str, T: Array) -> Any:
    x, y, z, *q = (float(v) for v in pose_from_matrix(T))
    return TYPES["geometry_msgs/msg/TransformStamped"](
        header=TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=parent),
        child_frame_id=child,
        transform=TYPES["geometry_msgs/msg/Transform"](
            translation=TYPES["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
            rotation=TYPES["geometry_msgs/msg/Quaternion"](x=q[0], y=q[1], z=q[2], w=q[3]),
        ),
    )


def static(messages: list[Message], parent: str, child: str, T: Array) -> Message:
    first = next(m for m in messages if m[1] == JOINTS)
    edge = transform(first[3].header.stamp, parent, child, T)
    return [first[0], "/tf_static", TF, TYPES[TF](transforms=[edge])]


def moving(
    messages: list[Message], trial: Trial, parent: str, child: str, ago_ns: int = 0
) -> list[Message]:
    """By the trial's own poses, `ago_ns` ago, at every second message of the joints."""
    out = []
    for m in [m for m in messages if m[1] == JOINTS][::2]:
        stamp = m[3].header.stamp
        t_ns = stamp.sec * 1_000_000_000 + stamp.nanosec - ago_ns
        T = trial.robot.tree.lookup(trial.robot.base_frame or "", child, t_ns)
        if T is not None:
            edge = transform(stamp, parent, child, T)
            out.append([m[0], "/tf", TF, TYPES[TF](transforms=[edge])])
    return out


@pytest.fixture(scope="module")
def demo_trial(demo: Path) -> Trial:
    return opened(demo)


# frames from two sources


def test_a_camera_in_a_map_of_its_own_leaves_the_robot_its_camera(
    tmp_path: Path, messages: list[Message], original: list[Any], demo_trial: Trial
) -> None:
    """Visual odometry publishes the camera's pose; the description puts it on the hand."""
    odometry = moving(messages, demo_trial, "map", OPTICAL)
    trial = opened(write(tmp_path / "a.mcap", [*messages, *odometry]))
    assert contents(trial) == original
    assert any("nothing ties 'map' to the robot" in n for n in trial.notes)


def test_a_palm_that_a_late_publisher_moves_fails_its_check(
    tmp_path: Path, messages: list[Message], demo_trial: Trial
) -> None:
    base = demo_trial.robot.base_frame or ""
    late = moving(messages, demo_trial, base, "palm_link", 80_000_000)
    trial = opened(write(tmp_path / "a.mcap", [*messages, *late]))
    assert names(trial) == ["tree"]
    assert "'palm_link'" in trial.checks[0].what
    right = moving(messages, demo_trial, base, "palm_link")
    assert names(opened(write(tmp_path / "b.mcap", [*messages, *right]))) == []


def test_a_calibrated_mount_beside_a_nominal_one_is_told(
    tmp_path: Path, messages: list[Message], original: list[Any], demo_trial: Trial
) -> None:
    tree = demo_trial.robot.tree
    parent = tree.parent(OPTICAL) or ""
    T = tree.lookup(parent, OPTICAL, demo_trial.pairs[0].t_ns)
    assert T is not None
    same = opened(write(tmp_path / "a.mcap", [*messages, static(messages, parent, OPTICAL, T)]))
    assert contents(same) == original
    assert not any("/tf puts" in n for n in same.notes)
    moved = T.copy()
    moved[0, 3] += 0.03
    told = opened(write(tmp_path / "b.mcap", [*messages, static(messages, parent, OPTICAL, moved)]))
    assert any(
        f"/tf puts {OPTICAL!r} 30 mm and 0 degrees from where the description has it" in n
        for n in told.notes
    )
    used = told.robot.tree.lookup(parent, OPTICAL, demo_trial.pairs[0].t_ns)
    assert used is not None
    assert np.allclose(used, moved, atol=1e-9)


# names of topics


@pytest.mark.parametrize("how", ["rt{}", "{}", "/robot1{}"])
def test_topics_by_other_middlewares_names(
    tmp_path: Path, messages: list[Message], original: list[Any], how: str
) -> None:
    """As DDS has them, without a slash, and dgeval's own behind a robot's namespace."""

    def renamed(topic: str) -> str:
        if how.startswith("/"):
            return how.format(topic) if topic.startswith("/dgeval/") else topic
        return how.format(topic).lstrip("/")

    trial = opened(write(tmp_path / "a.mcap", [[m[0], renamed(m[1]), *m[2:]] for m in messages]))
    assert contents(trial) == original
    assert trial.events.label() == "success"
    assert any("is read as /dgeval/events" in n for n in trial.notes) == how.startswith("/")


# joint states


def test_ros2_controls_own_states(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    """Fails where they are not read, or go before joint states that say the same."""

    def dynamic(m: Message, off: float) -> Message:
        values = [
            TYPES["control_msgs/msg/InterfaceValue"](
                interface_names=["velocity", "position"], values=np.array([0.0, p + off])
            )
            for p in m[3].position
        ]
        state = TYPES[DYNAMIC](
            header=m[3].header, joint_names=list(m[3].name), interface_values=values
        )
        return [m[0], "/dynamic_joint_states", DYNAMIC, state]

    alone = [dynamic(m, 0.0) if m[1] == JOINTS else m for m in messages]
    assert contents(opened(write(tmp_path / "a.mcap", alone))) == original
    both = [*messages, *(dynamic(m, 0.1) for m in messages if m[1] == JOINTS)]
    trial = opened(write(tmp_path / "b.mcap", both))
    assert contents(trial) == original
    assert not any("merged" in n for n in trial.notes)


def test_a_trajectory_controllers_state() -> None:
    stamp = SimpleNamespace(sec=1, nanosec=0)
    point = SimpleNamespace(positions=[0.1, 0.2], effort=[])
    for name in ("feedback", "actual"):
        message = SimpleNamespace(
            header=SimpleNamespace(stamp=stamp), joint_names=["a", "b"], **{name: point}
        )
        assert joints_of(message).positions == {"a": 0.1, "b": 0.2}


def test_efforts_on_a_topic_of_their_own_are_the_joints(
    tmp_path: Path, messages: list[Message]
) -> None:
    made = []
    for m in messages:
        if m[1] == JOINTS:
            state, torques = copy.deepcopy(m[3]), copy.deepcopy(m[3])
            state.effort = np.zeros(0)
            torques.position, torques.velocity = np.zeros(0), np.zeros(0)
            torques.effort = np.full(len(torques.name), 0.5)
            made.append([m[0] + 1, "/hand/joint_torques", m[2], torques])
            m = [*m[:3], state]
        made.append(m)
    trial = opened(write(tmp_path / "a.mcap", made))
    assert any(s.efforts for s in trial.robot.samples)
    assert any(s.positions for s in trial.robot.samples)


def test_joint_states_without_names_are_told(tmp_path: Path, messages: list[Message]) -> None:
    def nameless(m: Message) -> Message:
        value = copy.deepcopy(m[3])
        value.name = []
        return [*m[:3], value]

    made = [nameless(m) if m[1] == JOINTS else m for m in messages]
    trial = opened(write(tmp_path / "a.mcap", made))
    assert any("/joint_states name no joint that has a position" in n for n in trial.notes)


def test_states_stamped_when_their_packet_arrives_fail_their_check(
    tmp_path: Path, messages: list[Message]
) -> None:
    made, k = [], 0
    for m in messages:
        if m[1] == JOINTS:
            value = copy.deepcopy(m[3])
            stamp = value.header.stamp
            t_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
            arrived = t_ns // 100_000_000 * 100_000_000 + 100_000_000 + k % 10 * 100_000
            stamp.sec, stamp.nanosec = divmod(arrived, 1_000_000_000)
            m, k = [*m[:3], value], k + 1
        made.append(m)
    trial = opened(write(tmp_path / "a.mcap", made))
    assert "stamps" in names(trial)
    assert any("/joint_states come in bursts" in c.what for c in trial.checks)


@pytest.mark.parametrize(("part", "told"), [(slice(0, 250), "end"), (slice(200, None), "begin")])
def test_joint_states_of_a_part_of_the_trial_fail_a_check(
    tmp_path: Path, messages: list[Message], part: slice, told: str
) -> None:
    """Fails where half of the camera's poses are enough, and a close that is not seen is none."""
    states = [m for m in messages if m[1] == JOINTS]
    others = [m for m in messages if m[1] != JOINTS]
    trial = opened(write(tmp_path / "a.mcap", [*others, *states[part]]))
    assert any(c.name == "gap" and f"the joint states {told}" in c.what for c in trial.checks)


# pictures


def test_images_that_are_logged_late_are_no_clock_that_is_off(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    """The printed offset, followed, made the object twice as fast."""
    late = [[m[0] + 600_000_000 * (m[1] in (COLOUR, DEPTH, INFO)), *m[1:]] for m in messages]
    trial = opened(write(tmp_path / "a.mcap", late))
    assert contents(trial) == original
    assert names(trial) == []
    assert any("they were logged late" in n for n in trial.notes)


def test_a_camera_whose_clock_runs_faster_is_no_wrong_depth(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a factor of depth is printed, which makes it worse."""
    first = min(m[0] for m in messages)
    made = []
    for m in messages:
        if m[1] in (COLOUR, DEPTH, INFO):
            value = copy.deepcopy(m[3])
            stamp = value.header.stamp
            after = stamp.sec * 1_000_000_000 + stamp.nanosec - first
            stamp.sec, stamp.nanosec = divmod(first + after * 102 // 100, 1_000_000_000)
            m = [*m[:3], value]
        made.append(m)
    trial = opened(write(tmp_path / "a.mcap", made))
    assert names(trial) == ["clocks"]
    assert "does one clock run faster" in trial.checks[0].what


def test_a_simulation_slower_than_the_clock_parts_no_stamps(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where joints that are recorded longer than the images seem to drift: only their
    stretch of the recorder's clock is another.
    """
    first = min(m[0] for m in messages)
    slow = [[first + (m[0] - first) * 23 // 10, *m[1:]] for m in messages]
    cut = [m for m in slow if m[1] not in (COLOUR, DEPTH, INFO) or m[0] - first < 9_900_000_000]
    trial = opened(write(tmp_path / "a.mcap", cut))
    assert names(trial) == []
    assert not any("does one clock run faster" in note for note in trial.notes)


@pytest.mark.parametrize("speed", [0.0, 0.05])
def test_a_base_is_said_to_move_where_it_does(
    tmp_path: Path, messages: list[Message], speed: float
) -> None:
    """Fails where every base that is on /tf is said to move: a legged robot's body that stood."""
    out = list(messages)
    first = min(m[0] for m in messages)
    for m in messages:
        if m[1] == JOINTS:
            edge = TYPES["geometry_msgs/msg/TransformStamped"](
                header=TYPES["std_msgs/msg/Header"](stamp=m[3].header.stamp, frame_id="body"),
                child_frame_id="base_link",
                transform=TYPES["geometry_msgs/msg/Transform"](
                    translation=TYPES["geometry_msgs/msg/Vector3"](
                        x=3.0 + speed * (m[0] - first) * 1e-9, y=1.0, z=0.5
                    ),
                    rotation=TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.6, w=0.8),
                ),
            )
            tf = TYPES["tf2_msgs/msg/TFMessage"](transforms=[edge])
            out.append([m[0], "/tf", "tf2_msgs/msg/TFMessage", tf])
    trial = opened(write(tmp_path / "a.mcap", out), "frames.base=base_link")
    assert any("'base_link' moves in 'body'" in n for n in trial.notes) == (speed > 0)


def test_intrinsics_of_a_former_mode_do_not_count(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    made, n = [], 0
    for m in messages:
        if m[1] == INFO and n < 3:
            value, n = copy.deepcopy(m[3]), n + 1
            value.k = np.asarray(value.k) * [2, 1, 2, 1, 2, 2, 1, 1, 1]
            value.width, value.height = 2 * value.width, 2 * value.height
            m = [*m[:3], value]
        made.append(m)
    trial = opened(write(tmp_path / "a.mcap", made))
    assert contents(trial) == original
    assert any("those of most messages are used, 3 have others" in n for n in trial.notes)


def test_a_picture_without_a_step(tmp_path: Path, messages: list[Message]) -> None:
    def raw(m: Message) -> Message:
        value = image(m[3], depth_codes(m[3]), "16UC1")
        value.step = 0
        return [m[0], "/camera/aligned_depth_to_color/image_raw", "sensor_msgs/msg/Image", value]

    made = [raw(m) if m[1] == DEPTH else m for m in messages]
    plain = opened(write(tmp_path / "b.mcap", messages))
    trial = opened(write(tmp_path / "a.mcap", made))
    assert contents(trial, 20) == contents(plain, 20)


def test_depth_whose_bytes_are_swapped_is_told_so(demo_trial: Trial) -> None:
    frames = [f for f, _ in zip(demo_trial.frames(), range(4), strict=False)]

    def swapped(depth: np.ndarray) -> np.ndarray:
        codes = np.rint(depth * 1000).astype(np.uint16).byteswap()
        return codes.astype(np.float32) * np.float32(0.001)

    middle = bytes_swapped([replace(f, depth=swapped(f.depth)) for f in frames], None)
    known = np.concatenate([f.depth[f.depth > 0] for f in frames])
    assert middle == pytest.approx(float(np.median(known)), abs=1e-3)
    assert bytes_swapped(frames, None) is None


def test_a_frame_that_two_passes_lose_is_one(demo_trial: Trial) -> None:
    place = SimpleNamespace(t_ns=5)
    lost = LostFrames([])
    for _ in range(2):
        lost.add("cut", place)  # type: ignore[arg-type]
    assert (lost.count, len(lost.damage)) == (1, 1)


# trials


def test_a_start_that_is_pressed_twice_is_one_trial(
    tmp_path: Path, messages: list[Message]
) -> None:
    first = min(m[0] for m in messages)
    starts = []
    for after_ns in (0, 400_000_000):
        text = json.dumps({"event": TRIAL_START_EVENT})
        said = TYPES["std_msgs/msg/String"](data=text)
        starts.append([first + after_ns, EVENTS, "std_msgs/msg/String", said])
    path = write(tmp_path / "a.mcap", [*starts, *messages])
    assert len(find_trials([path])) == 1
    assert any("trial_start is marked 2 times within 0.40 s" in n for n in opened(path).notes)


def test_two_trials_stay_two() -> None:
    def start(s: float, kind: str = TRIAL_START_EVENT) -> Event:
        return Event(int(s * 1e9), kind, {})

    two = [start(0), start(2.1)]
    assert pressed_once(two) == two
    ended = [start(0), start(0.5, "trial_end"), start(1.0)]
    assert pressed_once(ended) == ended
    assert started_twice(two, 0, 1_000_000_000) == []


def test_an_empty_path_is_not_the_working_folder() -> None:
    from dgeval.cli.boundary import given_path
    from typer import BadParameter

    with pytest.raises(BadParameter, match="an empty path"):
        given_path("")
    assert given_path(".") == Path()


@pytest.mark.parametrize(
    "args",
    [["inspect"], ["replay"], ["report"], ["regress", "--baseline", "x"], ["compare", "a"]],
)
def test_every_command_refuses_an_empty_path(args: list[str]) -> None:
    from dgeval.cli import app
    from typer.testing import CliRunner

    done = CliRunner().invoke(app, [*args, ""])
    assert done.exit_code == 2
    assert "an empty path" in done.output
