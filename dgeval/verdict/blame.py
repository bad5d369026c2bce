"""Which part of the system is to blame (DESIGN section 2.4): the one without whose error the approach would have worked.

The twin runs the approach again, displaced by what `palm_errors` says that one part put the palm off. Where no part is off by
more than grasps survive, what the robot was after would have failed too: synthesis; where another close time lifts the object
it is execution. Of a collision nothing can be said: from the push on the robot's beliefs follow it. Needs those beliefs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgeval.geometry import Array
from dgeval.verdict.causes import Cause

ENOUGH = 0.5  # weighted share of the draws in which it must restore success
TOLERANCE_M = 0.007  # five of six grasps survive 4 mm and 3 degrees, and hindsight is off by 2 to 4: less put nothing wrong


@dataclass(frozen=True)
class Blame:
    """`term` servo, synthesis, velocity, tracking or execution; sizes m (execution: s) of all that are known."""

    term: str
    probability: float
    sizes: dict[str, float]
    source: str | None
    why_unknown: str | None = None


def blame_of(cause: Cause, errors: dict[str, Array] | str) -> Blame:
    """The part whose removal alone restores success; unknown where several or none would, or nothing is recorded."""
    if cause.failure_class == "unknown":
        return Blame("unknown", 0.0, {}, None, "the class is unknown")
    if cause.failure_class == "timing":
        return Blame("execution", max(cause.probabilities), {"execution": abs(cause.shift_s or 0.0)}, "recorded")
    if isinstance(errors, str):
        return Blame("unknown", 0.0, {}, None, errors)
    sizes = {k: float(np.linalg.norm(e)) for k, e in errors.items()}
    if cause.failure_class == "collision":
        return Blame("unknown", 0.0, sizes, "recorded", "the object was pushed, and the robot believed what was pushed")
    asked = [s for s in cause.samples if s.verdict.failure_class == cause.failure_class]
    total = sum(s.weight for s in asked)
    shares = {k: sum(s.weight for s in asked if s.restored.get(k)) / total for k in (*errors, "all")}
    large = sorted((k for k in errors if sizes[k] > TOLERANCE_M), key=lambda k: -sizes[k])
    restoring = [k for k in large if shares[k] > ENOUGH]
    # where only all together restore success and one of them is far larger than the rest, it is that one
    for parts, clearly, share in ((restoring, 1.5, shares), (large if shares["all"] > ENOUGH else [], 2.0, {})):
        if len(parts) == 1 or (parts and sizes[parts[0]] > clearly * sizes[parts[1]]):
            return Blame(parts[0], share.get(parts[0], shares["all"]), sizes, "recorded")
    if restoring:
        return Blame("unknown", 0.0, sizes, "recorded", f"removing any of {', '.join(sorted(restoring))} alone would do")
    if large:
        why = f"no part alone explains it, the largest is {large[0]} with {sizes[large[0]] * 1000:.0f} mm"
        return Blame("unknown", 0.0, sizes, "recorded", why)
    return Blame("synthesis", 1.0 - max(shares.values()), sizes, "recorded")
