"""Parts found by their folder or by an entry point, so that adding one is adding one file."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from importlib.metadata import entry_points
from types import ModuleType

from dgeval.errors import UsageError


def modules_with(package: str, attribute: str, group: str) -> Iterator[ModuleType]:
    """Modules that have an attribute: the files of a package by name, then installed entry points.

    group: of entry points, each of which names a module, e.g. `dgeval.hands`. UsageError names an
    entry point that can't be used, and the package it comes from.
    """
    folder = importlib.import_module(package)
    for info in pkgutil.iter_modules(folder.__path__):
        module = importlib.import_module(f"{package}.{info.name}")
        if hasattr(module, attribute):
            yield module
    for entry in sorted(entry_points(group=group), key=lambda e: e.name):
        package = "" if entry.dist is None else f" of the package {entry.dist.name}"
        what = f"the entry point {entry.name!r} in the group {group}{package}"
        try:
            module = entry.load()
        except (ImportError, AttributeError) as error:
            raise UsageError(f"{what} can't be loaded: {error}") from error
        if not hasattr(module, attribute):
            raise UsageError(f"{what} names {entry.value}, which has no {attribute}")
        yield module
