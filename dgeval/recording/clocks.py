"""Pairs colour and depth by header stamp, and rules for stamps that are wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgeval.config import SyncConfig

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class StampFaults:
    """Counts of wrong stamps over one image topic.

    zero: the log time is used instead. backward, duplicate: the message is not used. jump: forward
    by more than `sync.jump_s`; the message is used.
    """

    zero: int
    backward: int
    duplicate: int
    jump: int

    @property
    def dropped(self) -> int:
        return self.backward + self.duplicate


def clean_stamps(
    header_ns: Ints, log_ns: Ints, offset_ns: int, jump_ns: int
) -> tuple[Ints, Ints, StampFaults]:
    """Usable stamps, ns, strictly rising; their ordinals in the topic; counts of wrong stamps."""
    zero = header_ns == 0
    stamps = np.where(zero, log_ns, header_ns) + offset_ns
    keep: list[int] = []
    backward = duplicate = jump = 0
    last: int | None = None
    for i, t in enumerate(stamps.tolist()):
        if last is not None and t <= last:
            backward += t < last
            duplicate += t == last
            continue
        jump += last is not None and t - last > jump_ns
        keep.append(i)
        last = t
    ordinals = np.array(keep, dtype=np.int64)
    return stamps[ordinals], ordinals, StampFaults(int(zero.sum()), backward, duplicate, jump)


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
