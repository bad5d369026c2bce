"""Catches parts and messages of a split recording that are gone without a word, or for which the
rest is refused; and the recordings of a trial's two computers that nothing puts together.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from dgeval.config import Config
from dgeval.errors import UnreadableError, UsageError
from dgeval.recording.containers.opening import open_container
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import open_trial
from tests.recording.recorders import Message, contents, opened, write
from tests.recording.test_ninth_strangers import parts

JOINTS = "/joint_states"


def listed(folder: Path, files: list[Path], messages: list[Message], more: int = 0) -> None:
    """A metadata.yaml as rosbag2 writes it. more: joint states that it counts besides."""
    counts: dict[str, int] = {JOINTS: more}
    for m in messages:
        counts[m[1]] = counts.get(m[1], 0) + 1
    topics = "".join(
        f"    - topic_metadata:\n        name: {name}\n      message_count: {count}\n"
        for name, count in counts.items()
    )
    names = "".join(f"    - {file.name}\n" for file in files)
    (folder / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n{names}"
        f"  topics_with_message_count:\n{topics}"
    )


@pytest.mark.parametrize("gone", [0, 1, 2])
def test_the_parts_that_can_be_read_are(tmp_path: Path, messages: list[Message], gone: int) -> None:
    """Fails where one empty part refuses the recording, and where its times are not told."""
    files = parts(tmp_path / "run", messages, 3)
    listed(tmp_path / "run", files, messages)
    whole = [(m.topic, m.log_ns) for m in open_container(tmp_path / "run").messages()]
    there = [open_container(file) for k, file in enumerate(files) if k != gone]
    files[gone].write_bytes(b"")
    rest = open_container(tmp_path / "run")
    found = [(m.topic, m.log_ns) for m in rest.messages()]
    kept = [(m.topic, m.log_ns) for part in there for m in part.messages()]
    assert found == sorted(kept, key=whole.index)
    counted, lost = sorted(rest.damage, key=lambda damage: "can't be read" in damage.what)
    assert f"{files[gone].name} can't be read (the file is empty)" in lost.what
    spans = [span for part in there if (span := part.span_ns()) is not None]
    if gone == 1:
        assert (lost.lost_from_ns, lost.lost_to_ns) == (spans[0][1], spans[1][0])
    if gone == 2:
        assert (lost.lost_from_ns, lost.lost_to_ns) == (spans[1][1], None)
    assert "metadata.yaml counts messages that are lost" in counted.what


def test_no_part_is_left(tmp_path: Path, messages: list[Message]) -> None:
    files = parts(tmp_path / "run", messages, 2)
    listed(tmp_path / "run", files, messages)
    for file in files:
        file.write_bytes(b"")
    with pytest.raises(Exception, match="the file is empty"):
        open_container(tmp_path / "run")


def test_messages_that_the_recorder_counted_and_the_files_lack(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a part that was replaced, or a cache that overflowed, is no loss."""
    files = parts(tmp_path / "run", messages, 2)
    listed(tmp_path / "run", files, messages, more=7)
    [damage] = open_container(tmp_path / "run").damage
    there = sum(m[1] == JOINTS for m in messages)
    assert damage.what.endswith(f"{there + 7} on {JOINTS}, and {there} are there")
    listed(tmp_path / "run", files, messages)
    assert open_container(tmp_path / "run").damage == []


@pytest.mark.parametrize("text", ["", "a: [", "rosbag2_bagfile_information: 3", "- run_0.mcap"])
def test_another_programs_metadata_counts_nothing(
    tmp_path: Path, messages: list[Message], text: str
) -> None:
    parts(tmp_path / "run", messages, 2)
    (tmp_path / "run" / "metadata.yaml").write_text(text)
    assert open_container(tmp_path / "run").damage == []


def two_computers(folder: Path, messages: list[Message]) -> dict[str, list[Message]]:
    """The camera's and the robot's recording of one trial."""
    folder.mkdir()
    held = {"camera": [m for m in messages if "camera" in m[1]]}
    held["robot"] = [m for m in messages if "camera" not in m[1]]
    for name, own in held.items():
        write(folder / f"{name}.mcap", own)
    return held


def test_the_recordings_of_two_computers_are_one_by_a_manifest(
    tmp_path: Path, messages: list[Message]
) -> None:
    whole = contents(opened(write(tmp_path / "whole.mcap", messages)))
    two_computers(tmp_path / "run", messages)
    manifest = tmp_path / "run" / "m.toml"
    manifest.write_text('[[trial]]\nrecording = ["camera.mcap", "robot.mcap"]\n')
    (spec,) = find_trials([manifest])
    assert spec.id == "camera"
    trial = open_trial(spec, Config())
    assert contents(trial) == whole
    assert trial.checks == ()
    manifest.write_text("[[trial]]\nrecording = []\n")
    with pytest.raises(UsageError, match="recording"):
        find_trials([manifest])


def test_the_folders_of_two_computers_are_one_by_a_manifest(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where only files can be put together: `ros2 bag record` writes folders."""
    whole = contents(opened(write(tmp_path / "whole.mcap", messages)))
    held = two_computers(tmp_path / "run", messages)
    folders = tmp_path / "day"
    for name, own in held.items():
        (folders / name).mkdir(parents=True)
        files = [write(folders / name / f"{name}_0.mcap", own)]
        listed(folders / name, files, own)
    (camera,) = find_trials([folders / "camera"])
    note = next(n for n in open_trial(camera, Config()).notes if "at the same time" in n)
    assert 'recording = ["camera", "robot"]' in note
    manifest = folders / "m.toml"
    manifest.write_text('[[trial]]\nid = "both"\nrecording = ["camera", "robot"]\n')
    (spec,) = find_trials([manifest])
    assert (spec.id, len(spec.parts)) == ("both", 2)
    assert contents(open_trial(spec, Config())) == whole


def test_a_recording_beside_that_may_be_of_the_same_trial_is_named(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a camera's recording is replayed alone, and nothing says where its robot is."""
    run = tmp_path / "run"
    held = two_computers(run, messages)
    camera, robot = (find_trials([run / f"{name}.mcap"])[0] for name in ("camera", "robot"))
    said = "recorded at the same time"
    assert any(said in note for note in open_trial(camera, Config()).notes)
    with pytest.raises(UnreadableError, match="images found") as refused:
        open_trial(robot, Config())
    assert 'recording = ["robot.mcap", "camera.mcap"]' in str(refused.value)
    # of two that may be, of the next trial's, and of a copy nothing is said
    write(run / "another.mcap", [m for m in held["robot"] if "joint" in m[1]])
    assert not any(said in note for note in open_trial(camera, Config()).notes)
    (run / "another.mcap").unlink()
    later = [[m[0] + 60 * 10**9, *m[1:]] for m in held["robot"]]
    write(run / "robot.mcap", later)
    assert not any(said in note for note in open_trial(camera, Config()).notes)
    write(run / "robot.mcap", messages)
    assert not any(said in note for note in open_trial(camera, Config()).notes)
