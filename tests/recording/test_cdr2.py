"""Catches: a payload of CDR version 2 read as version 1, or called damage.

The writer here follows DDS-XTypes 1.3, 7.4.3.5, member by member.
"""

from __future__ import annotations

import contextlib
import copy
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dgeval.recording.encodings.cdr2 import NUMBERS, deserialize
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer
from rosbags.interfaces import Nodetype
from tests.recording.recorders import STORE, Message, contents, opened


def encoded(kind: str, value: Any, order: str = "<", lengths: bool = True) -> bytes:
    out = bytearray()

    def align(n: int) -> None:
        out.extend(bytes(-len(out) % n))

    def numbers(name: str, values: Any) -> None:
        array = np.asarray(values, np.dtype(NUMBERS[name]).newbyteorder(order)).ravel()
        if array.size:
            align(min(array.itemsize, 4))
            out.extend(array.tobytes())

    def member(node: Any, v: Any) -> None:
        tag, inner = node
        if tag == Nodetype.NAME:
            message(inner, v)
        elif tag == Nodetype.BASE and inner[0] == "string":
            raw = v.encode() + b"\0"
            numbers("uint32", len(raw))
            out.extend(raw)
        elif tag == Nodetype.BASE:
            numbers(inner[0], v)
        else:
            element = inner[0]
            bare = element[0] == Nodetype.BASE and element[1][0] in NUMBERS
            start = None
            if not bare and lengths:
                numbers("uint32", 0)
                start = len(out)
            if tag == Nodetype.SEQUENCE:
                numbers("uint32", len(v))
            if bare:
                numbers(element[1][0], v)
            else:
                for item in v:
                    member(element, item)
            if start is not None:
                struct.pack_into(f"{order}I", out, start - 4, len(out) - start)

    def message(name: str, v: Any) -> None:
        for field, node in STORE.fielddefs[name][1]:
            member(node, getattr(v, field))

    message(kind, value)
    return bytes([0, 7 if order == "<" else 6, 0, 0]) + bytes(out)


@pytest.mark.parametrize("lengths", [True, False])
def test_a_recording_in_version_2_is_the_original(
    tmp_path: Path, messages: list[Message], original: list[Any], lengths: bool
) -> None:
    """Fails where a valid payload of version 2 is called damage."""
    path = tmp_path / "v2.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        channels: dict[str, int] = {}
        for log_ns, topic, kind, value in sorted(messages, key=lambda m: m[0]):
            if topic not in channels:
                text = STORE.generate_msgdef(kind, ros_version=2)[0].encode()
                schema = writer.register_schema(kind, "ros2msg", text)
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = encoded(kind, value, lengths=lengths)
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.finish()
    trial = opened(path)
    assert not trial.damage
    assert contents(trial) == original


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("lengths", [True, False])
def test_every_kind_of_member(messages: list[Message], order: str, lengths: bool) -> None:
    """Fails where a member is read at another place than it was written."""
    for kind in sorted({m[2] for m in messages}):
        value = next(m[3] for m in messages if m[2] == kind)
        back = deserialize(STORE, kind, encoded(kind, value, order, lengths))
        assert bytes(STORE.serialize_cdr(back, kind)) == bytes(STORE.serialize_cdr(value, kind))


@given(st.binary(max_size=120), st.integers(0, 300))
def test_broken_bytes_are_refused(noise: bytes, cut: int) -> None:
    """Fails where anything but ValueError leaves, or a cut message is read as a whole one."""
    for name in ("sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage"):
        with contextlib.suppress(ValueError):
            deserialize(STORE, name, b"\0\x07\0\0" + noise)
    stamp = STORE.types["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    joints = STORE.types["sensor_msgs/msg/JointState"](
        header=STORE.types["std_msgs/msg/Header"](stamp=stamp, frame_id="a"),
        name=["a", "bc"],
        position=np.array([1.0, 2.0]),
        velocity=np.zeros(0),
        effort=np.array([3.0, 4.0]),
    )
    whole = encoded("sensor_msgs/msg/JointState", copy.deepcopy(joints))
    if cut < len(whole):
        with pytest.raises(ValueError):
            deserialize(STORE, "sensor_msgs/msg/JointState", whole[:cut])


def test_another_representation_is_named() -> None:
    """Fails where it is called damage."""
    with pytest.raises(ValueError, match="delimited CDR version 2"):
        deserialize(STORE, "std_msgs/msg/String", bytes([0, 9, 0, 0]) + bytes(20))
