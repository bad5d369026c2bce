"""Which part of the system the palm's error at the decisive instant came from (DESIGN section 2.4).

The palm stood at T_hand instead of at a grasp that works on the object where it really was. On the way there:
servo (hand against commanded grasp), velocity (prediction since the last accepted frame), tracking (believed against
hindsight place at that frame), synthesis (grasp against what the object supports, only where the others are small), and
execution (when it closed). Needs the robot's own beliefs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgeval.geometry import Array, invert, matrix_from_pose, transform
from dgeval.hindsight import Hindsight
from dgeval.recording.messages import StampedPose
from dgeval.recording.trials import GRASP_TOPIC, Trial
from dgeval.verdict.causes import Cause
from dgeval.verdict.evidence import VELOCITY_TOPIC

TARGET_TOPIC = "/dgeval/belief/target_pose"
TOLERANCE_M = 0.008  # a palm this near to a grasp that holds still lifts: five of six grasps survive 4 mm and 3 degrees


@dataclass(frozen=True)
class Blame:
    """`term` servo, synthesis, velocity, tracking or execution; sizes m (execution: s) of all that are known."""

    term: str
    probability: float
    sizes: dict[str, float]
    source: str | None
    why_unknown: str | None = None


def blame_of(trial: Trial, hindsight: Hindsight, cause: Cause) -> Blame:
    """The term whose removal alone brings the palm back into tolerance; unknown where several or none would."""
    if cause.failure_class == "timing":
        return Blame("execution", max(cause.probabilities), {"execution": abs(cause.shift_s or 0.0)}, "recorded")
    close_ns = trial.event_ns("close")
    if close_ns is None:
        return Blame("unknown", 0.0, {}, None, "it never closed: there is no decisive instant")
    poses = {topic: [p for p in trial.scan.poses.get(topic, []) if p.t_ns <= close_ns] for topic in (GRASP_TOPIC, TARGET_TOPIC)}
    palm = trial.robot.T_base_palm(close_ns)
    if palm is None or not poses[GRASP_TOPIC] or len(poses[TARGET_TOPIC]) < 2:
        return Blame("unknown", 0.0, {}, None, "beliefs not recorded")
    grasp = matrix_from_pose(poses[GRASP_TOPIC][-1].pose)
    errors: dict[str, Array] = {"servo": palm[:3, 3] - grasp[:3, 3]}
    believed = _believed_track(trial, poses[TARGET_TOPIC], hindsight)
    if believed is None:
        return Blame("unknown", 0.0, {}, None, "the camera's pose is not known when the robot last saw the object")
    last_ns, tracking = believed
    velocities = [v for t, v in trial.scan.velocities.get(VELOCITY_TOPIC, []) if t <= close_ns]
    errors["tracking"] = tracking
    if velocities:
        errors["velocity"] = (velocities[-1] - hindsight.path.velocity[-1]) * (close_ns - last_ns) * 1e-9
    sizes = {k: float(np.linalg.norm(v)) for k, v in errors.items()}
    total = np.sum(list(errors.values()), axis=0)
    restoring = [k for k, v in errors.items() if np.linalg.norm(total - v) < TOLERANCE_M <= np.linalg.norm(total)]
    if np.linalg.norm(total) < TOLERANCE_M:
        return Blame("synthesis", 0.5, sizes, "recorded")  # the palm was where it was wanted, and what was wanted failed
    if len(restoring) == 1:
        share = sizes[restoring[0]] / max(sum(sizes.values()), 1e-9)
        return Blame(restoring[0], share, sizes, "recorded")
    worst = max(sizes, key=lambda k: sizes[k])
    if len(restoring) > 1:
        why = f"removing any of {', '.join(sorted(restoring))} alone would do"
    else:
        why = f"no term alone explains it, the largest is {worst} with {sizes[worst] * 1000:.0f} mm"
    return Blame("unknown", 0.0, sizes, "recorded", why)


def _believed_track(trial: Trial, believed: list[StampedPose], hindsight: Hindsight) -> tuple[int, Array] | None:
    """Time of the robot's last own sighting, and how far its belief then was from hindsight, m (3,), base frame.

    The robot's model frame is its own, so its first belief is laid on hindsight's path: an error it had from the start
    (hand-eye, a wrong model) can't be seen in the difference.
    """
    first, last = believed[0], believed[-1]
    T_first, T_last = trial.robot.T_base_camera(first.t_ns), trial.robot.T_base_camera(last.t_ns)
    if T_first is None or T_last is None:
        return None
    own_first, own_last = T_first @ matrix_from_pose(first.pose), T_last @ matrix_from_pose(last.pose)
    T_own_model = invert(own_first) @ hindsight.path.at(first.t_ns)
    centre = hindsight.path.centroid[None]
    error = transform(own_last @ T_own_model, centre)[0] - transform(hindsight.path.at(last.t_ns), centre)[0]
    return last.t_ns, np.asarray(error)
