"""Whether a description's hand is one that dgeval knows: by its geometry, not by names alone."""

from __future__ import annotations

from functools import cache

import numpy as np

from dgeval.geometry import Array
from dgeval.robots.description import Description, Joint
from dgeval.robots.hand import KnownHand, hand_named, hand_of
from dgeval.robots.loading import load_description
from dgeval.robots.urdf import robot_urdf

SAME_M = 0.002  # m, by which a joint may lie elsewhere
SAME_DEG = 2.0  # degrees, by which its axis may be turned
NO_RADIUS_M = 0.01  # m, of links without solids, which play no part here
SAME_SHARE = 0.05  # of the joint's range, by which its limits may differ


def known_hand(description: Description) -> tuple[KnownHand | None, str]:
    """The hand of a description, and a note where its joints have a known hand's names, but not its
    geometry: then it is none that is known.
    """
    hand = hand_of({joint.name for joint in description.joints.values()})
    if hand is None:
        return None, ""
    other = _difference(description, hand)
    if other is None:
        return hand, ""
    return None, (
        f"the hand's joints have the names of those of {hand.name}, but it is another hand: {other}"
    )


def _difference(description: Description, hand: KnownHand) -> str | None:
    """What of the hand's joints is not as in its own description; None where all agree."""
    own = _joints_of_hand(_own(hand.name), hand)
    recorded = _joints_of_hand(description, hand)
    for name in hand.joints:
        if name not in own:
            continue  # a hand that an extension describes with other names
        if name not in recorded:
            return f"{name} is not on the link that carries {hand.drives[0]}"
        (a, T_a), (b, T_b) = own[name], recorded[name]
        if a.kind != b.kind:
            return f"{name} is {b.kind}, and not {a.kind}"
        apart = float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3]))
        if apart > SAME_M:
            return f"{name} is {apart * 1000:.0f} mm from where that hand has it"
        turn = _angle(T_a[:3, :3] @ a.axis, T_b[:3, :3] @ b.axis)
        if turn > SAME_DEG:
            return f"the axis of {name} is turned by {turn:.0f} degrees"
        limits = np.array([[a.lower, a.upper], [b.lower, b.upper]])
        if np.isfinite(limits).all():
            off = float(np.abs(limits[0] - limits[1]).max())
            if off > SAME_SHARE * (a.upper - a.lower):
                return f"the limits of {name} are {b.lower:g} to {b.upper:g}"
    return None


@cache
def _own(name: str) -> Description:
    """The own description of the hand of that name, on dgeval's arm."""
    hand = hand_named(name)
    return load_description(robot_urdf(hand.T_hand_camera, hand), name, (), NO_RADIUS_M)


def _joints_of_hand(description: Description, hand: KnownHand) -> dict[str, tuple[Joint, Array]]:
    """By name, the hand's joints and T_root_joint (4, 4) with all joints at 0.

    The root is the link that carries the first drive. Joints elsewhere on the robot are left out.
    """
    by_name = {joint.name: joint for joint in description.joints.values()}
    root = by_name[hand.drives[0]].parent if hand.drives[0] in by_name else ""
    out = {}
    for name in hand.joints:
        joint = by_name.get(name)
        T, link = np.eye(4), joint.parent if joint is not None else ""
        while link != root and link in description.joints:
            above = description.joints[link]
            T = above.at(0.0) @ T
            link = above.parent
        if joint is not None and link == root:
            out[name] = (joint, np.asarray(T @ joint.origin))
    return out


def _angle(a: Array, b: Array) -> float:
    """Degrees between two directions (3,)."""
    cosine = float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
