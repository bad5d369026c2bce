"""Parts found by their folder or by an entry point, so that adding one is adding one file."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from importlib.metadata import entry_points
from types import ModuleType


def modules_with(package: str, attribute: str, group: str) -> Iterator[ModuleType]:
    """Modules that have an attribute: the files of a package by name, then installed entry points.

    group: of entry points, each of which names a module, e.g. `dgeval.hands`.
    """
    folder = importlib.import_module(package)
    for info in pkgutil.iter_modules(folder.__path__):
        module = importlib.import_module(f"{package}.{info.name}")
        if hasattr(module, attribute):
            yield module
    for entry in sorted(entry_points(group=group), key=lambda e: e.name):
        module = entry.load()
        if hasattr(module, attribute):
            yield module
