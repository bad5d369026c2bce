"""How a message's bytes become an object: one file per encoding.

A new encoding is one file here, or a module behind the entry point group `dgeval.encodings`, with
`ENCODES` (message encoding, schema encoding) and `decoder(type_name, schema) -> (bytes -> object)`.
Every decoder gives objects with ROS 2 field names, so that nothing above needs to know where a
message came from.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from dgeval.plugins import modules_with

Decoder = Callable[[str, bytes], Callable[[bytes], Any]]


@cache
def decoders() -> dict[tuple[str, str], Decoder]:
    """By message encoding and schema encoding, what makes a decoder of a type."""
    modules = modules_with(
        "dgeval.recording.encodings", "ENCODES", "dgeval.encodings", ("decoder",)
    )
    return {module.ENCODES: module.decoder for module in modules}
