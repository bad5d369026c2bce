"""Parts found by their folder or by an entry point, so that adding one is adding one file."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from importlib.metadata import entry_points
from types import ModuleType

from dgeval.errors import UsageError


def modules_with(
    package: str, attribute: str, group: str, also: tuple[str, ...] = ()
) -> Iterator[ModuleType]:
    """Modules that have an attribute: the files of a package by name, then installed entry points.

    group: of entry points, each of which names a module, e.g. `dgeval.hands`. also: what a module
    with the attribute must have besides. UsageError names what can't be used, and an entry point's
    package.
    """
    folder = importlib.import_module(package)
    for info in pkgutil.iter_modules(folder.__path__):
        module = importlib.import_module(f"{package}.{info.name}")
        _complete(module, attribute, also)
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
        _complete(module, attribute, also)
        yield module


def _complete(module: ModuleType, attribute: str, also: tuple[str, ...]) -> None:
    """UsageError for a module that has a part of what is needed, and not all."""
    needed = (attribute, *also)
    there = [name for name in needed if hasattr(module, name)]
    if there and len(there) < len(needed):
        missing = ", ".join(name for name in needed if name not in there)
        raise UsageError(f"{module.__name__} has {', '.join(there)} but no {missing}")
