"""How an image message's bytes become pixels: one file per kind, tried in the order of `ORDER`.

A new kind is one file here, or a module behind the entry point group `dgeval.image_codecs`, with
`ORDER`, `accepts(message) -> bool` and `decode(message) -> Pixels`.
"""

from __future__ import annotations

from functools import cache
from types import ModuleType

from dgeval.plugins import modules_with


@cache
def codecs() -> tuple[ModuleType, ...]:
    """All kinds, the first that accepts a message decodes it."""
    modules = modules_with(
        "dgeval.recording.image_codecs", "accepts", "dgeval.image_codecs", ("decode", "ORDER")
    )
    return tuple(sorted(modules, key=lambda module: module.ORDER))
