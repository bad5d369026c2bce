"""ROS 1 messages with their definition as ROS .msg text."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ENCODES = ("ros1", "ros1msg")  # message encoding, schema encoding


def decoder(type_name: str, schema: bytes) -> Callable[[bytes], Any]:
    """The function that decodes one message's bytes into an object with the type's fields."""
    store = get_typestore(Stores.EMPTY)
    normal = type_name if "/msg/" in type_name else type_name.replace("/", "/msg/", 1)
    store.register(get_types_from_msg(schema.decode(), normal))
    return partial(store.deserialize_ros1, typename=normal)
