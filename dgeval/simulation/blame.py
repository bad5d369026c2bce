"""Which injected fault a failure is due to: the one whose removal restores success.

Each question is asked over slightly different re-runs, on modelled perception, without images.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from dgeval.determinism import generator
from dgeval.simulation.scenario import Plan

# All values are ours; docs/simulation.md, "Blame in the simulator".
# Of RERUNS re-runs, at least RESTORED succeed without the fault, and at most BASE_AT_MOST with it.
RERUNS, RESTORED, BASE_AT_MOST = 5, 4, 1
# Half widths of the uniform differences: m of the start, m/s of the speed, s of the close.
JITTER_M, JITTER_SPEED, JITTER_S = 0.001, 0.003, 0.010


def jittered(plan: Plan, k: int) -> Plan:
    """The plan with a slightly different start, speed and close.

    Differences are uniform within ±1 mm, ±3 mm/s and ±10 ms, and follow from the number k.
    """
    rng = generator(plan.seed, f"jitter/{plan.index}", k)
    dx, dy, dv, dt = rng.uniform(-1, 1, 4)
    speed = plan.speed + JITTER_SPEED * dv if plan.speed else 0.0
    return replace(
        plan,
        x=plan.x + JITTER_M * dx,
        y=plan.y + JITTER_M * dy,
        speed=speed,
        close_jitter=JITTER_S * dt,
    )


def blame(plan: Plan, succeeds: Callable[[Plan], bool]) -> dict[str, Any]:
    """The fault to blame, and how often re-runs succeeded.

    Returns {"fault": name or "combined" or None, "base": successes of 5, "without": {fault:
    successes of 5}}. None: no fault was injected. "combined": no single removal restores success,
    several do, or the failure itself does not repeat.
    """
    present = plan.faults.present()
    if not present:
        return {"fault": None, "base": None, "without": {}}
    base = sum(succeeds(jittered(plan, k)) for k in range(RERUNS))
    without: dict[str, int] = {}
    if base <= BASE_AT_MOST:
        for name in present:
            removed = replace(plan, faults=plan.faults.without(name))
            without[name] = sum(succeeds(jittered(removed, k)) for k in range(RERUNS))
    restored = [name for name, n in without.items() if n >= RESTORED]
    # several that each restore it: the failure needs all of them together
    return {
        "fault": restored[0] if len(restored) == 1 else "combined",
        "base": base,
        "without": without,
    }
