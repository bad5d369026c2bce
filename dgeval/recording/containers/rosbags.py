"""ROS 1 `.bag`, ROS 2 SQLite folders and bare `.db3`, read with rosbags. They have no checksums."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
import weakref
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import IO, Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from dgeval.errors import Damage, Place, UndecodableError, UnreadableError, describe
from dgeval.recording.containers.container import RawMessage, Topic, sidecars
from dgeval.recording.encodings import cdr2, foxglove, ros1

BAG_HEADER, INDEX_DATA, CHUNK, CHUNK_INFO = 3, 4, 5, 6  # record kinds of the ROS bag format 2.0
ORPHANS = "SELECT COUNT(*) FROM messages WHERE topic_id NOT IN (SELECT id FROM topics)"


class RosbagsContainer:
    """A `.bag` or `.db3` recording. Changed bytes show only against the SHA-256 of a manifest."""

    checksums = "none in this format: only a manifest with sha256 can tell changed bytes"

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage: list[Damage] = []
        self.topics: dict[str, Topic] = {}
        self.notes: list[str] = []
        self._source = path
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            files = sorted(path.glob("*.db3"))
            if len(files) != 1:
                raise UnreadableError(
                    "no metadata.yaml, and more than one .db3", Place(str(path)), "name one file"
                )
            self._source = files[0]
        self._source = self._recovered(self._source)
        self.kind = (
            "ROS 1 bag" if path.suffix == ".bag" or _is_bag(self._source) else "ROS 2 SQLite"
        )
        if self.kind == "ROS 2 SQLite":
            self._check_sqlite()
        else:
            self._check_bag()
        reader = self._open()
        try:
            store = reader.typestore
            has_any = reader.message_count > 0
            # rosbags gives the end behind the last message
            self.span_ns: tuple[int, int] | None = (
                (reader.start_time, reader.end_time - 1) if has_any else None
            )
            for connection in reader.connections:
                stored, why = connection.msgtype, None
                decode: Callable[[bytes], Any] = partial(cdr2.deserialize, store, stored)
                if self.kind == "ROS 1 bag":
                    decode = partial(ros1.decode, store, stored)
                if stored not in store.fielddefs:
                    why = f"no definition of {stored} in the recording"
                    decode = partial(_unknown_type, why, Place(str(path), connection.topic))
                else:
                    decode = foxglove.adapted(stored, decode)
                before = self.topics.get(connection.topic)
                count = connection.msgcount + (before.count or 0 if before else 0)
                encoding = "ros1" if self.kind == "ROS 1 bag" else "cdr"
                self.topics[connection.topic] = Topic(
                    connection.topic,
                    foxglove.ros_type(stored),
                    encoding,
                    count,
                    decode,
                    stored,
                    why,
                )
        finally:
            reader.close()

    def _recovered(self, source: Path) -> Path:
        """The source, or a temporary copy of it with what its recorder left beside the SQLite file.

        A recorder that died leaves messages in a -wal file, or a change half made and a -journal.
        SQLite puts them in when it opens the file for writing. The copy lives with the reader.
        """
        files = list(source.glob("*.db3")) if source.is_dir() else [source]
        left = [p for f in files for p in sidecars(f)]
        if not left:
            return source
        folder = Path(tempfile.mkdtemp(prefix="dgeval-"))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        extra = [source / "metadata.yaml"] if source.is_dir() else []
        for file in [*files, *left, *extra]:
            if file.is_file():
                shutil.copyfile(file, folder / file.name)
        for file in files:
            try:
                with closing(sqlite3.connect(folder / file.name)) as connection:
                    connection.execute("PRAGMA journal_mode=DELETE").fetchone()
            except sqlite3.Error:
                pass  # the check that follows says what is wrong
        for end, what in (
            ("-wal", "what {} holds is read as well"),
            ("-journal", "what was written last is taken back, as {} says"),
        ):
            names = ", ".join(sorted(p.name for p in left if p.name.endswith(end)))
            if names:
                self.notes.append(f"the recorder was stopped: {what.format(names)}")
        return folder if source.is_dir() else folder / source.name

    def _open(self) -> AnyReader:
        try:
            reader = AnyReader([self._source], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            reader.open()
        except Exception as error:  # rosbags lets errors of yaml, sqlite, zstd and struct through
            what = f"the {self.kind} can't be opened ({describe(error)})"
            hint = "`rosbag reindex` may bring it back" if self.kind == "ROS 1 bag" else None
            if self.path.suffix == ".active":
                what = "its recorder did not finish the bag, so that it has no index"
                hint = "name it .bag and run `rosbag reindex`"
            raise UnreadableError(what, Place(str(self.path)), hint) from error
        return reader

    def _check_sqlite(self) -> None:
        """UnreadableError where SQLite's structural check fails.

        It finds pages that a cut or a zeroed block destroyed, not changed contents.
        """
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
                raise UnreadableError(
                    f"the SQLite file is damaged ({describe(error)})", Place(str(file))
                ) from error
            if orphans:
                what = f"{orphans} messages belong to no topic of the file and can't be used"
                self.damage.append(Damage(what, Place(str(file))))
            if verdict != "ok":
                raise UnreadableError(f"the SQLite file is damaged ({verdict})", Place(str(file)))

    def _check_bag(self) -> None:
        """Compare the index with the chunks: their number, places, and messages per connection.

        A bag is read by the index at its end. An index that has lost chunks would lose their
        messages without an error.
        """
        n_promised, n_indexed = None, 0
        held: dict[tuple[int, int], int] = {}
        listed: dict[tuple[int, int], int] = {}
        chunks: list[int] = []
        try:
            for at, fields, data in _bag_records(self._source):
                kind = fields[b"op"][0]
                if kind == BAG_HEADER:
                    n_promised = _number(fields[b"chunk_count"])
                elif kind == CHUNK:
                    chunks.append(at)
                elif kind == INDEX_DATA:
                    held[chunks[-1], _number(fields[b"conn"])] = _number(fields[b"count"])
                elif kind == CHUNK_INFO:
                    n_indexed += 1
                    if _number(fields[b"count"]) * 8 != len(data):
                        raise ValueError("a chunk's summary is not as long as it says")
                    for i in range(0, len(data), 8):
                        listed[_number(fields[b"chunk_pos"]), _number(data[i : i + 4])] = _number(
                            data[i + 4 : i + 8]
                        )
        except (KeyError, IndexError, ValueError) as error:
            what = f"its records don't follow one another ({describe(error)})"
            self.damage.append(Damage(what, Place(str(self.path))))
            return
        if not n_promised == n_indexed == len(chunks) or held != listed:
            counts = f"{n_promised} chunks in the header, {len(chunks)} in the file"
            what = (
                f"the bag contradicts itself ({counts}; "
                "the index and the chunks list different messages)"
            )
            self.damage.append(Damage(what, Place(str(self.path))))

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        """Messages of the topics in log-time order; a fault ends them and is kept in `damage`."""
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
                        raise TypeError(
                            f"a message is stored as {type(raw).__name__}, not as bytes"
                        )
                    if not _is_time(log_ns):
                        raise TypeError(f"a message's time is {log_ns!r}")
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


def _bag_records(path: Path) -> Iterator[tuple[int, dict[bytes, bytes], bytes]]:
    """Byte offset, header fields and data of the top-level records of a ROS 1 bag.

    The data of other records than chunk indexes are skipped. ValueError for a broken record.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        stream.readline()
        while stream.tell() < size:
            start = stream.tell()
            head = stream.read(_length(stream, size))
            fields: dict[bytes, bytes] = {}
            at = 0
            while at < len(head):
                end = at + 4 + _number(head[at : at + 4])
                name, sign, value = head[at + 4 : end].partition(b"=")
                if not sign or end > len(head):
                    raise ValueError(f"a record header is broken near byte {stream.tell()}")
                fields[name] = value
                at = end
            length = _length(stream, size)
            if fields[b"op"][0] == CHUNK_INFO:
                yield start, fields, stream.read(length)
            else:
                yield start, fields, b""
                stream.seek(length, 1)


def _is_time(value: object) -> bool:
    """Whether a log time is one: SQLite stores any type, a time may be a text or a float there."""
    return isinstance(value, int) and 0 <= value < 1 << 63


def _number(raw: bytes) -> int:
    return int.from_bytes(raw, "little")


def _length(stream: IO[bytes], size: int) -> int:
    raw = stream.read(4)
    length = _number(raw)
    if len(raw) < 4 or stream.tell() + length > size:
        raise ValueError(f"a record reaches beyond the file at byte {stream.tell()}")
    return length


def _is_bag(path: Path) -> bool:
    if path.is_dir():
        return False
    with path.open("rb") as stream:
        return stream.read(8) == b"#ROSBAG "


def _unknown_type(why: str, place: Place, _: bytes) -> Any:
    raise UndecodableError(why, place)
