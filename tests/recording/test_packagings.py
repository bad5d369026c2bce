"""The demo recording as other people's robots would have written it: read as the original, or told.

Catches: a packaging that is refused though nothing is lost, frames or poses that differ from the
original's, and a fault of the packaging that nobody is told of.
"""

from __future__ import annotations

import copy
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from dgeval.config import Config
from dgeval.errors import UnreadableError, UsageError
from dgeval.recording.containers.opening import open_container
from dgeval.recording.image_codecs import rvl
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import open_trial
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from tests.recording.recorders import (
    COLOUR,
    DEPTH,
    EVENTS,
    INFO,
    JOINTS,
    ROS1,
    STORE,
    TYPES,
    Message,
    contents,
    depth_codes,
    header,
    image,
    opened,
    rvl_words,
    write,
)

# nothing is lost


@pytest.mark.parametrize("encoding", ["", "ros2idl"])
def test_standard_types_are_known_by_name(
    tmp_path: Path, messages: list[Message], original: list[Any], encoding: str
) -> None:
    """Catches the empty definition that rosbag2 writes where a package is not installed."""
    trial = opened(write(tmp_path / "a.mcap", messages, lambda _: (encoding, b"")))
    assert contents(trial) == original
    assert any("known by its name" in n for n in trial.notes) == (encoding == "")


def test_depth_as_rvl(tmp_path: Path, messages: list[Message], original: list[Any]) -> None:
    """Catches runs, signs and nibbles in another order than image_transport's."""
    made = [list(m) for m in messages]
    for m in made:
        if m[1] == DEPTH:
            codes, old = depth_codes(m[3]), m[3]
            size = struct.pack("<ii", codes.shape[1], codes.shape[0])
            m[3] = copy.copy(old)
            m[3].format = "16UC1; compressedDepth rvl"
            m[3].data = np.frombuffer(bytes(12) + size + rvl_words(codes), np.uint8)
    assert contents(opened(write(tmp_path / "a.mcap", made))) == original


@pytest.mark.parametrize("damage", [b"", b"\xff" * 40, b"\x00" * 3])
def test_rvl_that_ends_early_or_runs_over_is_refused(damage: bytes) -> None:
    """Catches a loop that never ends, and a write behind the image."""
    with pytest.raises(ValueError, match="do not hold 100 readings"):
        rvl.readings(damage, 100)


def test_splits_are_one_recording(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    """Catches the second part without its latched topics, and parts in the order of their names."""
    begin = min(m[0] for m in messages)
    latched: set[str] = set()
    parts: list[list[Message]] = [[], [], []]
    for m in sorted(messages, key=lambda m: m[0]):
        if m[1] == INFO and m[1] in latched:
            continue
        latched.add(m[1])
        parts[min(2, int((m[0] - begin) // 1_600_000_000))].append(m)
    folder = tmp_path / "bag"
    folder.mkdir()
    names = ["bag_0.mcap", "bag_1.mcap", "bag_10.mcap"]
    for name, part in zip(names, parts, strict=True):
        write(folder / name, part)
    listed = "\n".join(f"    - path: {n}" for n in names)
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  files:\n{listed}\n")
    assert contents(opened(folder)) == original
    with pytest.raises(UsageError, match=r"no camera intrinsics.*bag_0.mcap beside it is a part"):
        opened(folder / "bag_1.mcap")  # the first part has the latched topics


def test_a_compressed_file_is_read_and_not_left_out(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    folder = tmp_path / "day" / "trial_b"
    folder.mkdir(parents=True)
    plain = write(folder / "b_0.mcap", messages)
    packed = zstandard.ZstdCompressor().compress(plain.read_bytes())
    (folder / "b_0.mcap.zstd").write_bytes(packed)
    plain.unlink()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    (specs,) = find_trials([tmp_path / "day"])
    assert contents(open_trial(specs, Config())) == original


def test_a_recording_that_can_not_be_opened_is_named(tmp_path: Path) -> None:
    """Catches a bag that the recorder did not finish, left out of a folder in silence."""
    (tmp_path / "a.bag.active").write_bytes(b"#ROSBAG V2.0\n" + bytes(5000))
    (spec,) = find_trials([tmp_path])
    assert spec.id == "a"
    with pytest.raises(UnreadableError):
        open_trial(spec, Config())


@pytest.mark.parametrize("name", ["a.mcap.lz4", "a.bag.xz", "a.mcap.part"])
def test_what_is_packed_otherwise_is_named(tmp_path: Path, name: str) -> None:
    """Catches a recording left out of a day's folder in silence, as its packing is not read."""
    (tmp_path / name).write_bytes(b"\x04\x22\x4d\x18" + bytes(100))
    (tmp_path / "a.mcap.md5").write_text("no recording")
    (spec,) = find_trials([tmp_path])
    assert spec.id == name
    with pytest.raises(UnreadableError):
        open_trial(spec, Config())


def test_arm_and_hand_on_topics_of_their_own(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    """Catches the joints of one driver dropped."""
    made = []
    for log_ns, topic, kind, value in messages:
        if topic != JOINTS:
            made.append([log_ns, topic, kind, value])
            continue
        half = len(value.name) // 2
        for name, part in (("/arm", slice(0, half)), ("/hand", slice(half, None))):
            some = copy.deepcopy(value)
            some.name = value.name[part]
            some.position = value.position[part]
            some.velocity, some.effort = value.velocity[part], value.effort[part]
            made.append([log_ns, name + JOINTS, kind, some])
    trial = opened(write(tmp_path / "a.mcap", made))
    assert contents(trial) == original
    assert trial.roles.joints == ("/arm/joint_states", "/hand/joint_states")


@pytest.mark.parametrize("unit", [0.001, 0.0001])
def test_the_depth_unit_that_librealsense_writes_behind_an_image(
    tmp_path: Path, messages: list[Message], original: list[Any], unit: float
) -> None:
    """Catches "damage" for bytes that ROS 1's own reader ignores, and the unit in them unread."""
    path = tmp_path / "a.bag"
    with BagWriter(path) as bag:
        known: dict[str, Any] = {}
        for log_ns, topic, kind, value in sorted(messages, key=lambda m: m[0]):
            name, tail = topic, b""
            if topic == DEPTH:
                codes = np.round(depth_codes(value) * (0.001 / unit)).astype(np.uint16)
                name, kind = "/camera/depth/image", "sensor_msgs/msg/Image"
                value, tail = image(value, codes, "mono16"), struct.pack("<f", unit)
            if name not in known:
                known[name] = bag.add_connection(name, kind, typestore=ROS1)
            data = bytes(STORE.cdr_to_ros1(STORE.serialize_cdr(value, kind), kind))
            bag.write(known[name], log_ns, data + tail)
    trial = opened(path)
    assert trial.damage == []
    for found, right in zip(contents(trial), original, strict=True):
        assert found[:2] == right[:2]
        assert found[2] == pytest.approx(right[2], rel=1e-5)


def test_a_rectified_picture_has_the_matrix_p(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    """Catches K of the raw picture, 15 % shorter here, and a word on distortion."""
    made = [[m[0], m[1].replace("image_raw", "image_rect"), m[2], m[3]] for m in messages]
    right = None
    for m in made:
        if m[2].endswith("CameraInfo"):
            m[3] = copy.deepcopy(m[3])
            right = float(m[3].k[0])
            m[3].k[0] *= 0.85
            m[3].d = np.array([-0.2, 0.03, 0.0, 0.0, 0.0])
    trial = opened(write(tmp_path / "a.mcap", made))
    assert trial.camera.fx == right
    assert contents(trial) == original
    assert not any("distortion" in n for n in trial.notes)


def test_binning_and_region_of_interest(tmp_path: Path, messages: list[Message]) -> None:
    """Catches intrinsics of the sensor's picture for the smaller one that is published."""
    made = [list(m) for m in messages]
    for m in made:
        if m[2].endswith("CameraInfo"):
            m[3] = copy.deepcopy(m[3])
            right = (m[3].k[0], m[3].k[2])
            # twice the picture, of which every second pixel from column 40 on is published
            m[3].k[[0, 2, 4, 5]] *= 2
            m[3].k[[2, 5]] += 0.5
            m[3].k[2] += 40
            m[3].width, m[3].height = 2 * m[3].width + 80, 2 * m[3].height
            m[3].binning_x = m[3].binning_y = 2
            m[3].roi.x_offset, m[3].roi.width = 40, m[3].width - 80
            m[3].roi.height = m[3].height
    camera = opened(write(tmp_path / "a.mcap", made)).camera
    assert (camera.fx, camera.cx) == pytest.approx(right)


def test_depth_of_its_own_camera_is_brought_into_colour(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Catches depth read with the wrong lens: a plane 0.5 m ahead, seen from 30 mm beside."""
    transform = TYPES["geometry_msgs/msg/TransformStamped"]
    made = []
    for log_ns, topic, kind, value in messages:
        if topic == DEPTH:
            far = image(value, np.full((120, 200), 500, np.uint16), "16UC1", "depth_optical")
            made.append([log_ns, "/camera/depth/image_rect_raw", "sensor_msgs/msg/Image", far])
            continue
        made.append([log_ns, topic, kind, value])
        if topic == INFO:
            info = copy.deepcopy(value)
            info.header.frame_id, info.width, info.height = "depth_optical", 200, 120
            info.k = np.array([90.0, 0, 99.5, 0, 90.0, 59.5, 0, 0, 1])
            info.p = np.array([90.0, 0, 99.5, 0, 0, 90.0, 59.5, 0, 0, 0, 1, 0])
            made.append([log_ns, "/camera/depth/camera_info", kind, info])
            one = transform(
                header=header(value),
                child_frame_id="depth_optical",
                transform=TYPES["geometry_msgs/msg/Transform"](
                    translation=TYPES["geometry_msgs/msg/Vector3"](x=0.03, y=0.0, z=0.1),
                    rotation=TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
                ),
            )
            message = TYPES["tf2_msgs/msg/TFMessage"](transforms=[one])
            made.append([log_ns, "/tf_static", "tf2_msgs/msg/TFMessage", message])
    trial = opened(write(tmp_path / "a.mcap", made))
    frame = next(iter(trial.frames()))
    c = trial.camera
    inside = frame.depth > 0
    assert np.unique(frame.depth[inside]) == pytest.approx([0.6])
    # the depth image's left and right edges, in the colour image
    x = (np.array([-0.5, 199.5]) - 99.5) / 90.0 * 0.5 + 0.03
    left, right = np.clip(x / 0.6 * c.fx + c.cx, 0, c.width - 1)
    columns = np.flatnonzero(inside.any(axis=0))
    assert (columns[0], columns[-1]) == pytest.approx((left, right), abs=1.01)
    rows = inside[:, columns[2] : columns[-2]]
    assert rows[np.flatnonzero(rows.any(axis=1))[2:-2]].all(), "no holes between the pixels"
    assert any("is brought into the colour camera" in n for n in trial.notes)


# told


def test_depth_that_can_not_be_aligned_is_refused(tmp_path: Path, messages: list[Message]) -> None:
    made = []
    for log_ns, topic, kind, value in messages:
        if topic == DEPTH:
            value = image(value, np.full((120, 200), 500, np.uint16), "16UC1", "depth_optical")
            topic, kind = "/camera/depth/image_rect_raw", "sensor_msgs/msg/Image"
        made.append([log_ns, topic, kind, value])
    with pytest.raises(UnreadableError, match=r"is not aligned to colour.*T_colour_depth"):
        opened(write(tmp_path / "a.mcap", made))


def test_depth_in_another_unit_fails_a_check(tmp_path: Path, messages: list[Message]) -> None:
    """Catches millimetres in floats, read as metres; and a scale that floats ignore."""
    made = []
    for log_ns, topic, kind, value in messages:
        if topic == DEPTH:
            value = image(value, depth_codes(value).astype(np.float32), "32FC1")
            topic, kind = "/camera/depth/image", "sensor_msgs/msg/Image"
        made.append([log_ns, topic, kind, value])
    path = write(tmp_path / "a.mcap", made)
    (check,) = opened(path).checks
    assert check.name == "depth_unit"
    assert "0.001" in check.mend
    assert opened(path, "calibration.depth_scale=0.001").checks == ()


def test_a_camera_with_a_clock_of_its_own(tmp_path: Path, messages: list[Message]) -> None:
    """Catches a run without poses, and an offset of the wrong sign."""
    made = []
    for log_ns, topic, kind, value in messages:
        if topic == EVENTS:
            continue
        if topic in (COLOUR, DEPTH, INFO):
            value = copy.deepcopy(value)
            value.header.stamp.sec -= 111
        made.append([log_ns, topic, kind, value])
    path = write(tmp_path / "a.mcap", made)
    names = [c.name for c in opened(path).checks]
    assert names == ["clocks", "poses"]
    mend = opened(path).checks[0].mend.removeprefix("--set ").split(" --set ")
    assert opened(path, *mend).checks == ()


def test_one_stamp_ahead_costs_one_image(tmp_path: Path, messages: list[Message]) -> None:
    """Catches everything after a glitch dropped."""
    made = [list(m) for m in messages]
    (glitch,) = [m for m in made if m[1] == COLOUR][10:11]
    glitch[3] = copy.deepcopy(glitch[3])
    glitch[3].header.stamp.sec += 4
    trial = opened(write(tmp_path / "a.mcap", made))
    assert len(trial.pairs) == 67
    assert "stamps: 1 ahead in colour" in trial.notes
    assert trial.checks == ()


def test_a_log_without_events_tells_the_close_by_the_fingers(
    tmp_path: Path, messages: list[Message], demo: Path
) -> None:
    """Catches "no grasp" from the lack of a topic that nobody else writes."""
    path = write(tmp_path / "a.mcap", [m for m in messages if m[1] != EVENTS])
    trial = opened(path)
    recorded = opened(demo).event_ns("close")
    assert recorded is not None
    assert trial.close.source == "joints"
    assert any("the fingers begin to close at +3.2" in n for n in trial.notes), "said"
    assert trial.event_ns("close") == pytest.approx(recorded, abs=50_000_000)
    still = [m for m in messages if m[1] not in (EVENTS, JOINTS)]
    unknown = opened(write(tmp_path / "b.mcap", still)).close
    assert unknown.source is None
    assert unknown.missing is not None
    assert "--close TIME" in unknown.missing


@pytest.mark.parametrize(
    ("written", "label"),
    [
        ('{"event": "label", "label": "Success"}', "success"),
        ('{"event": "label", "label": "fail"}', "failure"),
        ("failed", "failure"),
        ('{"event": "label", "label": "maybe"}', None),
    ],
)
def test_an_operators_words(
    tmp_path: Path, messages: list[Message], written: str, label: str | None
) -> None:
    """Catches a label that is dropped for its spelling, or because it is not JSON."""
    from dgeval.verdict.log import log_of

    made = [list(m) for m in messages]
    for m in made:
        if m[1] == EVENTS and json.loads(m[3].data)["event"] == "label":
            m[3] = TYPES["std_msgs/msg/String"](data=written)
    assert log_of(opened(write(tmp_path / "a.mcap", made))).label == label


def test_a_clock_setting_that_moves_nothing_says_so(demo: Path) -> None:
    """Catches an offset that a user gives in vain: the camera's pose comes from the joints."""
    given = opened(demo, "clock.camera_pose.offset_ns=60000000")
    assert any("clock.camera_pose.offset_ns moves nothing here" in n for n in given.notes)
    assert not any("moves nothing" in n for n in opened(demo).notes)


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_the_span_of_a_file_by_its_index_is_that_of_its_messages(
    tmp_path: Path, messages: list[Message], kind: str
) -> None:
    """Catches a part that seems to overlap the next one, and trials opened whole to list them."""
    few = [m for m in messages if m[1] in (INFO, JOINTS)][:200]
    types = {topic: name for _, topic, name, _ in few}
    path = tmp_path / f"a.{kind}"
    if kind == "mcap":
        write(path, few)
    elif kind == "bag":
        with BagWriter(path) as bag:
            added = {t: bag.add_connection(t, k, typestore=ROS1) for t, k in types.items()}
            for log_ns, topic, name, value in few:
                data = STORE.cdr_to_ros1(STORE.serialize_cdr(value, name), name)
                bag.write(added[topic], log_ns, bytes(data))
    else:
        plugin = StoragePlugin.SQLITE3
        with FolderWriter(tmp_path / "a", version=8, storage_plugin=plugin) as stored:
            joined = {t: stored.add_connection(t, k, typestore=STORE) for t, k in types.items()}
            for log_ns, topic, name, value in few:
                stored.write(joined[topic], log_ns, STORE.serialize_cdr(value, name))
        path = next((tmp_path / "a").glob("*.db3"))
    read = open_container(path)
    times = [m.log_ns for m in read.messages()]
    assert read.container.span_ns == read.span_ns() == (min(times), max(times))
