"""What the robot believed at the close, against hindsight: how far each part put the palm off.

- servo: the palm against the grasp that it was sent to;
- tracking: the robot's pose of the object against hindsight's, when the robot last saw it;
- velocity: how far the robot carried the object wrongly since then.

Synthesis and execution have no such distance: synthesis is what is left when all of these are taken
out, execution shows in the close times that work. For a hand that never closed, what counts is
whether the grasp that it was sent to would have held, and whether it came there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from dgeval.failure_rule import Unknown
from dgeval.geometry import Array, best_rigid, invert, matrix_from_pose, transform
from dgeval.hindsight.second_pass import Hindsight
from dgeval.recording.messages import StampedPose
from dgeval.recording.robot import RobotStates
from dgeval.verdict.log import Recorded, TrialLog

# before its last sighting, and how many in it, whose errors tell a drift
DRIFT_NS, LEAST_SIGHTINGS = 1_000_000_000, 5
SEEN_NS = 50_000_000  # from a time to the sighting that tells where a pushed object was
# a push is told late; over which a believed velocity is taken
BEFORE_PUSH_NS, STEADY_NS = 300_000_000, 500_000_000
GAIN_LEAST_M = 0.01  # root mean square way, level and upright, over which gains can be told
# of laying hindsight's surface on the robot's model: its trimmed share is used
MOST_POINTS, ROUNDS, KEPT = 600, 60, 0.8


@dataclass(frozen=True)
class Beliefs:
    """The robot's errors, in one frame.

    errors: by part, m (3,), positive as the palm was displaced by it at the close (without a close:
    when the palm was nearest to its grasp). goal: T (4, 4) of the palm in the grasp commanded then,
    on the undisturbed object at the close or at the end of the log: where the hand would have been
    without the errors of servo and prediction; None where the object was not seen. gains: 1/s,
    level and upright, with which the commanded twist closed the error up to the first contact; None
    without commands. source: `recorded`, or `replayed_faithful` where a faithful replay's stand for
    the robot's.
    """

    errors: dict[str, Array]
    goal: Array | None
    gains: tuple[float, float] | None
    source: str = "recorded"

    def moved(self, T: Array) -> Beliefs:
        """The same in another frame: T (4, 4) maps points from the old one into it."""
        errors = {k: T[:3, :3] @ e for k, e in self.errors.items()}
        return replace(self, errors=errors, goal=None if self.goal is None else T @ self.goal)


def beliefs_of(log: TrialLog, hindsight: Hindsight) -> Beliefs | Unknown:
    """What the robot believed, base frame; `Unknown` says why nothing can be said."""
    recorded, robot = log.recorded, log.robot
    at_ns = _nearest_ns(robot, recorded.grasps) if log.close_ns is None else log.close_ns
    if at_ns is None:
        return Unknown("beliefs not recorded")
    grasps = [p for p in recorded.grasps if p.t_ns <= at_ns]
    targets = [p for p in recorded.targets if p.t_ns <= at_ns]
    palm = robot.T_base_palm(at_ns)
    if palm is None or not grasps or len(targets) < 2:
        return Unknown("beliefs not recorded")
    velocities = [v[:3] for t, v in recorded.velocities if t <= at_ns]
    # the grasp was last recorded with a frame; the robot believed that it moved on with the object
    velocity = velocities[-1] if velocities else np.zeros(3)
    grasp = matrix_from_pose(grasps[-1].pose)[:3, 3] + velocity * (at_ns - grasps[-1].t_ns) * 1e-9
    # what it saw itself; between and after it there are predictions
    seen_ns = recorded.seen_ns
    own = [
        p for p in targets if not len(seen_ns) or np.abs(seen_ns - p.t_ns).min() <= 1_000_000
    ] or targets
    tracking = _tracking(log, targets[0], own[-1], hindsight)
    if tracking is None:
        return Unknown(
            "where camera and object were when the robot last saw the object is not known"
        )
    errors = {"servo": palm[:3, 3] - grasp, "tracking": tracking}
    # what is pushed moves otherwise than before, and the belief follows it
    free_ns = min(
        [
            at_ns,
            *(
                t - BEFORE_PUSH_NS
                for t in (hindsight.contact_ns, hindsight.pushed_ns)
                if t is not None
            ),
        ]
    )
    closed = log.close_ns is not None
    free = velocities[-1:] if closed else steady(recorded.velocities, free_ns)
    if free:
        wrong = free[-1] - hindsight.path.velocity[-1]
        recent = [p for p in own if own[-1].t_ns - p.t_ns <= DRIFT_NS]
        drift = _drift(robot, recent, hindsight)
        gain = None if closed else log.servo_gain
        errors |= carried(tracking, drift, wrong, (at_ns - own[-1].t_ns) * 1e-9, gain)
    gains = _gains(robot, recorded, grasps, free_ns)
    return Beliefs(errors, _goal(grasps, hindsight, log.end_ns), gains, recorded.source)


def steady(twists: Sequence[tuple[int, Array]], until_ns: int) -> list[Array]:
    """Median velocity (3,) m/s over STEADY_NS up to a time.

    Empty where the filter had not been running for as long before that.
    """
    recent = [v[:3] for t, v in twists if until_ns - STEADY_NS <= t <= until_ns]
    return (
        [np.median(recent, axis=0)] if recent and twists[0][0] <= until_ns - 2 * STEADY_NS else []
    )


def gains_of(apart: list[Array], speeds: list[Array]) -> tuple[float, float] | None:
    """Gains 1/s, level and upright, by least squares.

    apart: from palm to grasp, m (3,) each. speeds: commanded less the target's, m/s (3,) each.
    """
    if len(apart) < LEAST_SIGHTINGS:
        return None
    e, v = np.array(apart), np.array(speeds)
    level, upright = float((e[:, :2] ** 2).sum()), float((e[:, 2] ** 2).sum())
    if min(level, upright) < len(e) * GAIN_LEAST_M**2:
        return None
    return float((e[:, :2] * v[:, :2]).sum()) / level, float((e[:, 2] * v[:, 2]).sum()) / upright


def _gains(
    robot: RobotStates, recorded: Recorded, grasps: list[StampedPose], until_ns: int
) -> tuple[float, float] | None:
    commands, velocities = recorded.commands, recorded.velocities
    commanded_ns, believed_ns = (
        np.array([t for t, _ in some], dtype=np.int64) for some in (commands, velocities)
    )
    apart, speeds = [], []
    for p in grasps:
        palm = robot.T_base_palm(p.t_ns)
        k, n = (
            int(np.searchsorted(t, p.t_ns, side="right")) - 1 for t in (commanded_ns, believed_ns)
        )
        if p.t_ns <= until_ns and palm is not None and k >= 0 and n >= 0:
            apart.append(p.pose[:3] - palm[:3, 3])
            speeds.append(commands[k][1][:3] - velocities[n][1][:3])
    return gains_of(apart, speeds)


def _nearest_ns(robot: RobotStates, grasps: Sequence[StampedPose]) -> int | None:
    """When the palm was nearest to the grasp it was sent to."""
    apart: list[tuple[float, int]] = []
    for p in grasps:
        palm = robot.T_base_palm(p.t_ns)
        if palm is not None:
            apart.append((float(np.linalg.norm(palm[:3, 3] - p.pose[:3])), p.t_ns))
    return min(apart)[1] if apart else None


def growth(t_ns: list[int], errors: list[Array]) -> Array:
    """Slope m/s (3,) of a straight line through errors (3,) m over time.

    0 with fewer than LEAST_SIGHTINGS.
    """
    if len(errors) < LEAST_SIGHTINGS:
        return np.zeros(3)
    t = np.array(t_ns, dtype=float) * 1e-9
    t -= t.mean()
    return np.asarray(t @ np.array(errors) / (t @ t))


def carried(
    tracking: Array, drift: Array, wrong: Array, seconds: float, gain: float | None
) -> dict[str, Array]:
    """Errors of tracking and velocity, m (3,), `seconds` after the last sighting.

    tracking m: at the last sighting. drift m/s: how fast that grew; what it makes the believed
    velocity wrong by is tracking's. wrong m/s: believed velocity less the true one. gain 1/s: of
    the servo, where the hand never closed: it runs ahead of a grasp, or behind it, by the
    velocity's error over its gain.
    """
    return {
        "tracking": tracking + drift * seconds,
        "velocity": (wrong - drift) * (seconds if gain is None else 1.0 / gain),
    }


def _there(hindsight: Hindsight, t_ns: int) -> Array | None:
    """T_base_model (4, 4) where the object really was at a time.

    On its path, or, once it had been pushed off it, where it was seen.
    """
    if hindsight.pushed_ns is None or t_ns < hindsight.pushed_ns:
        return hindsight.path.at(t_ns)
    near = min(hindsight.sightings, key=lambda s: abs(s.t_ns - t_ns))
    return near.T_base_model if abs(near.t_ns - t_ns) <= SEEN_NS else None


def _goal(grasps: list[StampedPose], hindsight: Hindsight, end_ns: int) -> Array | None:
    for p in reversed(grasps):
        there = _there(hindsight, p.t_ns)
        if there is not None:
            return hindsight.path.at(end_ns) @ invert(there) @ matrix_from_pose(p.pose)
    return None


def _drift(robot: RobotStates, own: list[StampedPose], hindsight: Hindsight) -> Array:
    """How fast the robot's pose of the object left hindsight's over its sightings, m/s (3,)."""
    centre = hindsight.path.centroid[None]
    times, errors = [], []
    T_own_model: Array | None = (
        None  # in the robot's model, by the first of them: only the growth counts
    )
    for p in own:
        T_camera, there = robot.T_base_camera(p.t_ns), _there(hindsight, p.t_ns)
        if T_camera is None or there is None:
            continue
        T_base_own = T_camera @ matrix_from_pose(p.pose)
        if T_own_model is None:
            T_own_model = invert(T_base_own) @ there
        times.append(p.t_ns)
        errors.append(transform(T_base_own @ T_own_model, centre)[0] - transform(there, centre)[0])
    return growth(times, errors)


def _tracking(
    log: TrialLog, first: StampedPose, last: StampedPose, hindsight: Hindsight
) -> Array | None:
    """Believed minus hindsight place of the object at the last own sighting, m (3,), base frame.

    The robot's model frame is its own: its recorded model says where in it the object lies. Without
    a model its first belief is laid on hindsight's path, and an error that it had from the start
    can't be seen.
    """
    T_first, T_last = (log.robot.T_base_camera(p.t_ns) for p in (first, last))
    there = _there(hindsight, last.t_ns)
    if T_first is None or T_last is None or there is None:
        return None
    T_base_own = T_last @ matrix_from_pose(last.pose)
    centre = hindsight.path.centroid[None]
    model = log.recorded.model(last.t_ns)
    if model is None:
        T_own_model = invert(T_first @ matrix_from_pose(first.pose)) @ hindsight.path.at(first.t_ns)
        return np.asarray(
            transform(T_base_own @ T_own_model, centre)[0] - transform(there, centre)[0]
        )
    seen = transform(there, hindsight.points)
    middle = transform(there, centre)
    return np.asarray(transform(laid_on(seen, transform(T_base_own, model)), middle)[0] - middle[0])


def laid_on(points: Array, target: Array) -> Array:
    """T (4, 4) that moves points (n, 3) onto a cloud (m, 3), from where they are.

    Trimmed iterative closest points: the nearest KEPT share of the matches counts. Trimmed from the
    start it can stop half-way, with most of a large flat face on another; with all points first,
    strays can lead it away. Both are tried, and the closer one counts.
    """
    tree = cKDTree(target)
    points = points[:: max(1, len(points) // MOST_POINTS)]
    T_trimmed, apart_trimmed = _closest(points, tree, np.eye(4), KEPT)
    T_staged, apart_staged = _closest(points, tree, _closest(points, tree, np.eye(4), 1.0)[0], KEPT)
    return T_trimmed if apart_trimmed <= apart_staged else T_staged


def _closest(points: Array, tree: cKDTree, T: Array, kept: float) -> tuple[Array, float]:
    """Iterative closest points from T (4, 4) on: where they end, and how far apart, m."""
    target = np.asarray(tree.data)
    for _ in range(ROUNDS):
        moved = transform(T, points)
        distance, nearest = tree.query(moved)
        used = distance <= np.quantile(distance, kept)
        a, b = moved[used], target[np.asarray(nearest)[used]]
        T = best_rigid(a, b) @ T
    distance = np.asarray(tree.query(transform(T, points))[0])
    return T, float(np.mean(distance[distance <= np.quantile(distance, kept)]))
