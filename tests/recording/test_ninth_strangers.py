"""Catches: what a ninth stranger's logs had that crashed, was lost, or was told untruly."""

from __future__ import annotations

import copy
import itertools
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from dgeval.config import Config
from dgeval.errors import UnreadableError, UsageError
from dgeval.geometry import increment
from dgeval.recording.containers.opening import open_container
from dgeval.recording.encodings import foxglove, json_text
from dgeval.recording.inspection import inspect_recording
from dgeval.recording.librealsense import extrinsics_of
from dgeval.recording.manifest import find_trials
from dgeval.recording.messages import event_of, event_text, read_event, stamp_ns
from dgeval.recording.splits import split_recordings
from dgeval.recording.trials import open_trial
from dgeval.verdict.log import log_of
from google.protobuf import struct_pb2
from mcap.writer import Writer
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
    header,
    names,
    opened,
    write,
)
from tests.recording.test_seventh_strangers import OPTICAL, TF, transform

GRASP_EVENT = "grasp_msgs/msg/GraspEvent"
STORE.register(
    get_types_from_msg("std_msgs/Header header\nstring event\nstring label", GRASP_EVENT)
)
LOG = "rcl_interfaces/msg/Log"


def as_structure(text: str) -> tuple[str, Any]:
    said = json.loads(text)
    header = TYPES["std_msgs/msg/Header"](
        stamp=TYPES["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id=""
    )
    label = said.get("label", "")
    return GRASP_EVENT, TYPES[GRASP_EVENT](header=header, event=said["event"], label=label)


def as_log_line(text: str) -> tuple[str, Any]:
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    return LOG, TYPES[LOG](
        stamp=stamp, level=20, name="grasp", msg=text, file="", function="", line=0
    )


@pytest.mark.parametrize("as_other", [as_structure, as_log_line])
def test_events_of_another_type_are_the_same_events(
    tmp_path: Path, messages: list[Message], as_other: Any
) -> None:
    """Fails where an event that is no std_msgs/String ends in an internal error."""
    kept = [m for m in messages if m[1] != EVENTS]
    kept += [[m[0], EVENTS, *as_other(m[3].data)] for m in messages if m[1] == EVENTS]
    before, after = (
        opened(write(tmp_path / f"{name}.mcap", listed))
        for name, listed in (("a", messages), ("b", kept))
    )
    kinds = [(e.kind, e.t_ns, e.fields.get("label")) for e in before.scan.events]
    assert kinds
    assert [(e.kind, e.t_ns, e.fields.get("label") or None) for e in after.scan.events] == kinds
    assert after.spec.start_ns == before.spec.start_ns


def protobuf_struct() -> Any:
    made = struct_pb2.Value()
    made.string_value = "close"
    return made


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (json_text.decode(b'{"event": "close", "t_ns": 5}'), '{"event": "close", "t_ns": 5}'),
        (json_text.decode(b'{"data": "close"}'), "close"),
        (json_text.decode(b'{"success": true}'), '{"success": true}'),
        (json_text.decode(b'{"event": "end", "of": {"n": 1}}'), '{"event": "end", "of": {"n": 1}}'),
        (SimpleNamespace(message="lift", level=2), "lift"),
    ],
)
def test_the_text_of_an_event(message: Any, text: str) -> None:
    assert event_text(message) == text
    assert event_of(event_text(message), 5).t_ns == 5


@pytest.mark.parametrize("message", [SimpleNamespace(), SimpleNamespace(data=3), protobuf_struct()])
def test_what_has_no_text_is_no_event(message: Any) -> None:
    with pytest.raises(ValueError, match="no text"):
        event_text(message)


def test_events_that_have_no_text_are_told(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where a topic of another type is passed over without a word."""
    number = TYPES["std_msgs/msg/Int32"]
    other = [
        [m[0], EVENTS, "std_msgs/msg/Int32", number(data=1)] if m[1] == EVENTS else m
        for m in messages
    ]
    trial = opened(write(tmp_path / "a.mcap", other))
    assert any("an event's message has no text, but data" in str(d) for d in trial.damage)


def parts(folder: Path, messages: list[Message], cuts: int = 4) -> list[Path]:
    """The messages as a split recording of so many parts."""
    folder.mkdir()
    listed = sorted(messages, key=lambda m: m[0])
    edges = [round(k * len(listed) / cuts) for k in range(cuts + 1)]
    return [
        write(folder / f"{folder.name}_{k}.mcap", copy.copy(listed[a:b]))
        for k, (a, b) in enumerate(itertools.pairwise(edges))
    ]


@pytest.mark.parametrize("left", [b"", b"\x00" * 64])
@pytest.mark.parametrize("cuts", [2, 4])
def test_a_last_part_of_which_nothing_is_left(
    tmp_path: Path, messages: list[Message], left: bytes, cuts: int
) -> None:
    """Fails where a recorder that was killed makes a trial of each part of one."""
    files = parts(tmp_path / "run", messages, cuts)
    whole = contents(opened(write(tmp_path / "whole.mcap", sorted(messages, key=lambda m: m[0]))))
    files[-1].write_bytes(left)
    (spec,) = find_trials([tmp_path / "run"])
    assert spec.parts == tuple(files)
    damage = open_container(spec.recording, spec.parts).damage
    assert [f"{files[-1].name} can't be read" in str(d) for d in damage] == [True]
    found = contents(open_trial(spec, Config()))
    assert found
    assert found == whole[: len(found)]


def test_an_empty_file_behind_one_trial_is_no_part_of_it(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a numbered trial whose recorder did not start damages the one before."""
    files = [write(tmp_path / "trial_0.mcap", messages), tmp_path / "trial_1.mcap"]
    files[1].write_bytes(b"")
    assert split_recordings(files) == [(f,) for f in files]
    between = [*parts(tmp_path / "run", messages, 3)]
    between[1].write_bytes(b"")
    assert split_recordings(between) == [(f,) for f in between]


def test_events_whose_times_are_no_times_of_the_trial_place_no_close(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a converter that wrote every log time as 0 makes a search of 56 years."""
    unplaced = copy.deepcopy(messages)
    for m in unplaced:
        m[0] = 0
        if m[1] == EVENTS:
            said = json.loads(m[3].data)
            m[3].data = said.get("label") or said["event"]
    trial = opened(write(tmp_path / "a.mcap", unplaced))
    assert {"events", "stamps"} <= set(names(trial))
    assert trial.close.source == "joints"
    log = log_of(trial)
    assert log.close_ns is not None
    assert log.first_ns < log.close_ns < log.last_ns
    assert log.label == "success"


def stamped(like: Any, **changes: Any) -> Any:
    value = copy.deepcopy(like)
    for name, change in changes.items():
        setattr(value, name, change)
    return value


POINT = "trajectory_msgs/msg/JointTrajectoryPoint"
CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
if CONTROLLER not in STORE.fielddefs:
    fields = "\n".join(
        f"trajectory_msgs/JointTrajectoryPoint {name}" for name in ("reference", "feedback")
    )
    STORE.register(
        get_types_from_msg(f"std_msgs/Header header\nstring[] joint_names\n{fields}", CONTROLLER)
    )


def in_controller(messages: list[Message], moved: Any) -> list[Message]:
    """Some of the joints, by name, on the topic of their controller alone."""
    out = []
    for m in messages:
        if m[1] != JOINTS:
            out.append(m)
            continue
        names_, positions = list(m[3].name), np.asarray(m[3].position)
        for topic, chosen in ((JOINTS, False), ("/hand_controller/controller_state", True)):
            k = [i for i, name in enumerate(names_) if moved(name) == chosen]
            listed, at = [names_[i] for i in k], positions[k]
            if not chosen:
                state = stamped(m[3], name=listed, position=at, velocity=at * 0, effort=at * 0)
                out.append([m[0], topic, m[2], state])
                continue
            none = np.zeros(0)
            after = TYPES["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)
            points = [TYPES[POINT](q, none, none, none, after) for q in (at + 1.0, at)]
            out.append([m[0], topic, CONTROLLER, TYPES[CONTROLLER](m[3].header, listed, *points)])
    return out


def test_a_hand_that_only_its_controller_tells_of(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where "the fingers' joint states are not recorded" is said of a log that has them."""
    before = opened(write(tmp_path / "a.mcap", messages)).robot.joints
    after = opened(
        write(tmp_path / "b.mcap", in_controller(messages, lambda n: n.startswith("index")))
    ).robot.joints
    assert {n for n in before.values if n.startswith("index")}
    assert after.values == before.values
    # what a controller says of joints that have states is the same once more
    again = [*messages, *(m for m in in_controller(messages, lambda n: True) if m[1] != JOINTS)]
    assert opened(write(tmp_path / "c.mcap", again)).roles.joints == (JOINTS,)


def on_tf(messages: list[Message], once: tuple[str, ...], robot: Any) -> list[Message]:
    """The recording without description and joints, its frames on /tf; some of them once."""
    colour = [m for m in messages if m[1] == COLOUR]
    out = [m for m in messages if m[1] not in (JOINTS, "/robot_description")]
    for k, m in enumerate(colour):
        t_ns = stamp_ns(m[3])
        edges = [("base_link", "palm_link"), ("palm_link", OPTICAL)]
        for parent, child in edges:
            if child in once and k:
                continue
            T = robot.tree.lookup(parent, child, t_ns)
            edge = transform(m[3].header.stamp, parent, child, T)
            out.append([m[0], "/tf", TF, TYPES[TF](transforms=[edge])])
    return out


def test_a_mount_that_is_on_tf_once_is_fixed(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where a camera's mount, sent once, leaves one frame with a pose."""
    robot = opened(write(tmp_path / "a.mcap", messages)).robot
    always = opened(write(tmp_path / "b.mcap", on_tf(messages, (), robot)))
    once = opened(write(tmp_path / "c.mcap", on_tf(messages, (OPTICAL,), robot)))
    assert any("/tf has 'camera_color_optical_frame' only once" in n for n in once.notes)
    assert once.checks == always.checks == ()
    assert contents(once) == contents(always)


def test_a_tag_that_is_seen_once_stays_where_it_was_only_then(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a thing that was seen once is taken to stand still for ever."""
    robot = opened(write(tmp_path / "a.mcap", messages)).robot
    m = next(m for m in messages if m[1] == COLOUR)
    tag = TYPES[TF](transforms=[transform(m[3].header.stamp, OPTICAL, "tag_3", np.eye(4))])
    trial = opened(
        write(tmp_path / "b.mcap", [*on_tf(messages, (), robot), [m[0], "/tf", TF, tag]])
    )
    assert "tag_3" in trial.robot.tree.moving


EXTRINSICS = "realsense2_camera_msgs/msg/Extrinsics"
STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\nfloat64[9] rotation\nfloat64[3] translation", EXTRINSICS
    )
)


def test_the_drivers_own_extrinsics_bring_depth_into_colour(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where depth is refused for want of what realsense-ros records beside it, or where its
    rotation is read by rows.
    """
    T = increment(np.array([-0.015, 0.002, 0.001, 0.02, -0.03, 0.01]))  # colour from depth
    topics = {DEPTH: "/camera/depth/image_rect_raw/compressedDepth", INFO: INFO}
    listed = []
    for m in messages:
        if m[1] in topics:
            listed.append([m[0], topics[m[1]], m[2], m[3]])
        if m[1] == DEPTH:
            listed[-1][3] = stamped(m[3], header=header(m[3], "depth_optical"))
        elif m[1] == INFO:
            own = stamped(m[3], header=header(m[3], "depth_optical"))
            listed.append([m[0], "/camera/depth/camera_info", m[2], own])
        elif m[1] not in topics:
            listed.append(m)
    first = listed[0]
    with pytest.raises(UnreadableError, match="the transform between them"):
        opened(write(tmp_path / "a.mcap", listed))
    said = TYPES[EXTRINSICS](
        header=header(next(m[3] for m in messages if m[1] == COLOUR), ""),
        rotation=np.ascontiguousarray(T[:3, :3].T).ravel(),
        translation=T[:3, 3].copy(),
    )
    both = [*listed, [first[0], "/camera/extrinsics/depth_to_color", EXTRINSICS, said]]
    trial = opened(write(tmp_path / "b.mcap", both))
    alignment = trial.reader.camera.alignment
    assert alignment is not None
    np.testing.assert_allclose(alignment.T_colour_depth, T, atol=1e-12)
    with pytest.raises(ValueError, match="rotation"):
        extrinsics_of(SimpleNamespace(rotation=np.full(9, 0.5), translation=np.zeros(3)))


def test_what_two_files_that_overlapped_hold_twice_is_no_fault(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    """Fails where copies are told as stamps that go back, and the recording is to be cut."""
    twice = [[m[0] + 700_000, *m[1:]] for m in sorted(messages, key=lambda m: m[0])[300:700]]
    trial = opened(write(tmp_path / "a.mcap", [*messages, *twice]))
    assert names(trial) == []
    assert contents(trial) == original


def test_parts_that_are_given_without_the_last_are_told(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where several parts count as the whole, and the label in the last one is lost."""
    files = parts(tmp_path / "run", messages)
    for given, other in ((files[:-1], files[-1]), (files[1:], files[0])):
        (spec, *rest) = find_trials(given)
        if rest:
            continue  # without the first part each is one of its own
        checks = open_trial(spec, Config()).checks
        assert [other.name in str(c) for c in checks if c.name == "parts"] == [True]
    (spec,) = find_trials(files)
    assert "parts" not in names(open_trial(spec, Config()))


def test_joints_that_cant_be_right_say_nothing_of_the_close(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where fingers in ticks of their encoders "never close"."""
    ticks = [m for m in copy.deepcopy(messages) if m[1] != EVENTS]
    for m in ticks:
        if m[1] == JOINTS:
            finger = np.array([not name.startswith("joint") for name in m[3].name])
            m[3].position = np.where(finger, 2048.0, m[3].position)
    trial = opened(write(tmp_path / "a.mcap", ticks))
    assert "joints" in names(trial)
    assert trial.close.source is None
    assert trial.close.missing is not None


def apart(
    messages: list[Message], arm_ns: int, hand_ns: int, hand: str = "/hand/joint_states"
) -> list[Message]:
    """Arm and hand on topics of their own, their stamps moved; logged when they were before."""
    out = []
    for m in messages:
        if m[1] != JOINTS:
            out.append(m)
            continue
        finger = np.array([not name.startswith("joint") for name in m[3].name])
        for topic, kept, by_ns in ((JOINTS, ~finger, arm_ns), (hand, finger, hand_ns)):
            state = stamped(m[3])
            state.name = [n for n, k in zip(m[3].name, kept, strict=True) if k]
            state.position = np.asarray(m[3].position)[kept]
            state.velocity = state.effort = np.zeros(0)
            stamp = state.header.stamp
            stamp.sec, stamp.nanosec = divmod(stamp_ns(state) + by_ns, 1_000_000_000)
            out.append([m[0], topic, m[2], state])
    return out


def setting_of(mend: str) -> str:
    """The assignment that a check's line gives."""
    return mend.removeprefix("set ").removeprefix("--set ").strip("'")


@pytest.mark.parametrize(
    ("arm_s", "hand_s"), [(0.0, 0.35), (0.0, -900.0), (1.3, 1.3), (1.3, 1.0), (0.9, 0.0)]
)
def test_the_clock_that_is_odd_is_the_one_to_set(
    tmp_path: Path, messages: list[Message], arm_s: float, hand_s: float
) -> None:
    """Fails where the camera, which the recorder agrees with, is told to move to the robot."""
    by_ns = [round(s * 1e9) for s in (arm_s, hand_s)]
    before = opened(write(tmp_path / "a.mcap", apart(messages, 0, 0)))
    path = write(tmp_path / "b.mcap", apart(messages, *by_ns))
    (told,) = [c for c in opened(path).checks if c.name == "clocks"]
    assert "those of the camera, by the recorder" in told.what
    after = opened(path, setting_of(told.mend.split(";")[0]))
    assert names(after) == names(before) == []
    for joint, times in before.robot.joints.times.items():
        apart_ns = np.subtract(times, after.robot.joints.times[joint])
        assert np.abs(apart_ns).max() < 25_000_000  # how evenly the recorder wrote
    assert contents(after)[0][:3] == contents(before)[0][:3]


def test_a_topic_that_has_no_states_has_no_clock(tmp_path: Path, messages: list[Message]) -> None:
    path = write(tmp_path / "a.mcap", messages)
    with pytest.raises(UsageError, match="holds no joint states or poses"):
        opened(path, f'clock.topics={{"{COLOUR}" = 5}}')


def test_a_recorder_that_runs_faster_is_no_clock_of_the_camera(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a simulation at 0.4 of real time is told to move its pictures."""
    first, last = min(m[0] for m in messages), max(m[0] for m in messages)
    states = [m for m in messages if m[1] == JOINTS]
    # so that the middle one of them is early
    late = [m for m in states if m[0] > (first + last) / 2][::2]
    kept = [m for m in messages if m[1] != JOINTS or m[0] <= (first + last) / 2]
    slow = [[first + round((m[0] - first) * 2.5) + 10**18, *m[1:]] for m in [*kept, *late]]
    trial = opened(write(tmp_path / "a.mcap", slow))
    assert names(trial) == []
    assert not any("stamps are" in note for note in trial.notes)


# what is told


@pytest.mark.parametrize(
    ("magic", "packing"),
    [(b"\x04\x22\x4d\x18", "lz4"), (b"\xfd7zXZ\x00", "xz"), (b"BZh91AY", "bzip2")],
)
def test_a_file_that_is_packed_otherwise_is_to_be_unpacked(
    tmp_path: Path, magic: bytes, packing: str
) -> None:
    path = tmp_path / "a.mcap.packed"
    path.write_bytes(magic + bytes(600))
    with pytest.raises(UnreadableError, match=f"with {packing}, which is not read; unpack it"):
        open_container(path)


PACKET = "theora_image_transport/msg/Packet"
STORE.register(get_types_from_msg("std_msgs/Header header\nuint8[] data", PACKET))


@pytest.mark.parametrize("kind", [PACKET, "sensor_msgs/msg/CompressedImage"])
def test_pictures_in_a_form_that_is_not_read_are_named_as_that(
    tmp_path: Path, messages: list[Message], kind: str
) -> None:
    """Fails where "no depth is recorded" is said of depth that is, or where it is called damage."""
    listed = [m for m in messages if m[1] != DEPTH]
    for m in messages:
        if m[1] != DEPTH:
            continue
        data = np.frombuffer(b"(\xb5/\xfd" + bytes(60), np.uint8)
        fields: dict[str, Any] = {"header": m[3].header, "data": data}
        if kind != PACKET:
            fields["format"] = "16UC1; zstd"
        listed.append([m[0], "/camera/depth/packed", kind, TYPES[kind](**fields)])
    with pytest.raises(UnreadableError) as told:
        opened(write(tmp_path / "a.mcap", listed))
    text = str(told.value)
    assert "not understood: /camera/depth/packed: " in text
    assert ("theora_image_transport/msg/Packet is not read" in text) == (kind == PACKET)
    assert "none holds depth" not in text
    assert "after damage" not in text
    assert "record raw images" in text


def test_an_encoding_that_is_not_read_is_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("foxglove.CompressedImage", "flatbuffer", b"x")
        channel = writer.register_channel("/colour", "flatbuffer", schema)
        for k in range(3):
            writer.add_message(channel, k, b"y", k)
        writer.finish()
    with pytest.raises(UnreadableError) as told:
        opened(path)
    assert "'flatbuffer' is not supported" in str(told.value)
    assert "after damage" not in str(told.value)


def test_a_foxglove_image_without_a_time_has_the_recorders() -> None:
    """Fails where a default that JSON leaves out is called damage."""
    text = b'{"frame_id": "c", "format": "jpeg", "data": "aGk="}'
    read = foxglove.adapted("foxglove.CompressedImage", json_text.decode)(text)
    assert (stamp_ns(read), read.header.frame_id, bytes(read.data)) == (0, "c", b"hi")


@pytest.mark.parametrize("is_structure", [False, True])
def test_events_on_a_topic_of_their_own_are_named(
    tmp_path: Path, messages: list[Message], is_structure: bool
) -> None:
    """Fails where "no close is recorded" is all that is said of a log that holds it."""
    own = "/experiment/events"
    listed = [[m[0], own if m[1] == EVENTS else m[1], *m[2:]] for m in messages]
    for m in listed:
        if m[1] == own and is_structure:
            m[2:] = as_structure(m[3].data)
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert any(f"--set roles.events={own}" in note for note in trial.notes)
    given = opened(tmp_path / "a.mcap", f"roles.events={own}")
    assert given.close.source == "event"
    assert not any("could be events" in note for note in given.notes)


def test_a_key_that_a_manifest_has_not_is_told_with_those_that_it_has(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text('[[trial]]\nrecording = "a.mcap"\noutcome = "failed"\n')
    with pytest.raises(
        UsageError, match=r"trial\.0\.outcome: there is no such key; there are .*label"
    ):
        find_trials([path])


def test_what_is_asked_of_a_trial_that_cant_be_opened_can_not_be_told(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where `inspect` says yes to what `replay` refuses, or to blame without beliefs."""
    apart_ns = [m for m in copy.deepcopy(messages) if m[1] != EVENTS]
    for m in apart_ns:
        if m[1] == DEPTH:
            m[1] = "/camera/depth/image_rect_raw/compressedDepth"
            m[3].header.frame_id = "depth_optical"  # which nothing places
    path = write(tmp_path / "a.mcap", apart_ns)
    refused = inspect_recording(path, Config())
    assert refused["replay"].startswith("refused")
    assert not any(a["can"] for a in refused["answers"])
    whole = inspect_recording(write(tmp_path / "b.mcap", messages), Config())
    why = next(a for a in whole["answers"] if a["question"] == "why did it fail")
    assert why["provided"] == "", "a label is recorded"
    bare = [m for m in messages if m[1] not in (EVENTS, "/robot_description")]
    unsaid = inspect_recording(write(tmp_path / "c.mcap", bare), Config())["answers"]
    why = next(a for a in unsaid if a["question"] == "why did it fail")
    assert why["missing"][-2:] == ["a robot description", "a close event"]
    assert "--label failure" in why["provided"], "the demo's joint states hold no efforts"
    can = {a["question"]: a["can"] for a in whole["answers"]}
    assert can["where is the target in the camera, frame by frame"]
    assert can["what would the controller have commanded"]
    assert not can["which part of the robot's own belief is to blame"]  # it has no target's pose


def test_a_folder_is_inspected_though_its_first_file_cant_be_read(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where one bad file hides the rest, or is passed over without a word."""
    (tmp_path / "a.mcap").write_bytes(b"BZh91AY" + bytes(600))
    write(tmp_path / "b.mcap", messages)
    told = inspect_recording(tmp_path, Config())
    assert told["file"] == str(tmp_path / "b.mcap")
    assert "compressed as a whole with bzip2" in told["damage"][0]
    assert told["notes"][0] == "2 trials; this is of the first that can be opened, b"
    (tmp_path / "b.mcap").unlink()
    with pytest.raises(UnreadableError, match="bzip2"):
        inspect_recording(tmp_path, Config())


def test_whose_matrix_is_used_for_a_camera_without_one_is_said(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    """Fails where an uncalibrated colour camera takes the aligned depth's matrix without a word."""
    aligned = "/camera/aligned_depth_to_color/camera_info"
    listed = [m for m in messages if m[1] != INFO]
    for m in messages:
        if m[1] == INFO:
            none = stamped(m[3], k=np.zeros(9), p=np.zeros(12))
            listed += [[m[0], INFO, m[2], none], [m[0], aligned, m[2], m[3]]]
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert f"{INFO} can't be used: the intrinsics are those of {aligned}" in trial.notes
    assert contents(trial) == original


def test_an_event_is_when_its_message_says(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where a structure or a line that is logged late is placed by the recorder."""
    listed = [m for m in messages if m[1] != EVENTS]
    closes_ns = 1_780_000_003_200_000_000
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=closes_ns // 10**9, nanosec=closes_ns % 10**9)
    header_ = TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    of_own = TYPES[GRASP_EVENT](header=header_, event="close", label="")
    line = TYPES[LOG](stamp=stamp, level=20, name="", msg="close", file="", function="", line=0)
    for kind, said in ((GRASP_EVENT, of_own), (LOG, line)):
        late = [*listed, [closes_ns + 300_000_000, EVENTS, kind, said]]
        trial = opened(write(tmp_path / f"{kind[:4]}.mcap", late))
        assert trial.event_ns("close") == closes_ns
        assert trial.close.source == "event"
        assert "label" not in names(trial)
    pressed = read_event(SimpleNamespace(data="close"), closes_ns)
    assert (pressed.t_ns, pressed.is_log_time) == (closes_ns, True)


def test_one_wrong_stamp_is_no_second_publisher(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where a state that bears a later one's stamp is called another program's."""
    states = sorted((m for m in messages if m[1] == JOINTS), key=lambda m: m[0])
    stray = [*states[60][:3], stamped(states[60][3])]
    stray[3].header.stamp = states[260][3].header.stamp
    others = [m for m in messages if m is not states[60]]
    trial = opened(write(tmp_path / "a.mcap", [*others, stray]))
    assert not {"joints", "stamps", "clocks"} & set(names(trial))


def test_copies_that_are_not_alike_are_told(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where the first of two states counts without a word, or pictures that were encoded
    again are called out of order.
    """
    listed = sorted(messages, key=lambda m: m[0])[300:700]
    again = [[m[0] + 700_000, *m[1:3], stamped(m[3])] for m in listed if m[1] in (JOINTS, COLOUR)]
    for m in again:
        if m[1] == JOINTS:
            m[3].position = np.asarray(m[3].position) + 0.02
        else:
            _, data = cv2.imencode(".jpg", cv2.imdecode(np.asarray(m[3].data, np.uint8), 1))
            m[3].data = data.ravel()
    trial = opened(write(tmp_path / "a.mcap", [*messages, *again]))
    told = {c.name: c.what for c in trial.checks}
    assert "two positions under one stamp, up to 0.02 apart" in told["joints"]
    assert "bear another one's stamp" in told["stamps"]
