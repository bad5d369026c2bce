"""Where the object was in each frame around the close, and how near the hand was to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dgeval.failure_rule import NEAR_M
from dgeval.geometry import Array, invert, transform
from dgeval.hindsight.smoothing import Path, Sighting
from dgeval.hindsight.surface import CausalFrame
from dgeval.perception.self_filter import signed_distance
from dgeval.perception.types import Model
from dgeval.recording.robot import RobotStates

KnownBy = Literal["path", "registration", "depth", "colour", "hand", "support"]

WINDOW_BEFORE_S, WINDOW_AFTER_S = 4.0, 4.0  # s, around the close; frames that are searched again
APPROACH_STEP_NS = 50_000_000  # ns, between the times at which hand and object are compared
HAND_REACH_M = 0.25  # m from the palm to the farthest fingertip of any hand in use; ours
RISEN_M = 0.05  # m; from the palm's position at the close, for the palm to have moved on
HELD_M = 0.015  # m; from the object's typical position in the palm, for it to be in the hand


@dataclass(frozen=True, slots=True)
class Moment:
    """Where hindsight places the object in a frame, and the hand's nearest link then.

    by: what the pose comes from: `path` (undisturbed), `registration`, `depth` or `colour` (a
    sighting), `hand` (it moves with the hand), `support` (pushed; it moves on with what it stands
    on). sd: of the position, m; None off the path. distance: from the link, signed, m; None without
    hand geometry.
    """

    index: int
    t_ns: int
    T_base_model: Array
    by: KnownBy
    sd: float | None
    distance: float | None
    link: str | None


def hand_distance(robot: RobotStates, t_ns: int, points_base: Array) -> tuple[float, str] | None:
    """Least signed distance, m, of the hand to points (n, 3), base frame, and the link.

    None without hand geometry.
    """
    near = nearest_link(robot, t_ns, points_base, None)
    return None if near is None else (near[1], near[0])


def nearest_link(
    robot: RobotStates, t_ns: int, points_base: Array, link: str | None
) -> tuple[str, float, Array, Array] | None:
    """The link nearest to the points (n, 3), or the named one.

    Gives its name, its signed distance, m, its middle and the nearest point, base frame. None
    without hand geometry, or with every link farther than 0.4 m from the points' middle.
    """
    shapes = robot.hand_shapes(t_ns)
    T_base_camera = robot.T_base_camera(t_ns)
    if shapes is None or T_base_camera is None:
        return None
    best: tuple[str, float, Array, Array] | None = None
    in_camera = transform(invert(T_base_camera), points_base)
    middle = in_camera.mean(axis=0)
    for shape, T_camera_shape in shapes:
        if link is not None and shape.link != link:
            continue
        if float(np.linalg.norm(middle - T_camera_shape[:3, 3])) > 0.4 + shape.bound:
            continue
        d = signed_distance(shape, transform(invert(T_camera_shape), in_camera))
        k = int(np.argmin(d))
        if best is None or d[k] < best[1]:
            best = (
                shape.link,
                float(d[k]),
                transform(T_base_camera, T_camera_shape[None, :3, 3])[0],
                points_base[k],
            )
    return best


def nearest_approach(
    robot: RobotStates, first_ns: int, last_ns: int, path: Path, points: Array
) -> float | None:
    """Least distance, m, of the hand to the object on its path; None where it is not known.

    points (n, 3) m: the object's, model frame. Where the path is known too badly to tell, the hand
    must be clear of all of it. A hand without solids is within HAND_REACH_M of its palm.
    """
    step = max(1, len(points) // 100)
    nearest, doubtful = None, False
    for t_ns in range(first_ns, last_ns + 1, APPROACH_STEP_NS):
        palm = robot.T_base_palm(t_ns)
        if palm is None:
            continue
        placed = transform(path.at(t_ns), points[::step])
        solid = hand_distance(robot, t_ns, placed)
        sd = path.sd_at(t_ns)
        if solid is not None:
            distance = solid[0]
        else:
            distance = float(np.linalg.norm(placed - palm[:3, 3], axis=1).min()) - HAND_REACH_M
        if (solid is None or sd > NEAR_M / 2) and distance < NEAR_M + 2 * sd:
            doubtful = True
        else:
            nearest = distance if nearest is None else min(nearest, distance)
    if doubtful and (nearest is None or nearest >= NEAR_M):
        return None
    return nearest


def moments_of(
    robot: RobotStates,
    frames: list[CausalFrame],
    path: Path,
    sightings: list[Sighting],
    model: Model,
    pushed_ns: int | None,
    end_ns: int,
) -> tuple[Moment, ...]:
    """The object in every frame from WINDOW_BEFORE_S before the close on, and the nearest link.

    Up to the push, or the close, the object is on its path. Afterwards it is where a sighting has
    it. Between sightings it moves with the hand, if sightings show that it did; else, up to the
    close, with what it stands on.
    """
    step = max(1, len(model.points) // 400)
    left_ns = end_ns if pushed_ns is None else min(pushed_ns, end_ns)
    in_hand = _in_hand(robot, sightings, end_ns)
    at = {s.t_ns: s for s in sightings}
    out = []
    last: tuple[int, Array] | None = None
    for s in frames:
        if (end_ns - s.t_ns) * 1e-9 > WINDOW_BEFORE_S:
            continue
        by: KnownBy = "path"
        T, sd = path.at(s.t_ns), None
        palm = robot.T_base_palm(s.t_ns)
        if s.t_ns <= left_ns:
            sd = path.sd_at(s.t_ns)
        elif s.t_ns in at:
            T, by = at[s.t_ns].T_base_model, at[s.t_ns].by
            last = s.t_ns, T
        elif in_hand is not None and palm is not None and s.t_ns > in_hand[0]:
            T, by = palm @ in_hand[1], "hand"
        elif last is not None and s.t_ns <= end_ns:
            T, by = last[1].copy(), "support"
            T[:3, 3] += path.velocity[-1] * (s.t_ns - last[0]) * 1e-9
        else:
            continue  # closing fingers may have moved it anywhere
        near = hand_distance(robot, s.t_ns, transform(T, model.points[::step]))
        out.append(Moment(s.index, s.t_ns, T, by, sd, *(near or (None, None))))
    return tuple(out)


def _in_hand(
    robot: RobotStates, sightings: list[Sighting], end_ns: int
) -> tuple[int, Array] | None:
    """Since when, ns, and T_palm_model, if the object moved with the palm after the close.

    None where fewer than three sightings with a risen palm, or sightings that disagree, show it.
    """
    at_close = robot.T_base_palm(end_ns)
    after = [
        (s, palm)
        for s in sightings
        if s.t_ns > end_ns and (palm := robot.T_base_palm(s.t_ns)) is not None
    ]
    risen = [
        (s, palm)
        for s, palm in after
        if at_close is not None and np.linalg.norm(palm[:3, 3] - at_close[:3, 3]) > RISEN_M
    ]
    if len(risen) < 3:
        return None
    held = [invert(palm) @ s.T_base_model for s, palm in risen]
    typical = held[
        int(
            np.argmin(
                [np.median([np.linalg.norm(a[:3, 3] - b[:3, 3]) for b in held]) for a in held]
            )
        )
    ]
    if float(np.median([np.linalg.norm(T[:3, 3] - typical[:3, 3]) for T in held])) > HELD_M:
        return None
    # the first sighting after the close with the object at its typical place in the hand
    in_place = [
        s.t_ns
        for s, palm in after
        if np.linalg.norm((invert(palm) @ s.T_base_model)[:3, 3] - typical[:3, 3]) < HELD_M
    ]
    return in_place[0], typical
