"""What the robot believed at the close, against hindsight: how far each part put the palm off (DESIGN 2.4).

servo: palm against the grasp it was sent to. tracking: its pose of the object against hindsight's when it last saw it.
velocity: how far the object was carried wrongly since then. Synthesis and execution have no such distance: the first is
what is left when all of these are taken out, the second is told by the close times that work.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from dgeval.geometry import Array, invert, matrix_from_pose, transform
from dgeval.hindsight import Hindsight
from dgeval.recording.messages import StampedPose, cloud_points
from dgeval.recording.trials import GRASP_TOPIC, Trial

TARGET_TOPIC, VELOCITY_TOPIC = "/dgeval/belief/target_pose", "/dgeval/belief/velocity"
COMMAND_TOPIC = "/dgeval/belief/twist_command"
MASK_TOPIC, MODEL_TOPIC = "/dgeval/belief/mask", "/dgeval/belief/model"
MOST_POINTS, ROUNDS, KEPT = 600, 60, 0.8  # of laying hindsight's surface on the robot's model: its trimmed share is used


def palm_errors(trial: Trial, hindsight: Hindsight) -> dict[str, Array] | str:
    """By part, m (3,), base frame, positive as the palm was displaced by it; in words, why nothing can be said."""
    close_ns = trial.event_ns("close")
    if close_ns is None:
        return "it never closed: there is no decisive instant"
    grasps, targets = (
        [p for p in trial.scan.poses.get(topic, []) if p.t_ns <= close_ns] for topic in (GRASP_TOPIC, TARGET_TOPIC)
    )
    palm = trial.robot.T_base_palm(close_ns)
    if palm is None or not grasps or len(targets) < 2:
        return "beliefs not recorded"
    velocities = [v[:3] for t, v in trial.scan.twists.get(VELOCITY_TOPIC, []) if t <= close_ns]
    # the grasp was last recorded with a frame; it has moved on with the object since, as the robot believed
    velocity = velocities[-1] if velocities else np.zeros(3)
    grasp = matrix_from_pose(grasps[-1].pose)[:3, 3] + velocity * (close_ns - grasps[-1].t_ns) * 1e-9
    masks = trial.scan.times[MASK_TOPIC].arrays()[0] if MASK_TOPIC in trial.scan.times else np.zeros(0, dtype=np.int64)
    # what it saw itself; between and after it there are predictions
    own = [p for p in targets if not len(masks) or np.abs(masks - p.t_ns).min() <= 1_000_000] or targets
    tracking = _tracking(trial, targets[0], own[-1], hindsight)
    if tracking is None:
        return "the camera's pose is not known when the robot last saw the object"
    errors = {"servo": palm[:3, 3] - grasp, "tracking": tracking}
    if velocities:
        errors["velocity"] = (velocity - hindsight.path.velocity[-1]) * (close_ns - own[-1].t_ns) * 1e-9
    return errors


def _tracking(trial: Trial, first: StampedPose, last: StampedPose, hindsight: Hindsight) -> Array | None:
    """Believed minus hindsight place of the object at the robot's last own sighting, m (3,), base frame.

    The robot's model frame is its own: its recorded model says where in it the object lies. Without one its first belief is
    laid on hindsight's path, and an error it had from the start can't be seen.
    """
    T_first, T_last = trial.robot.T_base_camera(first.t_ns), trial.robot.T_base_camera(last.t_ns)
    if T_first is None or T_last is None:
        return None
    T_base_own = T_last @ matrix_from_pose(last.pose)
    there = hindsight.path.at(last.t_ns)
    centre = hindsight.path.centroid[None]
    model = _own_model(trial, last.t_ns)
    if model is None:
        T_own_model = invert(T_first @ matrix_from_pose(first.pose)) @ hindsight.path.at(first.t_ns)
        return np.asarray(transform(T_base_own @ T_own_model, centre)[0] - transform(there, centre)[0])
    seen = transform(there, hindsight.points)
    middle = transform(there, centre)
    return np.asarray(transform(laid_on(seen, transform(T_base_own, model)), middle)[0] - middle[0])


def _own_model(trial: Trial, t_ns: int) -> Array | None:
    """Points (n, 3) of the robot's model, its model frame, as recorded last before a time."""
    if MODEL_TOPIC not in trial.opened.topics:
        return None
    last = None
    for message in trial.opened.messages(frozenset({MODEL_TOPIC})):
        if message.log_ns > t_ns and last is not None:
            break
        last = message
    points = None if last is None else cloud_points(trial.opened.decode(last))
    return None if points is None or len(points) < 20 else points


def laid_on(points: Array, target: Array) -> Array:
    """T (4, 4) that moves points (n, 3) onto a cloud (m, 3): trimmed iterative closest points, from where they are."""
    tree = cKDTree(target)
    points = points[:: max(1, len(points) // MOST_POINTS)]
    T = np.eye(4)
    for _ in range(ROUNDS):
        moved = transform(T, points)
        distance, nearest = tree.query(moved)
        used = distance <= np.quantile(distance, KEPT)
        a, b = moved[used], target[np.asarray(nearest)[used]]
        U, _, Vt = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
        step = np.eye(4)
        step[:3, :3] = Vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))]) @ U.T
        step[:3, 3] = b.mean(axis=0) - step[:3, :3] @ a.mean(axis=0)
        T = step @ T
    return T
