"""ROS 2 messages (CDR) without a definition: standard types are known by their name.

rosbag2 writes an empty definition where the recording machine lacks it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from dgeval.recording.encodings.cdr2 import deserialize

ENCODES = ("cdr", "")  # message encoding, schema encoding


@cache
def standard_types() -> Typestore:
    """The message types of ROS 2 Humble."""
    return get_typestore(Stores.ROS2_HUMBLE)


def decoder(type_name: str, schema: bytes) -> Callable[[bytes], Any]:
    """The function that decodes one message's bytes. ValueError for a type that is no standard one.

    schema: not used; it is empty.
    """
    store = standard_types()
    if type_name not in store.fielddefs:
        raise ValueError(f"{type_name} is no standard type, and the file has no definition of it")
    return partial(deserialize, store, type_name)
