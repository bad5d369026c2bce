"""MCAP files of any profile, with every checksum verified.

A file with an intact summary is read by its index: chunks in the order of their start times, merged
where they overlap, so that memory holds only chunks that overlap. A file without one is read from
the front until it ends or breaks.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NoReturn

import lz4.frame
import mcap.exceptions
import mcap.records
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.stream_reader import CRCValidationError, StreamReader

from dgeval.errors import Damage, Place, UndecodableError, UnreadableError, describe
from dgeval.recording.containers.container import MCAP_MAGIC, RawMessage, Topic
from dgeval.recording.encodings import decoders, foxglove, json_text

FOOTER_LENGTH = 1 + 8 + 20  # bytes: kind, length and content of the footer record, MCAP format
MAX_CHUNK_BYTES = 1 << 30  # bytes, uncompressed; a larger claim is taken for damage
RECORD_HEAD = struct.Struct("<BQ")  # kind, length
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time and publish time, ns
DEFINITIONS: dict[int, Any] = {
    int(Opcode.SCHEMA): mcap.records.Schema,
    int(Opcode.CHANNEL): mcap.records.Channel,
}
# kinds of record that may stand before the end of the data section
DATA_KINDS = frozenset(
    int(k)
    for k in (
        Opcode.HEADER,
        Opcode.SCHEMA,
        Opcode.CHANNEL,
        Opcode.MESSAGE,
        Opcode.CHUNK,
        Opcode.MESSAGE_INDEX,
        Opcode.ATTACHMENT,
        Opcode.METADATA,
        Opcode.DATA_END,
    )
)

# What the mcap, zstd and lz4 libraries raise on broken bytes; collected on the damaged files of the
# tests (tests/recording/damage.py).
BROKEN = (
    mcap.exceptions.McapError,
    CRCValidationError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    RuntimeError,
    KeyError,
    IndexError,
    MemoryError,
    OverflowError,
    EOFError,
    OSError,
)


@dataclass(frozen=True, slots=True)
class _Chunk:
    """An entry of the chunk index: first and last log time, ns; offset and length, bytes."""

    start_ns: int
    end_ns: int
    offset: int
    length: int


class McapContainer:
    """An MCAP file. `checksums` says in words which parts have a CRC."""

    kind = "MCAP"

    def __init__(self, path: Path) -> None:
        self.path, self._source = path, path  # as errors name it, and what is read
        self.damage: list[Damage] = []
        self.topics: dict[str, Topic] = {}
        self.notes: list[str] = []
        self.profile = ""
        self._size = path.stat().st_size
        self._schemas: dict[int, mcap.records.Schema] = {}
        self._channels: dict[int, mcap.records.Channel] = {}
        self._chunks: list[_Chunk] | None = None
        self._unchunked = False
        self._zero_crcs = False
        self._checked: set[int] = set()  # offsets of chunks whose CRC was right
        try:
            counts = self._read_summary()
        except BROKEN as error:
            what = (
                f"the summary at the end can't be used ({describe(error)}), "
                "so the file is read from the front"
            )
            self.damage.append(Damage(what, self._place(offset=self._size)))
            self._schemas, self._channels, self._chunks, counts = {}, {}, None, {}
        if self._chunks is None:
            counts = self._scan_front(counts)
        for channel in self._channels.values():
            self._add_topic(channel, counts)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """By the chunk index; None without one."""
        if not self._chunks:
            return None
        return self._chunks[0].start_ns, max(chunk.end_ns for chunk in self._chunks)

    def _place(
        self, offset: int | None = None, topic: str | None = None, t_ns: int | None = None
    ) -> Place:
        return Place(str(self.path), topic, t_ns, offset)

    @property
    def checksums(self) -> str:
        if self._unchunked or self._zero_crcs:
            return "not everywhere: some messages stand outside chunks or in chunks without a CRC"
        return "CRC-32 per chunk, checked"

    def _read_summary(self) -> dict[int, int]:
        """Fill schemas, channels and chunk list from the summary; gives messages by channel id."""
        with self._source.open("rb") as stream:
            header = next(iter(StreamReader(stream, record_size_limit=self._size).records))
            if isinstance(header, mcap.records.Header):
                self.profile = header.profile
            stream.seek(-(FOOTER_LENGTH + len(MCAP_MAGIC)), 2)
            footer_start = stream.tell()
            tail = stream.read()
            if not tail.endswith(MCAP_MAGIC):
                raise mcap.exceptions.McapError(
                    "the file does not end with the MCAP magic: it is cut or still written"
                )
            if tail[0] != Opcode.FOOTER:
                raise mcap.exceptions.McapError("no footer record before the closing magic")
            summary_start, _, summary_crc = struct.unpack_from("<QQI", tail, 9)
            if summary_start == 0:
                return {}
            if not 0 < summary_start <= footer_start:
                raise mcap.exceptions.McapError(
                    f"summary offset {summary_start} lies outside the file"
                )
            stream.seek(summary_start)
            body = stream.read(footer_start - summary_start)
            if (
                summary_crc
                and zlib.crc32(tail[: FOOTER_LENGTH - 4], zlib.crc32(body)) != summary_crc
            ):
                raise mcap.exceptions.McapError("the summary's CRC does not match")
            stream.seek(summary_start)
            chunks: list[_Chunk] = []
            counts: dict[int, int] = {}
            total: int | None = None
            for record in StreamReader(
                stream, skip_magic=True, record_size_limit=self._size
            ).records:
                if isinstance(record, mcap.records.Schema):
                    self._schemas[record.id] = record
                elif isinstance(record, mcap.records.Channel):
                    self._channels[record.id] = record
                elif isinstance(record, mcap.records.ChunkIndex):
                    chunks.append(
                        _Chunk(
                            record.message_start_time,
                            record.message_end_time,
                            record.chunk_start_offset,
                            record.chunk_length,
                        )
                    )
                elif isinstance(record, mcap.records.Statistics):
                    counts = dict(record.channel_message_counts)
                    total = record.message_count
                    if record.chunk_count != len(chunks) and chunks:
                        raise mcap.exceptions.McapError(
                            "the statistics and the chunk index disagree"
                        )
        if total is not None and counts and sum(counts.values()) != total:
            raise mcap.exceptions.McapError("the statistics contradict themselves")
        if total is not None and not counts:
            counts = dict.fromkeys(self._channels, 0) if total == 0 else {}
        elif total is not None:
            counts = {i: counts.get(i, 0) for i in self._channels}
        if chunks and self._channels:
            self._chunks = sorted(chunks, key=lambda c: (c.start_ns, c.offset))
        return counts

    def _scan_front(self, counts: dict[int, int]) -> dict[int, int]:
        """Without a usable index: read the file once for its schemas and channels, and check it."""
        for _ in self._sequential(None):
            pass
        return counts

    def _add_topic(self, channel: mcap.records.Channel, counts: dict[int, int]) -> None:
        schema = self._schemas.get(channel.schema_id)
        stored = schema.name if schema else ""
        name = stored
        if "/" in name and "/msg/" not in name:
            name = name.replace("/", "/msg/", 1)
        key = (channel.message_encoding, schema.encoding if schema else "")
        # JSON says its fields itself, whatever its schema is written in
        make = decoders().get(json_text.ENCODES if key[0] == "json" else key)
        decode: Callable[[bytes], Any] | None = None
        why: str | None = None
        if make is None or schema is None:
            why = f"message encoding {key[0]!r} with schema encoding {key[1]!r} is not supported"
        else:
            try:
                decode = make(name, schema.data)
            except Exception as error:
                why = f"its definition can't be used ({describe(error)})"
        kind = foxglove.ros_type(name)
        if decode is not None:
            decode = foxglove.adapted(name, decode)
        if key == ("cdr", "") and decode is not None:
            self.notes.append(f"{channel.topic} has no definition: {name} is known by its name")
        count = counts.get(channel.id) if counts else None
        before = self.topics.get(channel.topic)
        if before is not None:
            # Some writers open one topic twice; both carry the same type, and the counts add up.
            count = None if count is None or before.count is None else count + before.count
        self.topics[channel.topic] = Topic(
            channel.topic,
            kind or "?",
            channel.message_encoding,
            count,
            decode or _refuse(why or "", self._place(topic=channel.topic)),
            stored,
            why,
        )

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        """Messages of the topics; by index where the summary is intact, else front to back."""
        if self._chunks is None:
            yield from self._sequential(topics)
        else:
            yield from self._indexed(topics, self._chunks)

    def _indexed(self, topics: frozenset[str], chunks: list[_Chunk]) -> Iterator[RawMessage]:
        pending: list[RawMessage] = []
        with self._source.open("rb") as stream:
            for i, chunk in enumerate(chunks):
                try:
                    new = self._read_chunk(stream, chunk.offset, topics)
                except BROKEN as error:
                    what = f"a chunk is damaged ({describe(error)})"
                    yield from sorted(
                        (m for m in pending if m.log_ns < chunk.start_ns), key=lambda m: m.log_ns
                    )
                    self._fault(Damage(what, self._place(chunk.offset), chunk.start_ns))
                    return
                pending = sorted(
                    [*pending, *new], key=lambda m: m.log_ns
                )  # stable: ties stay in file order
                if i + 1 < len(chunks):
                    limit = chunks[i + 1].start_ns
                    split = next(
                        (k for k, m in enumerate(pending) if m.log_ns >= limit), len(pending)
                    )
                    yield from pending[:split]
                    pending = pending[split:]
            yield from pending

    def _fault(self, damage: Damage) -> None:
        """Keep a fault once, with the time from which messages are lost where a pass tells it."""
        for i, known in enumerate(self.damage):
            if (known.what, known.place) == (damage.what, damage.place):
                self.damage[i] = damage if known.lost_from_ns is None else known
                return
        self.damage.append(damage)

    def _read_chunk(
        self, stream: IO[bytes], offset: int, topics: frozenset[str] | None
    ) -> list[RawMessage]:
        stream.seek(offset)
        opcode, length = struct.unpack("<BQ", stream.read(9))
        if opcode != Opcode.CHUNK or offset + 9 + length > self._size:
            raise mcap.exceptions.McapError(
                "the index points to something that is not a chunk inside the file"
            )
        return self._open_chunk(mcap.records.Chunk.read(ReadDataStream(stream)), offset, topics)

    def _open_chunk(
        self, chunk: mcap.records.Chunk, offset: int, topics: frozenset[str] | None
    ) -> list[RawMessage]:
        if chunk.uncompressed_size > MAX_CHUNK_BYTES:
            raise mcap.exceptions.McapError(
                f"a chunk claims {chunk.uncompressed_size} bytes, over dgeval's limit of 1 GiB"
            )
        if chunk.uncompressed_crc == 0:
            self._zero_crcs = True
        data = _expand(chunk)
        if chunk.uncompressed_crc != 0 and offset not in self._checked:
            found = zlib.crc32(data)
            if chunk.uncompressed_crc != found:
                raise CRCValidationError(chunk.uncompressed_crc, found, chunk)
            self._checked.add(offset)
        out: list[RawMessage] = []
        for kind, start, end in _records(data):
            if kind == Opcode.MESSAGE:
                if end - start < MESSAGE_HEAD.size:
                    raise mcap.exceptions.McapError("a message is shorter than its own head")
                channel, _, log_ns, _ = MESSAGE_HEAD.unpack_from(data, start)
                topic = self._channels[channel].topic
                if topics is not None and topic in topics:
                    payload = data[start + MESSAGE_HEAD.size : end]
                    out.append(RawMessage(topic, log_ns, payload, offset))
            elif kind in DEFINITIONS:
                body = ReadDataStream(BytesIO(data[start:end]))
                self._take(DEFINITIONS[kind].read(body), offset, topics)
        return out

    def _take(self, record: Any, offset: int, topics: frozenset[str] | None) -> RawMessage | None:
        if isinstance(record, mcap.records.Schema):
            self._agree(self._schemas.setdefault(record.id, record), record)
        elif isinstance(record, mcap.records.Channel):
            self._agree(self._channels.setdefault(record.id, record), record)
        elif isinstance(record, mcap.records.Message):
            topic = self._channels[record.channel_id].topic
            if topics is not None and topic in topics:
                return RawMessage(topic, record.log_time, record.data, offset)
        return None

    @staticmethod
    def _agree(known: Any, record: Any) -> None:
        """McapError where a schema or channel is defined twice and differently."""
        if known != record:
            raise mcap.exceptions.McapError(
                f"the summary and the data disagree on {type(record).__name__.lower()} {record.id}"
            )

    def _sequential(self, topics: frozenset[str] | None) -> Iterator[RawMessage]:
        """Messages front to back, up to the first fault, which is kept as damage.

        Messages are sorted by log time within a chunk, not across chunks.
        """
        last_ns: int | None = None
        offset = 0
        with self._source.open("rb") as stream:
            reader = StreamReader(
                stream, emit_chunks=True, validate_crcs=True, record_size_limit=self._size
            )
            try:
                for record in reader.records:
                    self._check_kinds(stream, offset or len(MCAP_MAGIC))
                    if isinstance(record, mcap.records.Chunk):
                        for message in sorted(
                            self._open_chunk(record, offset, topics), key=lambda m: m.log_ns
                        ):
                            last_ns = message.log_ns
                            yield message
                    elif isinstance(record, mcap.records.Header):
                        self.profile = record.profile
                    elif isinstance(record, mcap.records.DataEnd):
                        if self._unchunked and record.data_section_crc == 0:
                            self._zero_crcs = True
                        return
                    else:
                        message_or_none = self._take(record, offset, topics)
                        if isinstance(record, mcap.records.Message):
                            self._unchunked = True
                        if message_or_none is not None:
                            last_ns = message_or_none.log_ns
                            yield message_or_none
                    offset = stream.tell()
            except CRCValidationError as error:
                if isinstance(error.record, mcap.records.DataEnd):
                    self._refuse_unchunked()
                self._fault(
                    Damage(f"a chunk is damaged ({describe(error)})", self._place(offset), last_ns)
                )
            except BROKEN as error:
                what = f"the file breaks off or is damaged ({describe(error)})"
                self._fault(Damage(what, self._place(offset), last_ns))

    def _check_kinds(self, stream: IO[bytes], start: int) -> None:
        """McapError for a kind of record that can't stand in the data section.

        The mcap library skips kinds it doesn't know; a chunk with a damaged kind would be lost
        without a message.
        """
        end = stream.tell()
        stream.seek(start)
        kind = stream.read(1)[0]
        stream.seek(end)
        if kind not in DATA_KINDS:
            raise mcap.exceptions.McapError(f"a record of kind {kind} has no place in the data")

    def _refuse_unchunked(self) -> NoReturn:
        what = "the CRC over the data section does not match, and without chunks nothing says where"
        raise UnreadableError(what, self._place(), "record again or use `mcap recover`")


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Kind of each record in a chunk's bytes, and where its content starts and ends.

    The mcap library makes an object of every message, also of those that nobody asked for, which
    costs more than all else that is done with them.
    """
    at = 0
    while at < len(data):
        kind, length = RECORD_HEAD.unpack_from(data, at)
        start = at + RECORD_HEAD.size
        at = start + length
        if at > len(data):
            raise mcap.exceptions.McapError("a record reaches over the end of its chunk")
        yield kind, start, at


def _expand(chunk: mcap.records.Chunk) -> bytes:
    """A chunk's uncompressed bytes, never more than it claims, as damage expands to gigabytes."""
    size = chunk.uncompressed_size
    if chunk.compression == "":
        data = chunk.data
    elif chunk.compression == "zstd":
        stated = zstandard.frame_content_size(chunk.data)
        if stated not in (-1, size):
            raise mcap.exceptions.McapError(f"a chunk of {size} bytes holds a frame of {stated}")
        if stated == size:
            data = zstandard.ZstdDecompressor().decompress(chunk.data)
        else:
            with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
                data = reader.read(size + 1)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    else:
        raise mcap.exceptions.McapError(f"unknown compression {chunk.compression!r}")
    if len(data) != size:
        raise mcap.exceptions.McapError(
            f"a chunk claims {size} bytes and expands to {len(data)} or more"
        )
    return bytes(data)


def _refuse(why: str, place: Place) -> Callable[[bytes], Any]:
    def decode(_: bytes) -> Any:
        raise UndecodableError(f"can't decode: {why}", place)

    return decode
