"""JSON messages: objects with the fields as written, bytes from base64 or lists of numbers."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

ENCODES = ("json", "jsonschema")  # message encoding, schema encoding
OLDER = {"secs": "sec", "nsecs": "nanosec"}  # of ROS 1's stamps


def decoder(type_name: str, schema: bytes) -> Callable[[bytes], Any]:
    """The function that decodes one message's bytes; type and schema are not needed."""
    return decode


def decode(data: bytes) -> Any:
    """ValueError where the bytes are no JSON object."""
    try:
        value = json.loads(data, object_hook=_object)
    except RecursionError as error:
        raise ValueError("nested too deep") from error
    if not isinstance(value, SimpleNamespace):
        raise ValueError("not a JSON object")
    return value


def _object(fields: dict[str, Any]) -> SimpleNamespace:
    """An object; the `data` of an image or a cloud, which stands beside other fields, as bytes."""
    named = {OLDER.get(name, name): value for name, value in fields.items()}
    data = named.get("data")
    if len(named) > 1 and isinstance(data, str):
        named["data"] = base64.b64decode(data, validate=True)
    elif len(named) > 1 and isinstance(data, list):
        named["data"] = bytes(data)
    return SimpleNamespace(**named)
