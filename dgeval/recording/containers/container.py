"""One interface for every container format: its topics, and its messages in log-time order.

This is the error boundary of the recording layer: only dgeval's own errors pass out of here. The
messages before a fault are read exactly as stored. The fault is kept in `Container.damage`, and the
caller decides what it costs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import zstandard

from dgeval.errors import Damage, Place, UndecodableError, describe
from dgeval.recording.contract import DGEVAL_PREFIX, TRUTH_PREFIX

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
MAX_MESSAGE_BYTES = 1 << 30  # a frame that claims more is broken
MCAP_MAGIC = b"\x89MCAP0\r\n"
SQLITE_MAGIC = b"SQLite format 3\x00"


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a recording.

    type: a ROS 2 name; of Foxglove's types the one that means the same. count: from the file's own
    statistics, None without them. decode: gives an object with the type's fields. stored_type: as
    the file names it. unread: why its messages can't be decoded; None where they can.
    """

    name: str
    type: str
    encoding: str
    count: int | None
    decode: Callable[[bytes], Any]
    stored_type: str = ""
    unread: str | None = None


@dataclass(frozen=True, slots=True)
class RawMessage:
    """One message as stored: topic, log time, ns, bytes, and byte offset of its chunk or None."""

    topic: str
    log_ns: int
    data: bytes
    offset: int | None = None


class Container(Protocol):
    """What a container format implements. `messages` may be called any number of times.

    span_ns: the first and the last log time by the file's own index; None without one.
    """

    path: Path
    kind: str
    topics: dict[str, Topic]
    notes: list[str]

    @property
    def span_ns(self) -> tuple[int, int] | None: ...

    @property
    def damage(self) -> list[Damage]: ...

    @property
    def checksums(self) -> str: ...

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]: ...


def unpacked(message: RawMessage) -> RawMessage:
    """A CDR message, out of its zstd frame where it is one, as rosbag2's message mode writes it.

    CDR begins with a zero byte, so a frame is known by its own first bytes. Of a broken frame
    nothing is left, which no decoder accepts.
    """
    if not message.data.startswith(ZSTD_MAGIC):
        return message
    try:
        data = zstandard.ZstdDecompressor().decompress(message.data, MAX_MESSAGE_BYTES)
    except zstandard.ZstdError:
        data = b""
    return replace(message, data=data)


OWN = (DGEVAL_PREFIX, TRUTH_PREFIX)  # topics of dgeval, which a namespace may stand before


def ros_name(topic: str) -> str:
    """A topic's name as ROS has it: with a slash before it, and without the `rt` that DDS puts
    there, as a bridge or a recorder below ROS stores it.
    """
    return "/" + topic.removeprefix("rt/").lstrip("/")


@dataclass
class Opened:
    """A container with the checks that are the same for every format.

    Messages read are counted against the file's statistics; decoding errors name topic and time.
    """

    container: Container
    path: Path
    counts: dict[str, int] = field(default_factory=dict)

    @cached_property
    def topics(self) -> dict[str, Topic]:
        """By the names that ROS has for them: see `ros_name`."""
        return {new: replace(t, name=new) for new, t in self._stored.items()}

    @cached_property
    def _stored(self) -> dict[str, Topic]:
        """The file's topics, by their names in ROS; two that would be one keep their own."""
        names = [ros_name(name) for name in self.container.topics]
        own = [next((n[n.index(p) :] for p in OWN if p in n), n) for n in names]
        for k, (name, short) in enumerate(zip(names, own, strict=True)):
            if name != short and own.count(short) == 1:
                self.notes.append(f"{name} is read as {short}")
                names[k] = short
        return {
            new if names.count(new) == 1 else old: topic
            for (old, topic), new in zip(self.container.topics.items(), names, strict=True)
        }

    @property
    def damage(self) -> list[Damage]:
        return self.container.damage

    @property
    def notes(self) -> list[str]:
        """What was assumed to read the file."""
        return self.container.notes

    def span_ns(self) -> tuple[int, int] | None:
        """The first and the last log time; None without messages. Reads a file without an index."""
        if self.container.span_ns is not None and not self.damage:
            return self.container.span_ns
        times = [message.log_ns for message in self.messages()]
        return (min(times), max(times)) if times else None

    def messages(self, topics: frozenset[str] | None = None) -> Iterator[RawMessage]:
        """Messages of the topics (all if None) in log-time order, ties in file order.

        A full pass that ends without a fault is checked against the file's statistics.
        """
        wanted = frozenset(self.topics) if topics is None else topics
        counts = dict.fromkeys(sorted(wanted), 0)
        last_ns: int | None = None
        stored = {self._stored[name].name: name for name in wanted if name in self._stored}
        renamed = any(old != new for old, new in stored.items())
        for message in self.container.messages(frozenset(stored)):
            if renamed:
                message = replace(message, topic=stored[message.topic])
            counts[message.topic] += 1
            last_ns = message.log_ns
            packed = self.topics[message.topic].encoding == "cdr"
            yield unpacked(message) if packed else message
        self.counts.update(counts)
        if self.damage:
            return
        for name, count in counts.items():
            promised = self.topics[name].count
            if promised is not None and promised != count:
                what = f"the file's statistics promise {promised} messages, {count} were read"
                self.damage.append(Damage(what, Place(str(self.path), name), last_ns))

    def decode(self, message: RawMessage) -> Any:
        """A message as an object with its type's fields. UndecodableError names topic and time."""
        try:
            return self.topics[message.topic].decode(message.data)
        except UndecodableError:
            raise
        except Exception as error:
            what = f"can't decode a {self.topics[message.topic].type} ({describe(error)})"
            raise UndecodableError(
                what, Place(str(self.path), message.topic, message.log_ns, message.offset)
            ) from error


def sidecars(file: Path) -> list[Path]:
    """What SQLite left beside a .db3 whose writer was stopped, and that holds a part of it."""
    beside = [file.with_name(f"{file.name}-{end}") for end in ("wal", "journal")]
    return [p for p in beside if p.is_file() and p.stat().st_size]


def lacks_its_log(file: Path) -> bool:
    """Whether a .db3 of SQLite's crash-safe mode lacks its -wal file, which may hold messages.

    It does where its recorder did not end, by writing a metadata.yaml, and there is no such file.
    """
    finished = file.with_name("metadata.yaml").is_file()
    if finished or sidecars(file):
        return False
    with file.open("rb") as stream:
        head = stream.read(len(SQLITE_MAGIC) + 4)
    # https://www.sqlite.org/fileformat.html, "File format version numbers": 2 is WAL
    return head.startswith(SQLITE_MAGIC) and head[18:20] == b"\2\2"


def sha256_of(path: Path, parts: tuple[Path, ...] = ()) -> str:
    """SHA-256 of a file; of a folder over names and contents of its files, in name order.

    parts: files that together are the recording, in order.
    """
    kinds = (".mcap", ".db3", ".yaml", ".zstd")
    files = list(parts)
    if len(parts) < 2:
        files = [path]
        if not path.is_file():
            files = sorted(p for p in path.iterdir() if p.suffix in kinds)
    files = [
        p for file in files for p in (file, *(sidecars(file) if file.suffix == ".db3" else ()))
    ]
    digest = hashlib.sha256()
    for file in files:
        if len(files) > 1 or path.is_dir():
            digest.update(file.name.encode() + b"\0")
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()
