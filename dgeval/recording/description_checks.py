"""Whether the recorded transforms of the hand are those of its description.

A robot that publishes both takes them from one file. Where they differ, the description that was
recorded, or that a user gave, is another hand's: a left one for a right one, another model's
fingers, a joint whose axis runs the other way.
"""

from __future__ import annotations

import numpy as np

from dgeval.geometry import Array, invert, matrix_from_pose, rotation_angle
from dgeval.recording.robot import RobotStates
from dgeval.recording.two_sources import APART_M, APART_RAD
from dgeval.robots.description import Description, Joint

SAMPLED, LEAST_SAMPLES = 40, 5  # of a transform, that are compared; ours


def other_hand(robot: RobotStates) -> str | None:
    """What of the hand's recorded transforms contradicts its description; None where nothing does,
    or nothing of it is recorded.
    """
    description = robot.description
    if description is None:
        return None
    worst: tuple[float, str] | None = None
    for link in sorted(_of_hand(robot, description)):
        joint = description.joints[link]
        apart = _apart(robot, joint)
        if apart is None:
            continue
        metres, radians = apart
        size = max(metres / APART_M, radians / APART_RAD)
        if size > 1.0 and (worst is None or size > worst[0]):
            worst = (
                size,
                f"by /tf {link!r} is {metres * 1000:.0f} mm and {np.degrees(radians):.0f} degrees "
                f"from where the description and the states of {joint.follows} put it on "
                f"{joint.parent!r}",
            )
    return None if worst is None else worst[1]


def _of_hand(robot: RobotStates, description: Description) -> set[str]:
    """The links below the palm, and those of the hand that have a shape."""
    palm = robot.palm_frame
    below = set(description.below(palm)) - {palm} if palm is not None else set()
    return (below | set(robot.hand_links)) & set(description.joints)


def _apart(robot: RobotStates, joint: Joint) -> tuple[float, float] | None:
    """m and rad, in the median, between a link's recorded pose on its parent and the description's;
    None where they can't be compared.
    """
    tree = robot.tree
    pairs: list[tuple[Array, Array]] = []
    if joint.child in tree.moving and tree.moving[joint.child][1].has_one_parent:
        parent, track = tree.moving[joint.child]
        if parent != joint.parent:
            return None
        for k in range(0, len(track.times), max(1, len(track.times) // SAMPLED)):
            fixed = joint.kind == "fixed"
            q = 0.0 if fixed else robot.joints.position(joint, track.times[k], tree.max_gap_ns)
            if q is not None:
                pairs.append((matrix_from_pose(track.poses[k]), joint.moved(q)))
        if len(pairs) < LEAST_SAMPLES:
            return None
    elif joint.kind == "fixed" and joint.child in tree.static:
        parent, T = tree.static[joint.child]
        if parent != joint.parent:
            return None
        pairs.append((T, joint.origin))
    if not pairs:
        return None
    off = [invert(T) @ described for T, described in pairs]
    metres = float(np.median([np.linalg.norm(T[:3, 3]) for T in off]))
    return metres, float(np.median([rotation_angle(T[:3, :3]) for T in off]))
