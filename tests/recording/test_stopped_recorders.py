"""Recorders that were killed, and messages compressed one by one.

Catches: messages lost that the format's own reader gives, stamps read from compressed bytes, and a
part of a recording taken for the whole without a word.
"""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import zstandard
from dgeval.config import Config
from dgeval.recording.containers.container import sha256_of
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import open_trial
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from tests.recording.recorders import STORE, Message, contents, opened, write


def rosbag2(
    folder: Path, messages: list[Message], plugin: StoragePlugin, compressed: bool = False
) -> Path:
    """A ROS 2 folder."""
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if compressed:
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for log_ns, topic, kind, value in sorted(messages, key=lambda m: m[0]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], log_ns, bytes(STORE.serialize_cdr(value, kind)))
    return folder


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("bare", [False, True])
def test_messages_compressed_one_by_one(
    tmp_path: Path, messages: list[Message], original: list[Any], plugin: StoragePlugin, bare: bool
) -> None:
    """Fails where the stamps are read from compressed bytes, or a bare file is not understood."""
    folder = rosbag2(tmp_path / "bag", messages, plugin, compressed=True)
    (stored,) = (p for p in folder.iterdir() if p.suffix in (".mcap", ".db3"))
    assert contents(opened(stored if bare else folder)) == original


def test_a_broken_frame_of_one_message_costs_that_message(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where one broken message ends the reading."""
    folder = rosbag2(tmp_path / "bag", messages, StoragePlugin.SQLITE3, compressed=True)
    stamps = [frame.t_ns for frame in opened(folder).frames()]
    (file,) = folder.glob("*.db3")
    with sqlite3.connect(file) as connection:
        topics = dict(connection.execute("SELECT name, id FROM topics"))
        colour = next(i for name, i in topics.items() if name.endswith("image_raw/compressed"))
        ((row,),) = connection.execute(
            "SELECT id FROM messages WHERE topic_id = ? LIMIT 1 OFFSET 9", (colour,)
        )
        connection.execute("UPDATE messages SET data = ? WHERE id = ?", (b"\x28\xb5broken", row))
    connection.close()
    trial = opened(file)
    assert [frame.t_ns for frame in trial.frames()] == stamps[:9] + stamps[10:]
    assert any("messages can't be used" in str(d) for d in trial.damage)


@pytest.mark.parametrize("shape", ["bare", "folder", "folder without metadata"])
def test_messages_that_are_only_in_the_write_ahead_log(
    tmp_path: Path, messages: list[Message], original: list[Any], shape: str
) -> None:
    """Fails where a killed recorder's -wal file is passed over: half a trial is a `no_grasp`."""
    folder = rosbag2(tmp_path / "bag", messages, StoragePlugin.SQLITE3)
    (file,) = folder.glob("*.db3")
    with sqlite3.connect(file) as connection:
        (middle,) = connection.execute("SELECT COUNT(*) / 2 FROM messages").fetchone()
        rows = connection.execute("SELECT * FROM messages ORDER BY id").fetchall()
        connection.execute("DELETE FROM messages WHERE id > ?", (rows[middle][0],))
    connection.close()
    writer = sqlite3.connect(file)
    writer.execute("PRAGMA journal_mode=WAL")
    writer.execute("PRAGMA wal_autocheckpoint=0")
    marks = ",".join("?" * len(rows[0]))
    writer.executemany(f"INSERT INTO messages VALUES ({marks})", rows[middle + 1 :])
    writer.commit()
    dead = tmp_path / "dead"
    dead.mkdir()
    for name in (file.name, f"{file.name}-wal"):
        shutil.copyfile(folder / name, dead / name)
    if shape == "folder":
        shutil.copyfile(folder / "metadata.yaml", dead / "metadata.yaml")
    writer.close()
    before = sha256_of(dead / file.name)
    trial = opened(dead / file.name if shape == "bare" else dead)
    assert contents(trial) == original
    assert any("-wal" in note for note in trial.notes)
    assert sha256_of(dead / file.name) == before  # the recording itself is not touched
    (dead / f"{file.name}-wal").unlink()
    assert sha256_of(dead / file.name) != before  # and what lies beside it is a part of it


@pytest.mark.parametrize("finished", [False, True])
def test_a_write_ahead_log_that_is_lost_is_told(
    tmp_path: Path, messages: list[Message], finished: bool
) -> None:
    """Fails where a killed recorder's file, copied without its -wal, is half a trial in silence."""
    folder = rosbag2(tmp_path / "bag", messages, StoragePlugin.SQLITE3)
    (file,) = folder.glob("*.db3")
    with sqlite3.connect(file) as connection:
        connection.execute("PRAGMA journal_mode=WAL")
    connection.close()
    if not finished:
        (folder / "metadata.yaml").unlink()
    for given in (file, folder):
        told = [c for c in opened(given).checks if c.name == "parts"]
        assert ["-wal" in c.what for c in told] == ([] if finished else [True])


def test_a_change_that_was_half_made_is_taken_back(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    """Fails where a killed recorder's -journal is passed over: pages of two states, or none at all.

    The recorder dies while SQLite writes a transaction's pages into the file.
    """
    folder = rosbag2(tmp_path / "bag", messages, StoragePlugin.SQLITE3)
    (file,) = folder.glob("*.db3")
    code = (
        "import os, sqlite3, sys\n"
        "c = sqlite3.connect(sys.argv[1], isolation_level=None)\n"
        "c.execute('PRAGMA cache_size=5')\n"  # pages: a larger change goes to the disk at once
        "c.execute('BEGIN')\n"
        "c.execute('UPDATE messages SET data = zeroblob(length(data))')\n"
        "os._exit(1)\n"
    )
    before = file.read_bytes()
    subprocess.run([sys.executable, "-c", code, str(file)], check=False)
    assert file.with_name(f"{file.name}-journal").stat().st_size > 0
    assert file.read_bytes() != before, "nothing of the change reached the file: the case is none"
    trial = opened(file)
    assert contents(trial) == original
    assert any("-journal" in note for note in trial.notes)


def halves(messages: list[Message], *cuts: float) -> list[list[Message]]:
    begin = min(m[0] for m in messages)
    out: list[list[Message]] = [[] for _ in range(len(cuts) + 1)]
    for m in messages:
        out[sum(m[0] - begin > cut * 1e9 for cut in cuts)].append(m)
    return out


def test_parts_without_metadata_are_one_recording(
    tmp_path: Path, messages: list[Message], original: list[Any]
) -> None:
    """Fails where a killed recorder's parts become one trial each."""
    folder = tmp_path / "bag"
    folder.mkdir()
    files = [
        write(folder / f"bag_{k}.mcap", part) for k, part in enumerate(halves(messages, 1.5, 3.0))
    ]
    for given in ([folder], files):
        (spec,) = find_trials(given)
        assert contents(open_trial(spec, Config())) == original


def test_one_part_alone_fails_a_check(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where a part is judged as if it were the trial."""
    for k, part in enumerate(halves(messages, 1.5)):
        write(tmp_path / f"bag_{k}.mcap", part)
    trial = opened(tmp_path / "bag_0.mcap")
    (check,) = (c for c in trial.checks if c.name == "parts")
    assert "bag_1.mcap" in check.what


def test_numbered_trials_stay_trials(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where two trials that were recorded one after the other become one."""
    later = [[m[0] + 60_000_000_000, *m[1:]] for m in messages]
    write(tmp_path / "trial_0.mcap", messages)
    write(tmp_path / "trial_1.mcap", later)
    assert len(find_trials([tmp_path])) == 2
    assert not [c for c in opened(tmp_path / "trial_0.mcap").checks if c.name == "parts"]


def test_a_zstd_frame_that_is_cut(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where a message whose frame is cut is used."""
    from dgeval.recording.containers.container import RawMessage, unpacked

    whole = zstandard.ZstdCompressor().compress(b"x" * 1000)
    assert unpacked(RawMessage("/a", 1, whole)).data == b"x" * 1000
    assert unpacked(RawMessage("/a", 1, whole[:-5])).data == b""


def test_trials_recorded_right_after_one_another_stay_trials(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a campaign whose recorder is restarted for each trial becomes one recording."""
    last = max(m[0] for m in messages) - min(m[0] for m in messages)
    later = [[m[0] + last + 1_200_000_000, *m[1:]] for m in messages]
    write(tmp_path / "trial_0.mcap", messages)
    write(tmp_path / "trial_1.mcap", later)
    assert len(find_trials([tmp_path])) == 2
