"""Catches: manifests read loosely, trials cut at the wrong frame, a changed recording accepted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from dgeval.config import load_config
from dgeval.errors import UnreadableError, UsageError
from dgeval.geometry import Intrinsics
from dgeval.recording.containers.container import sha256_of
from dgeval.recording.containers.opening import open_container
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import open_trial
from dgeval.recording.write import McapWriter, camera_info_message, header, message
from rosbags.typesys import Stores, get_typestore

CAMERA = Intrinsics(16, 12, 20.0, 20.0, 8.0, 6.0)
START = 1_700_000_000_000_000_000
STEP = 50_000_000


def image(t_ns: int, array: np.ndarray, encoding: str) -> object:
    channels = array.shape[2] if array.ndim == 3 else 1
    return message(
        "sensor_msgs/Image",
        header=header(t_ns, "camera"),
        height=array.shape[0],
        width=array.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=array.shape[1] * array.itemsize * channels,
        data=np.ascontiguousarray(array).view(np.uint8).ravel(),
    )


def entries(n: int, events: dict[int, dict[str, object]]) -> list[tuple[int, str, object]]:
    out: list[tuple[int, str, object]] = []
    for k in range(n):
        t = START + k * STEP
        out.append((t, "/rgb/camera_info", camera_info_message(t, "camera", CAMERA)))
        out.append((t, "/rgb/image", image(t, np.full((12, 16, 3), k, np.uint8), "rgb8")))
        out.append((t, "/depth/image", image(t, np.full((12, 16), 500 + k, np.uint16), "16UC1")))
        if k in events:
            out.append(
                (t, "/dgeval/events", message("std_msgs/String", data=json.dumps(events[k])))
            )
    return out


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "three.mcap"
    starts = {2: {"event": "trial_start"}, 5: {"event": "trial_end"}, 8: {"event": "trial_start"}}
    with McapWriter(path, chunk_size=900) as writer:
        for t, topic, value in entries(12, starts):
            writer.write(topic, t, value)
    return path


def test_events_cut_a_recording_into_trials(recording: Path) -> None:
    """Fails where a trial starts or ends a frame off its event, or frames keep old indices."""
    specs = find_trials([recording])
    assert [s.id for s in specs] == ["three#0", "three#1"]
    grey_values = [
        [int(f.colour[0, 0, 0]) for f in open_trial(s, load_config()).frames()] for s in specs
    ]
    assert grey_values == [[2, 3, 4, 5], [8, 9, 10, 11]]
    frame = next(open_trial(specs[1], load_config()).frames())
    assert (frame.index, frame.t_ns) == (0, START + 8 * STEP)
    assert frame.depth[0, 0] == pytest.approx(0.508)


def test_folder_of_recordings_gives_ids_by_place(recording: Path, tmp_path: Path) -> None:
    """Fails where recordings of the same name in two folders get the same id."""
    (tmp_path / "sub").mkdir()
    recording.rename(tmp_path / "sub" / "a.mcap")
    assert [s.id for s in find_trials([tmp_path])] == ["sub/a#0", "sub/a#1"]


def test_manifest_with_frames_label_and_sha(recording: Path, tmp_path: Path) -> None:
    """Fails where the manifest's fields are not used, or another recording is accepted."""
    manifest = tmp_path / "m.toml"
    good = sha256_of(recording)
    text = (
        '[[trial]]\nid = "x"\nrecording = "three.mcap"\nframes = [1, 3]\n'
        'label = "failure"\nsha256 = "{}"\n'
    )
    manifest.write_text(text.format(good))
    spec = find_trials([manifest])[0]
    assert (spec.id, spec.label, spec.frames) == ("x", "failure", (1, 3))
    assert [f.index for f in open_trial(spec, load_config()).frames()] == [0, 1]
    manifest.write_text(text.format("0" * 64))
    with pytest.raises(UnreadableError, match="not the recording it names"):
        open_trial(find_trials([manifest])[0], load_config())


@pytest.mark.parametrize("line", ["bbx = [1, 2, 3, 4]", "frames = [1]", "speed = 'fast'"])
def test_manifest_mistakes_are_named(recording: Path, tmp_path: Path, line: str) -> None:
    """Fails where a mistyped key or a wrong type is ignored."""
    manifest = tmp_path / "m.toml"
    manifest.write_text(f'[[trial]]\nrecording = "three.mcap"\n{line}\n')
    with pytest.raises(UsageError, match="manifest: trial"):
        find_trials([manifest])


def test_ids_must_be_unique(recording: Path) -> None:
    """Fails where two trials write into the same files."""
    with pytest.raises(UsageError, match="not unique"):
        find_trials([recording, recording])


def test_topics_grouped_in_the_file_need_no_order(tmp_path: Path) -> None:
    """Fails where chunks that overlap in time are not merged into log-time order."""
    path = tmp_path / "grouped.mcap"
    with McapWriter(path, chunk_size=600) as writer:
        for t, topic, value in sorted(entries(10, {}), key=lambda e: e[1]):
            writer.write(topic, t, value)
    opened = open_container(path)
    times = [m.log_ns for m in opened.messages()]
    assert times == sorted(times)
    assert len(times) == 30
    assert not opened.damage
    assert len(list(open_trial(find_trials([path])[0], load_config()).frames())) == 10


def test_same_messages_from_mcap_bag_and_db3(tmp_path: Path) -> None:
    """Fails where a container changes a stamp or a pixel."""
    from rosbags.rosbag1 import Writer as BagWriter
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as FolderWriter

    ros1, ros2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
    source = [e for e in entries(6, {}) if "info" not in e[1]]
    with McapWriter(tmp_path / "a.mcap") as writer:
        for t, topic, value in source:
            writer.write(topic, t, value)
    with FolderWriter(
        tmp_path / "folder", version=9, storage_plugin=StoragePlugin.SQLITE3
    ) as folder:
        connections = {
            n: folder.add_connection(n, "sensor_msgs/msg/Image", typestore=ros2)
            for n in ("/rgb/image", "/depth/image")
        }
        for t, topic, value in source:
            folder.write(connections[topic], t, ros2.serialize_cdr(value, "sensor_msgs/msg/Image"))
    types = ros1.types
    with BagWriter(tmp_path / "a.bag") as bag:
        connections1 = {
            n: bag.add_connection(n, "sensor_msgs/msg/Image", typestore=ros1)
            for n in ("/rgb/image", "/depth/image")
        }
        for t, topic, value in source:
            stamp = types["builtin_interfaces/msg/Time"](
                value.header.stamp.sec, value.header.stamp.nanosec
            )
            head = types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id="camera")
            fields = {
                k: getattr(value, k)
                for k in ("height", "width", "encoding", "is_bigendian", "step", "data")
            }
            old = types["sensor_msgs/msg/Image"](header=head, **fields)
            bag.write(connections1[topic], t, ros1.serialize_ros1(old, "sensor_msgs/msg/Image"))
    config = load_config("dynamic", ("calibration.intrinsics=[20.0, 20.0, 8.0, 6.0]",))
    by_container = []
    for path in (
        tmp_path / "a.mcap",
        tmp_path / "folder",
        tmp_path / "folder" / "folder.db3",
        tmp_path / "a.bag",
    ):
        frames = list(open_trial(find_trials([path])[0], config).frames())
        by_container.append([(f.t_ns, f.colour.tobytes(), f.depth.tobytes()) for f in frames])
    assert len(by_container[0]) == 6
    assert all(frames == by_container[0] for frames in by_container[1:])


def test_missing_depth_is_an_error_that_lists_the_topics(tmp_path: Path) -> None:
    """Fails where the user has to guess which topic to name."""
    path = tmp_path / "blind.mcap"
    with McapWriter(path) as writer:
        for t, topic, value in entries(3, {}):
            if "depth" not in topic:
                writer.write(topic, t, value)
    with pytest.raises(UnreadableError, match=r"no depth images.*rgb/image"):
        open_trial(find_trials([path])[0], load_config())
