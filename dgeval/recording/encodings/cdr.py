"""ROS 2 messages (CDR) with their definition as ROS .msg text."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dgeval.recording.encodings.cdr2 import deserialize

ENCODES = ("cdr", "ros2msg")  # message encoding, schema encoding


@lru_cache(maxsize=256)
def decoder(type_name: str, schema: bytes) -> Callable[[bytes], Any]:
    """The function that decodes one message's bytes into an object with the type's fields."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema.decode(), type_name))
    return partial(deserialize, store, type_name)
