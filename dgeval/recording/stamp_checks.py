"""Consistency checks of header stamps: what the clock of a topic says by itself."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dgeval.recording.check import Check
from dgeval.recording.clocks import Ints, StampFaults
from dgeval.recording.messages import TF_TYPES
from dgeval.recording.pairing import Window
from dgeval.recording.roles import Roles
from dgeval.recording.scan import Scan, TopicTimes

CLOCK_STEP_S = 0.25  # s, by which a clock is said to have been set; ours
BEFORE_AFTER_S = 1.0  # s of messages on each side of a step; a burst of late ones is shorter
LEAST_BESIDE = 5  # messages on each side
MOST_STEPS = 100  # that are looked at; a stream with more has no clock that was set once
MOST_DROPPED = 0.1  # share of a stream whose stamps can't be used; ours
TWICE = 0.9  # share of those that can't be used, that bear the stamp of another one; ours
# states, and share of the mean step between their stamps, below which most steps are bursts; ours
LEAST_IN_BURSTS, BURST = 50, 0.1
# ns, under which all fractions of a second are those of lost digits, stamps and s that must show it
FRACTION_NS, LEAST_STAMPS, LEAST_S = 1_000_000, 10, 2.0
LEAST_A_SECOND = 1.5  # messages; a camera that takes one a second may stamp whole seconds; ours


def stamp_checks(scan: Scan, roles: Roles, window: Window) -> list[Check]:
    """Of the images and the robot: stamps that lost their fractions, that are used twice or go
    back, and clocks that were set in mid-recording.
    """
    assert roles.colour is not None
    assert roles.depth is not None
    robot = [n for n, t in scan.opened.topics.items() if t.type in TF_TYPES and "static" not in n]
    topics = list(dict.fromkeys([roles.colour, roles.depth, *roles.joints, *sorted(robot)]))
    cut = [topic for topic in topics if _lost_fractions(*scan.times[topic].arrays())]
    failed = []
    if cut:
        what = f"the stamps of {', '.join(cut)} have no fractions of a second above 1 ms"
        mend = "mend the driver: it cuts them, or writes microseconds as nanoseconds; no setting "
        failed.append(Check("stamps", what, mend + "brings them back"))
    log_ns = scan.times[roles.colour].arrays()[1]
    if len(log_ns) >= LEAST_STAMPS and np.ptp(log_ns) == 0:
        what = f"the recorder's times of {roles.colour} are all {int(log_ns[0])} ns: what has no "
        what += "stamp of its own, as events have none, can't be placed in time"
        failed.append(Check("stamps", what, "give --close and --label, or record again"))
    for role, faults in sorted(window.stamp_faults.items()):
        topic = getattr(roles, role)
        count = len(scan.times[topic].log_ns)
        lost = faults.dropped - min(faults.duplicate, _copies(scan.times[topic]))
        if topic not in cut and lost > MOST_DROPPED * count:
            failed.append(_dropped(role, faults, scan.times[topic].arrays()[0]))
    states = [topic for topic in roles.joints if topic not in cut]
    bursts = [_in_bursts(topic, scan.times[topic].arrays()[0]) for topic in states]
    failed += [check for check in bursts if check is not None]
    steady = [topic for topic in topics if topic not in (*cut, roles.depth)]
    return [*failed, *_clock_steps(scan, steady)]


def _copies(times: TopicTimes) -> int:
    """Images that stand twice, to the last byte of those that were looked at: a merge of two files
    that overlap has such, and none is lost.
    """
    seen = list(zip(times.header_ns, times.digests, strict=False))
    return len(seen) - len(set(seen))


def _in_bursts(topic: str, header_ns: Ints) -> Check | None:
    """Whether states are stamped when they arrive in packets, and not when they were measured."""
    stamps = np.unique(header_ns[header_ns > 0])
    if len(stamps) < LEAST_IN_BURSTS:
        return None
    steps = np.diff(stamps) * 1e-9
    if float(np.median(steps)) >= BURST * float(np.mean(steps)):
        return None
    what = f"the stamps of {topic} come in bursts, {np.quantile(steps, 0.99) * 1e3:.0f} ms apart: "
    what += "those of their arrival, and where the robot was in between is not recorded"
    return Check("stamps", what, "stamp the states where they are measured")


def _lost_fractions(header_ns: Ints, log_ns: Ints) -> bool:
    """Whether several messages a second, by the recorder, bear stamps of whole seconds."""
    stamps = header_ns[header_ns > 0]
    if len(log_ns) < LEAST_A_SECOND * np.ptp(log_ns) * 1e-9:
        return False
    if len(stamps) < LEAST_STAMPS or np.ptp(stamps) < LEAST_S * 1e9:
        return False
    return bool((stamps % 1_000_000_000 < FRACTION_NS).all())


def _dropped(role: str, faults: StampFaults, header_ns: Ints) -> Check:
    """That too many images of a role can't be used, by their stamps (n,) ns."""
    count = len(header_ns)
    if faults.duplicate >= TWICE * faults.dropped and faults.backward <= MOST_DROPPED * count:
        what = f"{faults.duplicate} of {count} {role} images bear another one's stamp, and are not "
        mend = "did two recorders write, or does the driver send each picture twice?"
        return Check("stamps", what + "used", mend)
    back_s = float((np.maximum.accumulate(header_ns) - header_ns).max()) * 1e-9
    what = f"{faults.dropped} of {count} {role} images have stamps out of order, by up to "
    what += f"{back_s:.2f} s, and are not used"
    mend = "did two drivers publish, or was the clock set back? Cut the recording there (start_ns, "
    return Check("stamps", what, mend + "end_ns)")


def _clock_steps(scan: Scan, topics: Iterable[str]) -> list[Check]:
    """Whether a clock was set in mid-recording: stamps jump and the log does not."""
    for topic in topics:
        header, log = scan.times[topic].arrays()
        if len(header) != len(log):
            continue
        header, log = header[header > 0], log[header > 0]
        late = (log - header) * 1e-9
        steps = np.flatnonzero(np.abs(np.diff(late)) > CLOCK_STEP_S) + 1
        for k in steps[:MOST_STEPS]:
            near = np.abs(log - log[k]) * 1e-9 < BEFORE_AFTER_S
            before, after = late[:k][near[:k]], late[k:][near[k:]]
            if min(len(before), len(after)) < LEAST_BESIDE:
                continue
            step = float(np.median(before) - np.median(after))
            if abs(step) > CLOCK_STEP_S:
                at = (int(log[k]) - int(log[0])) * 1e-9
                what = (
                    f"the clock of {topic} is set by {step:+.2f} s, {at:.2f} s into the recording"
                )
                return [Check("stamps", what, "cut the recording there (start_ns, end_ns)")]
    return []
