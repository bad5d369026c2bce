"""Which part of the system is to blame (DESIGN section 2.4): the one without whose error the approach would have worked.

The twin runs the approach again, displaced by what `beliefs_of` says that one part put the palm off. Where no part is off by
more than grasps survive, what the robot was after would have failed too: synthesis; where another close time lifts the object
it is execution. Of a hand that never closed the twin asks whether the grasp it was sent to would have held: if so, and it was
there, it is execution; if it never came there, the part that alone is off. A servo that is faster up and down than level is
off. Of a collision nothing else can be said: from the push on the robot's beliefs follow it. Needs those beliefs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgeval.verdict.beliefs import Beliefs
from dgeval.verdict.decide import Cause
from dgeval.verdict.twin import Sample

ENOUGH = 0.5  # weighted share of the draws in which it must restore success
TOLERANCE_M = 0.007  # five of six grasps survive 4 mm and 3 degrees, and hindsight is off by 2 to 4: less put nothing wrong
NEVER_CLOSED_M = (
    0.012  # likewise of a hand that never closed, where nothing is tried again without it
)
GAIN_LEAST, GAINS_APART = 0.15, 1.6  # 1/s; upright over level, or the other way round
HUGE = (
    5.0  # times the tolerance; of a part that is to blame though the twin does not hold without it
)
ALONE = 0.7  # stated where a part is blamed because it alone is off; chosen on development trials


@dataclass(frozen=True)
class Blame:
    """`term` servo, synthesis, velocity, tracking or execution; sizes m (execution: s) of all that are known."""

    term: str
    probability: float
    sizes: dict[str, float]
    source: str | None
    why_unknown: str | None = None


def blame_of(cause: Cause, beliefs: Beliefs | str) -> Blame:
    """The part whose removal alone restores success; unknown where several or none would, or nothing is recorded."""
    if cause.failure_class == "unknown":
        return Blame("unknown", 0.0, {}, None, "the class is unknown")
    if isinstance(beliefs, str):
        return Blame("unknown", 0.0, {}, None, beliefs)
    sizes = {k: float(np.linalg.norm(e)) for k, e in beliefs.errors.items()}
    if cause.failure_class == "collision":
        if _wrong_law(beliefs):
            return Blame("servo", ALONE, sizes, "recorded")
        return Blame(
            "unknown",
            0.0,
            sizes,
            "recorded",
            "the object was pushed, and the robot believed what was pushed",
        )
    asked = [s for s in cause.samples if s.verdict.failure_class == cause.failure_class]
    if not asked[0].facts.closed:
        return _never_closed(beliefs, sizes, asked)
    shares = {k: _share(asked, k) for k in (*sizes, "all")}
    large = sorted((k for k in sizes if sizes[k] > TOLERANCE_M), key=lambda k: -sizes[k])
    if cause.sub_cause == "early":
        # a hand that closes before it is there is off its grasp because of that
        large = [k for k in large if k != "servo"]
    restoring = [k for k in large if shares[k] > ENOUGH]
    huge = [
        k
        for k in large[:1]
        if sizes[k] > HUGE * TOLERANCE_M and all(sizes[k] > 2.0 * sizes[n] for n in large[1:])
    ]
    if _wrong_law(beliefs) and not huge and all(sizes[k] < 2 * TOLERANCE_M for k in restoring):
        return Blame("servo", ALONE, sizes, "recorded")
    # where only all together restore success and one of them is far larger than the rest, it is that one
    for parts, clearly, share in (
        (restoring, 1.5, shares),
        (large if shares["all"] > ENOUGH else [], 2.0, {}),
    ):
        if len(parts) == 1 or (parts and sizes[parts[0]] > clearly * sizes[parts[1]]):
            return Blame(parts[0], share.get(parts[0], shares["all"]), sizes, "recorded")
    if restoring:
        return Blame(
            "unknown",
            0.0,
            sizes,
            "recorded",
            f"removing any of {', '.join(sorted(restoring))} alone would do",
        )
    if huge:
        # by so much the approach can't be displaced and still be like the recorded one
        return Blame(huge[0], ALONE, sizes, "recorded")
    if cause.failure_class == "timing":
        return Blame(
            "execution",
            max(cause.probabilities),
            {"execution": abs(cause.shift_s or 0.0)},
            "recorded",
        )
    if large:
        why = f"no part alone explains it, the largest is {large[0]} with {sizes[large[0]] * 1000:.0f} mm"
        return Blame("unknown", 0.0, sizes, "recorded", why)
    return Blame("synthesis", 1.0 - max(shares.values()), sizes, "recorded")


def _share(asked: list[Sample], key: str) -> float:
    """Weighted share of the draws in which something restores success."""
    return sum(s.weight for s in asked if s.restored.get(key)) / sum(s.weight for s in asked)


def _wrong_law(beliefs: Beliefs) -> bool:
    """Whether the commands went after the grasp with one gain level and with quite another one up and down."""
    if beliefs.gains is None:
        return False
    level, upright = beliefs.gains
    return level > GAIN_LEAST and not 1 / GAINS_APART < upright / level < GAINS_APART


def _never_closed(beliefs: Beliefs, sizes: dict[str, float], asked: list[Sample]) -> Blame:
    goal = _share(asked, "goal")
    out = [k for k in ("tracking", "velocity") if sizes.get(k, 0.0) > NEVER_CLOSED_M]
    out += ["servo"] if _wrong_law(beliefs) else []
    if sizes["servo"] <= TOLERANCE_M and goal > ENOUGH:
        return Blame("execution", goal, sizes, "recorded")
    if len(out) == 1:
        return Blame(out[0], ALONE, sizes, "recorded")
    if out:
        return Blame("unknown", 0.0, sizes, "recorded", f"{', '.join(out)} are all off")
    if sizes["servo"] <= TOLERANCE_M and beliefs.goal is not None:
        return Blame("synthesis", 1.0 - goal, sizes, "recorded")
    why = f"the hand came no nearer to its grasp than {sizes['servo'] * 1000:.0f} mm, and no part stands out"
    return Blame("unknown", 0.0, sizes, "recorded", why)
