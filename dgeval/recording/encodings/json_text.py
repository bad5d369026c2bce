"""JSON messages with a JSON schema: objects with the fields as written."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

ENCODES = ("json", "jsonschema")  # message encoding, schema encoding


def decoder(type_name: str, schema: bytes) -> Callable[[bytes], Any]:
    """The function that decodes one message's bytes; type and schema are not needed."""
    return decode


def decode(data: bytes) -> Any:
    """ValueError where the bytes are no JSON object."""
    try:
        value = json.loads(data, object_hook=lambda fields: SimpleNamespace(**fields))
    except RecursionError as error:
        raise ValueError("nested too deep") from error
    if not isinstance(value, SimpleNamespace):
        raise ValueError("not a JSON object")
    return value
