"""ROS 2 messages (CDR) with their definition as OMG IDL text, as ros2idl schemas hold it."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

from rosbags.typesys import Stores, get_types_from_idl, get_typestore

from dgeval.recording.encodings import cdr_named
from dgeval.recording.encodings.cdr2 import deserialize

ENCODES = ("cdr", "ros2idl")  # message encoding, schema encoding
# the line before each of several definitions in one schema
SEPARATOR = re.compile(r"^=+\nIDL: .*$", re.MULTILINE)


@lru_cache(maxsize=256)
def decoder(type_name: str, schema: bytes) -> Callable[[bytes], Any]:
    """The function that decodes one message's bytes; standard types are known by name."""
    if type_name in cdr_named.standard_types().fielddefs:
        return cdr_named.decoder(type_name, b"")
    store = get_typestore(Stores.EMPTY)
    for definition in SEPARATOR.split(schema.decode()):
        if definition.strip():
            store.register(get_types_from_idl(definition))
    return partial(deserialize, store, type_name)
