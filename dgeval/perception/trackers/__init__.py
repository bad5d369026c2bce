"""Trackers of the target in the image: one file each.

A new tracker is one file here, or a module behind the entry point group `dgeval.trackers`, with
`METHOD` (its name in `tracking.method`), `STAND_IN` (what a trial's notes call it, None for the
paper's own) and `TRACKER`: a class made from the configuration, with `reset()` and
`step(TrackingInput) -> Tracked`.
"""

from __future__ import annotations

import difflib
from functools import cache
from types import ModuleType

from dgeval.errors import UsageError
from dgeval.plugins import modules_with


@cache
def trackers() -> dict[str, ModuleType]:
    """Modules of trackers by method. UsageError where two have the same one."""
    found: dict[str, ModuleType] = {}
    folder, group = "dgeval.perception.trackers", "dgeval.trackers"
    for module in modules_with(folder, "METHOD", group, ("TRACKER", "STAND_IN")):
        if module.METHOD in found:
            where = f"{found[module.METHOD].__name__} and {module.__name__}"
            raise UsageError(f"two trackers are called {module.METHOD!r}, in {where}")
        found[module.METHOD] = module
    return found


def tracker_named(method: str) -> ModuleType:
    """UsageError with the nearest name where there is none."""
    known = trackers()
    if method not in known:
        near = difflib.get_close_matches(method, known, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(sorted(known))}"
        raise UsageError(f"tracking.method: no tracker {method!r}", hint=hint)
    return known[method]
