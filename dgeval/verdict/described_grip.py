"""Whether a described hand holds something, by what its own trial shows of its fingers.

Nobody says what a grip looks like in the states of a hand that dgeval does not know. Two signs need
no other trial: fingers that closed as far as they go have nothing between them, and a finger that
holds something presses harder than it did on its way. Without efforts other trials may say where
this hand comes to rest when it closes on nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array
from dgeval.recording.messages import JointSample
from dgeval.robots.described_hand import DescribedHand

BEFORE_S, CLOSING_S = 0.5, 3.0  # s before the close, and after it, that tell how a finger moves
MOVED = 0.05  # share of a joint's range (rad and m without one), by which it closes; ours
AT_LIMIT = 0.03  # share of a joint's range, within which it has closed as far as it goes; ours
MOVING = 0.3  # share of its fastest motion, above which a joint is on its way
# a finger presses with more than so many times the effort of free motion, so many standard
# deviations of its effort up to the close, and such a share of the largest effort; ours
HARDER, NOISES, LEAST_SHARE = 3.0, 6.0, 0.1
NORMAL = 1.4826  # times the median deviation, is a normal distribution's standard deviation
FREE = (
    0.05  # quantile of the efforts on the way, which is what moves a finger through the air; ours
)
LEAST_SAMPLES = 5


@dataclass(frozen=True)
class _Closed:
    """A hand that has closed: by its joints (k,), rad or m, where they were before the close, how
    far they came, where they rest at the end; and which of them closed.

    way, last: positions and efforts (n, k) after the close, and at the end.
    """

    start: Array
    reached: Array
    rest: Array
    closed: NDArray[np.bool_]
    way: tuple[Array, Array]
    last: tuple[Array, Array]


def _closed(
    hand: DescribedHand, samples: list[JointSample], close_ns: int, end: list[JointSample]
) -> _Closed | None:
    """None where the states don't show a close, or the hand has opened again."""
    before = _of([s for s in samples if close_ns - BEFORE_S * 1e9 <= s.t_ns <= close_ns], hand)
    way = _of([s for s in samples if close_ns < s.t_ns <= close_ns + CLOSING_S * 1e9], hand)
    last = _of(end, hand)
    if min(len(x[0]) for x in (before, way, last)) < LEAST_SAMPLES:
        return None
    start, rest = (np.nanmedian(x[0], axis=0) for x in (before, last))
    reached = _farthest(way[0], start)
    span = hand.geometry.spans
    closed = np.abs(reached - start) > MOVED * span
    if not closed.any():
        return None
    if (np.abs(rest - start) < MOVED * span)[closed].all():
        return None  # the hand has opened again
    return _Closed(start, reached, rest, closed, way, last)


def rest_of_closed(
    hand: DescribedHand, samples: list[JointSample], close_ns: int, end: list[JointSample]
) -> Array | None:
    """(k,) rad or m, where the joints of a hand that has closed rest at the end; None as in
    `described_grip`, which has the same arguments.
    """
    found = _closed(hand, samples, close_ns, end)
    return None if found is None or np.isnan(found.rest).any() else found.rest


def described_grip(
    hand: DescribedHand,
    samples: list[JointSample],
    close_ns: int,
    end: list[JointSample],
    empty: Array | None = None,
) -> tuple[bool, str] | None:
    """Whether the hand holds something at the end, and why; None where its fingers don't tell.

    samples: the trial's joint states in time order; end: those of its end. empty (k,) rad or m:
    where its joints rest when it has closed on nothing, as other trials show it.
    """
    found = _closed(hand, samples, close_ns, end)
    if found is None:
        return None
    start, reached, rest, closed = found.start, found.reached, found.rest, found.closed
    joints = hand.geometry.joints
    lower, upper = hand.geometry.limits
    span = hand.geometry.spans
    limit = np.where(reached > start, upper, lower)
    ends = hand.geometry.closed
    # what was pushed shut before the close opens a little at it
    limit = np.where(ends != hand.geometry.open, ends, limit)
    at_limit = np.abs(rest - limit) < AT_LIMIT * span
    if at_limit[closed].all():
        return False, "the fingers have closed as far as they go, with nothing between them"
    # jaws that one drive moves show its effort at one of them
    drives = {joint.follows for k, joint in enumerate(joints) if closed[k]}
    two = min(2, len(drives))
    # before the close the fingers may already push something: the way there tells their zero
    half_ns = (samples[0].t_ns + close_ns) // 2
    earlier = _of([s for s in samples if s.t_ns <= half_ns], hand)
    pressing = _drives_press(earlier, found.way, found.last)
    if pressing is None:
        if empty is None:
            return None
        short = closed & (np.sign(reached - start) * (empty - rest) > AT_LIMIT * span)
        count = _fingers(hand, short)
        if count >= two:
            who = "a finger stops" if count == 1 else f"{count} fingers stop"
            return True, f"{who} short of where this hand closes on nothing in other trials"
        if not short.any():
            return False, "the fingers have closed as far as in other trials with nothing in them"
        return None
    harder, may_press = pressing
    presses = closed & ~at_limit & harder
    count = _fingers(hand, presses)
    if count >= two:
        who = "a finger presses" if count == 1 else f"{count} fingers press"
        return True, f"{who} harder at the end than on the way"
    if not (closed & ~at_limit & may_press).any():
        return False, "no finger presses at the end"
    return None


def _fingers(hand: DescribedHand, of_joints: NDArray[np.bool_]) -> int:
    """How many fingers have one of these joints (k,)."""
    links = [joint.child for k, joint in enumerate(hand.geometry.joints) if of_joints[k]]
    return sum(any(link in finger for link in links) for finger in hand.geometry.links.fingers)


def _of(samples: list[JointSample], hand: DescribedHand) -> tuple[Array, Array]:
    """Positions and efforts (n, k) of the hand's joints in the samples that hold a position; NaN
    where one is missing. A joint that is not recorded is where the one is that it follows, and its
    effort is 0.
    """
    rows, efforts = [], []
    for sample in samples:
        row = []
        for joint in hand.geometry.joints:
            source = sample.positions.get(joint.follows, np.nan)
            row.append(sample.positions.get(joint.name, joint.multiplier * source + joint.offset))
        if not np.isnan(row).all():
            rows.append(row)
            missing = 0.0 if any(n in sample.efforts for n in hand.joints) else np.nan
            efforts.append([sample.efforts.get(name, missing) for name in hand.joints])
    shape = (-1, len(hand.joints))
    return np.array(rows).reshape(shape), np.array(efforts).reshape(shape)


def _farthest(positions: Array, start: Array) -> Array:
    """(k,) of positions (n, k) the one farthest from where the joint was."""
    off = np.abs(positions - start)
    k = np.nanargmax(np.where(np.isnan(off), -1.0, off), axis=0)
    return np.asarray(positions[k, np.arange(positions.shape[1])])


def _drives_press(
    earlier: tuple[Array, Array], way: tuple[Array, Array], last: tuple[Array, Array]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]] | None:
    """(k,) whether each joint's drive gives more at the end than it gave on its way, and whether it
    may, as noise does not let it be told; None where efforts are not recorded.
    """
    efforts = [x[1] for x in (earlier, way, last)]
    if any(np.isnan(x).all() for x in efforts) or not any(np.nan_to_num(x).any() for x in efforts):
        return None
    rest = np.nanmedian(efforts[0], axis=0)
    noise = NORMAL * np.nanmedian(np.abs(efforts[0] - rest), axis=0)
    speed = np.abs(np.diff(way[0], axis=0, prepend=way[0][:1]))
    moving = speed > MOVING * np.nanmax(speed, axis=0)
    given = np.abs(efforts[1] - rest)
    if not moving.any():
        return None
    # some of the motion meets nothing yet
    free = float(np.nanquantile(given[moving], FREE))
    now = np.abs(np.nanmedian(efforts[2], axis=0) - rest)
    most = max(float(np.nanmax(given)), float(np.nanmax(now)))
    least = max(HARDER * free, LEAST_SHARE * most)
    return now > np.maximum(NOISES * noise, least), now > least
