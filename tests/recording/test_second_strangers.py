"""Catches: logs of other people's robots that gave a wrong number, or a reason that is not true,
without a word. Each is the demo with one oddity; what is right stands in the test's name.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dgeval.config import Config
from dgeval.errors import UsageError
from dgeval.geometry import Array, pose_from_matrix
from dgeval.recording.manifest import find_trials
from dgeval.recording.recorded_target import marks_of
from dgeval.recording.robot import JointTrack
from dgeval.recording.trials import Trial, open_trial
from tests.recording.recorders import (
    COLOUR,
    DEPTH,
    EVENTS,
    INFO,
    JOINTS,
    TYPES,
    Message,
    image,
    names,
    opened,
    write,
)
from tests.recording.test_pauses import twice

STRING = "std_msgs/msg/String"
DESCRIPTION = "/robot_description"


def said(trial: Trial) -> str:
    return "; ".join(map(str, trial.checks))


def joints(value: Any, positions: Array, labels: list[str] | None = None) -> Any:
    return TYPES["sensor_msgs/msg/JointState"](
        header=value.header,
        name=labels or value.name,
        position=np.asarray(positions, dtype=float),
        velocity=value.velocity,
        effort=value.effort,
    )


def with_joints(messages: list[Message], change: Callable[[int, Any], Any]) -> list[Message]:
    """Joint states changed by their number and message."""
    out, k = [], 0
    for m in messages:
        out.append([*m[:3], change(k, m[3])] if m[1] == JOINTS else m)
        k += m[1] == JOINTS
    return out


def test_a_label_stays_in_the_trial_that_it_was_given_in(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where the first of two trials, between which the recorder was paused, gets the second
    one's label.
    """
    listed = twice(messages, 8.0)
    last = max(m[0] for m in listed)
    listed.append([last, EVENTS, STRING, TYPES[STRING](data='{"event": "label", "label": "fail"}')])
    first, second = (open_trial(s, Config()) for s in find_trials([write(tmp_path / "a", listed)]))
    assert (first.events.label(), second.events.label()) == (None, "failure")


def test_two_publishers_of_one_topic_are_told(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where a hand that jumps between two places has a pose."""
    first = next(m for m in messages if m[1] == JOINTS)[3]
    again = [
        [m[0] + 1000, JOINTS, m[2], joints(m[3], np.zeros(len(first.name)))]
        for m in messages
        if m[1] == JOINTS
    ]
    for m in again:
        m[3] = copy.deepcopy(m[3])
        m[3].header.stamp.nanosec = (m[3].header.stamp.nanosec + 1_000_000) % 10**9
    trial = opened(write(tmp_path / "a.mcap", [*messages, *again]))
    assert "joints" in names(trial)
    assert "two programs" in said(trial)


def test_joints_in_degrees_are_told(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where degrees are radians, though the description says what the joint can do."""
    listed = with_joints(messages, lambda _, v: joints(v, np.degrees(v.position)))
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert "joints" in names(trial)
    assert "limits" in said(trial)


def test_a_robots_clock_that_is_set_is_told(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where only the camera's clock is looked at."""
    start = min(m[0] for m in messages)
    listed = []
    for m in messages:
        value = m[3]
        if m[1] == JOINTS and m[0] - start > 2.5e9:
            value = copy.deepcopy(value)
            t_ns = value.header.stamp.sec * 10**9 + value.header.stamp.nanosec + 400_000_000
            value.header.stamp.sec, value.header.stamp.nanosec = t_ns // 10**9, t_ns % 10**9
        listed.append([*m[:3], value])
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert names(trial) == ["stamps"]
    assert JOINTS in said(trial)


def test_a_clock_that_runs_fast_is_told(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where a robot whose clock runs 3 % fast gives a speed 4 % wrong, without a word."""
    first = next(m for m in messages if m[1] == JOINTS)[3].header.stamp
    start = first.sec * 10**9 + first.nanosec
    listed = []
    for m in messages:
        value = m[3]
        if m[1] == JOINTS:
            value = copy.deepcopy(value)
            stamp = value.header.stamp
            t_ns = start + round((stamp.sec * 10**9 + stamp.nanosec - start) * 1.03)
            stamp.sec, stamp.nanosec = t_ns // 10**9, t_ns % 10**9
        listed.append([*m[:3], value])
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert any("one clock run faster" in note and JOINTS in note for note in trial.notes)


def test_images_that_end_before_the_close_are_told(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where a label decides a trial whose grasp nobody saw."""
    start = min(m[0] for m in messages)
    listed = [m for m in messages if m[1] not in (COLOUR, DEPTH) or m[0] - start < 2e9]
    assert {"gap", "events"} <= set(names(opened(write(tmp_path / "a.mcap", listed))))


def test_a_description_that_changes_is_told(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where the last of two robots is taken for both."""
    one = next(m for m in messages if m[1] == DESCRIPTION)
    other = TYPES[STRING](data=one[3].data.replace('xyz="0 0', 'xyz="0.05 0', 1))
    assert other.data != one[3].data
    listed = [*messages, [one[0] + 2_000_000_000, DESCRIPTION, STRING, other]]
    assert "tree" in names(opened(write(tmp_path / "a.mcap", listed)))


def test_a_static_frame_that_is_given_twice_is_told(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where the last of two mounts counts for the time before it too, without a word."""
    start = min(m[0] for m in messages)
    stamp = next(m for m in messages if m[1] == COLOUR)[3].header
    listed = list(messages)
    for seconds, x in ((0, 0.0), (2, 0.05)):
        header = copy.deepcopy(stamp)
        header.frame_id = "palm_link"
        pose = TYPES["geometry_msgs/msg/Transform"](
            translation=TYPES["geometry_msgs/msg/Vector3"](x=x, y=0.0, z=0.0),
            rotation=TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        )
        edge = TYPES["geometry_msgs/msg/TransformStamped"](
            header=header, child_frame_id="mount", transform=pose
        )
        kind = "tf2_msgs/msg/TFMessage"
        listed.append([start + seconds * 10**9, "/tf_static", kind, TYPES[kind](transforms=[edge])])
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert names(trial) == ["tree"]
    assert "50 mm" in said(trial)


def test_joints_that_nobody_recorded_are_named(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where the times of joint states are blamed for names that don't fit the description."""

    def otherwise(_: int, value: Any) -> Any:
        return joints(value, value.position, [f"axis_of_{name}_1" for name in value.name])

    trial = opened(write(tmp_path / "a.mcap", with_joints(messages, otherwise)))
    assert "poses" in names(trial)
    assert "no states are recorded of the joints above the camera" in said(trial)


def test_a_label_that_comes_before_the_close_is_told(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where the label of the trial before decides this one."""
    start = min(m[0] for m in messages)
    label = TYPES[STRING](data='{"event": "label", "label": "success"}')
    listed = [m for m in messages if m[1] != EVENTS or "label" not in m[3].data]
    listed.append([start + 100_000_000, EVENTS, STRING, label])
    assert names(opened(write(tmp_path / "a.mcap", listed))) == ["label"]


def test_a_close_of_fingers_that_stand_still_is_told(
    tmp_path: Path, messages: list[Message]
) -> None:
    first = next(m for m in messages if m[1] == JOINTS)[3]
    arm = 4  # the joints that move the hand; those of the fingers follow

    def still(_: int, value: Any) -> Any:
        return joints(value, [*value.position[:arm], *first.position[arm:]])

    trial = opened(write(tmp_path / "a.mcap", with_joints(messages, still)))
    assert trial.close.source == "event"
    assert any("never close" in note for note in trial.notes)


def test_a_mask_of_valid_depth_is_no_target(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where the whole picture is the target; also where a mask is 0 on the object."""
    for name in ("/camera/depth/valid_mask", "/segmentation/mask"):
        listed = list(messages)
        for m in messages:
            if m[1] == COLOUR:
                pixels = np.full((240, 320), 255, np.uint8)
                pixels[70:150, 170:250] = 0
                listed.append(
                    [m[0] + 1, name, "sensor_msgs/msg/Image", image(m[3], pixels, "mono8")]
                )
        trial = opened(write(tmp_path / "a.mcap", listed))
        marks = marks_of(
            trial.scan, trial.roles.target, trial.pairs, trial.reader.camera, trial.robot
        )
        assert marks == []


def test_poses_of_two_objects_are_two_marks(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where the first of several topics by alphabet is the target."""
    kind = "geometry_msgs/msg/PoseStamped"
    colour = next(m for m in messages if m[1] == COLOUR)
    listed = list(messages)
    for name, x in (("/object_a/pose", -0.05), ("/object_b/pose", 0.05)):
        pose = TYPES["geometry_msgs/msg/Pose"](
            position=TYPES["geometry_msgs/msg/Point"](x=x, y=0.0, z=0.4),
            orientation=TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        )
        listed.append([colour[0] + 1, name, kind, TYPES[kind](header=colour[3].header, pose=pose)])
    trial = opened(write(tmp_path / "a.mcap", listed))
    (mark,) = marks_of(
        trial.scan, trial.roles.target, trial.pairs, trial.reader.camera, trial.robot
    )
    assert len(mark.boxes) == 2


def test_a_picture_unusable_than_its_intrinsics_is_refused(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where each frame is called damage; the mend has the matrix of the resized picture."""
    listed = []
    for m in messages:
        value = m[3]
        if m[1] == INFO:
            value = copy.deepcopy(value)
            value.width, value.height = 640, 480
            value.k = value.k * np.array([2, 1, 2, 1, 2, 2, 1, 1, 1])
        listed.append([*m[:3], value])
    path = write(tmp_path / "a.mcap", listed)
    with pytest.raises(UsageError, match=r"320x240.*640x480") as error:
        opened(path)
    fx = float(str(error.value).split("calibration.intrinsics=[")[1].split(",")[0])
    plain = opened(write(tmp_path / "b.mcap", messages)).camera
    assert fx == pytest.approx(plain.fx, rel=1e-3)


def test_a_frame_that_is_in_no_tree_is_named(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where "no camera pose recorded" is said of a frame with a prefix too many."""
    listed = []
    for m in messages:
        value = m[3]
        if m[1] in (COLOUR, DEPTH, INFO):
            value = copy.deepcopy(value)
            value.header.frame_id = "wrist_" + value.header.frame_id
        listed.append([*m[:3], value])
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert any("'wrist_" in note and "neither" in note for note in trial.notes)


def test_a_joint_that_turns_on_over_the_end_of_its_range() -> None:
    """Fails where a wrist at 3.1 and -3.1 rad was at 0 in between."""
    track = JointTrack({"wrist": [0, 100]}, {"wrist": [3.1, -3.1]})
    there = track.at("wrist", 50, 1000)
    assert there is not None
    assert np.cos(there) == pytest.approx(-1.0, abs=1e-6)


def as_transforms(tmp_path: Path, messages: list[Message], w_first: str) -> list[Message]:
    """The demo with /tf from the base to the hand and /tf_static to the camera, and neither joints
    nor description; on one of the two topics quaternions are written w first.
    """
    robot = opened(write(tmp_path / "as_it_is.mcap", messages)).robot
    kind, camera = "tf2_msgs/msg/TFMessage", "camera_color_optical_frame"

    def edge(topic: str, parent: str, child: str, at: Message) -> Message:
        stamp = at[3].header.stamp
        T = robot.tree.lookup(parent, child, stamp.sec * 10**9 + stamp.nanosec)
        assert T is not None
        x, y, z, *q = map(float, pose_from_matrix(T))
        if topic == w_first:
            q = [q[3], *q[:3]]
        transform = TYPES["geometry_msgs/msg/Transform"](
            translation=TYPES["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
            rotation=TYPES["geometry_msgs/msg/Quaternion"](*q),
        )
        header = TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=parent)
        named = TYPES["geometry_msgs/msg/TransformStamped"](
            header=header, child_frame_id=child, transform=transform
        )
        return [at[0], topic, kind, TYPES[kind](transforms=[named])]

    states = [m for m in messages if m[1] == JOINTS]
    listed = [m for m in messages if m[1] not in (JOINTS, DESCRIPTION)]
    listed.append(edge("/tf_static", "hand_base", camera, states[0]))
    return [*listed, *(edge("/tf", "base_link", "hand_base", m) for m in states)]


@pytest.mark.parametrize("topic", ["/tf", "/tf_static", ""])
def test_a_quaternion_written_w_first_is_told(
    tmp_path: Path, messages: list[Message], topic: str
) -> None:
    """Fails where each speed is that of a camera which looks elsewhere, or where the right order is
    called wrong.
    """
    trial = opened(write(tmp_path / "a.mcap", as_transforms(tmp_path, messages, topic)))
    assert ("camera_poses" in names(trial)) == bool(topic)
    assert ("written w first" in said(trial)) == bool(topic)


def test_a_body_frame_in_place_of_the_optical_one_is_told(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where every speed is that of a camera which looks elsewhere: the description's optical
    frame is turned back to the body's axes, under the same name.
    """
    one = next(m for m in messages if m[1] == DESCRIPTION)
    frame = "camera_color_optical_frame"
    extra = (
        f'<link name="{frame}"/><joint name="body" type="fixed"><parent link="optical_as_it_was"/>'
        f'<child link="{frame}"/><origin xyz="0 0 0" rpy="1.5707963268 -1.5707963268 0"/></joint>'
    )
    text = one[3].data.replace(frame, "optical_as_it_was").replace("</robot>", f"{extra}</robot>")
    listed = [m for m in messages if m[1] != DESCRIPTION]
    listed.append([one[0], DESCRIPTION, STRING, TYPES[STRING](data=text)])
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert "camera_poses" in names(trial)
    assert "body" in said(trial)


def with_pictures(messages: list[Message], topic: str, held: int) -> list[Message]:
    """From image number `held` on, a topic sends the same picture under new stamps."""
    out, k, kept = [], 0, None
    for m in messages:
        value = m[3]
        if m[1] == topic:
            kept = value.data if k == held else kept
            if k > held:
                value = copy.copy(value)
                value.data = kept
            k += 1
        out.append([*m[:3], value])
    return out


@pytest.mark.parametrize("topic", [COLOUR, DEPTH])
def test_a_picture_that_is_sent_again_and_again_is_told(
    tmp_path: Path, messages: list[Message], topic: str
) -> None:
    """Fails where a driver that hangs gives an object that stands still."""
    trial = opened(write(tmp_path / "a.mcap", with_pictures(messages, topic, 20)))
    assert "frozen" in names(trial)
    assert "is the same for" in said(trial)


def edges(parents: dict[str, str], stamp: Any) -> Any:
    """Static transforms (x 0.1 m) by child."""
    listed = []
    for child, parent in parents.items():
        header = copy.deepcopy(stamp)
        header.frame_id = parent
        pose = TYPES["geometry_msgs/msg/Transform"](
            translation=TYPES["geometry_msgs/msg/Vector3"](x=0.1, y=0.0, z=0.0),
            rotation=TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        )
        listed.append(
            TYPES["geometry_msgs/msg/TransformStamped"](
                header=header, child_frame_id=child, transform=pose
            )
        )
    return TYPES["tf2_msgs/msg/TFMessage"](transforms=listed)


def test_a_rig_that_nothing_joins_to_the_robot_is_no_base(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where the driver's camera_link is the base as soon as a robot is recorded beside it."""
    listed, camera = [], "camera_color_optical_frame"
    for m in messages:
        value = m[3]
        if m[1] == DESCRIPTION:
            value = TYPES[STRING](data=value.data.replace(camera, "another_camera"))
        listed.append([*m[:3], value])
    first = next(m for m in messages if m[1] == COLOUR)
    driver = edges(
        {"camera_color_frame": "camera_link", camera: "camera_color_frame"}, first[3].header
    )
    listed.append([first[0], "/tf_static", "tf2_msgs/msg/TFMessage", driver])
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert trial.robot.base_frame is None
    assert any("none to the robot" in note for note in trial.notes)


def test_a_static_frame_with_two_parents_is_told(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where the last that was heard counts."""
    first = next(m for m in messages if m[1] == COLOUR)
    listed = list(messages)
    for parent in ("camera_link", "hand_base"):
        value = edges({"camera_frame": parent}, first[3].header)
        listed.append([first[0], "/tf_static", "tf2_msgs/msg/TFMessage", value])
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert names(trial) == ["tree"]
    assert "hangs on 'camera_link' and on 'hand_base'" in said(trial)


@pytest.mark.parametrize(
    "text",
    [
        '{"event": "outcome", "outcome": "fail"}',
        '{"event": "trial_end", "success": false}',
        '{"event": "done", "result": "failed"}',
    ],
)
def test_how_it_ended_is_a_label_whatever_the_event_is_called(
    tmp_path: Path, messages: list[Message], text: str
) -> None:
    """Fails where an operator's failure is a success by the fingers."""
    last = max(m[0] for m in messages)
    listed = [m for m in messages if not (m[1] == EVENTS and "label" in m[3].data)]
    listed.append([last, EVENTS, STRING, TYPES[STRING](data=text)])
    assert opened(write(tmp_path / "a.mcap", listed)).events.label() == "failure"


def with_info(messages: list[Message], change: Callable[[Any], None]) -> list[Message]:
    out = []
    for m in messages:
        value = m[3]
        if m[1] == INFO:
            value = copy.deepcopy(value)
            change(value)
        out.append([*m[:3], value])
    return out


def test_intrinsics_without_a_size_are_those_of_the_picture(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a mend of 92800 px is proposed."""

    def unsized(info: Any) -> None:
        info.width = info.height = 0

    whole = opened(write(tmp_path / "b.mcap", messages)).camera
    trial = opened(write(tmp_path / "a.mcap", with_info(messages, unsized)))
    assert trial.camera == whole
    assert any("states no size" in note for note in trial.notes)


def test_intrinsics_without_a_size_keep_their_lens(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where the points keep a distortion that camera_info states."""

    def bent(info: Any) -> None:
        info.d = np.array([-0.2, 0.05, 0.0, 0.0, 0.0])

    def bent_and_unsized(info: Any) -> None:
        bent(info)
        info.width = info.height = 0

    lenses = []
    for change in (bent, bent_and_unsized):
        path = write(tmp_path / f"{change.__name__}.mcap", with_info(messages, change))
        lenses.append(opened(path).reader.camera.lens)
    assert lenses[0] is not None
    assert lenses[1] is not None
    assert lenses[0].matrix == lenses[1].matrix
    assert lenses[0].coefficients == lenses[1].coefficients


def test_intrinsics_of_a_turned_picture_are_not_stretched(
    tmp_path: Path, messages: list[Message]
) -> None:
    def turned(info: Any) -> None:
        info.width, info.height = info.height, info.width

    with pytest.raises(UsageError) as caught:
        opened(write(tmp_path / "a.mcap", with_info(messages, turned)))
    assert "turned by 90 degrees" in str(caught.value)
    assert "[fx, fy, cx, cy]" in str(caught.value)


def test_a_camera_matrix_that_is_transposed_is_refused(
    tmp_path: Path, messages: list[Message]
) -> None:
    def transposed(info: Any) -> None:
        info.k = np.asarray(info.k).reshape(3, 3).T.ravel()

    with pytest.raises(UsageError, match="transposed"):
        opened(write(tmp_path / "a.mcap", with_info(messages, transposed)))


def test_a_given_close_outside_of_the_trial_is_told(
    tmp_path: Path, messages: list[Message]
) -> None:
    spec = replace(find_trials([write(tmp_path / "a.mcap", messages)])[0], close_after_s=99.0)
    trial = open_trial(spec, Config())
    assert "events" in names(trial)
    assert "at +99.00 s" in said(trial)


def test_depth_with_exactly_colours_intrinsics_is_asked_about(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where depth that its driver aligned is aligned again, as its frame is its own."""
    listed, first = [], next(m for m in messages if m[1] == COLOUR)
    for m in messages:
        value = m[3]
        if m[1] == DEPTH:
            value = copy.deepcopy(value)
            value.header.frame_id = "camera_depth_optical_frame"
        listed.append([*m[:3], value])
        if m[1] == INFO:
            info = copy.deepcopy(m[3])
            info.header.frame_id = "camera_depth_optical_frame"
            listed.append([m[0], DEPTH.split("/image_raw")[0] + "/camera_info", m[2], info])
    mount = edges({"camera_depth_optical_frame": "camera_color_optical_frame"}, first[3].header)
    listed.append([first[0], "/tf_static", "tf2_msgs/msg/TFMessage", mount])
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert "cameras" in names(trial)
    assert "aligned to colour already" in said(trial)


def test_of_two_descriptions_that_with_the_images_frame(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where the hand's own description is taken and the camera has no place in it."""
    one = next(m for m in messages if m[1] == DESCRIPTION)
    frame = "camera_color_optical_frame"
    states = next(m for m in messages if m[1] == JOINTS)[3].name
    # more of the recorded joints stand in it, and not the camera
    links = "".join(
        f'<link name="l{k}"/><joint name="{name}" type="fixed"><parent link="root"/>'
        f'<child link="l{k}"/></joint>'
        for k, name in enumerate([*states, "another"])
    )
    text = f'<robot name="hand"><link name="root"/>{links}</robot>'
    listed = [
        [one[0] - 1, "/a_hand/robot_description", STRING, TYPES[STRING](data=text)],
        *messages,
    ]
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert trial.robot.description is not None
    assert frame in trial.robot.description.joints


def test_joint_states_without_stamps_have_the_recorders_times(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a driver that leaves its stamps at zero costs every pose, and is said to count
    from a start.
    """
    listed = []
    for message in messages:
        if message[1] == JOINTS:
            message = [*message[:3], copy.deepcopy(message[3])]
            message[3].header.stamp.sec = message[3].header.stamp.nanosec = 0
        listed.append(message)
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert trial.checks == ()
    assert any("bear no stamps" in note for note in trial.notes)
    frames = list(trial.frames())
    assert len(frames) == len(list(opened(write(tmp_path / "b.mcap", messages)).frames()))
    assert all(f.T_base_camera is not None for f in frames)
