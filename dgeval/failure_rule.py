"""The one rule that turns facts into outcome words, class and sub-cause of a failed grasp.

The simulator's truth and the verdict both use it: they find out facts, the rule says which fact it
needs next and what follows (docs/simulation.md, "Truth rule"). A new sub-cause is one row of
`SUB_CAUSES`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Outcome = Literal["success", "failure", "no_grasp", "incomplete", "unknown"]
OutcomeSource = Literal["label", "inferred"]
FailureClass = Literal["imprecise_pose", "collision", "timing"]
Tracking = Literal["tracked", "lost", "not_started"]
Fact = Literal["put_back", "free_pose"]
CLASSES: tuple[FailureClass, ...] = ("imprecise_pose", "collision", "timing")
NEAR_M = 0.08  # m from hand to object, within which there was an attempt to grasp it
NO_CLOSE = "the hand does not close in this log"  # which may begin after a close
KNOWN_SHARE = 0.9  # of the trial, in which the hand must be known to say what it never did


@dataclass(frozen=True, slots=True)
class Unknown:
    """No answer, and why. `reason` completes "unknown: …"."""

    reason: str


def outcome_without_close(
    pose_known: float, nearest_m: float | None, moved: bool
) -> tuple[Outcome, str]:
    """The outcome of a trial in which the fingers are known never to have closed, and why.

    pose_known: share of the trial in which the hand's pose is known. nearest_m: least distance of
    hand and object, m, on the object's path; None where it is not known. moved: whether the hand
    moved. Near and never closed is a failure; what is not known is no answer.
    """
    if pose_known < KNOWN_SHARE:
        return "unknown", f"{NO_CLOSE}, and its pose is known in {pose_known:.0%} only"
    if nearest_m is None and moved:
        return "unknown", f"{NO_CLOSE}, and how near it came to the target is not known"
    if nearest_m is not None and nearest_m < NEAR_M:
        within = f"{NEAR_M * 100:.0f} cm"
        return "failure", f"the hand came within {within} of the object and never closed"
    if nearest_m is None:
        return "no_grasp", "the hand never moved and never closed"
    return "no_grasp", f"the hand never closed and never came within {NEAR_M * 100:.0f} cm"


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Where the rule draws its lines; values of docs/simulation.md, "Truth rule"."""

    moved_m: float = 0.005  # m off the undisturbed path before the close
    moved_deg: float = 5.0  # degrees likewise
    overlap_m: float = 0.002  # m, penetration of hand and object put back on its path
    consecutive: int = 2  # other close times in a row that must succeed: single ones are chance
    unstable_m: float = 0.02  # m; raised by at least this and dropped: unstable, else missed
    inside_s: float = 0.06  # s, at a stretch, that an object between the fingers counts as there
    inside_share: float = 0.5  # of how deep anything can reach between the fingers; ours

    def scaled(self, name: str, factor: float) -> Thresholds:
        """The same with one threshold moved."""
        values = {n: getattr(self, n) for n in self.__slots__}
        values[name] = values[name] * factor
        return Thresholds(**values)


# a person who holds something gives way a little (docs/simulation.md, "Truth rule")
HANDED_OVER = Thresholds(moved_m=0.012)


@dataclass(frozen=True)
class Facts:
    """What is known of a failed grasp. Only `put_back` and `free_pose` may be None: not asked yet.

    displacement_m, displacement_deg: furthest off the undisturbed path before the close (of the
    whole approach if it never came). curve: (offset s from the real close, success) of other close
    times, in order; of the last possible close if it never came. contact_s: offset of the last
    instant before the displacing contact. overlap_m: penetration of hand and object put back at the
    close. put_back: with the object put back on its undisturbed path at the close (never closed: at
    first contact), the close succeeds. free_pose: likewise, from the nearest palm pose without
    penetration. height_m: greatest rise of the object.
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


@dataclass(frozen=True)
class Seen:
    """What a person at the video sees of a failed grasp; offsets s from the close.

    touched: hand or arm touched the object before the first closing motion (at all, if it never
    came). displacement_m, displacement_deg: as in `Facts`. reach: of every control period from
    where the hand first was near the object to 0.6 s after the close (offset s; how far the object
    reached into the region that the hand closes in, as a share of how deep anything can; how deep
    its centre was in it, m; both negative outside). met_s: when the closing fingers first touched
    the object or, on nothing, came to rest; None without a close, or later than that.
    """

    closed: bool
    touched: bool
    displacement_m: float
    displacement_deg: float
    reach: tuple[tuple[float, float, float], ...]
    met_s: float | None


@dataclass(frozen=True, slots=True)
class SubCause:
    """A row of the table of sub-causes.

    when: of a failure of this class with these facts and shift s, whether it is this sub-cause; the
    first row that holds is taken. sentence: what happened, with the fields of
    `verdict.sentence.fields_of`. hint: what to look at first.
    """

    name: str
    failure_class: FailureClass
    when: Callable[[Facts, float | None, Thresholds], bool]
    sentence: str
    hint: str


SUB_CAUSES: tuple[SubCause, ...] = (
    SubCause(
        "displaced",
        "collision",
        lambda facts, shift, th: True,
        "{link} pushed the object{pushed_at}; it was {off_mm:.0f} mm and {off_deg:.0f} degrees off "
        "its path by the close, and on its path it could be lifted",
        "the approach direction and the pre-shape of the link that pushed",
    ),
    SubCause(
        "never",
        "timing",
        lambda facts, shift, th: not facts.closed,
        "Closing at {good_at} would have lifted the object",
        "the condition that releases the close",
    ),
    SubCause(
        "early",
        "timing",
        lambda facts, shift, th: shift is not None and shift > 0,
        "The same approach closed {shift_s:.2f} s {direction}, at {good_at}, lifts the object",
        "the threshold that releases the close: it is reached before the hand is there",
    ),
    SubCause(
        "late",
        "timing",
        lambda facts, shift, th: True,
        "The same approach closed {shift_s:.2f} s {direction}, at {good_at}, lifts the object",
        "latency, and the threshold that releases the close",
    ),
    SubCause(
        "unstable",
        "imprecise_pose",
        lambda facts, shift, th: facts.height_m >= th.unstable_m,
        "The object was lifted and slipped; no close from {first_s:+.1f} s to {last_s:+.1f} s "
        "lifts it{pushed_too}",
        "the choice of the grasp: what it holds gives way",
    ),
    SubCause(
        "missed",
        "imprecise_pose",
        lambda facts, shift, th: True,
        "The object was not in the grasp; no close from {first_s:+.1f} s to {last_s:+.1f} s "
        "lifts it{pushed_too}",
        "the object's believed pose against hindsight's, and the servo's error at the close",
    ),
)  # fmt: skip


def sub_cause_named(name: str) -> SubCause:
    """The table's row; KeyError for a name that is not in it."""
    for row in SUB_CAUSES:
        if row.name == name:
            return row
    raise KeyError(f"no sub-cause {name!r} in failure_rule.SUB_CAUSES")


@dataclass(frozen=True, slots=True)
class Verdict:
    """Class and sub-cause of a failure; shift_s: by how much later the close works, s."""

    failure_class: FailureClass
    sub_cause: str
    shift_s: float | None = None


@dataclass(frozen=True, slots=True)
class Needs:
    """The rule can't go on without this fact."""

    fact: Fact


def classify(facts: Facts, thresholds: Thresholds | None = None) -> Verdict | Needs:
    """The class of a failed grasp, or the fact that decides it; the first step that applies.

    1. Never closed: another close time would do → timing. Moved, and the object put back at first
       contact would have been grasped → collision. Else imprecise pose.
    2. Moved before the close, and put back on its path without penetration: that succeeds →
       collision; else go on with step 4.
    3. Moved, and put back it penetrates the hand: a close before the contact succeeds → timing. The
       nearest palm pose that is free succeeds → collision; else imprecise pose.
    4. Another close time succeeds → timing.
    5. Else imprecise pose.
    """
    th = thresholds or Thresholds()
    moved = facts.displacement_m > th.moved_m or facts.displacement_deg > th.moved_deg
    shift = nearest_run(facts.curve, th.consecutive)

    def verdict(failure_class: FailureClass, shift_s: float | None = None) -> Verdict:
        row = next(
            r for r in SUB_CAUSES if r.failure_class == failure_class and r.when(facts, shift_s, th)
        )
        return Verdict(failure_class, row.name, shift_s)

    if not facts.closed:  # 1
        if shift is not None:
            return verdict("timing", shift)
        if not moved:
            return verdict("imprecise_pose")
        if facts.put_back is None:
            return Needs("put_back")
        return verdict("collision" if facts.put_back else "imprecise_pose")
    if moved:
        if facts.put_back is None:
            return Needs("put_back")
        if facts.overlap_m <= th.overlap_m:  # 2
            if facts.put_back:
                return verdict("collision")
        else:  # 3
            before = tuple(
                c for c in facts.curve if facts.contact_s is not None and c[0] <= facts.contact_s
            )
            earlier = nearest_run(before, th.consecutive)
            if earlier is not None:
                return verdict("timing", earlier)
            if facts.free_pose is None:
                return Needs("free_pose")
            return verdict("collision" if facts.free_pose else "imprecise_pose")
    if shift is not None:  # 4
        return verdict("timing", shift)
    return verdict("imprecise_pose")  # 5


def observed(seen: Seen, thresholds: Thresholds | None = None) -> FailureClass:
    """The class that a person at the video would write, which is what the papers' tables count.

    1. The object was touched and moved before the close → collision.
    2. It was between the fingers for 60 ms at a stretch, and the hand never closed, or met it or
       came to rest when it was not → timing.
    3. Else imprecise pose.

    Between the fingers: it reaches at least half as deep into the region that the hand closes in as
    anything can. Of its centre that can't be asked: things that are held by their end have it
    outside. Nothing here asks whether another close would have held.
    """
    th = thresholds or Thresholds()
    moved = seen.displacement_m > th.moved_m or seen.displacement_deg > th.moved_deg
    if seen.touched and moved:
        return "collision"
    longest, began = 0.0, None
    for offset, share, _ in seen.reach:
        if share < th.inside_share:
            began = None
            continue
        began = offset if began is None else began
        longest = max(longest, round(offset - began, 6))
    if longest < th.inside_s:
        return "imprecise_pose"
    if not seen.closed:
        return "timing"
    met_s = seen.reach[-1][0] if seen.met_s is None else seen.met_s
    share_then = min(seen.reach, key=lambda r: abs(r[0] - met_s))[1]
    return "imprecise_pose" if share_then >= th.inside_share else "timing"


def nearest_run(curve: tuple[tuple[float, bool], ...], consecutive: int) -> float | None:
    """Offset s, nearest to 0, of a close time in a run of at least `consecutive` successes.

    The failure at 0 parts runs. None where there is no such run.
    """
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
