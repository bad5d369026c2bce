"""Pairs colour and depth by header stamp, and rules for stamps that are wrong."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgeval.config import SyncConfig

Ints = NDArray[np.int64]
RECORDER_APART_S = 1.0  # s, between log time and stamps, from which on the clocks are two; ours
# s, by which a message may be logged later than others; by which these agree on how late they are;
# or the share of their spread, if that is more; messages beside it that say so; in order in all;
# share of the period that its stamp stands alone
LATE_S, SAME_CLOCK_S, SAME_SHARE, LEAST_BESIDE, LEAST_IN_ORDER = 1.5, 0.05, 0.25, 8, 10  # ours
OWN_PLACE = 0.4  # ours
ONE_CLOCK_S = 0.5  # s, within which all topics must agree on that; ours


@dataclass(frozen=True, slots=True)
class StampFaults:
    """Counts of wrong stamps over one image topic.

    zero: the log time is used instead. backward: below those of messages before it, ahead: above
    those of messages after it, duplicate: equal to another; the message is not used. jump: forward
    by more than `sync.jump_s`, late: logged after messages with later stamps, as over a bad
    network; the message is used.
    """

    zero: int
    backward: int
    duplicate: int
    jump: int
    late: int = 0
    ahead: int = 0

    @property
    def dropped(self) -> int:
        return self.backward + self.ahead + self.duplicate


def clean_stamps(
    header_ns: Ints, log_ns: Ints, offset_ns: int, jump_ns: int
) -> tuple[Ints, Ints, StampFaults]:
    """Usable stamps, ns, strictly rising; their ordinals in the topic; counts of wrong stamps.

    The ordinals rise but for messages that were logged late.
    """
    zero = header_ns == 0
    stamps = np.where(zero, log_ns, header_ns) + offset_ns
    keep = _longest_rising(stamps.tolist())
    late = _logged_late(stamps, log_ns, keep)
    keep = sorted([*keep, *late], key=lambda i: stamps[i])
    kept = set(keep)
    values = {int(stamps[i]) for i in keep}
    backward = ahead = duplicate = highest = 0
    for i, t in enumerate(stamps.tolist()):
        if i in kept:
            highest = max(highest, t)
        elif t in values:
            duplicate += 1
        elif t > highest:
            ahead += 1
        else:
            backward += 1
    ordinals = np.array(keep, dtype=np.int64)
    used = stamps[ordinals]
    jump = int((np.diff(used) > jump_ns).sum()) if len(used) > 1 else 0
    faults = StampFaults(int(zero.sum()), backward, duplicate, jump, len(late), ahead)
    return used, ordinals, faults


def _logged_late(stamps: Ints, log_ns: Ints, keep: list[int]) -> list[int]:
    """Those of the messages that are out of order whose stamps are right and that were logged late.

    Their log times are late by up to LATE_S more than those of others soon before and after them,
    as a clock's that was set back are not; and their stamps fall where one is missing.
    """
    left = sorted(set(range(len(stamps))) - set(keep))
    if not left or len(keep) < LEAST_IN_ORDER:
        return []
    behind = (log_ns - stamps) * 1e-9
    at = (log_ns - log_ns[0]) * 1e-9
    out = []
    for i in left:
        near = np.abs(at - at[i]) < LATE_S
        sides = [behind[:i][near[:i]], behind[i + 1 :][near[i + 1 :]]]
        least = [float(side.min()) for side in sides if len(side) >= LEAST_BESIDE]
        # where the network's delays vary more, so does the least of some
        same_s = max(SAME_CLOCK_S, SAME_SHARE * float(np.ptp(behind[near])))
        if not least or max(least) - min(least) > same_s:
            continue
        if -same_s <= behind[i] - min(least) <= LATE_S:
            out.append(i)
    together = np.sort(stamps[[*keep, *out]])
    gaps = np.diff(together)
    period = float(np.median(gaps[gaps > 0]))
    apart = np.minimum(np.append(gaps, period), np.insert(gaps.astype(float), 0, period))
    alone = dict(zip(together.tolist(), (apart >= OWN_PLACE * period).tolist(), strict=True))
    return [i for i in out if alone[int(stamps[i])]]


def _longest_rising(stamps: list[int]) -> list[int]:
    """Indices of the longest strictly rising subsequence, of equally long ones the earliest.

    One stamp that is far ahead or behind costs that stamp, not all that come after it.
    """
    lengths = [0] * len(stamps)  # of the longest that begins at each stamp
    ends: list[int] = []  # negative first values, by length, of the one that begins latest
    for i in reversed(range(len(stamps))):
        k = bisect_left(ends, -stamps[i])
        if k == len(ends):
            ends.append(-stamps[i])
        else:
            ends[k] = -stamps[i]
        lengths[i] = k + 1
    out: list[int] = []
    wanted, last = len(ends), None
    for i, t in enumerate(stamps):
        if lengths[i] == wanted and (last is None or t > last):
            out.append(i)
            wanted, last = wanted - 1, t
    return out


@dataclass(frozen=True)
class RecorderClock:
    """From log times to stamps, ns, of a recorder that runs on another clock than the robot, as a
    simulator's does; it may run faster or slower. log_ns rises.
    """

    log_ns: Ints
    stamps_ns: Ints

    @property
    def apart_s(self) -> float:
        return float(np.median(self.log_ns - self.stamps_ns)) * 1e-9

    def stamps_of(self, log_ns: Ints) -> Ints:
        """`stamp_ns` of several (n,), to a microsecond."""
        at = np.clip(log_ns, self.log_ns[0], self.log_ns[-1])
        since = (at - self.log_ns[0]).astype(np.float64)
        knots = (self.log_ns - self.log_ns[0]).astype(np.float64)
        values = (self.stamps_ns - self.stamps_ns[0]).astype(np.float64)
        inside = np.rint(np.interp(since, knots, values)).astype(np.int64)
        return np.asarray(self.stamps_ns[0] + inside + (log_ns - at))

    def stamp_ns(self, log_ns: int) -> int:
        """The stamp of what was logged then; beyond the ends with the offset of the end."""
        at = int(np.clip(log_ns, self.log_ns[0], self.log_ns[-1]))
        k = int(np.searchsorted(self.log_ns, at))
        if self.log_ns[k] == at:
            stamp = int(self.stamps_ns[k])
        else:
            before, after = (int(self.log_ns[i]) for i in (k - 1, k))
            low, high = (int(self.stamps_ns[i]) for i in (k - 1, k))
            stamp = low + round((high - low) * (at - before) / (after - before))
        return stamp + log_ns - at


def recorder_clock(stamped: dict[str, tuple[Ints, Ints]]) -> RecorderClock | None:
    """The recorder's clock against that of the stamps; None where they are the same, or where the
    topics' own clocks differ.

    stamped: header stamps and log times by topic.
    """
    usable = {
        n: (h, t)
        for n, (h, t) in stamped.items()
        if len(h) >= 3 and (h > 0).sum() >= 3 and np.ptp(t) > 0
    }
    if not usable:
        return None
    apart = {n: float(np.median((t - h)[h > 0])) * 1e-9 for n, (h, t) in usable.items()}
    if min(abs(a) for a in apart.values()) < RECORDER_APART_S:
        return None
    name = max(usable, key=lambda n: (len(usable[n][0]), n))
    header, log = usable[name]
    order = np.lexsort((header[header > 0], log[header > 0]))
    log, header = log[header > 0][order], header[header > 0][order]
    first = np.concatenate([[True], np.diff(log) > 0])
    clock = RecorderClock(log[first], header[first])
    # by this clock and not by how late they are: a recorder may run faster
    late = [
        float(np.median(clock.stamps_of(t[h > 0]) - h[h > 0])) * 1e-9 for h, t in usable.values()
    ]
    return clock if max(late) - min(late) <= ONE_CLOCK_S else None


def pair(colour_ns: Ints, depth_ns: Ints, tolerance_ns: int) -> list[tuple[int, int]]:
    """One-to-one pairs (colour index, depth index) of two rising arrays of stamps, in time order.

    The closest pairs are made first. Images farther apart than the tolerance stay unmatched.
    """
    if not len(colour_ns) or not len(depth_ns):
        return []
    after = np.searchsorted(depth_ns, colour_ns)
    candidates: list[tuple[int, int, int]] = []
    for c, a in enumerate(after.tolist()):
        for d in (a - 1, a):
            if 0 <= d < len(depth_ns):
                gap = abs(int(depth_ns[d]) - int(colour_ns[c]))
                if gap <= tolerance_ns:
                    candidates.append((gap, c, d))
    used_c: set[int] = set()
    used_d: set[int] = set()
    pairs = []
    for _, c, d in sorted(candidates):
        if c not in used_c and d not in used_d:
            used_c.add(c)
            used_d.add(d)
            pairs.append((c, d))
    return sorted(pairs)


def tolerance_ns(colour_ns: Ints, config: SyncConfig) -> int:
    """Tolerance, ns: configured, else half the median colour period, at most 50 ms.

    With fewer than two colour images it is 20 ms.
    """
    if config.tolerance_s is not None:
        return round(config.tolerance_s * 1e9)
    if len(colour_ns) < 2:
        return 20_000_000
    return min(int(np.median(np.diff(colour_ns))) // 2, 50_000_000)
