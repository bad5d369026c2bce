"""The moment of closing: as recorded, as a person says, or as gripper or fingers show it.

Nobody but dgeval writes /dgeval/events. Where several things tell, a person goes before an event,
that before a command to the gripper, and that before the motion of the fingers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dgeval.recording.closing_motion import (
    BEFORE_LIFT_NS,
    Inferred,
    NoClose,
    closing_motion,
    lift_after,
    opens_after,
)
from dgeval.recording.contract import (
    CLOSE_EVENT,
    LIFT_EVENT,
    TRIAL_END_EVENT,
)
from dgeval.recording.events import Events
from dgeval.recording.grippers import (
    GRIPPER_WORDS,
    WITHIN_S,
    GripperTrack,
    TrackKind,
    effort_track,
    is_command_topic,
    is_effort_topic,
)
from dgeval.recording.messages import Event
from dgeval.recording.robot import RobotStates
from dgeval.recording.scan import Scan

CloseSource = Literal["event", "manifest", "command", "joints", "width", "effort"]

STILL_FINGERS = ", and the fingers, whose joint states are recorded, never close"
# ns after the fingers' rest, from which a mark is late, and after the lift's begin, up to which it
# is this close's; ours
LATE_NS, UP_NS = 50_000_000, 1_000_000_000
FAR_NS = 60_000_000_000  # ns from the images, from which on a mark's time is no time of the trial
EARLY_NS = 600_000_000  # ns, that the fingers begin to close after their command at most; ours
NOT_BY_THESE = (
    "no moment of closing is marked, and the joint states, which fail the check `joints`, show "
    "none; mend that first, or mark it with --close TIME"
)
MENDS = "mark it with --close TIME, or close_ns in a manifest"


@dataclass(frozen=True)
class CloseKnown:
    """What is known of a trial's close.

    events: with the close, and a lift where the palm shows one. source: None without a close.
    missing: why no close is known; None where one is, or where the hand is known not to have
    closed. note: for the trial's row, "" without. fingers_ns: when the fingers are seen to begin to
    close; None where that is not seen. late: in words, why the close is marked too late, "" where
    it is not. before_ns: the close of the attempt before this one; None without one. motion_ns:
    when fingers that are seen throughout close for the last time, where no lift follows and that is
    all that is missing: far from the object that is no close.
    """

    events: Events
    source: CloseSource | None
    missing: str | None
    note: str = ""
    fingers_ns: int | None = None
    late: str = ""
    before_ns: int | None = None
    motion_ns: int | None = None


def close_of(
    events: Events,
    robot: RobotStates,
    first_ns: int,
    last_ns: int,
    given_ns: int | None = None,
    lift_ns: int | None = None,
    grippers: tuple[GripperTrack, ...] = (),
) -> CloseKnown:
    """The close of a trial whose images last from first_ns to last_ns.

    By the first of these that tells: a person, an event, a gripper's command, the fingers' joints,
    a gripper's width. given_ns, lift_ns: what a person says. grippers: of the whole recording.
    """
    far = [
        e
        for e in events
        if e.kind in (CLOSE_EVENT, LIFT_EVENT)
        and not first_ns - FAR_NS <= e.t_ns <= last_ns + FAR_NS
    ]
    # of another clock, or none: they can't be placed, and a check says so
    events = Events(tuple(e for e in events if e not in far))
    found = closing_motion(robot, first_ns, last_ns)
    fingers_ns = None if isinstance(found, NoClose) else found.close_ns
    if lift_ns is not None:
        events = _with(events, LIFT_EVENT, lift_ns)
    if given_ns is not None:
        at = (given_ns - first_ns) * 1e-9
        note = f"the close at {at:+.2f} s is as given, not as recorded"
        events = _with(events, CLOSE_EVENT, given_ns)
        return CloseKnown(events, "manifest", None, note, fingers_ns)
    if events.first_ns(CLOSE_EVENT) is not None:
        events, note, before_ns = _last_attempt(events, first_ns)
        still = isinstance(found, NoClose) and found.fingers_seen and found.motion_ns is None
        if still and first_ns <= (events.first_ns(CLOSE_EVENT) or 0) <= last_ns:
            note = "; ".join(filter(None, [note, "a close is marked" + STILL_FINGERS]))
        marked_ns = events.first_ns(CLOSE_EVENT) or 0
        late = _marked_late(marked_ns, found, first_ns)
        early = _marked_early(marked_ns, fingers_ns, first_ns)
        note = "; ".join(filter(None, [note, early]))
        return CloseKnown(events, "event", None, note, fingers_ns, late, before_ns)
    told = _by_grippers(robot, grippers, first_ns, last_ns, ("command",))
    if told is None and isinstance(found, NoClose) and not found.fingers_seen:
        told = _by_grippers(robot, grippers, first_ns, last_ns, ("width",)) or _by_grippers(
            robot, grippers, first_ns, last_ns, ("effort",)
        )
    if told is not None:
        track, close_ns, lift_at, risen_before = told
        if risen_before is not None and track.kind == "command":
            one, other = (f"{(t - first_ns) * 1e-9:+.2f}" for t in (risen_before, close_ns))
            why = (
                f"{track.topic} is told to move at {one} and {other} s, and the palm rises after "
                f"both: which of them closes? --close {one} or --close {other}"
            )
            return CloseKnown(events, None, why)
        events = _with(events, CLOSE_EVENT, close_ns)
        if lift_ns is None:
            events = _with(events, LIFT_EVENT, lift_at)
        at = (close_ns - first_ns) * 1e-9
        how = {"command": "is told to move", "width": "moves", "effort": "changes"}[track.kind]
        late = ", which is when the fingers press, not when they begin to close"
        note = (
            f"no close event is recorded; {track.topic} {how} at {at:+.2f} s, for the last time "
            f"before the palm rises: taken for the close{late if track.kind == 'effort' else ''}; "
            f"if that is wrong: {MENDS}"
        )
        return CloseKnown(events, track.kind, None, note, fingers_ns)
    if isinstance(found, NoClose) and events.first_ns(LIFT_EVENT) is not None:
        why = "a lift is marked and no close: does the log begin after it?"
        return CloseKnown(events, None, f"{why} If so nothing tells how it closed; else {MENDS}")
    if isinstance(found, NoClose):
        ended = events.first_ns(TRIAL_END_EVENT) is not None
        told_to_move = any(
            first_ns <= start <= last_ns
            for track in grippers
            if track.kind != "effort"
            for start, _ in track.changes()
        )
        still = found.motion_ns is None and not told_to_move
        if found.fingers_seen and (ended or still):
            # the fingers never closed, or the robot writes its events and none is a close
            note = ""
            if found.motion_ns is not None:
                at = (found.motion_ns - first_ns) * 1e-9
                note = (
                    f"fingers close at {at:+.2f} s and the palm does not rise after it, or rises "
                    "with it: taken for no close, as the trial's end is marked and none is; if it "
                    f"is one: {MENDS}"
                )
            return CloseKnown(events, None, None, note)
        why = f"no moment of closing is marked{found.why}; {MENDS}"
        motion_ns = found.motion_ns if found.fingers_seen and not told_to_move else None
        return CloseKnown(events, None, why, motion_ns=motion_ns)
    events = _with(events, CLOSE_EVENT, found.close_ns)
    if lift_ns is None:
        events = _with(events, LIFT_EVENT, found.lift_ns)
    at = (found.close_ns - first_ns) * 1e-9
    note = (
        f"no close command is recorded; the fingers begin to close at {at:+.2f} s "
        f"(± {max(found.period_s, 0.03):.2f} s), before the palm rises"
        f"{_attempts_before(found.earlier_ns, first_ns)}; if that is wrong: {MENDS}"
    )
    before_ns = max(found.earlier_ns, default=None)
    return CloseKnown(events, "joints", None, note, fingers_ns, before_ns=before_ns)


def _marked_late(close_ns: int, found: Inferred | NoClose, first_ns: int) -> str:
    """In words, that the fingers had closed when the close was marked; "" where they had not."""
    if isinstance(found, NoClose) or not found.rest_ns + LATE_NS < close_ns < found.lift_ns + UP_NS:
        return ""
    marked, began, rested = (
        (t - first_ns) * 1e-9 for t in (close_ns, found.close_ns, found.rest_ns)
    )
    return (
        f"a close is marked at {marked:+.2f} s, and the fingers close from {began:+.2f} to "
        f"{rested:+.2f} s"
    )


def _marked_early(close_ns: int, fingers_ns: int | None, first_ns: int) -> str:
    """In words, that the fingers begin to close long after the mark; "" where they don't."""
    if fingers_ns is None or fingers_ns - close_ns <= EARLY_NS:
        return ""
    marked, began = ((t - first_ns) * 1e-9 for t in (close_ns, fingers_ns))
    return (
        f"a close is marked at {marked:+.2f} s, and the fingers begin to close at {began:+.2f} s: "
        f"if the mark is early: --close {began:+.2f}"
    )


def _last_attempt(events: Events, first_ns: int) -> tuple[Events, str, int | None]:
    """The events with the close that decides: the last before the last lift, or of all without a
    lift after one; a note on the others, and the last one before it, ns.
    """
    closes = [e.t_ns for e in events if e.kind == CLOSE_EVENT]
    if len(closes) < 2:
        return events, "", None
    lifts = [e.t_ns for e in events if e.kind == LIFT_EVENT]
    before_lift = [t for t in closes if lifts and t <= lifts[-1]]
    last = (before_lift or closes)[-1]
    after = [t for t in lifts if t >= last]
    events = _with(events, CLOSE_EVENT, last)
    if len(lifts) > 1 and after:
        events = _with(events, LIFT_EVENT, after[0])
    at = (last - first_ns) * 1e-9
    others = tuple(t for t in closes if t != last)
    note = f"the close at {at:+.2f} s decides{_attempts_before(others, first_ns)}"
    return events, note, max((t for t in closes if t < last), default=None)


def _attempts_before(closes: tuple[int, ...], first_ns: int) -> str:
    """What a note adds about the other closes of a trial; "" without."""
    if not closes:
        return ""
    listed = ", ".join(f"{(t - first_ns) * 1e-9:+.2f} s" for t in closes)
    return f" (other attempts at {listed}: for a verdict on each, a manifest with start_ns, end_ns)"


def _by_grippers(
    robot: RobotStates,
    grippers: tuple[GripperTrack, ...],
    first_ns: int,
    last_ns: int,
    kinds: tuple[TrackKind, ...],
) -> tuple[GripperTrack, int, int, int | None] | None:
    """The track that shows a close, the close, the lift, and the change before that close if the
    palm rises between them, ns; None without.

    The last change of each track before the palm rises; of several tracks the latest, by then all
    have been told. A change after which the fingers are seen to part is an opening.
    """
    best = None
    for track in grippers:
        if track.kind not in kinds:
            continue
        openings, returns = track.openings(), track.returns()
        changes = [(a, b) for a, b in track.changes() if a not in openings]
        for k, (start, end) in reversed(list(enumerate(changes))):
            if not first_ns <= start <= last_ns or opens_after(robot, start, last_ns):
                continue
            # where it is known which commands open, those that are left are attempts
            earlier = [] if openings else changes[:k]
            risen = _rises_before(robot, earlier, first_ns, start)
            if start in returns and risen is not None:
                continue  # what was lifted with the command before is let go
            lift = _lift(robot, (start, end), last_ns)
            if lift is not None and lift - start >= BEFORE_LIFT_NS:
                if best is None or start > best[1]:
                    best = track, start, lift, risen
                break
    return best


def _rises_before(
    robot: RobotStates, changes: list[tuple[int, int]], first_ns: int, until_ns: int
) -> int | None:
    """The last of some changes of a gripper, ns, if the palm rises between it and a time."""
    if not changes or changes[-1][0] < first_ns:
        return None
    return None if _lift(robot, changes[-1], until_ns) is None else changes[-1][0]


def _lift(robot: RobotStates, change: tuple[int, int], last_ns: int) -> int | None:
    """When the palm rises after a gripper's change, ns; the fingers of a command need a while."""
    start, end = change
    rest = end if end > start else end + round(WITHIN_S * 1e9)
    return lift_after(robot, start, rest, last_ns)


def _with(events: Events, kind: str, t_ns: int) -> Events:
    """The events with one of a kind at a time, in place of those of that kind."""
    kept = [e for e in events if e.kind != kind]
    return replace(
        events, entries=tuple(sorted([*kept, Event(t_ns, kind, {})], key=lambda e: e.t_ns))
    )


def gripper_tracks(scan: Scan, robot: RobotStates) -> tuple[GripperTrack, ...]:
    """What the gripper's own topics say, joints of it that no description knows, and efforts."""
    out = []
    for topic, pairs in sorted(scan.grippers.items()):
        rows = sorted(dict(pairs).items())
        kind = scan.opened.topics[topic].type
        if is_effort_topic(topic) and not is_command_topic(topic, kind):
            track = effort_track(topic, rows)
            out += [] if track is None else [track]
            continue
        times = np.array([t for t, _ in rows], dtype=np.int64)
        values = np.array([v for _, v in rows])
        what: TrackKind = "command" if is_command_topic(topic, kind) else "width"
        out.append(GripperTrack(topic, what, times, values))
    joints = [] if robot.description is None else list(robot.description.joints.values())
    # a joint that follows another may be recorded too
    known = {name for joint in joints for name in (joint.name, joint.follows)}
    for name, stamps in sorted(robot.joints.times.items()):
        if name not in known and any(word in name.lower() for word in GRIPPER_WORDS):
            times = np.array(stamps, dtype=np.int64)
            values = np.array(robot.joints.values[name])
            out.append(GripperTrack(f"the joint {name}", "width", times, values))
    efforts: dict[str, list[tuple[int, float]]] = {}
    for sample in robot.samples:
        for name, effort in sample.efforts.items():
            if any(word in name.lower() for word in GRIPPER_WORDS):
                efforts.setdefault(name, []).append((sample.t_ns, effort))
    for name, listed in sorted(efforts.items()):
        track = effort_track(name, sorted(dict(listed).items()))
        if track is not None:
            out.append(track)
    return tuple(out)
