"""Damaged recordings: synthetic files in every container, their mutations, a reader's oracle.

Catches a reading layer that gives wrong or fewer messages and doesn't report it, lets a foreign
exception out, hangs, or needs memory out of proportion to the file. Used by test_damage.py (a
small selection) and soak/damage_campaign.py (all of it).
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import pickle
import resource
import select
import shutil
import signal
import sqlite3
import struct
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import lz4.frame
import numpy as np
import zstandard
from dgeval.errors import DgevalError, UndecodableError
from dgeval.recording.containers.opening import open_container
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

cv2.setNumThreads(1)  # campaign cases run in forked children

WIDTH, HEIGHT, FRAMES = 64, 48, 12
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 33_000_000
COLOUR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
INFO, TF, TF_STATIC, JOINTS, EVENTS = (
    "/camera/color/camera_info",
    "/tf",
    "/tf_static",
    "/joint_states",
    "/dgeval/events",
)
BOX = "16,10,44,36"
URDF = """<robot name="hand"><link name="palm"><collision><geometry>\
<box size="0.02 0.02 0.02"/></geometry></collision></link>
<link name="finger"><collision><geometry><box size="0.01 0.01 0.03"/></geometry></collision></link>
<joint name="finger_joint" type="revolute"><parent link="palm"/><child link="finger"/>\
<origin xyz="0 0 0.03"/>
<axis xyz="1 0 0"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""


# --- synthetic recordings -------------------------------------------------------------------------


def _store(ros: int) -> Any:
    if ros == 2:
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(
        get_types_from_msg(
            "geometry_msgs/TransformStamped[] transforms\n", "tf2_msgs/msg/TFMessage"
        )
    )
    return store


STORES = {1: _store(1), 2: _store(2)}


@dataclass
class Entry:
    """One message to write: topic, type, log time ns, and value (an object of rosbags)."""

    topic: str
    type: str
    log_ns: int
    value: Any


def header(ros: int, t_ns: int, frame: str) -> Any:
    """std_msgs/Header of either ROS version."""
    types = STORES[ros].types
    stamp = types["builtin_interfaces/msg/Time"](sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    extra = {"seq": 0} if ros == 1 else {}
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **extra)


def raw_image(
    ros: int,
    t_ns: int,
    array: Any,
    encoding: str,
    step: int | None = None,
    big_endian: bool = False,
) -> Any:
    """sensor_msgs/Image; `step` larger than a row adds padding."""
    array = np.ascontiguousarray(
        array if not big_endian else array.astype(array.dtype.newbyteorder(">"))
    )
    rows = array.view(np.uint8).reshape(array.shape[0], -1)
    step = step or rows.shape[1]
    padded = np.full((rows.shape[0], step), 0xAB, np.uint8)
    padded[:, : rows.shape[1]] = rows
    return STORES[ros].types["sensor_msgs/msg/Image"](
        header=header(ros, t_ns, "camera"),
        height=array.shape[0],
        width=array.shape[1],
        encoding=encoding,
        is_bigendian=int(big_endian),
        step=step,
        data=padded.ravel(),
    )


def compressed_image(ros: int, t_ns: int, data: bytes, format_: str) -> Any:
    return STORES[ros].types["sensor_msgs/msg/CompressedImage"](
        header=header(ros, t_ns, "camera"), format=format_, data=np.frombuffer(data, np.uint8)
    )


def encoded(suffix: str, array: Any) -> bytes:
    """An image as the bytes of a file."""
    return bytes(cv2.imencode(suffix, array)[1].tobytes())


def camera_info(
    ros: int,
    t_ns: int,
    width: int = WIDTH,
    height: int = HEIGHT,
    fx: float = 60.0,
    fy: float = 60.0,
) -> Any:
    k = np.array([fx, 0, width / 2, 0, fy, height / 2, 0, 0, 1.0])
    p = np.array([fx, 0, width / 2, 0, 0, fy, height / 2, 0, 0, 0, 1.0, 0])
    r = np.eye(3).ravel()
    names = ("d", "k", "r", "p") if ros == 2 else ("D", "K", "R", "P")
    types = STORES[ros].types
    roi = types["sensor_msgs/msg/RegionOfInterest"](
        x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    return types["sensor_msgs/msg/CameraInfo"](
        header=header(ros, t_ns, "camera"),
        height=height,
        width=width,
        distortion_model="plumb_bob",
        binning_x=0,
        binning_y=0,
        roi=roi,
        **dict(zip(names, (np.zeros(5), k, r, p), strict=True)),
    )


def transform(
    ros: int,
    t_ns: int,
    parent: str,
    child: str,
    translation: tuple[float, ...],
    rotation: tuple[float, ...] = (0, 0, 0, 1),
) -> Any:
    types = STORES[ros].types
    return types["geometry_msgs/msg/TransformStamped"](
        header=header(ros, t_ns, parent),
        child_frame_id=child,
        transform=types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](
                x=translation[0], y=translation[1], z=translation[2]
            ),
            rotation=types["geometry_msgs/msg/Quaternion"](
                x=rotation[0], y=rotation[1], z=rotation[2], w=rotation[3]
            ),
        ),
    )


def tf_message(ros: int, transforms: list[Any]) -> Any:
    return STORES[ros].types["tf2_msgs/msg/TFMessage"](transforms=transforms)


def joint_state(ros: int, t_ns: int, position: float) -> Any:
    return STORES[ros].types["sensor_msgs/msg/JointState"](
        header=header(ros, t_ns, ""),
        name=["finger_joint"],
        position=np.array([position]),
        velocity=np.zeros(0),
        effort=np.zeros(0),
    )


def text(ros: int, value: str) -> Any:
    return STORES[ros].types["std_msgs/msg/String"](data=value)


def scene(i: int) -> tuple[Any, Any]:
    """Colour (H, W, 3) BGR and depth (H, W) mm of frame i: a box moves right before a plane."""
    rng = np.random.default_rng(7)
    colour = rng.integers(60, 120, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    depth = np.full((HEIGHT, WIDTH), 800, np.uint16)
    x = 20 + i // 3
    colour[14:32, x : x + 20] = rng.integers(0, 255, (18, 20, 3), dtype=np.uint8)
    depth[14:32, x : x + 20] = 740 + (np.arange(18, dtype=np.uint16) // 3)[:, None]
    depth += np.random.default_rng([7, i]).integers(0, 4, depth.shape).astype(np.uint16)
    return cv2.GaussianBlur(colour, (3, 3), 0.8), depth


def recording(
    ros: int, colour: str = "jpeg", depth: str = "raw", frames: int = FRAMES
) -> list[Entry]:
    """A trial of `frames` images with all other topics, in the order of log times.

    colour: jpeg or raw. depth: raw or png.
    """
    mount = transform(ros, START_NS, "flange", "camera", (0, 0, 0.05))
    out = [
        Entry("/robot_description", "std_msgs/msg/String", START_NS - 4, text(ros, URDF)),
        Entry(TF_STATIC, "tf2_msgs/msg/TFMessage", START_NS - 3, tf_message(ros, [mount])),
        Entry(EVENTS, "std_msgs/msg/String", START_NS - 2, text(ros, '{"event": "trial_start"}')),
    ]  # fmt: skip
    for i in range(frames):
        t = START_NS + i * PERIOD_NS
        image, millimetres = scene(i)
        pose = [
            transform(ros, t, "base_link", "flange", (0.3 + 0.001 * i, 0, 0.8), (1, 0, 0, 0)),
            transform(ros, t, "flange", "palm", (0.1, 0.0, 0.1)),
        ]
        out.append(Entry(TF, "tf2_msgs/msg/TFMessage", t + 1_000, tf_message(ros, pose)))
        out.append(
            Entry(JOINTS, "sensor_msgs/msg/JointState", t + 2_000, joint_state(ros, t, 0.01 * i))
        )
        out.append(Entry(INFO, "sensor_msgs/msg/CameraInfo", t + 5_000_000, camera_info(ros, t)))
        if colour == "jpeg":
            message = compressed_image(ros, t, encoded(".jpg", image), "jpeg")
            out.append(
                Entry(
                    COLOUR + "/compressed",
                    "sensor_msgs/msg/CompressedImage",
                    t + 6_000_000,
                    message,
                )
            )
        else:
            out.append(
                Entry(
                    COLOUR, "sensor_msgs/msg/Image", t + 6_000_000, raw_image(ros, t, image, "bgr8")
                )
            )
        if depth == "png":
            data = struct.pack("<iff", 0, 0.0, 0.0) + encoded(".png", millimetres)
            message = compressed_image(ros, t, data, "16UC1; compressedDepth png")
            out.append(
                Entry(
                    DEPTH + "/compressedDepth",
                    "sensor_msgs/msg/CompressedImage",
                    t + 7_000_000,
                    message,
                )
            )
        else:
            out.append(
                Entry(
                    DEPTH,
                    "sensor_msgs/msg/Image",
                    t + 7_000_000,
                    raw_image(ros, t, millimetres, "16UC1"),
                )
            )
        if i == frames - 3:
            out.append(
                Entry(
                    EVENTS,
                    "std_msgs/msg/String",
                    t + 8_000_000,
                    text(ros, f'{{"event": "close", "t_ns": {t}}}'),
                )
            )
    return out


def write_mcap(
    path: Path,
    entries: list[Entry],
    ros: int = 2,
    compression: str = "zstd",
    chunked: bool = True,
    summary: bool = True,
    crcs: bool = True,
    data_crc: bool = False,
) -> Path:
    """An MCAP with several chunks; CRCs as asked for."""
    kind = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "": CompressionType.NONE}[
        compression
    ]
    with path.open("wb") as stream:
        writer = McapWriter(
            stream,
            chunk_size=24_000,
            compression=kind,
            use_chunking=chunked,
            index_types=IndexType.ALL if summary else IndexType.NONE,
            repeat_channels=summary,
            repeat_schemas=summary,
            use_statistics=summary,
            use_summary_offsets=summary,
            enable_crcs=crcs,
            enable_data_crcs=data_crc,
        )
        writer.start("ros2" if ros == 2 else "ros1")
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        store = STORES[ros]
        for entry in entries:
            if entry.type not in schemas:
                definition = store.generate_msgdef(entry.type, ros_version=ros)[0]
                name = entry.type if ros == 2 else entry.type.replace("/msg/", "/")
                schemas[entry.type] = writer.register_schema(
                    name, f"ros{ros}msg", definition.encode()
                )
            if entry.topic not in channels:
                channels[entry.topic] = writer.register_channel(
                    entry.topic, "cdr" if ros == 2 else "ros1", schemas[entry.type]
                )
            writer.add_message(
                channels[entry.topic], entry.log_ns, serialise(entry, ros), entry.log_ns
            )
        writer.finish()
    return path


def serialise(entry: Entry, ros: int) -> bytes:
    store = STORES[ros]
    return bytes(
        (store.serialize_cdr if ros == 2 else store.serialize_ros1)(entry.value, entry.type)
    )


def write_bag(path: Path, entries: list[Entry], compression: str = "") -> Path:
    """A ROS 1 bag with several chunks; compression "", bz2, lz4."""
    path.unlink(missing_ok=True)
    writer = BagWriter(path)
    if compression:
        writer.set_compression(BagWriter.CompressionFormat[compression.upper()])
    writer.chunk_threshold = 40_000
    with writer:
        connections: dict[str, Any] = {}
        for entry in entries:
            if entry.topic not in connections:
                connections[entry.topic] = writer.add_connection(
                    entry.topic, entry.type, typestore=STORES[1]
                )
            writer.write(connections[entry.topic], entry.log_ns, serialise(entry, 1))
    return path


def write_folder(path: Path, entries: list[Entry]) -> Path:
    """A ROS 2 SQLite folder: <path>/<name>.db3 and metadata.yaml."""
    shutil.rmtree(path, ignore_errors=True)
    with FolderWriter(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections: dict[str, Any] = {}
        for entry in entries:
            if entry.topic not in connections:
                connections[entry.topic] = writer.add_connection(
                    entry.topic, entry.type, typestore=STORES[2]
                )
            writer.write(connections[entry.topic], entry.log_ns, serialise(entry, 2))
    return path


def shuffled(entries: list[Entry]) -> list[Entry]:
    """The messages in the order of a recorder that gets some topics up to six periods late.

    Then chunks overlap in time.
    """
    delay_periods = {COLOUR + "/compressed": 6, COLOUR: 6, JOINTS: 3}
    return sorted(entries, key=lambda e: e.log_ns + delay_periods.get(e.topic, 0) * PERIOD_NS)


@dataclass(frozen=True)
class Kind:
    """One container variant: how it is written and what protects its bytes."""

    name: str
    suffix: str
    write: Callable[[Path], Path]
    checked: str  # chunk: each chunk under a checksum; file: one over the file; none
    layout: str


KINDS = (
    Kind("mcap zstd", ".mcap", lambda p: write_mcap(p, recording(2)), "chunk", "mcap"),
    Kind(
        "mcap lz4",
        ".mcap",
        lambda p: write_mcap(p, recording(2, "raw", "png"), compression="lz4"),
        "chunk",
        "mcap",
    ),
    Kind(
        "mcap none", ".mcap", lambda p: write_mcap(p, recording(2), compression=""), "chunk", "mcap"
    ),
    Kind("mcap ros1 zstd", ".mcap", lambda p: write_mcap(p, recording(1), 1), "chunk", "mcap"),
    Kind("mcap overlap", ".mcap", lambda p: write_mcap(p, shuffled(recording(2))), "chunk", "mcap"),
    Kind(
        "mcap overlap no summary",
        ".mcap",
        lambda p: write_mcap(p, shuffled(recording(2)), summary=False),
        "chunk",
        "mcap",
    ),
    Kind(
        "mcap no summary",
        ".mcap",
        lambda p: write_mcap(p, recording(2), summary=False),
        "chunk",
        "mcap",
    ),
    Kind(
        "mcap no summary, data CRC",
        ".mcap",
        lambda p: write_mcap(p, recording(2), summary=False, data_crc=True),
        "chunk",
        "mcap",
    ),
    Kind(
        "mcap unchunked, data CRC",
        ".mcap",
        lambda p: write_mcap(p, recording(2), chunked=False, data_crc=True),
        "file",
        "mcap",
    ),
    Kind(
        "mcap unchunked",
        ".mcap",
        lambda p: write_mcap(p, recording(2), chunked=False),
        "none",
        "mcap",
    ),
    Kind(
        "mcap no CRC",
        ".mcap",
        lambda p: write_mcap(p, recording(2), compression="", crcs=False),
        "none",
        "mcap",
    ),
    Kind("bag none", ".bag", lambda p: write_bag(p, recording(1, "raw")), "none", "bag"),
    Kind(
        "bag bz2", ".bag", lambda p: write_bag(p, recording(1, "raw", "png"), "bz2"), "none", "bag"
    ),
    Kind("bag lz4", ".bag", lambda p: write_bag(p, recording(1), "lz4"), "none", "bag"),
    Kind("db3 folder", "", lambda p: write_folder(p, recording(2)), "none", "db3"),
    Kind("db3 bare", ".db3", lambda p: _bare(p), "none", "db3"),
)


def _bare(path: Path) -> Path:
    with tempfile.TemporaryDirectory() as scratch:
        folder = write_folder(Path(scratch) / "x", recording(2))
        shutil.copyfile(folder / "x.db3", path)
    return path


# --- what the undamaged file holds ----------------------------------------------------------------

MessageKey = tuple[str, int, bytes]  # topic, log time ns, digest of the bytes


def message_keys(messages: Iterable[Any]) -> list[MessageKey]:
    """The keys of messages, in their order."""
    return [(m.topic, m.log_ns, hashlib.blake2b(m.data, digest_size=12).digest()) for m in messages]


@dataclass(frozen=True)
class Good:
    """An undamaged recording: the file whose bytes are mutated, and its messages."""

    kind: Kind
    path: Path
    file: Path
    data: bytes
    messages: list[MessageKey]


def make_good(kind: Kind, folder: Path) -> Good:
    """Write the recording and read it once; all messages must be there, without damage."""
    path = kind.write(folder / ("good" + kind.suffix))
    file = path if path.is_file() else path / f"{path.name}.db3"
    opened = open_container(path)
    messages = message_keys(opened.messages())
    assert not opened.damage, opened.damage
    assert len(messages) == 3 + 5 * FRAMES + 1
    return Good(kind, path, file, file.read_bytes(), messages)


# --- the parts of a file --------------------------------------------------------------------------

Region = tuple[str, int, int]
MCAP_NAMES = {
    1: "header",
    2: "footer",
    3: "definition",
    4: "definition",
    5: "message",
    7: "message index",
    8: "chunk index",
    11: "statistics",
    14: "summary offset",
    15: "data end",
}
BAG_NAMES = {3: "bag header", 4: "index", 5: "chunk", 6: "chunk info", 7: "connection"}


def regions(data: bytes, layout: str) -> list[Region]:
    """Name, start and end of every part of an undamaged file."""
    return {"mcap": _mcap_regions, "bag": _bag_regions, "db3": _db3_regions}[layout](data)


def _mcap_regions(data: bytes) -> list[Region]:
    out: list[Region] = [("magic", 0, 8)]
    at = 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        end = at + 9 + length
        if opcode == 6:
            payload = (
                end
                - struct.unpack_from("<Q", data, at + 9 + 8 + 8 + 8 + 4 + 4 + _u32(data, at + 37))[
                    0
                ]
            )
            out += [("chunk header", at, payload), ("chunk payload", payload, end)]
        else:
            out.append((MCAP_NAMES[opcode], at, end))
        at = end
    return [*out, ("closing magic", at, at + 8)]


def _u32(data: bytes, at: int) -> int:
    return int(struct.unpack_from("<I", data, at)[0])


def _bag_regions(data: bytes) -> list[Region]:
    out: list[Region] = [("magic", 0, 13)]
    at = 13
    while at < len(data):
        head_end = at + 4 + _u32(data, at)
        end = head_end + 4 + _u32(data, head_end)
        op = data[data.index(b"op=", at) + 3]
        if op == 5:
            out += [("chunk header", at, head_end + 4), ("chunk payload", head_end + 4, end)]
        else:
            out.append((BAG_NAMES[op], at, end))
        at = end
    return out


def _db3_regions(data: bytes) -> list[Region]:
    out: list[Region] = [("database header", 0, 100), ("schema page", 100, 4096)]
    names = {2: "index page", 5: "inner page", 10: "index page", 13: "table page"}
    return out + [
        (names.get(data[at], "overflow page"), at, at + 4096) for at in range(4096, len(data), 4096)
    ]


# --- mutations ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """One damaged input.

    mutation: row of the table in which it is counted. detail: what was done. data: new bytes of the
    file; None: unchanged. place: another file name. metadata: new bytes of metadata.yaml; None:
    unchanged, "missing": the file is removed.
    """

    mutation: str
    detail: str
    data: bytes | None = None
    place: str | None = None
    metadata: bytes | str | None = None


def flip(data: bytes, bits: Iterable[int]) -> bytes:
    out = bytearray(data)
    for bit in bits:
        out[bit // 8] ^= 1 << (bit % 8)
    return bytes(out)


def flip_cases(good: Good, seeds: Iterable[int]) -> Iterator[Case]:
    """One flipped bit per seed, in each named region in turn, so that small ones are hit too."""
    named: dict[str, list[Region]] = {}
    for region in regions(good.data, good.kind.layout):
        named.setdefault(region[0], []).append(region)
    names = sorted(named)
    for seed in seeds:
        rng = np.random.default_rng([1, seed])
        name = names[seed % len(names)]
        _, start, end = named[name][int(rng.integers(len(named[name])))]
        if name == "bag header":
            end = min(end, start + 80)  # the rest is padding
        bit = int(rng.integers(start * 8, end * 8))
        yield Case(
            f"1 flip, {name}", f"seed {seed}: byte {bit // 8} bit {bit % 8}", flip(good.data, [bit])
        )


def cases(good: Good, seeds: int, boundaries: int = 24) -> Iterator[Case]:
    """Every mutation of one recording.

    seeds: number of single flips. Other random mutations are a tenth as many, at least 3.
    """
    data, layout = good.data, good.kind.layout
    size = len(data)
    yield Case("empty", "0 bytes", b"")
    for share in (1, 10, 50, 90, 99.5):
        yield Case("cut", f"at {share} %", data[: int(size * share / 100)])
    for last in (1, 8, 9, 40, 100, 4096):
        yield Case("cut", f"last {last} bytes", data[:-last])
    edges = sorted({edge for _, start, end in regions(data, layout) for edge in (start, end)})
    for edge in edges[:: max(1, len(edges) // boundaries)]:
        for at in (edge - 1, edge, edge + 1):
            if 0 < at < size:
                yield Case("cut at boundary", f"at byte {at}", data[:at])
    yield from flip_cases(good, range(seeds))
    for seed in range(max(3, seeds // 10)):
        rng = np.random.default_rng([2, seed])
        yield Case(
            "20 flips", f"seed {seed}", flip(data, [int(b) for b in rng.integers(0, size * 8, 20)])
        )
        hole = bytearray(data)
        at = int(rng.integers(0, size - 4096))
        hole[at : at + 4096] = bytes(4096)
        yield Case("4 KiB hole", f"seed {seed}: at byte {at}", bytes(hole))
        pages = size // 4096
        a, b = (int(p) for p in rng.choice(pages, 2, replace=False))
        page = data[a * 4096 : (a + 1) * 4096]
        yield Case(
            "page over another",
            f"page {a} over page {b}",
            data[: b * 4096] + page + data[(b + 1) * 4096 :],
        )
        yield Case(
            "page put in twice", f"page {a}", data[: (a + 1) * 4096] + page + data[(a + 1) * 4096 :]
        )
        yield Case("page left out", f"page {a}", data[: a * 4096] + data[(a + 1) * 4096 :])
        junk = rng.integers(0, 256, int(rng.integers(1, 9000)), dtype=np.uint8).tobytes()
        yield Case("junk appended", f"seed {seed}: {len(junk)} bytes", data + junk)
        yield Case("junk in front", f"seed {seed}: {len(junk)} bytes", junk + data)
    yield Case("file twice", "appended to itself", data + data)
    yield from _length_cases(data, layout)
    yield from _field_cases(good)
    yield Case(
        "LFS pointer",
        "",
        b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 123456\n",
    )
    yield Case("web page", "", b"\n<!DOCTYPE html><html><body>404 Not Found</body></html>\n")
    for suffix in (".mcap", ".bag", ".db3", ".dat", ""):
        if suffix != good.kind.suffix and good.path.is_file():
            yield Case("wrong suffix", repr(suffix), place="other" + suffix)
    yield Case(
        "path", "spaces, UTF-8", place=f"Prüfstand Läufe/Lauf 1 – größe 試験{good.kind.suffix}"
    )
    yield Case("path", "newline, quotes", place=f"a\n'b\"{good.kind.suffix}")
    if not good.path.is_file():
        meta = (good.path / "metadata.yaml").read_bytes()
        yield Case("metadata", "missing", metadata="missing")
        yield Case("metadata", "empty", metadata=b"")
        yield Case("metadata", "binary", metadata=bytes(range(256)) * 4)
        yield Case("metadata", "a list", metadata=b"- 1\n- 2\n")
        yield Case(
            "metadata", "version 99", metadata=meta.replace(b"version: 9", b"version: 99", 1)
        )
        yield Case("metadata", "half", metadata=meta[: len(meta) // 2])
        yield Case("metadata", "other file named", metadata=meta.replace(b".db3", b".db4"))
        yield Case(
            "metadata",
            "count lies",
            metadata=meta.replace(b"message_count: 12", b"message_count: 13"),
        )


def _length_cases(data: bytes, layout: str) -> Iterator[Case]:
    """Wrong record lengths."""
    parts = regions(data, layout)
    if layout == "mcap":
        records = [r for r in parts if r[0] not in ("magic", "closing magic", "chunk payload")]
        for name, start, _ in (
            records[0],
            records[1],
            records[len(records) // 2],
            records[-2],
            records[-1],
        ):
            for length in (0, 1, 3 << 30, 1 << 40, (1 << 64) - 1):
                changed = data[: start + 1] + struct.pack("<Q", length) + data[start + 9 :]
                yield Case("record length", f"{name} at byte {start}: {length}", changed)
    elif layout == "bag":
        for name, start, end in parts[1:4] + parts[-3:]:
            if name == "chunk payload":
                continue
            for offset in (
                start,
                end - 4 if name == "chunk header" else start + 4 + _u32(data, start),
            ):
                for length in (0, 1, (1 << 31) - 1, (1 << 32) - 1):
                    changed = data[:offset] + struct.pack("<I", length) + data[offset + 4 :]
                    yield Case("record length", f"{name} at byte {offset}: {length}", changed)
    else:
        for offset, length in ((28, 1 << 31), (28, 0), (28, 2), (16, 0x0200), (16, 1), (16, 0)):
            value = struct.pack(">H" if offset == 16 else ">I", length)
            yield Case(
                "record length",
                f"header byte {offset}: {length}",
                data[:offset] + value + data[offset + len(value) :],
            )


def _field_cases(good: Good) -> Iterator[Case]:
    """Changes of single fields that random flips hit too seldom: messages vanish or move."""
    data, layout = good.data, good.kind.layout
    parts = regions(data, layout)
    if layout == "mcap":
        starts = [s for n, s, _ in parts if n in ("chunk header", "message", "data end")]
        for start in starts[:: max(1, len(starts) // 6)] + starts[-1:]:
            for bit in range(8):
                yield Case(
                    "record opcode flip", f"byte {start} bit {bit}", flip(data, [start * 8 + bit])
                )
    elif layout == "bag":
        for name in (b"chunk_count=", b"conn_count="):
            at = data.index(name) + len(name)
            count = _u32(data, at)
            for value in (0, 1, count - 1, count + 1, count | 1 << 30):
                yield Case(
                    "count field",
                    f"{name.decode()}{value}",
                    data[:at] + struct.pack("<I", value) + data[at + 4 :],
                )
        for name, start, end in parts:
            if name == "chunk info":
                at = data.index(b"count=", start, end) + 6
                value = _u32(data, at)
                yield Case(
                    "count field",
                    f"chunk info at byte {start}",
                    data[:at] + struct.pack("<I", value - 1) + data[at + 4 :],
                )
                at = data.index(b"chunk_pos=", start, end) + 10
                other = parts[[w[0] for w in parts].index("chunk header")][1]
                yield Case(
                    "count field",
                    f"chunk_pos at byte {at}",
                    data[:at] + struct.pack("<Q", other) + data[at + 8 :],
                )
    else:
        for sql in (
            "UPDATE messages SET topic_id = 77 WHERE id = 30",
            "UPDATE messages SET topic_id = topic_id + 1 WHERE id = 30",
            "DELETE FROM messages WHERE id > 40",
            "DELETE FROM topics WHERE id = 3",
            "UPDATE messages SET timestamp = 'x' WHERE id = 30",
            "UPDATE messages SET data = NULL WHERE id = 30",
            "UPDATE messages SET data = 'text' WHERE id = 30",
            "UPDATE messages SET data = 7 WHERE id = 30",
            "UPDATE messages SET data = 1000000000000 WHERE id = 30",
            "UPDATE messages SET timestamp = -timestamp WHERE id = 30",
            "UPDATE messages SET timestamp = 1e300 WHERE id = 30",
            "UPDATE topics SET type = 'x/y' WHERE id = 4",
            "UPDATE topics SET name = 7 WHERE id = 4",
            "UPDATE message_definitions SET encoded_message_definition = 'rubbish{' WHERE id = 4",
            "UPDATE schema SET schema_version = 99",
            "DROP TABLE topics",
            "DROP TABLE messages",
        ):
            yield Case("SQL", sql, _with_sql(data, sql))
        stamp = struct.pack(">q", good.messages[30][1])
        at = -1
        while (at := data.find(stamp, at + 1)) >= 0:
            yield Case("count field", f"timestamp at byte {at}", flip(data, [at * 8 + 8 * 4]))


def _with_sql(data: bytes, sql: str) -> bytes:
    """The database after one SQL statement with all constraints removed, as after changed bytes."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "x.db3"
        path.write_bytes(data)
        connection = sqlite3.connect(path)
        try:
            connection.execute("PRAGMA writable_schema = ON")
            connection.execute(
                "UPDATE sqlite_master SET sql = replace(sql, ' NOT NULL', '') WHERE type = 'table'"
            )
            connection.commit()
        finally:
            connection.close()
        connection = sqlite3.connect(path)
        try:
            connection.execute(sql)
            connection.commit()
        finally:
            connection.close()
        return path.read_bytes()


def bomb(compression: str, size: int) -> bytes:
    """An MCAP whose one chunk claims 1000 bytes and expands to `size` zero bytes."""
    if compression == "zstd":
        compressor = zstandard.ZstdCompressor().compressobj(size=size)
        block = bytes(1 << 24)
        parts = [compressor.compress(block) for _ in range(size >> 24)]
        packed = b"".join(parts) + compressor.flush()
    else:
        with tempfile.TemporaryFile() as stream:
            with lz4.frame.open(stream, "wb") as out:
                for _ in range(size >> 24):
                    out.write(bytes(1 << 24))
            stream.seek(0)
            packed = stream.read()
    name = compression.encode()
    chunk = (
        struct.pack("<QQQII", 0, 1, 1000, 1, len(name))
        + name
        + struct.pack("<Q", len(packed))
        + packed
    )
    out_ = (
        b"\x89MCAP0\r\n"
        + struct.pack("<BQII", 1, 8, 0, 0)
        + struct.pack("<BQ", 6, len(chunk))
        + chunk
    )
    return (
        out_
        + struct.pack("<BQI", 15, 4, 0)
        + struct.pack("<BQQQI", 2, 20, 0, 0, 0)
        + b"\x89MCAP0\r\n"
    )


def place_case(good: Good, case: Case, folder: Path) -> Path:
    """Write a case below an empty folder; returns the path to open."""
    data = good.data if case.data is None else case.data
    if good.path.is_file():
        path = folder / (case.place or "case" + good.kind.suffix)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        return path
    path = folder / (case.place or "case")
    path.mkdir(parents=True)
    (path / good.file.name).write_bytes(data)
    if case.metadata != "missing":
        meta = (
            case.metadata
            if isinstance(case.metadata, bytes)
            else (good.path / "metadata.yaml").read_bytes()
        )
        (path / "metadata.yaml").write_bytes(meta)
    return path


# --- the oracle of a reader -----------------------------------------------------------------------

COMPLETE, COMPLETE_REPORTED, PREFIX, ERROR = (
    "complete",
    "complete, damage said",
    "prefix, damage said",
    "typed error",
)
OTHER_ORDER = "right by topic, other order, damage said"
SILENT, SILENT_META, CHANGED_REPORTED = (
    "silent payload change",
    "silent topic/time change",
    "changed, damage said",
)
VIOLATION = "VIOLATION"
STDOUT_ONLY = "exit 3, file on stdout only"
OUTCOMES = (
    COMPLETE,
    COMPLETE_REPORTED,
    PREFIX,
    OTHER_ORDER,
    ERROR,
    SILENT,
    SILENT_META,
    CHANGED_REPORTED,
    VIOLATION,
)


@dataclass
class Outcome:
    """Result of one case. n: messages read; peak_mb: resident memory of the child process."""

    kind: str
    detail: str = ""
    n: int = 0
    seconds: float = 0.0
    peak_mb: float = 0.0
    lines: list[str] = field(default_factory=list)


def read_outcome(path: Path, truth: list[MessageKey], checked: str) -> Outcome:
    """Read and decode all messages and judge the reader.

    Right is an exact prefix of `truth` with the damage reported, or an error that names the file.
    checked: what protects the bytes, see Kind.
    """
    keys: list[MessageKey] = []
    reported: list[str] = []
    error: DgevalError | None = None
    checksums = ""
    try:
        opened = open_container(path)
        try:
            for message in opened.messages():
                if (
                    type(message.log_ns) is not int
                    or not 0 <= message.log_ns < 1 << 63
                    or type(message.data) is not bytes
                ):
                    return Outcome(
                        VIOLATION,
                        f"not a message: log time {message.log_ns!r}, {type(message.data)}",
                        len(keys),
                    )
                keys += message_keys([message])
                try:
                    opened.decode(message)
                except UndecodableError as fault:
                    if path.name not in str(fault):
                        return Outcome(
                            VIOLATION,
                            f"UndecodableError does not name the file: {fault}",
                            len(keys),
                        )
        finally:
            reported = [str(d) for d in opened.damage]
            checksums = opened.container.checksums
    except DgevalError as fault:
        error = fault
    except BaseException as fault:
        frame = traceback.extract_tb(fault.__traceback__)[-1]
        at = f"{Path(frame.filename).name}:{frame.lineno}"
        return Outcome(
            VIOLATION,
            f"foreign exception {type(fault).__name__}: {str(fault)[:200]} ({at})",
            len(keys),
        )
    n = len(keys)
    exact = keys == truth[:n]
    text = str(error) if error is not None else "; ".join(reported)
    for line in reported if error is None else [str(error)]:
        if path.name not in line:
            return Outcome(VIOLATION, f"the file is not named: {line}", n)
    if error is not None:
        return (
            Outcome(ERROR, text, n)
            if exact
            else Outcome(VIOLATION, f"wrong messages, then {text}", n)
        )
    if exact:
        if n == len(truth):
            return Outcome(COMPLETE_REPORTED if reported else COMPLETE, text, n)
        if reported:
            return Outcome(PREFIX, text, n)
        return Outcome(VIOLATION, f"{len(truth) - n} of {len(truth)} messages lost in silence", n)
    first = next(
        (i for i, (a, b) in enumerate(zip(keys, truth, strict=False)) if a != b), len(truth)
    )
    claim = "CRC-32 per chunk, checked"
    if reported and _in_order_by_topic(keys, truth):
        return Outcome(OTHER_ORDER, text, n)
    if checked == "chunk" or checksums == claim or (checked == "file" and not reported):
        how_reported = f"damage said: {text}" if reported else "in silence"
        return Outcome(
            VIOLATION, f"message {first} of {n} (true {len(truth)}) is wrong, {how_reported}", n
        )
    if reported:
        return Outcome(CHANGED_REPORTED, text, n)
    if n != len(truth):
        return Outcome(
            VIOLATION,
            f"{n} messages instead of {len(truth)} in silence, the first wrong one is {first}",
            n,
        )
    same_places = [g[:2] for g in keys] == [t[:2] for t in truth]
    return Outcome(SILENT if same_places else SILENT_META, f"first wrong message {first}", n)


def parse_definitions_once() -> None:
    """Cache parsed message definitions over cases; parsing them takes 90 % of a case's time."""
    from functools import cache

    import rosbags.highlevel.anyreader as anyreader
    from dgeval.recording.encodings import decoders

    known = decoders()
    for key, make in list(known.items()):
        known[key] = cache(make)
    anyreader.get_types_from_msg = cache(anyreader.get_types_from_msg)


def _in_order_by_topic(keys: list[MessageKey], truth: list[MessageKey]) -> bool:
    """Each topic on its own is an exact prefix; only the order between topics differs."""
    for topic in {m[0] for m in keys}:
        of_topic = [m for m in keys if m[0] == topic]
        if of_topic != [m for m in truth if m[0] == topic][: len(of_topic)]:
            return False
    return True


# --- children with a limit on time and memory -----------------------------------------------------


def in_children(functions: list[Callable[[], Outcome]], seconds: float = 20.0) -> list[Outcome]:
    """Run all cases in one child process, because a fork takes ten times as long as a case.

    Each case runs in its own child where the common child failed.
    """
    results: list[Outcome] = []

    def together() -> Outcome:
        return Outcome("together", lines=[pickle.dumps([f() for f in functions]).hex()])

    batch = in_child(together, seconds)
    if batch.kind == "together" and batch.peak_mb < 700:
        results = pickle.loads(bytes.fromhex(batch.lines[0]))
        for result in results:
            result.seconds, result.peak_mb = batch.seconds / len(results), batch.peak_mb
        return results
    return [in_child(f, seconds) for f in functions]


def in_child(
    function: Callable[[], Outcome], seconds: float = 20.0, extra_mb: int = 1024
) -> Outcome:
    """Run in a forked child with limits.

    seconds: of wall time. extra_mb: address space in MB more than this process has.
    """
    started = time.perf_counter()
    read_end, write_end = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(read_end)
        try:
            used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
            resource.setrlimit(resource.RLIMIT_AS, (used + (extra_mb << 20),) * 2)
            result = function()
        except BaseException as error:
            result = Outcome(VIOLATION, f"the harness failed: {error!r}")
        with os.fdopen(write_end, "wb") as stream:
            stream.write(pickle.dumps(result))
        os._exit(0)
    os.close(write_end)
    parts: list[bytes] = []
    timed_out = False
    while True:
        left_s = seconds - (time.perf_counter() - started)
        if left_s <= 0 or not select.select([read_end], [], [], left_s)[0]:
            timed_out = True
            os.kill(pid, signal.SIGKILL)
            break
        block = os.read(read_end, 1 << 16)
        if not block:
            break
        parts.append(block)
    os.close(read_end)
    _, status, usage = os.wait4(pid, 0)
    if timed_out:
        result = Outcome(VIOLATION, f"not done after {seconds} s")
    elif not parts:
        result = Outcome(VIOLATION, f"the process died (status {status})")
    else:
        result = pickle.loads(b"".join(parts))
    result.seconds = time.perf_counter() - started
    result.peak_mb = usage.ru_maxrss / 1024
    return result


def run_cli(arguments: list[str]) -> tuple[int, str, str]:
    """Run dgeval's command line in this (forked) process.

    Returns exit code, standard output and standard error, as `python -m dgeval` would give them.
    """
    from dgeval.cli import app

    with tempfile.TemporaryDirectory() as scratch:
        files = [(Path(scratch) / n).open("a", encoding="utf-8") for n in "oe"]
        saved = sys.stdout, sys.stderr, os.dup(1), os.dup(2)
        for number, file in enumerate(files, 1):
            os.dup2(file.fileno(), number)  # for what libraries in C write
        sys.stdout, sys.stderr = files
        try:
            app(arguments, prog_name="dgeval")
            code = 0
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else (0 if stop.code is None else 1)
        except BaseException:
            traceback.print_exc()
            code = 1
        finally:
            sys.stdout, sys.stderr = saved[:2]
            for number, old in enumerate(saved[2:], 1):
                os.dup2(old, number)
                os.close(old)
        texts = []
        for file in files:
            file.close()
            texts.append(Path(file.name).read_text(encoding="utf-8", errors="replace"))
    return code, texts[0], texts[1]


def judge_cli(code: int, out: str, err: str, name: str, intact: bool | None) -> Outcome:
    """Judge a call of the command line.

    Right are exit codes 0, 2 and 3 without a traceback. 2 and 3 name the file on standard error. 0
    is right only for an intact file. intact None: unknown (no checksum), 0 and 3 are both right.
    """
    lines = [f"exit {code}", *err.strip().splitlines()[-4:]]
    if "Traceback (most recent call last)" in err + out:
        return Outcome(VIOLATION, f"traceback: {err.strip().splitlines()[-1][:300]}", lines=lines)
    if code not in (0, 2, 3):
        return Outcome(VIOLATION, f"exit code {code}: {err.strip()[-400:]}", lines=lines)
    file_name = name.splitlines()[0]
    if code and file_name not in err and file_name in out:
        return Outcome(STDOUT_ONLY, lines=[f"exit {code}", *out.strip().splitlines()[2:4]])
    if code and file_name not in err:
        where = "nowhere"
        return Outcome(
            VIOLATION,
            f"exit code {code}, the file is named {where}: {err.strip()[-300:]!r}",
            lines=lines,
        )
    if code == 0 and intact is False:
        return Outcome(
            VIOLATION, "exit code 0, but reading was not complete and clean", lines=lines
        )
    if code != 0 and intact is True:
        return Outcome(
            VIOLATION, f"exit code {code} for an intact file: {err.strip()[-300:]}", lines=lines
        )
    return Outcome(f"exit {code}", lines=lines)


# --- intact files with wrong contents -------------------------------------------------------------


@dataclass(frozen=True)
class Semantic:
    """A recording with intact bytes and wrong contents, and the right exit codes for it."""

    name: str
    change: Callable[[list[Entry], int], list[Entry]]
    codes: tuple[int, ...] = (0, 2, 3)
    colour: str = "raw"
    depth: str = "raw"
    box: str = BOX


def _on(
    topic: str, change: Callable[[int, Entry], Entry | None]
) -> Callable[[list[Entry], int], list[Entry]]:
    """Apply `change` to every message of the topics that start with `topic`.

    It gets the message's number and the message; None removes it.
    """

    def apply(entries: list[Entry], ros: int) -> list[Entry]:
        out: list[Entry] = []
        k = 0
        for entry in entries:
            if entry.topic.startswith(topic):
                changed = change(k, entry)
                k += 1
                if changed is not None:
                    out.append(changed)
            else:
                out.append(entry)
        return out

    return apply


def _restamp(entry: Entry, t_ns: int) -> Entry:
    stamp = dataclasses.replace(entry.value.header.stamp, sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    return _with(entry, header=dataclasses.replace(entry.value.header, stamp=stamp))


def _with(entry: Entry, **fields: Any) -> Entry:
    return dataclasses.replace(entry, value=dataclasses.replace(entry.value, **fields))


def _t(k: int) -> int:
    return START_NS + k * PERIOD_NS


def _both(
    change: Callable[[int, Entry], Entry | None],
) -> Callable[[list[Entry], int], list[Entry]]:
    def apply(entries: list[Entry], ros: int) -> list[Entry]:
        return _on(DEPTH, change)(_on(COLOUR, change)(entries, ros), ros)

    return apply


def _depth_of(
    make: Callable[[Any], Any], **fields: Any
) -> Callable[[list[Entry], int], list[Entry]]:
    def apply(entries: list[Entry], ros: int) -> list[Entry]:
        encoding = fields.get("encoding", "16UC1")
        rest = {k: v for k, v in fields.items() if k != "encoding"}
        return _on(
            DEPTH,
            lambda k, e: dataclasses.replace(
                e, value=raw_image(ros, _t(k), make(scene(k)[1]), encoding, **rest)
            ),
        )(entries, ros)

    return apply


def _info(**fields: Any) -> Callable[[list[Entry], int], list[Entry]]:
    def apply(entries: list[Entry], ros: int) -> list[Entry]:
        return _on(
            INFO, lambda k, e: dataclasses.replace(e, value=camera_info(ros, _t(k), **fields))
        )(entries, ros)

    return apply


def _tf(change: Callable[[int, int], list[Any]]) -> Callable[[list[Entry], int], list[Entry]]:
    def apply(entries: list[Entry], ros: int) -> list[Entry]:
        return [
            dataclasses.replace(
                e, value=tf_message(ros, change(ros, (e.log_ns - START_NS) // PERIOD_NS))
            )
            if e.topic == TF
            else e
            for e in entries
        ]

    return apply


def _image_data(
    topic: str, change: Callable[[bytes], bytes], every: int = 1
) -> Callable[[list[Entry], int], list[Entry]]:
    def one(k: int, entry: Entry) -> Entry:
        if k % every:
            return entry
        return _with(entry, data=np.frombuffer(change(bytes(entry.value.data)), np.uint8))

    return _on(topic, one)


def _keep(entries: list[Entry], ros: int) -> list[Entry]:
    return entries


def _without(prefix: str) -> Callable[[list[Entry], int], list[Entry]]:
    return _on(prefix, lambda k, e: None)


SEMANTIC = (
    Semantic("control: nothing wrong", _keep, (0,)),
    Semantic("control: jpeg and compressedDepth", _keep, (0,), "jpeg", "png"),
    Semantic("stamps all zero", _both(lambda k, e: _restamp(e, 0))),
    Semantic("stamps zero in colour only", _on(COLOUR, lambda k, e: _restamp(e, 0))),
    Semantic(
        "stamps backward 0.19 s from frame 6",
        _both(lambda k, e: _restamp(e, _t(k) - (190_000_000 if k >= 6 else 0))),
    ),
    Semantic(
        "stamps backward 1 h from frame 6",
        _both(lambda k, e: _restamp(e, _t(k) - (3600 * 10**9 if k >= 6 else 0))),
    ),
    Semantic("stamps duplicate", _both(lambda k, e: _restamp(e, _t(k - k % 2)))),
    Semantic(
        "stamps jump +1 year at frame 6",
        _both(lambda k, e: _restamp(e, _t(k) + (365 * 86400 * 10**9 if k >= 6 else 0))),
    ),
    Semantic("stamps falling", _both(lambda k, e: _restamp(e, _t(100 - k)))),
    Semantic(
        "stamps with nanosec of 4e9",
        _both(
            lambda k, e: _with(
                e,
                header=dataclasses.replace(
                    e.value.header,
                    stamp=dataclasses.replace(e.value.header.stamp, nanosec=4_000_000_000),
                ),
            )
        ),
    ),
    Semantic(
        "stamps of 2106", _both(lambda k, e: _restamp(e, 2**31 * 10**9 - 10**9 + k * PERIOD_NS))
    ),
    Semantic(
        "depth stamped 1 h away", _on(DEPTH, lambda k, e: _restamp(e, _t(k) + 3600 * 10**9)), (2, 3)
    ),
    Semantic("gap of 10 s", _both(lambda k, e: _restamp(e, _t(k) + (10**10 if k >= 6 else 0)))),
    Semantic(
        "joints and tf stamped zero",
        lambda es, r: [
            _restamp(e, 0) if e.topic == JOINTS else e
            for e in _tf(lambda ros, i: [transform(ros, 0, "base_link", "flange", (0, 0, 1))])(
                es, r
            )
        ],
    ),
    Semantic("no camera_info", _without(INFO), (2,)),
    Semantic("no depth", _without(DEPTH), (2,)),
    Semantic("no colour", _without(COLOUR), (2,)),
    Semantic("no tf", _without("/tf"), (0,)),
    Semantic("no joints", _without(JOINTS), (0,)),
    Semantic("nothing but events", lambda es, r: [e for e in es if e.topic == EVENTS], (2,)),
    Semantic("no messages at all", lambda es, r: [], (2,)),
    Semantic("depth in the first half only", _on(DEPTH, lambda k, e: e if k < 6 else None)),
    Semantic("1 frame only", _both(lambda k, e: e if k == 0 else None)),
    Semantic("2 frames only", _both(lambda k, e: e if k < 2 else None)),
    Semantic("camera_info of another size", _info(width=640, height=480), (2, 3)),
    Semantic("camera_info of size 0", _info(width=0, height=0), (2, 3)),
    Semantic("K zero", _info(fx=0.0, fy=0.0), (2, 3)),
    Semantic("K NaN", _info(fx=math.nan), (2, 3)),
    Semantic("K negative", _info(fx=-60.0), (2, 3)),
    Semantic("K huge", _info(fx=1e300, fy=1e300)),
    Semantic("K tiny", _info(fx=1e-300, fy=1e-300)),
    Semantic("K infinite", _info(fx=math.inf), (2, 3)),
    Semantic(
        "image size changes at frame 6",
        _both(lambda k, e: e if k < 6 else _with(e, height=HEIGHT // 2)),
        (0, 3),
    ),
    Semantic("image height 0", _both(lambda k, e: _with(e, height=0)), (2, 3)),
    Semantic("image width 2^31", _both(lambda k, e: _with(e, width=2**31)), (2, 3)),
    Semantic("step 0", _on(DEPTH, lambda k, e: _with(e, step=0)), (2, 3)),
    Semantic("step with padding", _depth_of(lambda d: d, step=WIDTH * 2 + 12), (0,)),
    Semantic("depth big-endian", _depth_of(lambda d: d, big_endian=True), (0,)),
    Semantic(
        "depth 32FC1", _depth_of(lambda d: d.astype(np.float32) / 1000, encoding="32FC1"), (0,)
    ),
    Semantic(
        "depth 32FC1 big-endian",
        _depth_of(lambda d: d.astype(np.float32) / 1000, encoding="32FC1", big_endian=True),
        (0,),
    ),
    Semantic("depth all zero", _depth_of(np.zeros_like), (0,)),
    Semantic("depth all 65535", _depth_of(lambda d: np.full_like(d, 65535)), (0,)),
    Semantic(
        "depth all NaN",
        _depth_of(lambda d: np.full(d.shape, np.nan, np.float32), encoding="32FC1"),
        (0,),
    ),
    Semantic(
        "depth all inf",
        _depth_of(lambda d: np.full(d.shape, np.inf, np.float32), encoding="32FC1"),
        (0,),
    ),
    Semantic(
        "depth all 1e30 m",
        _depth_of(lambda d: np.full(d.shape, 1e30, np.float32), encoding="32FC1"),
        (0,),
    ),
    Semantic(
        "depth all 1e-30 m",
        _depth_of(lambda d: np.full(d.shape, 1e-30, np.float32), encoding="32FC1"),
        (0,),
    ),
    Semantic(
        "depth noise",
        _depth_of(lambda d: np.random.default_rng(3).integers(0, 65536, d.shape).astype(np.uint16)),
        (0,),
    ),
    Semantic(
        "depth one pixel",
        _depth_of(
            lambda d: np.where(np.arange(d.size).reshape(d.shape) == 1500, d, 0).astype(np.uint16)
        ),
        (0,),
    ),
    Semantic("depth flat", _depth_of(lambda d: np.full_like(d, 700)), (0,)),
    Semantic(
        "depth zero from frame 1",
        lambda es, r: _on(
            DEPTH, lambda k, e: e if not k else _with(e, data=np.zeros(len(e.value.data), np.uint8))
        )(es, r),
        (0,),
    ),
    Semantic(
        "colour black",
        _on(COLOUR, lambda k, e: _with(e, data=np.zeros(len(e.value.data), np.uint8))),
        (0,),
    ),
    Semantic("encoding nonsense", _on(DEPTH, lambda k, e: _with(e, encoding="yuv99")), (2, 3)),
    Semantic(
        "depth encoding 8UC1 stated", _on(DEPTH, lambda k, e: _with(e, encoding="8UC1")), (2, 3)
    ),
    Semantic("depth data half", _image_data(DEPTH, lambda d: d[: len(d) // 2], 4), (2, 3)),
    Semantic("depth data empty", _image_data(DEPTH, lambda d: b""), (2, 3)),
    Semantic(
        "JPEG cut in every frame", _image_data(COLOUR, lambda d: d[: len(d) // 2]), (2, 3), "jpeg"
    ),
    Semantic(
        "JPEG cut in every 4th frame",
        _image_data(COLOUR, lambda d: d[: len(d) // 2], 4),
        (2, 3),
        "jpeg",
    ),
    Semantic(
        "JPEG cut in the last frame",
        lambda es, r: _on(
            COLOUR, lambda k, e: e if k < FRAMES - 1 else _with(e, data=e.value.data[:300])
        )(es, r),
        (3,),
        "jpeg",
    ),
    Semantic(
        "JPEG zeroed in the middle",
        _image_data(COLOUR, lambda d: d[:400] + bytes(300) + d[700:], 4),
        (0, 2, 3),
        "jpeg",
    ),
    Semantic(
        "JPEG cut, end marker put on",
        _image_data(COLOUR, lambda d: d[: len(d) // 2] + b"\xff\xd9", 4),
        (2, 3),
        "jpeg",
    ),
    Semantic("JPEG empty", _image_data(COLOUR, lambda d: b""), (2, 3), "jpeg"),
    Semantic("PNG cut", _image_data(DEPTH, lambda d: d[: len(d) // 2], 4), (2, 3), "jpeg", "png"),
    Semantic(
        "PNG cut by 30 bytes", _image_data(DEPTH, lambda d: d[:-30], 4), (2, 3), "jpeg", "png"
    ),
    Semantic(
        "PNG with a flipped bit",
        _image_data(DEPTH, lambda d: flip(d, [len(d) * 4 + 3]), 4),
        (2, 3),
        "jpeg",
        "png",
    ),
    Semantic(
        "compressedDepth without header",
        _image_data(DEPTH, lambda d: d[12:]),
        (0, 2, 3),
        "jpeg",
        "png",
    ),
    Semantic(
        "compressedDepth rvl stated, rubbish",
        lambda es, r: _on(
            DEPTH,
            lambda k, e: _with(
                e, format="16UC1; compressedDepth rvl", data=np.frombuffer(bytes(40), np.uint8)
            ),
        )(es, r),
        (2, 3),
        "jpeg",
        "png",
    ),
    Semantic(
        "compressedDepth 32FC1 with a = b = 0",
        lambda es, r: _on(DEPTH, lambda k, e: _with(e, format="32FC1; compressedDepth png"))(es, r),
        (0, 2, 3),
        "jpeg",
        "png",
    ),
    Semantic(
        "joints NaN", _on(JOINTS, lambda k, e: _with(e, position=np.array([math.nan]))), (0, 3)
    ),
    Semantic(
        "joints inf", _on(JOINTS, lambda k, e: _with(e, position=np.array([math.inf]))), (0, 3)
    ),
    Semantic(
        "joints 1e300", _on(JOINTS, lambda k, e: _with(e, position=np.array([1e300]))), (0, 3)
    ),
    Semantic(
        "joints without positions", _on(JOINTS, lambda k, e: _with(e, position=np.zeros(0))), (0, 3)
    ),
    Semantic("joints renamed", _on(JOINTS, lambda k, e: _with(e, name=["other"])), (0, 3)),
    Semantic(
        "quaternion norm 0",
        _tf(lambda r, i: [transform(r, _t(i), "base_link", "flange", (0, 0, 1), (0, 0, 0, 0))]),
        (3,),
    ),
    Semantic(
        "quaternion norm 1.2",
        _tf(lambda r, i: [transform(r, _t(i), "base_link", "flange", (0, 0, 1), (0, 0, 0, 1.2))]),
        (0, 3),
    ),
    Semantic(
        "tf translation NaN",
        _tf(lambda r, i: [transform(r, _t(i), "base_link", "flange", (0, math.nan, 1))]),
        (3,),
    ),
    Semantic(
        "tf translation 1e300",
        _tf(lambda r, i: [transform(r, _t(i), "base_link", "flange", (0, 1e300, 1))]),
    ),
    Semantic(
        "tf cycle",
        _tf(
            lambda r, i: [
                transform(r, _t(i), "camera", "flange", (0, 0, 1)),
                transform(r, _t(i), "flange", "camera", (0, 0, 1)),
            ]
        ),
    ),
    Semantic(
        "tf frame its own parent",
        _tf(lambda r, i: [transform(r, _t(i), "flange", "flange", (0, 0, 1))]),
    ),
    Semantic("tf with empty names", _tf(lambda r, i: [transform(r, _t(i), "", "", (0, 0, 1))])),
    Semantic(
        "tf two parents",
        _tf(
            lambda r, i: [
                transform(r, _t(i), "base_link" if i % 2 else "world", "flange", (0, 0, 1))
            ]
        ),
    ),
    Semantic("tf empty message", _tf(lambda r, i: [])),
    Semantic(
        "tf jumps 1 m each frame",
        _tf(lambda r, i: [transform(r, _t(i), "base_link", "flange", (i, 0, 1))]),
        (0,),
    ),
    Semantic(
        "description not XML", _on("/robot_description", lambda k, e: _with(e, data="<robot><link"))
    ),
    Semantic("description empty", _on("/robot_description", lambda k, e: _with(e, data=""))),
    Semantic(
        "description is a web page",
        _on("/robot_description", lambda k, e: _with(e, data="<html><body>404</body></html>")),
    ),
    Semantic(
        "description joint cycle",
        _on(
            "/robot_description",
            lambda k, e: _with(
                e,
                data=URDF.replace(
                    "</robot>",
                    '<joint name="j2" type="fixed"><parent link="finger"/><child '
                    'link="palm"/></joint></robot>',
                ),
            ),
        ),
    ),
    Semantic(
        "description with NaN",
        _on("/robot_description", lambda k, e: _with(e, data=URDF.replace("0 0 0.03", "nan 0 x"))),
    ),
    Semantic(
        "description box of size 0",
        _on(
            "/robot_description",
            lambda k, e: _with(e, data=URDF.replace("0.01 0.01 0.03", "0 0 0")),
        ),
    ),
    Semantic("event not JSON", _on(EVENTS, lambda k, e: _with(e, data="{close"))),
    Semantic(
        "event t_ns text",
        _on(EVENTS, lambda k, e: _with(e, data='{"event": "close", "t_ns": "now"}')),
    ),
    Semantic(
        "event t_ns true",
        _on(EVENTS, lambda k, e: _with(e, data='{"event": "close", "t_ns": true}')),
    ),
    Semantic(
        "event t_ns of 1e30",
        _on(EVENTS, lambda k, e: _with(e, data=json.dumps({"event": "close", "t_ns": 10**30}))),
    ),
    Semantic(
        "trial_start t_ns of -1e30",
        _on(
            EVENTS,
            lambda k, e: _with(e, data=json.dumps({"event": "trial_start", "t_ns": -(10**30)})),
        ),
    ),
    Semantic(
        "event JSON nested 100000 deep", _on(EVENTS, lambda k, e: _with(e, data="[" * 100_000))
    ),
    Semantic(
        "trial_start only, at the end",
        _on(
            EVENTS,
            lambda k, e: (
                dataclasses.replace(
                    e,
                    log_ns=_t(50),
                    value=dataclasses.replace(e.value, data='{"event": "trial_start"}'),
                )
                if k
                else None
            ),
        ),
    ),
    Semantic(
        "label of a number",
        _on(EVENTS, lambda k, e: _with(e, data='{"event": "label", "label": 7}')),
    ),
    Semantic("box outside the image", _keep, box="100,100,140,140"),
    Semantic("box far outside", _keep, box="1e9,1e9,2e9,2e9"),
    Semantic("box negative", _keep, box="-90,-90,-40,-40"),
    Semantic("box larger than the image", _keep, box="-100,-100,300,300"),
    Semantic("box area 0", _keep, (2,), box="10,10,10,40"),
    Semantic("box of one pixel", _keep, box="20,20,21,21"),
    Semantic("box NaN", _keep, (2,), box="nan,10,40,40"),
    Semantic("box inf", _keep, box="10,10,inf,inf"),
    Semantic("box of words", _keep, (2,), box="a,b,c,d"),
    Semantic("box on the plane", _keep, box="2,2,12,12"),
)


def write_semantic(case: Semantic, container: str, folder: Path) -> Path:
    """The case as mcap, bag or db3 folder."""
    ros = 1 if container == "bag" else 2
    entries = case.change(recording(ros, case.colour, case.depth), ros)
    if container == "mcap":
        return write_mcap(folder / "case.mcap", entries)
    if container == "bag":
        return write_bag(folder / "case.bag", entries)
    return write_folder(folder / "case", entries)


# the made recordings show no object that could be measured
NO_TARGET = ("--set", 'checks.accept=["measured"]')


def semantic_outcome(case: Semantic, path: Path, command: str, scratch: Path) -> Outcome:
    """inspect or replay through the command line (in this process)."""
    if command == "inspect":
        code, out, err = run_cli(["inspect", str(path)])
        result = judge_cli(code, out, err, path.name, None)
    else:
        arguments = [
            "replay",
            str(path),
            f"--bbox={case.box}",
            "--out",
            str(scratch),
            "--no-review",
            *NO_TARGET,
        ]
        code, out, err = run_cli(arguments)
        # a wrong option is not the file's fault
        result = judge_cli(code, out, err, "--bbox" if "--bbox" in err else path.name, None)
        if result.kind != VIOLATION and code not in case.codes:
            result = Outcome(
                VIOLATION,
                f"exit code {code}, expected one of {case.codes}: {err.strip()[-300:]}",
                lines=result.lines,
            )
    if "NaN" in err or "RuntimeWarning" in err:
        result.lines.append("warnings: " + " ".join(err.split())[:300])
    return result
