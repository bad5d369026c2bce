"""CDR version 2 (XCDR2 of DDS-XTypes 1.3, 7.4): what some DDS vendors write for ROS 2.

Against version 1, numbers of 8 bytes stand at multiples of 4, and a sequence of other things than
numbers has its length in bytes before it. Some writers leave that length out; both are read.
`deserialize` reads either version.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

VERSION_1 = (0x00, 0x01)  # representation ids of plain CDR, big and little endian
VERSION_2 = (0x06, 0x07)
OTHERS = {
    0x02: "parameter list CDR",
    0x03: "parameter list CDR",
    0x08: "delimited CDR version 2",
    0x09: "delimited CDR version 2",
    0x0A: "parameter list CDR version 2",
    0x0B: "parameter list CDR version 2",
}
HEADER_BYTES = 4
NUMBERS = {
    "bool": "b1",
    "byte": "u1",
    "char": "u1",
    "octet": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
PADDING = 3  # bytes at most behind the last member


def deserialize(store: Typestore, type_name: str, data: bytes) -> Any:
    """A message of either CDR version; ValueError names another representation."""
    if len(data) < HEADER_BYTES:
        raise ValueError(f"{len(data)} bytes are too few for a CDR header")
    kind = data[1] if data[0] == 0 else -1
    if kind in VERSION_2:
        return _message(store, type_name, data, kind)
    if kind not in VERSION_1:
        named = OTHERS.get(kind, "unknown")
        raise ValueError(f"the CDR representation {data[:2].hex()} ({named}) is not read")
    return store.deserialize_cdr(data, type_name)


def _message(store: Typestore, type_name: str, data: bytes, kind: int) -> Any:
    order = "<" if kind & 1 else ">"
    for with_lengths in (True, False):
        reader = _Reader(store, data[HEADER_BYTES:], order, with_lengths)
        try:
            value = reader.message(type_name)
        except (ValueError, IndexError, struct.error):
            continue
        if len(reader.data) - reader.at <= PADDING:
            return value
    raise ValueError(f"{len(data)} bytes of CDR version 2 are no {type_name}")


class _Reader:
    """Reads the members of one message in turn; `at` is where the next one begins."""

    def __init__(self, store: Typestore, data: bytes, order: str, with_lengths: bool) -> None:
        self.store, self.data, self.order = store, data, order
        self.with_lengths, self.at = with_lengths, 0

    def message(self, type_name: str) -> Any:
        names = self.store.fielddefs[type_name][1]
        return self.store.types[type_name](**{name: self.field(kind) for name, kind in names})

    def field(self, kind: Any) -> Any:
        node, inner = kind
        if node == Nodetype.BASE:
            return self.text() if inner[0] in ("string", "wstring") else self.number(inner[0])
        if node == Nodetype.NAME:
            return self.message(inner)
        element, length = inner
        is_number = element[0] == Nodetype.BASE and element[1][0] in NUMBERS
        end = None
        if not is_number and self.with_lengths:
            size = self.length()
            end = self.at + size
        count = length if node == Nodetype.ARRAY else self.length()
        if is_number:
            return self.numbers(element[1][0], count)
        if count > len(self.data):
            raise ValueError(f"{count} elements in {len(self.data)} bytes")
        out = [self.field(element) for _ in range(count)]
        if end is not None and self.at != end:
            raise ValueError("a sequence is not as long as it says")
        return out

    def length(self) -> int:
        return int(self.numbers("uint32", 1)[0])

    def number(self, name: str) -> Any:
        return self.numbers(name, 1)[0].item()

    def numbers(self, name: str, count: int) -> Any:
        kind = np.dtype(f"{self.order}{NUMBERS[name]}")
        if count == 0:
            return np.zeros(0, NUMBERS[name])
        start = -(-self.at // min(kind.itemsize, 4)) * min(kind.itemsize, 4)
        if start + count * kind.itemsize > len(self.data):
            raise ValueError("the bytes end early")
        self.at = start + count * kind.itemsize
        return np.frombuffer(self.data, kind, count, start).astype(NUMBERS[name], copy=False)

    def text(self) -> str:
        size = self.length()
        raw = self.data[self.at : self.at + size]
        if not size or len(raw) != size or raw[-1]:
            raise ValueError("a text without its end")
        self.at += size
        return raw[:-1].decode()
