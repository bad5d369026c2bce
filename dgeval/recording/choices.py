"""What the robot recorded of its own choice: grasp, scores and decision, each by time."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dgeval.geometry import Array, matrix_from_pose
from dgeval.recording.contract import (
    ACCEPTED_TOPIC,
    CANDIDATES_TOPIC,
    EXECUTE_TOPIC,
    GRASP_SCORE_TOPIC,
    GRASP_TOPIC,
    SCORE_TOPIC,
    SEED_TOPIC,
)
from dgeval.recording.messages import StampedPose, StampedPoses
from dgeval.recording.robot import RobotStates
from dgeval.recording.scan import Scan

# s before a trial in which its first choice may be made; ns, within which stamps and the recorder's
# times are of one clock; ours
BEFORE_S, ONE_CLOCK_NS = 10.0, 2_000_000_000
SCORE_LATE_NS = 1_000_000  # ns; a value logged this long after its grasp still belongs to it


@dataclass(frozen=True)
class Numbers:
    """Values of a topic without a header, by the time they were logged, ns, in time order."""

    times: tuple[int, ...] = ()
    values: tuple[float, ...] = ()

    def at(self, t_ns: int) -> float | None:
        """The newest value by then; None before the first."""
        k = bisect_right(self.times, t_ns + SCORE_LATE_NS)
        return self.values[k - 1] if k else None


@dataclass(frozen=True)
class CandidateSet:
    """What a robot could choose from, of the image at t_ns: T_base_palm (n, 4, 4), scores (n,)."""

    t_ns: int
    T_base_palm: Array
    scores: Array


@dataclass(frozen=True)
class RecordedChoices:
    """The robot's grasps T_base_palm (4, 4) with their stamps, ns, in time order.

    scores: of the chosen grasp. hand_scores: of the hand as it is. decisions: whether to close.
    candidates: in time order.
    """

    times: tuple[int, ...] = ()
    grasps: tuple[Array, ...] = ()
    scores: Numbers = Numbers()
    hand_scores: Numbers = Numbers()
    decisions: Numbers = Numbers()
    candidates: tuple[CandidateSet, ...] = ()

    def grasp_at(self, t_ns: int) -> Array | None:
        """The newest grasp by then; None before the first."""
        k = bisect_right(self.times, t_ns)
        return self.grasps[k - 1] if k else None


def recorded_choices(found: Scan, span: tuple[int, int], robot: RobotStates) -> RecordedChoices:
    """The choices of one trial, within a span of time, ns, see `choice_span`.

    A grasp counts from its stamp on, but not before it was logged, where both are of one clock;
    without a stamp of the recording's clock, from when it was logged on. One in a frame
    that nothing connects to the base is left out (`unplaced`).
    """
    grasps: list[tuple[int, Array]] = []
    poses = logged_poses(found, GRASP_TOPIC)
    apart = [log_ns - pose.t_ns for pose, log_ns in poses]
    one_clock = bool(apart) and abs(sorted(apart)[len(apart) // 2]) < ONE_CLOCK_NS
    for pose, log_ns in poses:
        is_stamped = span[0] <= pose.t_ns <= span[1]
        t_ns = max(pose.t_ns, log_ns) if one_clock else pose.t_ns if is_stamped else log_ns
        T = in_base(pose, log_ns, robot)
        if T is not None and span[0] <= t_ns <= span[1]:
            grasps.append((t_ns, T))
    grasps.sort(key=lambda grasp: grasp[0])
    return RecordedChoices(
        tuple(t_ns for t_ns, _ in grasps),
        tuple(T for _, T in grasps),
        _numbers(found, GRASP_SCORE_TOPIC, span),
        _numbers(found, SCORE_TOPIC, span),
        _numbers(found, EXECUTE_TOPIC, span),
        _candidates(found, span, robot),
    )


def _candidates(found: Scan, span: tuple[int, int], robot: RobotStates) -> tuple[CandidateSet, ...]:
    """The sets that have as many scores as poses, and whose frame is known.

    Scores have no stamp: they belong to the newest set by the time they were logged.
    """
    out = []
    listed = sorted(found.candidates, key=lambda one: one.log_ns)
    logged = [one.log_ns for one in listed]
    scores: dict[int, Array] = {}
    for log_ns, values in sorted(found.candidate_scores, key=lambda one: one[0]):
        scores.setdefault(bisect_right(logged, log_ns + SCORE_LATE_NS) - 1, values)
    for k, one in enumerate(listed):
        own, is_stamped = scores.get(k), span[0] <= one.t_ns <= span[1]
        t_ns = one.t_ns if is_stamped else one.log_ns
        if own is None or len(own) != len(one.poses) or not span[0] <= t_ns <= span[1]:
            continue
        T_base = _T_base(one, robot)
        usable = np.isfinite(one.poses).all(axis=1) & np.isfinite(own)
        if T_base is None or not usable.any():
            continue
        poses = np.array([matrix_from_pose(pose) for pose in one.poses[usable]])
        out.append(CandidateSet(t_ns, T_base @ poses, own[usable]))
    return tuple(sorted(out, key=lambda one: one.t_ns))


def unscored(found: Scan) -> bool:
    """Whether no set of candidates has as many scores as poses."""
    lengths = {len(scores) for _, scores in found.candidate_scores}
    return bool(found.candidates) and not any(len(s.poses) in lengths for s in found.candidates)


def _T_base(one: StampedPoses, robot: RobotStates) -> Array | None:
    """T_base_x (4, 4) of the frame that a set is given in; None where it is not known."""
    identity = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    return in_base(StampedPose(one.t_ns, one.parent, "", identity), one.log_ns, robot)


def logged_poses(found: Scan, topic: str) -> list[tuple[StampedPose, int]]:
    """The poses of a topic, each with the time it was logged, ns, on the clock of the stamps."""
    poses = found.poses.get(topic, [])
    logged = found.times[topic].log_ns if topic in found.times else []
    if found.recorder_clock is not None:
        logged = [found.recorder_clock.stamp_ns(t_ns) for t_ns in logged]
    if len(logged) != len(poses):
        logged = [pose.t_ns for pose in poses]
    return list(zip(poses, logged, strict=True))


def in_base(pose: StampedPose, log_ns: int, robot: RobotStates) -> Array | None:
    """A recorded pose as T_base_x (4, 4); None where its frame is not known.

    Its frame is where it was at the pose's stamp, of a pose without one when it was logged. Without
    a frame it is taken as of the base. Without a base everything is of the camera.
    """
    T, base = matrix_from_pose(pose.pose), robot.base_frame or robot.camera_frame
    if not pose.parent or pose.parent == base:
        return T
    for t_ns in (pose.t_ns, log_ns):
        if t_ns and (T_base_parent := robot.tree.lookup(base, pose.parent, t_ns)) is not None:
            return T_base_parent @ T
    return None


def unplaced(found: Scan, robot: RobotStates) -> list[str]:
    """Of each topic of palm poses that holds none that can be brought to the base: in words why."""
    base = robot.base_frame or robot.camera_frame
    out = []
    for topic in (GRASP_TOPIC, SEED_TOPIC):
        poses = logged_poses(found, topic)
        if poses and all(in_base(pose, log_ns, robot) is None for pose, log_ns in poses):
            frame = poses[0][0].parent
            out.append(f"{topic} is given in {frame!r}, and nothing says where that is in {base!r}")
    sets = found.candidates
    if sets and all(_T_base(one, robot) is None for one in sets):
        frame = sets[0].parent
        out.append(
            f"{CANDIDATES_TOPIC} is given in {frame!r}, and nothing says where that is in {base!r}"
        )
    return out


def choice_span(start_ns: int, end_ns: int, marks: Sequence[int]) -> tuple[int, int]:
    """The time, ns, in which a choice belongs to the trial from start_ns to end_ns.

    It may be made before the start, but not before the newest of `marks`, ns, at which something
    else began or ended, nor earlier than BEFORE_S.
    """
    before = [t for t in marks if t < start_ns]
    return max([start_ns - round(BEFORE_S * 1e9), *before]), end_ns


def accepted_flags(found: Scan, times: Sequence[int]) -> dict[int, bool]:
    """Whether the robot merged a frame into its model, by the frame's stamp, ns.

    A flag has no stamp. As many flags as frames are one each, in order; else a flag is of the
    newest frame by the time it was logged, and of none a second after the last. times: of the
    frames. A frame without a flag is left out.
    """
    first, last = times[0] - SCORE_LATE_NS, times[-1] + round(1e9)
    flags = [f for f in sorted(found.numbers.get(ACCEPTED_TOPIC, [])) if first <= f[0] <= last]
    if len(flags) == len(times):
        return {t_ns: bool(flag) for t_ns, (_, flag) in zip(times, flags, strict=True)}
    out: dict[int, bool] = {}
    for t_ns, value in flags:
        k = bisect_right(times, t_ns + SCORE_LATE_NS)
        if k:
            out.setdefault(times[k - 1], bool(value))
    return out


def _numbers(found: Scan, topic: str, span: tuple[int, int]) -> Numbers:
    listed = sorted(v for v in found.numbers.get(topic, []) if span[0] <= v[0] <= span[1])
    return Numbers(tuple(t_ns for t_ns, _ in listed), tuple(value for _, value in listed))
