"""The undisturbed path of the object, and when it left it."""

from __future__ import annotations

import numpy as np

from dgeval.geometry import Array, rotation_angle, transform
from dgeval.hindsight.moments import hand_distance
from dgeval.hindsight.smoothing import Path, Sighting, smooth
from dgeval.perception.types import Model
from dgeval.recording.robot import RobotStates

FIRST_S = 0.5  # from which the path is begun

# sightings in a row this far off the path so far
OFF_PATH_M, OFF_PATH_RAD, OFF_PATH_COUNT = 0.006, 0.12, 3

PUSHING_M = 0.030  # m; hand to the sighted object, when it leaves its path


def free_path(
    robot: RobotStates,
    sightings: list[Sighting],
    model: Model,
    centroid: Array,
    end_ns: int,
) -> tuple[Path, int | None]:
    """The undisturbed path, and when the object left it with the hand at it (the change point), or None.

    Sightings are taken in one after the other. Where several in a row lie off the path so far, it was a push if the hand
    is at the object then, else its own motion, which the path follows.
    """
    before = [s for s in sightings if s.t_ns <= end_ns] or sightings[:1]
    first = max(2, sum((s.t_ns - before[0].t_ns) * 1e-9 < FIRST_S for s in before))
    used, off = before[:first], list[Sighting]()
    path = smooth(used, centroid)
    for s in before[first:]:
        there = path.at(s.t_ns)
        apart = float(
            np.linalg.norm(
                transform(s.T_base_model, centroid[None]) - transform(there, centroid[None])
            )
        )
        turned = rotation_angle(s.T_base_model[:3, :3].T @ there[:3, :3])
        if apart < OFF_PATH_M + 2 * path.sd_at(s.t_ns) and turned < OFF_PATH_RAD + min(
            2 * path.sd_angle, 0.05
        ):
            used, off = [*used, *off, s], []
            if len(used) % 5 == 0 or len(used) < 15:
                path = smooth(used, centroid)
            continue
        off.append(s)
        if len(off) == OFF_PATH_COUNT:
            step = max(1, len(model.points) // 400)
            near = [
                hand_distance(robot, o.t_ns, transform(o.T_base_model, model.points[::step]))
                for o in off
            ]
            if any(n is not None and n[0] < PUSHING_M for n in near):
                return smooth(used, centroid), off[0].t_ns
            used, off = [*used, *off], []
            path = smooth(used, centroid)
    return smooth(used, centroid), None
