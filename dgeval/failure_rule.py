"""Outcomes, failure classes, and the one rule that turns facts into a class (SIMULATION section 5, "the rule").

The simulator's truth and the twin both use it: they find out facts, the rule says which fact it needs next and what follows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Outcome = Literal["success", "failure", "no_grasp", "incomplete", "unknown"]
OutcomeSource = Literal["label", "inferred"]
FailureClass = Literal["imprecise_pose", "collision", "timing", "unknown"]
Tracking = Literal["tracked", "lost", "not_started"]
SubCause = Literal["never", "early", "late", "displaced", "missed", "unstable"]
Fact = Literal["put_back", "free_pose"]


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Where the rule draws its lines."""

    moved_m: float = 0.005  # off the undisturbed path before the close
    moved_deg: float = 5.0
    overlap_m: float = 0.002  # of hand and object put back
    consecutive: int = 2  # other close times in a row that must succeed: single ones are chance
    unstable_m: float = 0.02  # raised by at least this and dropped: unstable, else missed

    def scaled(self, name: str, factor: float) -> Thresholds:
        """The same with one threshold moved."""
        values = {n: getattr(self, n) for n in self.__slots__}
        values[name] = values[name] * factor
        return Thresholds(**values)


# who holds something gives way a little (SIMULATION section 5)
HANDED_OVER = Thresholds(moved_m=0.012)


@dataclass(frozen=True)
class Facts:
    """What is known of a failed grasp. None: not found out yet; only `put_back` and `free_pose` may be.

    displacement_m, displacement_deg: furthest off the undisturbed path before the close (of the whole approach if it never
    came). curve: (offset s from the real close, success) of other close times, in order; of the last possible close if it
    never came. contact_s: offset of the last instant before the displacing contact. overlap_m: hand and object put back at
    the close. put_back: the object put back on its undisturbed path at the close (never closed: at first contact), it
    works. free_pose: likewise, from the nearest palm pose that overlaps nothing. height_m: greatest rise of the object.
    """

    closed: bool
    displacement_m: float
    displacement_deg: float
    curve: tuple[tuple[float, bool], ...]
    contact_s: float | None
    height_m: float
    overlap_m: float = 0.0
    put_back: bool | None = None
    free_pose: bool | None = None


@dataclass(frozen=True, slots=True)
class Verdict:
    """Class and sub-cause of a failure; shift_s: how much later (positive) the close should have come."""

    failure_class: FailureClass
    sub_cause: SubCause
    shift_s: float | None = None


@dataclass(frozen=True, slots=True)
class Needs:
    """The rule can't go on without this fact."""

    fact: Fact


def classify(facts: Facts, thresholds: Thresholds | None = None) -> Verdict | Needs:
    """The class of a failed grasp, or the fact that decides it."""
    th = thresholds or Thresholds()
    moved = facts.displacement_m > th.moved_m or facts.displacement_deg > th.moved_deg
    shift = _nearest_run(facts.curve, th.consecutive)
    imprecise = Verdict(
        "imprecise_pose", "unstable" if facts.height_m >= th.unstable_m else "missed"
    )
    if not facts.closed:
        if shift is not None:
            return Verdict("timing", "never", shift)
        if not moved:
            return imprecise
        if facts.put_back is None:
            return Needs("put_back")
        return Verdict("collision", "displaced") if facts.put_back else imprecise
    if moved:
        if facts.put_back is None:
            return Needs("put_back")
        if facts.overlap_m <= th.overlap_m:
            if facts.put_back:
                return Verdict("collision", "displaced")
        else:
            before = tuple(
                c for c in facts.curve if facts.contact_s is not None and c[0] <= facts.contact_s
            )
            earlier = _nearest_run(before, th.consecutive)
            if earlier is not None:
                return Verdict("timing", "late", earlier)
            if facts.free_pose is None:
                return Needs("free_pose")
            return Verdict("collision", "displaced") if facts.free_pose else imprecise
    if shift is not None:
        return Verdict("timing", "early" if shift > 0 else "late", shift)
    return imprecise


def _nearest_run(curve: tuple[tuple[float, bool], ...], consecutive: int) -> float | None:
    """Offset, nearest to 0, of a close time in a run of at least `consecutive` successes; the failure at 0 parts runs."""
    best: float | None = None
    run: list[float] = []
    for offset, success in (*curve, (float("inf"), False)):
        parted = bool(run) and run[-1] < 0 < offset
        if (not success or parted) and len(run) >= consecutive:
            nearest = min(run, key=abs)
            best = nearest if best is None or abs(nearest) < abs(best) else best
        if not success or parted:
            run = []
        if success:
            run.append(offset)
    return best
