"""Several robots in one recording: whose topics count is decided by the camera's namespace."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array

NEAR_NS = 20_000_000  # ns; values at most so far apart in time are compared
Series = tuple[NDArray[np.int64], Array]


def namespace_of(topic: str) -> str:
    """`/robot1` of `/robot1/tf`; "" of `/tf`."""
    return topic.rpartition("/")[0]


def holds(namespace: str, topic: str) -> bool:
    """Whether a topic is in a namespace; everything is in the empty one."""
    return not namespace or topic.startswith(namespace + "/")


def home_of(colour: str | None, stated: str | None) -> str:
    """What the robot's namespaces must hold: the stated one, else the colour topic."""
    return f"{stated.rstrip('/')}/" if stated is not None else colour or ""


def of_camera(
    namespaces: Iterable[str],
    contradict: Callable[[str, str], bool],
    colour: str | None,
    stated: str | None,
    prefers: Callable[[str], bool] | None = None,
) -> tuple[list[str], list[str]]:
    """Namespaces that count, and those that contradict each other and are not told apart.

    contradict: whether two namespaces give one name two meanings. Where no two do, all count. Else
    the stated one; else those that hold the colour topic; else those that `prefers` names, as those
    that place the camera. Those that contradict none of them count as well.
    """
    order = sorted(namespaces)
    pairs = {(a, b) for a, b in combinations(order, 2) if contradict(a, b)}
    if not pairs:
        return order, []

    def apart(a: str, b: str) -> bool:
        return (a, b) in pairs or (b, a) in pairs

    home = home_of(colour, stated)
    kept: list[str] = []
    mixed: list[str] = []
    candidates = [ns for ns in order if holds(ns, home)]
    if stated is None and prefers is not None and not any(candidates):
        candidates = [ns for ns in order if prefers(ns)] or candidates
    for ns in sorted(candidates, key=lambda ns: (-len(ns), ns)):
        if not any(apart(ns, k) for k in kept):
            kept.append(ns)
    if not kept:
        first = min(a for a, _ in pairs)
        kept, mixed = [first], [first, *(ns for ns in order if apart(ns, first))]
    kept += [ns for ns in order if ns not in kept and not any(apart(ns, k) for k in kept)]
    return kept, mixed


def differ(a: Series, b: Series, tolerance: float) -> bool:
    """Whether two series of one name disagree: in the median of the times that they share.

    a, b: stamps, ns, rising, and values (n, m). Series without a common time do not.
    """
    (times_a, values_a), (times_b, values_b) = a, b
    if not len(times_a) or not len(times_b):
        return False
    at = np.clip(np.searchsorted(times_b, times_a), 0, len(times_b) - 1)
    near = np.abs(times_b[at] - times_a) <= NEAR_NS
    if not near.any():
        return False
    apart = np.abs(values_a[near] - values_b[at[near]]).max(axis=1)
    return bool(np.median(apart) > tolerance or np.quantile(apart, 0.9) > 3 * tolerance)
