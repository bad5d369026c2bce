"""Whether camera and robot stamp with one clock, by the times at which the recorder had them."""

from __future__ import annotations

import json
from collections.abc import Iterable

import numpy as np

from dgeval.config import ClockConfig
from dgeval.recording.check import Check
from dgeval.recording.messages import TF_TYPES
from dgeval.recording.robot import RobotStates
from dgeval.recording.roles import Roles
from dgeval.recording.scan import Scan

MOST_CLOCKS_APART_S = 0.5  # s, between two roles' clocks; no transport takes that long; ours
SAME_S = 0.02  # s, within which topics have one clock; ours
CLOCKS_TOLD_S = 0.08  # s, from which on a note says it; ours


def clocks_apart(scan: Scan, roles: Roles, clock: ClockConfig) -> tuple[str, float] | None:
    """The topic of the robot whose delay to the recorder differs most from colour's, and by how
    much colour's is larger, s; None where one of both has no stamps.
    """
    camera = _delay(scan, roles.colour, clock.colour.offset_ns)
    robots = _robot_delays(scan, roles, clock)
    if camera is None or not robots:
        return None
    topic, robot = max(robots.items(), key=lambda item: abs(item[1] - camera))
    return topic, camera - robot


def _robot_delays(scan: Scan, roles: Roles, clock: ClockConfig) -> dict[str, float]:
    """By topic of the robot that bears stamps, in name order, its delay to the recorder, s."""
    tf = [n for n, t in scan.opened.topics.items() if t.type in TF_TYPES and "static" not in n]
    offsets = dict.fromkeys(tf, clock.camera_pose.offset_ns)
    offsets |= dict.fromkeys(roles.joints, clock.hand_joints.offset_ns)
    found = {topic: _delay(scan, topic, offset) for topic, offset in sorted(offsets.items())}
    return {topic: delay for topic, delay in found.items() if delay is not None}


def clock_check(scan: Scan, roles: Roles, clock: ClockConfig) -> tuple[Check | None, str]:
    """Whether the camera's clock is that of the robot, by each one's delay to the recorder.

    Also a note where it is off by less, as a slow transport is too; "" without.
    """
    found = clocks_apart(scan, roles, clock)
    if found is None:
        return None, ""
    topic, apart = found
    if abs(apart) <= CLOCKS_TOLD_S:
        return None, clocks_drift(scan, roles, clock, CLOCKS_TOLD_S)
    odd = odd_clocks(scan, roles, clock)
    if odd:
        return _of_robot(odd, clock, roles)
    side = "behind" if apart > 0 else "ahead of"
    what = f"the camera's stamps are {abs(apart):.2f} s {side} those of {topic}, by the recorder"
    mend = f"--set clock.colour.offset_ns={round(apart * 1e9) + clock.colour.offset_ns}"
    camera = _delay(scan, roles.colour, clock.colour.offset_ns)
    depth = _delay(scan, roles.depth, clock.depth.offset_ns)
    assert camera is not None
    robot = camera - apart
    if depth is None or abs(depth - robot) > CLOCKS_TOLD_S:
        depth_apart = apart if depth is None else depth - robot
        mend += f" --set clock.depth.offset_ns={round(depth_apart * 1e9) + clock.depth.offset_ns}"
    if abs(apart) <= MOST_CLOCKS_APART_S:
        return None, f"{what}; if that is no delay of the images: {mend}"
    return Check("clocks", what, mend), ""


def odd_clocks(scan: Scan, roles: Roles, clock: ClockConfig) -> dict[str, float]:
    """By topic of the robot whose clock is another one than the camera's and the recorder's, what
    has to be added to its stamps, s; none where the camera's clock is the odd one, or may be.

    Other topics of the robot agree with the camera; or the camera's delay to the recorder is one
    that a transport has, and the robot's are not.
    """
    camera = _delay(scan, roles.colour, clock.colour.offset_ns)
    if camera is None:
        return {}
    delays = _robot_delays(scan, roles, clock)
    off = {t: d - camera for t, d in delays.items() if abs(d - camera) > CLOCKS_TOLD_S}
    agree = len(off) < len(delays)
    impossible = [t for t in off if not -CLOCKS_TOLD_S <= delays[t] <= MOST_CLOCKS_APART_S]
    by_recorder = -CLOCKS_TOLD_S <= camera <= CLOCKS_TOLD_S and len(impossible) == len(off)
    return off if agree or by_recorder else {}


def move_camera(topics: Iterable[str], scan: Scan, robot: RobotStates) -> bool:
    """Whether one of the robot's topics tells where the camera is, so that the pictures can say
    whether its stamps are right.
    """
    joints = robot.description.joints if robot.description is not None else {}
    chain = robot.tree.ancestors(robot.camera_frame)
    named = {name for f in chain if f in joints for name in (joints[f].name, joints[f].follows)}
    return any(
        topic not in scan.joints or any(named & s.positions.keys() for s in scan.joints[topic])
        for topic in topics
    )


def _of_robot(odd: dict[str, float], clock: ClockConfig, roles: Roles) -> tuple[Check | None, str]:
    """A check, or a note where a slow transport may be behind it, on clocks of the robot that are
    not the camera's. odd: s, to be added to the stamps of each topic.
    """
    topic = max(odd, key=lambda t: abs(odd[t]))
    side = "ahead of" if odd[topic] < 0 else "behind"
    what = (
        f"the stamps of {', '.join(odd)} are {abs(odd[topic]):.2f} s {side} those of the camera, "
        "by the recorder"
    )
    joints = {t: s for t, s in odd.items() if t in roles.joints}
    lines = []
    if joints and len(joints) == len(roles.joints) and np.ptp(list(joints.values())) <= SAME_S:
        ns = round(float(np.median(list(joints.values()))) * 1e9) + clock.hand_joints.offset_ns
        lines.append(f"--set clock.hand_joints.offset_ns={ns}")
    elif joints:
        given = clock.topics | {
            t: round(s * 1e9) + clock.topics.get(t, 0) for t, s in joints.items()
        }
        table = ", ".join(f"{json.dumps(t)} = {ns}" for t, ns in sorted(given.items()))
        lines.append(f"--set 'clock.topics={{ {table} }}'")
    others = [s for t, s in odd.items() if t not in joints]
    if others:
        ns = round(float(np.median(others)) * 1e9) + clock.camera_pose.offset_ns
        lines.append(f"--set clock.camera_pose.offset_ns={ns}")
    mend = " ".join(lines)
    if 0 < odd[topic] <= MOST_CLOCKS_APART_S:
        return None, f"{what}; if that is no delay of theirs: {mend}"
    if odd[topic] > 0:
        mend += "; if they were logged late and stamped right: --set 'checks.accept=[\"clocks\"]'"
    return Check("clocks", what, mend), ""


def _delay(scan: Scan, topic: str | None, offset_ns: int) -> float | None:
    """Median log time less header time of a topic, s; None where its stamps are not kept."""
    if topic is None or topic not in scan.times:
        return None
    header, log = scan.times[topic].arrays()
    if len(header) != len(log) or not len(log) or not header.any():
        return None
    if scan.recorder_clock is not None:  # which may run faster than that of the stamps
        log = scan.recorder_clock.stamps_of(log)
    return float(np.median(log - header - offset_ns)) * 1e-9


def _parting(scan: Scan, topic: str, other: str) -> float:
    """By how much the delay of a topic to the recorder grows more than that of another, s: from the
    first to the last quarter of the time in which both are recorded.
    """
    both = [scan.times[name].arrays() for name in (topic, other)]
    first, last = max(log.min() for _, log in both), min(log.max() for _, log in both)
    quarter = (last - first) / 4
    grown = []
    for header, log in both:
        late = (log - header) * 1e-9
        begin = (log >= first) & (log <= first + quarter)
        end = (log >= last - quarter) & (log <= last)
        if not (begin.any() and end.any()):
            return 0.0
        grown.append(float(np.median(late[end]) - np.median(late[begin])))
    return grown[0] - grown[1]


def clocks_drift(scan: Scan, roles: Roles, clock: ClockConfig, least_s: float) -> str:
    """What is said where the delay to the recorder changes over the recording by more than least_s
    for a topic of the robot against the camera's; "" without.
    """
    stamped = _robot_delays(scan, roles, clock)
    if roles.colour is None or _delay(scan, roles.colour, 0) is None or not stamped:
        return ""
    apart = {topic: _parting(scan, topic, roles.colour) for topic in stamped}
    topic = max(apart, key=lambda t: abs(apart[t]))
    if abs(apart[topic]) <= least_s:
        return ""
    return (
        f"over the recording the stamps of {topic} move by {-apart[topic]:+.2f} s against those of "
        "the camera, by the recorder: does one clock run faster, or do messages queue up?"
    )
