"""The object's undisturbed path, and the time at which it left that path."""

from __future__ import annotations

import numpy as np

from dgeval.geometry import Array, rotation_angle, transform
from dgeval.hindsight.moments import hand_distance
from dgeval.hindsight.smoothing import Path, Sighting, smooth
from dgeval.perception.types import Model
from dgeval.recording.robot import RobotStates

FIRST_S = 0.25  # s; sightings from the first on that start the path
# The object has left its path when OFF_PATH_COUNT sightings in a row lie off the path so far by
# more than one of these, beyond twice the path's own standard deviation.
OFF_PATH_M = 0.006  # m
OFF_PATH_RAD = 0.12  # rad
OFF_PATH_COUNT = 3
RENEWED = 5  # sightings, after which the path is smoothed anew
LEAST_COUNT = 5  # sightings that a path has at least
TOUCHING_M = 0.010  # m; a hand so near to an object that it pushes may have begun to; ours
PUSHING_M = 0.030  # m; from the hand to an object that leaves its path, for the hand to push it


def free_path(
    robot: RobotStates,
    sightings: list[Sighting],
    model: Model,
    centroid: Array,
    end_ns: int,
) -> tuple[Path, int | None]:
    """The undisturbed path, and when the hand pushed the object off it, ns, or None.

    Sightings are taken in time order. Several in a row that lie off the path so far are a push if
    the hand is near the object in one of them; else the object moved by itself, and the path
    follows it. What was seen of a pushed object since the hand came to it is not of its own path.
    centroid: of the model, (3,) m, model frame. end_ns: sightings after it don't count.
    """
    step = max(1, len(model.points) // 400)

    def hand_from(s: Sighting) -> float:
        found = hand_distance(robot, s.t_ns, transform(s.T_base_model, model.points[::step]))
        return np.inf if found is None else found[0]

    before = [s for s in sightings if s.t_ns <= end_ns] or sightings[:1]
    first = max(2, sum((s.t_ns - before[0].t_ns) * 1e-9 < FIRST_S for s in before))
    used, off, since = before[:first], list[Sighting](), 0
    path = smooth(used, centroid)
    for s in before[first:]:
        predicted = path.at(s.t_ns)
        distance = float(
            np.linalg.norm(
                transform(s.T_base_model, centroid[None]) - transform(predicted, centroid[None])
            )
        )
        angle = rotation_angle(s.T_base_model[:3, :3].T @ predicted[:3, :3])
        if distance < OFF_PATH_M + 2 * path.sd_at(s.t_ns) and angle < OFF_PATH_RAD + min(
            2 * path.sd_angle, 0.05
        ):
            used, off = [*used, *off, s], []
            since += 1
            # what a hand may be pushing does not tell where the path goes
            if (since >= RENEWED or len(used) < 15) and hand_from(s) >= TOUCHING_M:
                path, since = smooth(used, centroid), 0
            continue
        off.append(s)
        if len(off) == OFF_PATH_COUNT:
            if any(hand_from(o) < PUSHING_M for o in off):
                while len(used) > LEAST_COUNT and hand_from(used[-1]) < TOUCHING_M:
                    used = used[:-1]
                return smooth(used, centroid), off[0].t_ns
            used, off, since = [*used, *off], [], 0
            path = smooth(used, centroid)
    return smooth(used, centroid), None
