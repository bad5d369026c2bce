"""What joint states can't be: two publishers' by turns, or outside of what the joint can do."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from dgeval.recording.robot import RobotStates

LEAST_SAMPLES = 20  # of a joint, to say anything; ours
JUMP = 0.03  # rad or m, there and back between neighbouring samples; ours
BACK = 0.3  # share of the jump, by which at most the sample after it differs from the one before
ALTERNATES = 0.1  # share of the samples that jump there and back; ours
BEYOND = 0.5  # share of a joint's range, and
BEYOND_LEAST = {"revolute": 0.2, "prismatic": 0.05}  # rad or m, by which it may be outside of it
MOVES_FIXED = 0.02  # rad or m, by which a joint moves that the description says is fixed; ours
OUTSIDE = 0.5  # share of the samples that are outside; ours
TWO_VALUES = 1e-3  # rad or m, between two states that are one
# s, for which a moving arm's states repeat to the last digit; steps before, which the next one is
# so many times as large as, to make up for them; joints that must agree; ours
HANGS_S, STEPS, MAKES_UP, LEAST_JOINTS = 0.15, 10, 5.0, 3
LONGEST = 3.0  # times the usual period, between two states of an arm that hangs; ours
STRAY = 0.01  # share of the stamps that two states may have: one wrong stamp is no second publisher


def joint_faults(robot: RobotStates, is_stamped: bool = True) -> list[tuple[str, str]]:
    """What is wrong with the joint states, and what mends it.

    is_stamped: whether they bear stamps; else several may have one of the recorder's times.
    """
    out = []
    for name, values in sorted(robot.joints.values.items()):
        q = np.array(values)
        if len(q) < LEAST_SAMPLES:
            continue
        there, back = np.abs(np.diff(q))[:-1], np.abs(q[2:] - q[:-2])
        share = float(((there > JUMP) & (back < BACK * there)).mean())
        if share > ALTERNATES:
            what = f"the joint {name} jumps there and back in {share:.0%} of its samples"
            mend = "record the topic with one program alone"
            out.append((f"{what}: do two programs publish it?", mend))
            break  # the others of that topic do so too
    if is_stamped and (twice := _two_values(robot)):
        out.append(twice)
    if robot.description is None:
        return out
    if hangs := _hang(robot):
        out.append(hangs)
    for joint in sorted(robot.description.joints.values(), key=lambda j: j.name):
        q = np.array(robot.joints.values.get(joint.name, []))
        if joint.kind == "fixed" and len(q) >= LEAST_SAMPLES and np.ptp(q) > MOVES_FIXED:
            what = f"the joint {joint.name} moves by {np.ptp(q):.3g} in the joint states, and is "
            mend = "give the robot's own description (calibration.description)"
            out.append((f"{what}fixed in the description", mend))
            break
        span = joint.upper - joint.lower
        if len(q) < LEAST_SAMPLES or joint.kind == "fixed" or not 0 < span < np.inf:
            continue
        off = np.maximum(joint.lower - q, q - joint.upper)
        if float((off > max(BEYOND * span, BEYOND_LEAST[joint.kind])).mean()) > OUTSIDE:
            unit = {"revolute": "rad", "prismatic": "m"}[joint.kind]
            what = f"the joint {joint.name} is at {np.median(q):.4g}, and its limits are "
            what += f"{joint.lower:.4g} to {joint.upper:.4g} {unit}"
            mend = (
                "are the states in degrees or millimetres, or is the description another robot's?"
            )
            out.append((what, mend))
            break
    return out


def _hang(robot: RobotStates) -> tuple[str, str] | None:
    """What is wrong where an arm in motion seems to stand, and jumps then; None where it doesn't.

    An arm that really stops starts again with small steps.
    """
    names = [name for name in _arm(robot) if robot.joints.times.get(name)]
    if len(names) < LEAST_JOINTS:
        return None
    times = np.array(robot.joints.times[names[0]], dtype=np.int64)
    if any(len(robot.joints.times[n]) != len(times) for n in names) or len(times) < LEAST_SAMPLES:
        return None
    q = np.array([robot.joints.values[n] for n in names]).T
    steps, periods = np.abs(np.diff(q, axis=0)).max(axis=1), np.diff(times)
    moves = np.flatnonzero(steps > 0)
    for before, after in pairwise(moves.tolist()):
        first, last = before + 1, after  # samples that are one
        lasts_s = (times[last] - times[first]) * 1e-9
        if lasts_s < HANGS_S or before + 1 < STEPS:
            continue
        if (periods[first : after + 1] > LONGEST * np.median(periods)).any():
            continue  # nothing was recorded for a while, and the arm is elsewhere after it
        usual = float(np.median(steps[before + 1 - STEPS : before + 1]))
        if usual > 0 and steps[after] > MAKES_UP * usual:
            a, b = ((times[k] - times[0]) * 1e-9 for k in (first, last))
            what = (
                f"the arm's joint states repeat to the last digit for {lasts_s:.2f} s, {a:.2f} to "
                f"{b:.2f} s after their first, and jump by {steps[after]:.2g} then"
            )
            return f"{what}: does their driver hang?", "record again: the hand was elsewhere then"
    return None


def _arm(robot: RobotStates) -> list[str]:
    """The joints above all links of the hand."""
    assert robot.description is not None
    joints = robot.description.joints
    above: list[set[str]] = []
    for link in robot.hand_links:
        names = set()
        while link in joints:
            names.add(joints[link].name)
            link = joints[link].parent
        above.append(names)
    return sorted(set.intersection(*above)) if above else []


def _two_values(robot: RobotStates) -> tuple[str, str] | None:
    """What is wrong where states with one stamp differ, and what mends it; None without."""
    first: dict[str, float] = {}
    apart: dict[str, float] = {}
    at_ns, stamps, shared = 0, 0, set[int]()
    for sample in sorted(robot.samples, key=lambda s: s.t_ns):
        if sample.t_ns != at_ns:
            at_ns, first, stamps = sample.t_ns, {}, stamps + 1
        for name, value in sample.positions.items():
            known = first.setdefault(name, value)
            if abs(known - value) > TWO_VALUES:
                shared.add(at_ns)
                apart[name] = max(apart.get(name, 0.0), abs(known - value))
    if len(shared) <= STRAY * stamps:
        return None
    name = max(sorted(apart), key=lambda n: apart[n])
    what = f"the joint {name} has two positions under one stamp, up to {apart[name]:.3g} apart"
    return f"{what}: the first counts", "record the topic once, with one program alone"
