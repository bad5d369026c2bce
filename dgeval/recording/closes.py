"""The moment of closing: as recorded, as a person says, or as the fingers show it.

Nobody but dgeval writes /dgeval/events. Without a close in the log, the close is the start of the
last closing motion before the palm rises: the fingers' solids come nearer to each other by at least
a fifth of what they ever do, within 1.5 s. Fingers that move without a lift after it are no proof
of a grasp, so nothing is inferred from them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array
from dgeval.recording.contract import (
    CLOSE_EVENT,
    LIFT_EVENT,
    TRIAL_END_EVENT,
)
from dgeval.recording.events import Events
from dgeval.recording.grippers import (
    GRIPPER_WORDS,
    MOVES_BY,
    WITHIN_S,
    GripperTrack,
    is_command_topic,
)
from dgeval.recording.messages import Event
from dgeval.recording.robot import RobotStates
from dgeval.recording.scan import Scan

CloseSource = Literal["event", "manifest", "command", "joints", "width"]

LEAST_M = 0.004  # m, least range of a hand that is said to close at all; ours
STEP_NS = 10_000_000  # ns, between the times at which the hand is looked at
STILL_NS = 100_000_000  # ns; a closing motion may pause for so long
RESTING_NS = 250_000_000  # ns; fingers that met the object may go on within so long; ours
# ns; fingers that begin to move less than this before the palm rises, or while it does, slip or
# press on as the object is lifted: that is no close
BEFORE_LIFT_NS = 120_000_000
# m and s: the palm begins to rise within AFTER_S of the fingers' coming to rest, and is up by
# RISES_M within RISES_S of that; ours
RISES_M, RISES_S, AFTER_S = 0.05, 1.0, 1.0
RISING_M = 0.005  # m, from which on it is rising
SEEN = 0.9  # share of the trial in which the fingers must be known, to say that they never closed
MENDS = "mark it with --close TIME, or close_ns in a manifest"


@dataclass(frozen=True)
class CloseKnown:
    """What is known of a trial's close.

    events: with the close, and a lift where the palm shows one. source: None without a close.
    missing: why no close is known; None where one is, or where the hand is known not to have
    closed. note: for the trial's row, "" without. fingers_ns: when the fingers are seen to begin to
    close; None where that is not seen.
    """

    events: Events
    source: CloseSource | None
    missing: str | None
    note: str = ""
    fingers_ns: int | None = None


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
    found = _inferred(robot, first_ns, last_ns)
    fingers_ns = None if isinstance(found, NoClose) else found[0]
    if lift_ns is not None:
        events = _with(events, LIFT_EVENT, lift_ns)
    if given_ns is not None:
        at = (given_ns - first_ns) * 1e-9
        note = f"the close at {at:+.2f} s is as given, not as recorded"
        events = _with(events, CLOSE_EVENT, given_ns)
        return CloseKnown(events, "manifest", None, note, fingers_ns)
    if events.first_ns(CLOSE_EVENT) is not None:
        return CloseKnown(events, "event", None, "", fingers_ns)
    told = _by_grippers(robot, grippers, first_ns, last_ns, commands=True)
    if told is None and isinstance(found, NoClose) and not found.fingers_seen:
        told = _by_grippers(robot, grippers, first_ns, last_ns, commands=False)
    if told is not None:
        track, close_ns, lift_at = told
        events = _with(events, CLOSE_EVENT, close_ns)
        if lift_ns is None:
            events = _with(events, LIFT_EVENT, lift_at)
        at = (close_ns - first_ns) * 1e-9
        how = "is told to move" if track.is_command else "moves"
        note = (
            f"no close event is recorded; {track.topic} {how} at {at:+.2f} s, for the last time "
            f"before the palm rises: taken for the close; if that is wrong: {MENDS}"
        )
        source: CloseSource = "command" if track.is_command else "width"
        return CloseKnown(events, source, None, note, fingers_ns)
    if isinstance(found, NoClose):
        ended = events.first_ns(TRIAL_END_EVENT) is not None
        still = found.motion_ns is None and not any(
            first_ns <= start <= last_ns for track in grippers for start, _ in track.changes()
        )
        if found.fingers_seen and (ended or still):
            # the fingers never closed, or the robot writes its events and none is a close
            note = ""
            if found.motion_ns is not None:
                at = (found.motion_ns - first_ns) * 1e-9
                note = (
                    f"fingers close at {at:+.2f} s and the palm does not rise after it: taken for "
                    f"pre-shaping, as the trial's end is marked and no close; if it is one: {MENDS}"
                )
            return CloseKnown(events, None, None, note)
        return CloseKnown(events, None, f"no moment of closing is marked{found.why}; {MENDS}")
    close_ns, lift_at, period_s = found
    events = _with(events, CLOSE_EVENT, close_ns)
    if lift_ns is None:
        events = _with(events, LIFT_EVENT, lift_at)
    at = (close_ns - first_ns) * 1e-9
    note = (
        f"no close command is recorded; the fingers begin to close at {at:+.2f} s "
        f"(± {max(period_s, 0.03):.2f} s), before the palm rises; if that is wrong: {MENDS}"
    )
    return CloseKnown(events, "joints", None, note, fingers_ns)


def _by_grippers(
    robot: RobotStates,
    grippers: tuple[GripperTrack, ...],
    first_ns: int,
    last_ns: int,
    commands: bool,
) -> tuple[GripperTrack, int, int] | None:
    """The track that shows a close, the close and the lift, ns; None without.

    The last change of each track before the palm rises; of several tracks the latest, by then all
    have been told.
    """
    best = None
    for track in grippers:
        if track.is_command != commands:
            continue
        for start, end in reversed(track.changes()):
            if not first_ns <= start <= last_ns:
                continue
            rest = end if end > start else end + round(WITHIN_S * 1e9)
            lift = _lift(robot, start, rest, last_ns)
            if lift is not None and lift - start >= BEFORE_LIFT_NS:
                if best is None or start > best[1]:
                    best = track, start, lift
                break
    return best


def _with(events: Events, kind: str, t_ns: int) -> Events:
    """The events with one of a kind at a time, in place of those of that kind."""
    kept = [e for e in events if e.kind != kind]
    return replace(
        events, entries=tuple(sorted([*kept, Event(t_ns, kind, {})], key=lambda e: e.t_ns))
    )


@dataclass(frozen=True)
class NoClose:
    """Why the fingers show no close; whether they were seen throughout; when a motion begins that
    no lift follows, ns.
    """

    why: str
    fingers_seen: bool
    motion_ns: int | None = None


def _inferred(robot: RobotStates, first_ns: int, last_ns: int) -> tuple[int, int, float] | NoClose:
    """Close and lift, ns, and the period of the joint states, s; or why they are not known."""
    tips = _finger_ends(robot)
    if len(tips) < 2:
        return NoClose(
            ", and no fingers that move are known "
            "(joint states of the hand and a robot description are needed)",
            False,
        )
    times, width = _width(robot, tips, first_ns, last_ns)
    if len(times) < 20:
        return NoClose(", and the fingers' joint states are not recorded", False)
    seen = len(times) * STEP_NS >= SEEN * (last_ns - first_ns)
    if float(np.ptp(width)) < LEAST_M:
        return NoClose(", and the fingers hardly move", seen)
    motions = _closing_motions(times, width)
    if not motions:
        return NoClose(", and the fingers never close", seen)
    for k in reversed(range(len(motions))):
        start, end = motions[k]
        while k and start - motions[k - 1][1] < RESTING_NS:
            k -= 1
            start = motions[k][0]
        lift = _lift(robot, start, end, last_ns)
        if lift is not None and lift - start >= BEFORE_LIFT_NS:
            period = float(np.median(np.diff(times))) * 1e-9
            return start, lift, period
    at = (motions[-1][0] - first_ns) * 1e-9
    why = f"; fingers close at {at:+.2f} s, but the palm does not rise after it"
    return NoClose(why, seen, motions[-1][0])


def _finger_ends(robot: RobotStates) -> tuple[str, ...]:
    """The hand's links with a shape, below which there is no other one, and that can move."""
    description = robot.description
    if description is None:
        return ()
    links = set(robot.hand_links)
    ends = [link for link in robot.hand_links if not links & set(description.below(link)[1:])]

    def moves(link: str) -> bool:
        while link in description.joints and link in links:
            if description.joints[link].kind != "fixed":
                return True
            link = description.joints[link].parent
        return False

    return tuple(link for link in ends if moves(link))


def _width(
    robot: RobotStates, tips: tuple[str, ...], first_ns: int, last_ns: int
) -> tuple[NDArray[np.int64], Array]:
    """Mean distance between the ends of the fingers, m, over time; where all are known."""
    assert robot.description is not None
    middle = {
        tip: np.append(
            np.mean([s.T_link_shape[:3, 3] for s in robot.description.shapes[tip]], axis=0), 1.0
        )
        for tip in tips
    }
    times, widths = [], []
    root = robot.palm_frame or robot.base_frame or tips[0]
    for t_ns in range(first_ns, last_ns + 1, STEP_NS):
        places = []
        for tip in tips:
            T = robot.tree.lookup(root, tip, t_ns)
            if T is None:
                break
            places.append((T @ middle[tip])[:3])
        if len(places) == len(tips):
            times.append(t_ns)
            widths.append(np.mean([np.linalg.norm(a - b) for a, b in combinations(places, 2)]))
    return np.array(times, dtype=np.int64), np.array(widths)


def _closing_motions(times: NDArray[np.int64], width: Array) -> list[tuple[int, int]]:
    """Start and end, ns, of the motions that narrow the hand enough."""
    span = float(np.ptp(width))
    kernel = np.ones(3) / 3
    smooth = np.convolve(np.pad(width, 1, mode="edge"), kernel, mode="valid")
    rate = np.gradient(smooth, times * 1e-9)
    closing = rate < -MOVES_BY * span / WITHIN_S
    out: list[tuple[int, int]] = []
    k = 0
    while k < len(times):
        if not closing[k]:
            k += 1
            continue
        end = k
        for j in range(k, len(times)):
            if closing[j]:
                end = j
            elif times[j] - times[end] > STILL_NS:
                break
        if smooth[k] - smooth[end] >= max(MOVES_BY * span, LEAST_M / 2):
            out.append((_start(times, width, k, end), int(times[end])))
        k = end + 1
    return out


def _start(times: NDArray[np.int64], width: Array, k: int, end: int) -> int:
    """When a motion that is seen from k on began: its first steep part, carried back to the level
    before it.
    """
    before = slice(max(0, k - 12), max(1, k - 2))
    level, drop = float(np.median(width[before])), float(width[before].min() - width[end])
    inside = np.arange(max(0, k - 3), end + 1)
    some = next((i for i in inside if width[i] < level - 0.05 * drop), k)
    more = next((i for i in inside if i > some and width[i] < level - 0.20 * drop), some)
    if more == some or width[some] == width[more]:
        return int(times[k])
    slope = (width[more] - width[some]) / float(times[more] - times[some])
    back = (level - width[some]) / slope
    return int(np.clip(times[some] + back, times[max(0, k - 12)], times[some]))


def _lift(robot: RobotStates, close_ns: int, rest_ns: int, last_ns: int) -> int | None:
    """When the palm begins to rise after a close, ns; None where it does not, or is not known.

    rest_ns: when the fingers came to rest.
    """
    heights: list[tuple[int, float]] = []
    until = rest_ns + round((AFTER_S + RISES_S) * 1e9)
    for t_ns in range(close_ns, min(last_ns, until) + 1, STEP_NS):
        T = robot.T_base_palm(t_ns)
        if T is not None:
            heights.append((t_ns, float(T[2, 3])))
    if not heights:
        return None
    lowest = np.minimum.accumulate([z for _, z in heights])
    up = next((i for i, (_, z) in enumerate(heights) if z - lowest[i] > RISES_M), None)
    if up is None:
        return None
    begin = next(t for t, z in heights[: up + 1][::-1] if z - lowest[up] < RISING_M)
    if begin - rest_ns > AFTER_S * 1e9 or heights[up][0] - begin > RISES_S * 1e9:
        return None
    return begin


def gripper_tracks(scan: Scan, robot: RobotStates) -> tuple[GripperTrack, ...]:
    """What the gripper's own topics say, and joints of it that no description knows."""
    out = []
    for topic, pairs in sorted(scan.grippers.items()):
        rows = sorted(dict(pairs).items())
        kind = scan.opened.topics[topic].type
        times = np.array([t for t, _ in rows], dtype=np.int64)
        values = np.array([v for _, v in rows])
        out.append(GripperTrack(topic, is_command_topic(topic, kind), times, values))
    known = (
        set()
        if robot.description is None
        else {j.follows for j in robot.description.joints.values()}
    )
    for name, stamps in sorted(robot.joints.times.items()):
        if name not in known and any(word in name.lower() for word in GRIPPER_WORDS):
            times = np.array(stamps, dtype=np.int64)
            values = np.array(robot.joints.values[name])
            out.append(GripperTrack(f"the joint {name}", False, times, values))
    return tuple(out)
