"""Decoders of message bytes: one file per encoding, chosen by the encoding's name in the container.

A new encoding is one file with `decoder(type_name, schema) -> (bytes -> object)` and one line here.
Every decoder gives objects with ROS 2 field names, so that the code above is the same for all.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dgeval.recording.encodings import cdr, ros1

DECODERS: dict[tuple[str, str], Callable[[str, bytes], Callable[[bytes], Any]]] = {
    # (message encoding, schema encoding)
    ("cdr", "ros2msg"): cdr.decoder,
    ("ros1", "ros1msg"): ros1.decoder,
}
