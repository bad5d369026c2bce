"""ROS 1 `.bag`, ROS 2 SQLite folders and bare `.db3`, read with rosbags. None of them has checksums."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from dgeval.errors import Damage, Place, UndecodableError, UnreadableError
from dgeval.recording.containers import RawMessage, Topic, describe


ORPHANS = "SELECT COUNT(*) FROM messages WHERE topic_id NOT IN (SELECT id FROM topics)"


class RosbagsContainer:
    """A `.bag` or `.db3` recording. A flipped bit in it can't be noticed: only a manifest's sha256 tells."""

    checksums = "none in this format: only a manifest with sha256 can tell changed bytes"

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage: list[Damage] = []
        self.topics: dict[str, Topic] = {}
        self._source = path
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            files = sorted(path.glob("*.db3"))
            if len(files) != 1:
                raise UnreadableError("no metadata.yaml, and more than one .db3", Place(str(path)), "name one file")
            self._source = files[0]
        self.kind = "ROS 1 bag" if path.suffix == ".bag" or _is_bag(self._source) else "ROS 2 SQLite"
        if self.kind == "ROS 2 SQLite":
            self._check_sqlite()
        reader = self._open()
        try:
            store = reader.typestore
            deserialize = store.deserialize_ros1 if self.kind == "ROS 1 bag" else store.deserialize_cdr
            for connection in reader.connections:
                decode: Callable[[bytes], Any] = partial(deserialize, typename=connection.msgtype)
                if connection.msgtype not in store.fielddefs:
                    decode = partial(_unknown_type, connection.msgtype, Place(str(path), connection.topic))
                before = self.topics.get(connection.topic)
                count = connection.msgcount + (before.count or 0 if before else 0)
                encoding = "ros1" if self.kind == "ROS 1 bag" else "cdr"
                self.topics[connection.topic] = Topic(connection.topic, connection.msgtype, encoding, count, decode)
        finally:
            reader.close()

    def _open(self) -> AnyReader:
        try:
            reader = AnyReader([self._source], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            reader.open()
        except Exception as error:  # rosbags lets errors of yaml, sqlite, zstd and struct through
            what = f"the {self.kind} can't be opened ({describe(error)})"
            hint = "`rosbag reindex` may bring it back" if self.kind == "ROS 1 bag" else None
            raise UnreadableError(what, Place(str(self.path)), hint) from error
        return reader

    def _check_sqlite(self) -> None:
        """SQLite's own structural check: finds pages that a cut or a zeroed block destroyed, not changed contents."""
        files = sorted(self._source.glob("*.db3")) if self._source.is_dir() else [self._source]
        for file in files:
            try:
                connection = sqlite3.connect(f"file:{file}?mode=ro&immutable=1", uri=True)
                try:
                    verdict = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
                    orphans = connection.execute(ORPHANS).fetchone()[0] if verdict == "ok" else 0
                finally:
                    connection.close()
            except (sqlite3.Error, UnicodeDecodeError) as error:
                raise UnreadableError(f"the SQLite file is damaged ({describe(error)})", Place(str(file))) from error
            if orphans:
                what = f"{orphans} messages belong to no topic of the file and can't be used"
                self.damage.append(Damage(what, Place(str(file))))
            if verdict != "ok":
                raise UnreadableError(f"the SQLite file is damaged ({verdict})", Place(str(file)))

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        """Messages of the topics in log-time order; a fault ends the pass and is kept in `damage`."""
        reader = self._open()
        last_ns: int | None = None
        try:
            connections = [c for c in reader.connections if c.topic in topics]
            if not connections:
                return
            stream = reader.messages(connections)
            while True:
                try:
                    connection, log_ns, raw = next(stream)
                    if not isinstance(raw, bytes | bytearray | memoryview):
                        raise TypeError(f"a message is stored as {type(raw).__name__}, not as bytes")
                except StopIteration:
                    return
                except Exception as error:
                    what = f"reading stopped ({describe(error)})"
                    damage = Damage(what, Place(str(self.path), t_ns=last_ns), last_ns)
                    if damage not in self.damage:
                        self.damage.append(damage)
                    return
                last_ns = log_ns
                yield RawMessage(connection.topic, log_ns, bytes(raw))
        finally:
            reader.close()


def _is_bag(path: Path) -> bool:
    if path.is_dir():
        return False
    with path.open("rb") as stream:
        return stream.read(8) == b"#ROSBAG "


def _unknown_type(msgtype: str, place: Place, _: bytes) -> Any:
    raise UndecodableError(f"no definition of {msgtype} in the recording", place)
