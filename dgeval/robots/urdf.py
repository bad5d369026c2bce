"""The robot as a URDF, from the same tables as the physics.

A recording carries it as /robot_description.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.geometry import Array
from dgeval.robots import diana7 as arm
from dgeval.robots.hand import BASE, SimulatedHand

Numbers = tuple[float, ...]
FLANGE = "flange"  # where a hand is mounted that has frames of its own
CAMERA_FRAME = "camera_color_optical_frame"  # the colour camera's frame in recordings


def robot_urdf(T_hand_camera: Array, hand: SimulatedHand) -> str:
    """URDF text of arm, hand with its solids, and camera; `palm_link` is the frame of grasps where
    the hand has none of its own.

    T_hand_camera (4, 4): the camera as calibrated.
    """
    parts = [link("base_link")]
    parent = "base_link"
    for k, (xyz, rpy, lower, upper, speed) in enumerate(arm.JOINTS):
        limits = lower, upper, 100.0, speed
        name = f"link_{k + 1}"
        parts += [link(name), joint(arm.JOINT_NAMES[k], parent, name, xyz, rpy, limits)]
        parent = name
    base = BASE if hand.palm_frame is None else FLANGE
    parts += [link(base, hand.palm_solids), fixed("hand_mount", parent, base, arm.T_flange_hand)]
    if hand.palm_frame is None:
        parts += [link("palm_link"), fixed("palm_mount", BASE, "palm_link", hand.T_hand_palm)]
    parts += [link(CAMERA_FRAME), fixed("hand_eye", base, CAMERA_FRAME, T_hand_camera)]
    parts += hand.links()
    return f'<robot name="dgeval_arm_hand">{"".join(parts)}</robot>'


def boxes(boxes: Sequence[tuple[Numbers, Numbers]]) -> str:
    """Box solids as URDF text, from half sizes m and centres m."""
    return "".join(
        solid(centre, (0, 0, 0), f'<box size="{2 * half[0]} {2 * half[1]} {2 * half[2]}"/>')
        for half, centre in boxes
    )


def origin(T: Array) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """xyz m and rpy rad (fixed axes) of a pose (4, 4)."""
    # a finger that points straight up is at the pole of these angles
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        rpy = Rotation.from_matrix(T[:3, :3]).as_euler("xyz")
    return tuple(float(v) for v in T[:3, 3]), tuple(float(v) for v in rpy)  # type: ignore[return-value]


def text(values: tuple[float, ...]) -> str:
    """Numbers as text, nine digits."""
    return " ".join(f"{v:.9g}" for v in values)


def solid(xyz: tuple[float, ...], rpy: tuple[float, ...], geometry: str) -> str:
    """A collision solid at xyz m and rpy rad."""
    return (
        f'<collision><origin xyz="{text(xyz)}" rpy="{text(rpy)}"/>'
        f"<geometry>{geometry}</geometry></collision>"
    )


def capsule(a: Array, b: Array, radius: float) -> str:
    """A capsule from a to b, m, as a cylinder and two spheres; no text if b is the origin."""
    if not b.any():
        return ""
    length = float(np.linalg.norm(b - a))
    T = np.eye(4)
    T[:3, :3] = Rotation.align_vectors([(b - a) / length], [[0.0, 0.0, 1.0]])[0].as_matrix()
    T[:3, 3] = (a + b) / 2
    xyz, rpy = origin(T)
    ends = "".join(solid(tuple(e), (0, 0, 0), f'<sphere radius="{radius}"/>') for e in (a, b))
    return solid(xyz, rpy, f'<cylinder radius="{radius}" length="{length:.9g}"/>') + ends


def link(name: str, solids: str = "") -> str:
    """A link with its solids."""
    return f'<link name="{name}">{solids}</link>'


def joint(
    name: str,
    parent: str,
    child: str,
    xyz: Numbers,
    rpy: Numbers,
    limits: Numbers,
    more: str = "",
    kind: str = "revolute",
    axis: str = "0 0 1",
) -> str:
    """A joint; limits: lower and upper rad or m, effort Nm or N, speed rad/s or m/s."""
    lower, upper, effort, speed = limits
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{text(xyz)}" rpy="{text(rpy)}"/><axis xyz="{axis}"/>'
        f'<limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="{speed}"/>{more}'
        "</joint>"
    )


def fixed(name: str, parent: str, child: str, T: Array) -> str:
    """A fixed joint with T_parent_child (4, 4)."""
    xyz, rpy = origin(T)
    return (
        f'<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{text(xyz)}" rpy="{text(rpy)}"/></joint>'
    )
