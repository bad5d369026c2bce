"""When the fingers close and the palm rises, by the recorded joints.

The close is the start of the last closing motion before the palm rises: the fingers' solids come
nearer to each other by at least a fifth of what they ever do, within 1.5 s. Fingers that move
without a lift after it are no proof of a grasp.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array
from dgeval.recording.grippers import MOVES_BY, WITHIN_S
from dgeval.recording.robot import RobotStates

LEAST_M = 0.004  # m, least range of a hand that is said to close at all; ours
STEP_NS = 10_000_000  # ns, between the times at which the hand is looked at
PARTS = 0.5  # of the largest change of a distance between two fingertips; ours
LEAST_SEEN = 10  # times at which the fingers are known, to be seen; ours
STILL_NS = 100_000_000  # ns; a closing motion may pause for so long
RESTING_NS = 250_000_000  # ns; fingers that met the object may go on within so long; ours
# ns; for so long their tips may draw apart between, as those of fingers do that curl past each
# other, if they never rest: ns over which that is seen, share of their speed before; ours
CURLING_NS, SEEN_NS, GOES_ON = 600_000_000, 50_000_000, 0.2
SAME_LIFT_NS = 50_000_000  # ns, between two sights of one lift at most; ours
# ns; fingers that begin to move less than this before the palm rises, or while it does, slip or
# press on as the object is lifted: that is no close
BEFORE_LIFT_NS = 120_000_000
# m and s: the palm begins to rise within AFTER_S of the fingers' coming to rest, and is up by
# RISES_M within RISES_S of that; ours
RISES_M, RISES_S, AFTER_S = 0.05, 1.0, 1.0
# s after the close, when fingers have settled on what they hold; shares of the way that they
# closed, by which they have opened again at the end, and begin to; ours
SETTLED_S, REOPENED, BEGINS = (1.0, 1.5), 0.6, 0.1
OPEN_LEAST = 10  # times at which a hand is open that then closes again; ours
RISING_M = 0.005  # m, from which on it is rising
OVER_NOISE = 3.0  # standard deviations, by which a motion of the fingers stands out; ours
MOST_HALF = 25  # samples on each side, over which fingers are smoothed at most; ours
# of a closing motion's largest speed, below which fingers only give way; of its way, by which they
# have closed faster than that where they close in earnest; ours
CREEPS, IN_EARNEST = 0.1, 0.1
MOST_GAP_NS = 500_000_000  # ns between states, in which a close can't be placed; ours
EDGE_NS = 50_000_000  # ns, beside a hole's edge, where a motion in it seems to begin; ours
SEEN = 0.9  # share of the trial in which the fingers must be known, to say that they never closed


@dataclass(frozen=True)
class Inferred:
    """Close, when the fingers come to rest, and lift, ns, and how far the fingers' states are apart
    at the close, s; closes of earlier attempts, ns.
    """

    close_ns: int
    rest_ns: int
    lift_ns: int
    period_s: float
    earlier_ns: tuple[int, ...] = ()


@dataclass(frozen=True)
class NoClose:
    """Why the fingers show no close; whether they were seen throughout; when a motion begins that
    no lift follows, ns.
    """

    why: str
    fingers_seen: bool
    motion_ns: int | None = None


def closing_motion(robot: RobotStates, first_ns: int, last_ns: int) -> Inferred | NoClose:
    """The last closing motion before the palm rises, or why the fingers show none."""
    tips = finger_ends(robot)
    if len(tips) < 2:
        return NoClose(
            ", and no fingers that move are known "
            "(joint states of the hand and a robot description are needed)",
            False,
        )
    times, places = _places(robot, tips, first_ns, last_ns)
    width = _width(places)
    if len(times) < 20:
        return NoClose(", and the fingers' joint states are not recorded", False)
    seen = len(times) * STEP_NS >= SEEN * (last_ns - first_ns)
    if float(np.ptp(width)) < LEAST_M:
        return NoClose(", and the fingers hardly move", seen)
    motions = _closing_motions(times, width)
    if not motions:
        k = int(np.argmax(np.diff(times)))
        if times[k + 1] - times[k] > MOST_GAP_NS:
            a, b = ((int(t) - first_ns) * 1e-9 for t in times[k : k + 2])
            why = f", and between {a:+.2f} and {b:+.2f} s no states of the fingers are recorded"
            return NoClose(why, False)
        return NoClose(", and the fingers never close", seen)
    attempts: list[tuple[int, int, int]] = []  # close, rest and lift, the last first
    for k in reversed(range(len(motions))):
        start, end = motions[k]
        while k and (
            start - motions[k - 1][1] < RESTING_NS
            or (robot.palm_frame is not None and _goes_on(times, places, motions[k - 1], start))
        ):
            k -= 1
            start = motions[k][0]
        lift = lift_after(robot, start, end, last_ns)
        # motions before one lift are one attempt, of which the last begins it
        if lift is None or lift - start < BEFORE_LIFT_NS:
            continue
        if all(abs(lift - at) > SAME_LIFT_NS for *_, at in attempts):
            attempts.append((start, end, lift))
    if attempts:
        start, rest, _ = attempts[0]
        before, after = _apart(robot, tips, start - EDGE_NS, rest)
        if after - before > MOST_GAP_NS:
            a, b = ((t - first_ns) * 1e-9 for t in (before, after))
            why = f"; fingers close between {a:+.2f} and {b:+.2f} s, where no states are recorded"
            return NoClose(why, False, before)
        earlier = tuple(start for start, *_ in attempts[:0:-1])
        before, after = _apart(robot, tips, start - EDGE_NS, start + EDGE_NS)
        return Inferred(*attempts[0], (after - before) * 1e-9, earlier)
    at = (motions[-1][0] - first_ns) * 1e-9
    rises = lift_after(robot, *motions[-1], last_ns) is not None
    why = f"; fingers close at {at:+.2f} s, but " + (
        "with the palm's rise and not before it, as they do where something held them open"
        if rises
        else "the palm does not rise after it"
    )
    return NoClose(why, seen, motions[-1][0])


def _apart(
    robot: RobotStates, tips: tuple[str, ...], start_ns: int, end_ns: int
) -> tuple[int, int]:
    """Two recorded states of the fingers, one after the other, ns, that are farthest apart of those
    from just before a time to just after another; the first time twice where none are recorded.
    """
    tree, links = robot.tree, set(robot.hand_links)
    joints = robot.description.joints if robot.description else {}
    pairs = [(start_ns, start_ns)]
    for link in {above for tip in tips for above in tree.ancestors(tip) if above in links}:
        times: list[int] = []
        if link in tree.moving:
            times = tree.moving[link][1].times
        elif link in joints:
            known = robot.joints.times
            times = known.get(joints[link].name) or known.get(joints[link].follows, [])
        first = max(bisect_right(times, start_ns) - 1, 0)
        around = times[first : bisect_left(times, end_ns + 1) + 1]
        pairs.extend(pairwise(around))
    return max(pairs, key=lambda pair: (pair[1] - pair[0], -pair[0]))


def opens_after(robot: RobotStates, t_ns: int, last_ns: int) -> bool:
    """Whether the fingers part after a time and do not close first; False where none are seen."""
    tips = finger_ends(robot)
    if len(tips) < 2:
        return False
    until = min(t_ns + round(WITHIN_S * 1e9), last_ns)
    width = _width(_places(robot, tips, t_ns, until)[1])
    if len(width) < 2 or width.min() < width[0] - LEAST_M / 2:
        return False
    return bool(width[-1] - width[0] > LEAST_M)


def fingers_seen(robot: RobotStates, first_ns: int, last_ns: int) -> bool:
    """Whether it is known between two times how far the fingers are apart."""
    tips = finger_ends(robot)
    return len(tips) >= 2 and len(_places(robot, tips, first_ns, last_ns)[0]) >= LEAST_SEEN


def release_after(
    robot: RobotStates, close_ns: int, last_ns: int, lift_ns: int | None = None
) -> int | None:
    """When a hand that has closed begins to open again, ns: for good, or at all after its lift;
    None where it does not, or its fingers are not known.
    """
    tips = finger_ends(robot)
    if len(tips) < 2:
        return None
    times, places = _places(robot, tips, close_ns, last_ns)
    since = (times - close_ns) * 1e-9
    settled = (since >= SETTLED_S[0]) & (since <= SETTLED_S[1])
    if settled.sum() < 10 or since[-1] < SETTLED_S[1]:
        return None
    if robot.palm_frame is None:  # the fingers' ends move with the arm
        places = _width(places)[:, None, None]
    held = np.median(places[settled], axis=0)
    closed = held - places[0]
    opens = robot.palm_frame is None and closed.sum() > 0
    if opens or float(np.linalg.norm(closed, axis=1).mean()) < LEAST_M / 2:
        return None
    # shares of the way that the fingers closed; a hand need not open to the shape it closed from
    back = -np.einsum("nij,ij->n", places - held, closed) / float((closed * closed).sum())
    if float(np.median(back[-10:])) >= REOPENED:
        return int(times[np.flatnonzero(back <= BEGINS)[-1]])
    if lift_ns is None:
        return None
    is_open = np.flatnonzero((back >= REOPENED) & (times > lift_ns) & (since > SETTLED_S[1]))
    if len(is_open) < OPEN_LEAST:
        return None
    return int(times[np.flatnonzero(back[: is_open[0]] <= BEGINS)[-1]])


def finger_ends(robot: RobotStates) -> tuple[str, ...]:
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


def _places(
    robot: RobotStates, tips: tuple[str, ...], first_ns: int, last_ns: int
) -> tuple[NDArray[np.int64], Array]:
    """Times, ns, at which all ends of the fingers are known, and their middles (n, tips, 3), m,
    palm frame; of a robot without one its base frame.
    """
    assert robot.description is not None
    middle = {
        tip: np.append(
            np.mean([s.T_link_shape[:3, 3] for s in robot.description.shapes[tip]], axis=0), 1.0
        )
        for tip in tips
    }
    times, places = [], []
    root = robot.palm_frame or robot.base_frame or tips[0]
    for t_ns in range(first_ns, last_ns + 1, STEP_NS):
        here = []
        for tip in tips:
            T = robot.tree.lookup(root, tip, t_ns)
            if T is None:
                break
            here.append((T @ middle[tip])[:3])
        if len(here) == len(tips):
            times.append(t_ns)
            places.append(here)
    return np.array(times, dtype=np.int64), np.array(places).reshape(-1, len(tips), 3)


def _width(places: Array) -> Array:
    """Mean distance between the ends of the fingers, m, over time: of those pairs of which it
    changes most, as bars of a linkage and fingers side by side hardly part.
    """
    pairs = combinations(range(places.shape[1]), 2)
    apart = np.array([np.linalg.norm(places[:, a] - places[:, b], axis=1) for a, b in pairs])
    if not apart.shape[1]:
        return np.empty(0)
    ranges = np.ptp(apart, axis=1)
    return np.asarray(apart[ranges >= PARTS * ranges.max()].mean(axis=0))


def _goes_on(
    times: NDArray[np.int64], places: Array, before: tuple[int, int], start_ns: int
) -> bool:
    """Whether fingers keep moving from a motion, from and to ns, to the start of the next one."""
    first, end = (int(np.searchsorted(times, t)) for t in before)
    start = int(np.searchsorted(times, start_ns))
    step = SEEN_NS // STEP_NS
    if start_ns - before[1] > CURLING_NS or end - first < step or start - end < step:
        return False
    moved = np.linalg.norm(places[step:] - places[:-step], axis=2).mean(axis=1)
    return bool(moved[end : start - step + 1].min() > GOES_ON * moved[first : end - step + 1].max())


def _closing_motions(times: NDArray[np.int64], width: Array) -> list[tuple[int, int]]:
    """Start and end, ns, of the motions that narrow the hand enough."""
    span = float(np.ptp(width))
    least = MOVES_BY * span / WITHIN_S
    noise = _noise(width)
    half = _half_window(noise, least)
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    over = np.pad(width, half, mode="edge")
    smooth = np.convolve(over, kernel, mode="valid")
    rate = np.gradient(smooth, times * 1e-9)
    if half > 1:  # of a line through the window, which noise moves least
        steps = np.arange(half, -half - 1, -1)
        rate = np.convolve(over, steps / (steps @ steps), mode="valid") / (STEP_NS * 1e-9)
    closing = rate < -least
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
            at = _after_creep(smooth, rate, k, end)
            out.append((_start(times, width, at, end, noise), int(times[end])))
        k = end + 1
    return out


def _after_creep(smooth: Array, rate: Array, k: int, end: int) -> int:
    """Where a motion from k to end begins in earnest: fingers that lean on the ground or the object
    give way slowly before they close. Fingers that stop on the way have begun before.
    """
    fastest = k + int(np.argmin(rate[k : end + 1]))
    is_slow = rate[k : end + 1] > CREEPS * rate[fastest]
    way = np.where(is_slow[:-1], 0.0, -np.diff(smooth[k : end + 1]))
    made = np.flatnonzero(np.cumsum(way) > IN_EARNEST * (smooth[k] - smooth[end]))
    before = np.flatnonzero(is_slow[: int(made[0])] if len(made) else is_slow[:0])
    return k + int(before[-1]) + 1 if len(before) else k


def _noise(width: Array) -> float:
    """Standard deviation, m, of one sample, by the steps between two; 0 of rounded numbers."""
    return float(1.4826 * np.median(np.abs(np.diff(width))) / np.sqrt(2.0))


def _half_window(noise: float, least: float) -> int:
    """Samples on each side over which a rate of `least`, m/s, stands out of the noise, m."""
    # of a line through n samples the slope's variance is 12 noise^2 / n^3 / period^2
    count = (12 * (OVER_NOISE * noise / (least * STEP_NS * 1e-9)) ** 2) ** (1 / 3)
    return int(np.clip(count / 2, 1, MOST_HALF))


def _start(times: NDArray[np.int64], width: Array, k: int, end: int, noise: float) -> int:
    """When a motion that is seen from k on began: its first steep part, carried back to the level
    before it. noise, m: of one sample.
    """
    before = slice(max(0, k - 12), max(1, k - 2))
    level, drop = float(np.median(width[before])), float(width[before].min() - width[end])
    inside = np.arange(max(0, k - 3), end + 1)
    first, second = max(0.05 * drop, OVER_NOISE * noise), max(0.20 * drop, 2 * OVER_NOISE * noise)
    some = next((i for i in inside if width[i] < level - first), k)
    more = next((i for i in inside if i > some and width[i] < level - second), some)
    if more == some or width[some] == width[more]:
        return int(times[k])
    slope = (width[more] - width[some]) / float(times[more] - times[some])
    back = (level - width[some]) / slope
    return int(np.clip(times[some] + back, times[max(0, k - 12)], times[some]))


def lift_after(robot: RobotStates, close_ns: int, rest_ns: int, last_ns: int) -> int | None:
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
