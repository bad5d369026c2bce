"""ROS 1 messages with their definition as ROS .msg text.

Bytes behind a message's end are ignored, as ROS 1's own reader does. librealsense's recorder (SDK
2.54 to 2.57) puts the depth unit there.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

ENCODES = ("ros1", "ros1msg")  # message encoding, schema encoding
IMAGE = "sensor_msgs/msg/Image"
UNIT_BYTES = 4  # a float32 behind an image: m per unit of depth, 0 behind colour


@lru_cache(maxsize=256)
def decoder(type_name: str, schema: bytes) -> Callable[[bytes], Any]:
    """The function that decodes one message's bytes into an object with the type's fields."""
    store = get_typestore(Stores.EMPTY)
    normal = type_name if "/msg/" in type_name else type_name.replace("/", "/msg/", 1)
    store.register(get_types_from_msg(schema.decode(), normal))
    return partial(decode, store, normal)


def decode(store: Typestore, type_name: str, data: bytes) -> Any:
    """One message; an image with a depth unit behind it gets it as `depth_unit`, m.

    ValueError, struct.error or UnicodeDecodeError where the bytes are too few.
    """
    definition = store.get_msgdef(type_name)
    message, end = definition.deserialize_ros1(data, 0, definition.cls, store)
    if end > len(data):
        raise ValueError(f"{len(data)} bytes are too few")
    if type_name == IMAGE and len(data) - end == UNIT_BYTES:
        (unit,) = struct.unpack_from("<f", data, end)
        if unit > 0:
            fields = {name: getattr(message, name) for name in definition.cls.__annotations__}
            return SimpleNamespace(**fields, depth_unit=round(float(unit), 9))
    return message
