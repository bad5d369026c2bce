"""The closing motion of a described hand, as its own trial recorded it.

A joint that came to rest with nothing beside its finger stops there at any other close too: a width
that was commanded is no limit. One that something may have stopped goes on at its last free speed:
to where it rests after a lift that left the object behind, where the log has one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, invert, transform
from dgeval.perception.self_filter import signed_distance
from dgeval.robots.described_hand import DescribedHand
from dgeval.worlds.closing import CONTROL_S, SETTLE_S

LONGEST_S = 3.0  # s, that a hand needs to close at most; ours
# share of the fastest motion: above it a joint moves, and at half of its usual speed it is slowed
MOVING, SLOWED = 0.05, 0.5
REST_TICKS = 10  # control periods, over which it is told whether a joint stands
# share of the fastest motion over so long, up to which it stands: encoders tremble; ours
STANDS = 0.1
SETTLED = 0.01  # share of its way, within which a joint is where it comes to rest; ours
BESIDE_M = 0.010  # m; a finger so near to the object may have been stopped; ours
TOGETHER_TICKS = 5  # control periods, within which fingers come to rest together; ours
STILL_CLOSED = 0.5  # share of how far a joint had closed when it first stood; ours
LEAST_MOVED = 0.02  # share of a joint's range, or rad and m, by which it moves if it closes at all


@dataclass(frozen=True)
class Closing:
    """How a hand closes with nothing in its way, by its joints (k,), rad or m.

    before (k,): at the close command. way (m, k): at the control periods after it. speeds (k,): per
    control period, with which a joint that something may have stopped goes on after the way. until
    (k,): where they rest with nothing between the fingers, beyond which none goes; None where that
    is not known.
    """

    before: Array
    way: Array
    speeds: Array
    until: Array | None = None

    @property
    def lasts_s(self) -> float:
        """From the command to rest, s."""
        return len(self.way) * CONTROL_S


def recorded_closing(
    hand: DescribedHand, before: Array, path: Array, points: Array, empty: Array | None = None
) -> Closing | None:
    """The closing motion that was recorded; None where the hand did not move.

    before (k,): its joints at the close command. path (m, k): at the control periods after it, rad
    or m, as far as recorded. points (n, 3) m: the object at the close, which may stop a finger, in
    its base frame. empty (k,): where the joints rest after the hand has lifted and left the object
    behind; None where the log does not go so far.
    """
    if len(path) < REST_TICKS:
        return None
    rest = np.median(path[-REST_TICKS:], axis=0)
    least = LEAST_MOVED * hand.geometry.spans
    moved = np.abs(rest - before) > least
    if not moved.any():
        return None
    q = np.vstack([before, path])  # by period
    stands = np.array([_first_stands(q[:, k], least[k]) for k in range(len(before))])
    if empty is not None and _is_open_again(q, stands, empty, least):
        empty = None
    stopped = _may_be_stopped(hand, q[stands, np.arange(len(before))], points)
    if (free := moved & ~stopped).any():
        # fingers that end with those that nothing is beside end where they were sent
        stopped &= stands < stands[free].max() - TOGETHER_TICKS
    settled = np.abs(_without_outliers(q) - rest) <= SETTLED * np.abs(rest - before)
    rests = [int(np.flatnonzero(~settled[:, k])[-1]) + 2 for k in np.flatnonzero(moved)]
    ends = np.where(stopped[moved], stands[moved], rests)
    last = int(min(max(1, ends.max()), len(path)))  # periods from the command to rest
    way = path[:last].copy()
    way[-1, moved & ~stopped] = rest[moved & ~stopped]
    speeds = np.zeros(len(rest))
    for k in np.flatnonzero(moved & stopped):
        own = np.abs(np.diff(q[: stands[k] + 1, k]))
        usual = float(np.median(own[own > MOVING * own.max()]))
        until = int(np.flatnonzero(own >= SLOWED * usual)[-1]) + 1
        speed = float(np.sign(q[stands[k], k] - before[k])) * usual
        way[until:, k] = q[until, k] + speed * np.arange(1, last - until + 1)
        speeds[k] = speed
    return Closing(before, np.clip(way, *hand.geometry.limits), speeds, empty)


def _is_open_again(q: Array, stands: NDArray[np.int_], empty: Array, least: Array) -> bool:
    """Whether a joint that had closed where it first stood rests much farther open.

    q (m, k): positions by period. stands (k,): where each stood first. empty, least (k,): where
    they rest, and motion that counts, rad or m.
    """
    stood = np.abs(q[stands, np.arange(len(stands))] - q[0])
    return bool(((stood > least) & (np.abs(empty - q[0]) < STILL_CLOSED * stood)).any())


def _without_outliers(q: Array) -> Array:
    """The positions (m, k), each the median of five periods."""
    padded = np.pad(q, ((2, 2), (0, 0)), mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0), -1))


def _first_stands(q: Array, least: float) -> int:
    """The period of the positions (m,) from which on a joint stands after it has moved, for the
    first time; the last one where it never does. least: motion that counts, rad or m.

    What stopped it may let go later, and it snaps shut.
    """
    over = np.abs(q[REST_TICKS:] - q[:-REST_TICKS])
    fastest = np.maximum.accumulate(over)
    standing = np.flatnonzero((over <= STANDS * fastest) & (fastest >= least))
    return int(standing[0]) if len(standing) else len(q) - 1


def closing_as(
    hand: DescribedHand, closing: Closing, source: Literal["recorded", "estimates"]
) -> DescribedHand:
    """The hand with that closing motion, of this trial (`recorded`) or of another one."""
    lower, upper = hand.geometry.limits
    if closing.until is not None:
        closes = np.abs(closing.until - closing.before) > LEAST_MOVED * hand.geometry.spans
        until = np.where(closes, closing.until, np.nan)  # what does not close is where it was put
        upper = np.where(until > closing.before, np.minimum(upper, until), upper)
        lower = np.where(until < closing.before, np.maximum(lower, until), lower)
    # the fingers before this trial's own close are its own
    opened = closing.before if source == "recorded" else hand.geometry.open
    geometry = replace(hand.geometry, open=opened)
    end = closing.way[-1] + closing.speeds * LONGEST_S / CONTROL_S + opened - closing.before
    end = np.clip(end, lower, upper)
    return replace(
        hand,
        geometry=geometry,
        centre=geometry.meeting(np.where(np.isfinite(end), end, closing.way[-1])),
        close_s=closing.lasts_s,
        lift_after_s=closing.lasts_s + SETTLE_S,
        targets=partial(_along, closing, lower, upper, hand.lags_s),
        closing_source=source,
    )


def _may_be_stopped(hand: DescribedHand, rest: Array, points: Array) -> NDArray[np.bool_]:
    """(k,) by joint, whether something is beside its finger where it came to rest."""
    beside = dict.fromkeys(hand.geometry.links.fingers, False)
    if not len(points):
        return np.zeros(len(rest), dtype=bool)
    for shape, T in hand.geometry.shapes(rest):
        finger = next((f for f in beside if shape.link in f), None)
        if finger is not None and not beside[finger]:
            near = signed_distance(shape, transform(invert(T), points)).min()
            beside[finger] = bool(near < BESIDE_M)
    of = [next(f for f in beside if joint.child in f) for joint in hand.geometry.joints]
    return np.array([beside[finger] for finger in of])


def slowed(hand: DescribedHand, factor: float) -> DescribedHand:
    """The hand whose whole closing motion takes `factor` times as long."""
    return replace(
        hand,
        close_s=factor * hand.close_s,
        lift_after_s=max(hand.lift_after_s, factor * hand.close_s),
        targets=partial(_at_pace, hand.targets, factor),
    )


def _at_pace(
    targets: Callable[[float, Array], Array], factor: float, since_close: float, preshape: Array
) -> Array:
    return targets(since_close / factor, preshape)


def _along(
    closing: Closing,
    lower: Array,
    upper: Array,
    lags: Array,
    since_close: float,
    preshape: Array,
) -> Array:
    """Targets (k,) of the drives a time, s, after the close command, from where they were.

    lags (k,) s: by which each drive follows its target too late. Its target is so far ahead, so
    that the joints themselves move as recorded.
    """
    before, way, speeds = closing.before, closing.way, closing.speeds
    path = np.vstack([before, way])
    ticks = (since_close + lags) / CONTROL_S
    last = len(way)
    k = np.minimum(ticks.astype(int), last - 1)
    joints = np.arange(len(before))
    first = path[k, joints]
    at = first + np.minimum(ticks - k, 1.0) * (path[k + 1, joints] - first)
    at = at + speeds * np.maximum(ticks - last, 0.0)
    return np.asarray(np.clip(preshape + at - before, lower, upper))
