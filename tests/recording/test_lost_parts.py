"""Catches parts and messages of a split recording that are gone without a word, or for which the
rest is refused.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from dgeval.recording.containers.opening import open_container
from tests.recording.recorders import Message
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
    opened = open_container(tmp_path / "run")
    found = [(m.topic, m.log_ns) for m in opened.messages()]
    kept = [(m.topic, m.log_ns) for part in there for m in part.messages()]
    assert found == sorted(kept, key=whole.index)
    counted, lost = sorted(opened.damage, key=lambda damage: "can't be read" in damage.what)
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
