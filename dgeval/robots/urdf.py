"""The robot as a URDF, from the same tables as the physics; what a log carries as /robot_description."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.geometry import Array
from dgeval.robots import diana7 as arm
from dgeval.robots import dlr_hit_hand as hand
from dgeval.robots import parallel_jaw as jaw
from dgeval.robots.hand import FIVE_FINGERS, Gripper

Numbers = tuple[float, ...]
CAMERA_FRAME = "camera_color_optical_frame"


def robot_urdf(T_hand_camera: Array, gripper: Gripper = FIVE_FINGERS) -> str:
    """Arm, gripper with its solids, palm_link (the frame of grasps), and the camera where the calibration says it is."""
    parts = [_link("base_link")]
    parent = "base_link"
    for k, (xyz, rpy, lower, upper, speed) in enumerate(arm.JOINTS):
        limits = lower, upper, 100.0, speed
        parts += [
            _link(f"link_{k + 1}"),
            _joint(arm.JOINT_NAMES[k], parent, f"link_{k + 1}", xyz, rpy, limits),
        ]
        parent = f"link_{k + 1}"
    offset = jaw.T_hand_grasp[:3, 3]
    palm: list[tuple[Numbers, Numbers]] = [(half, centre) for half, centre, _ in hand.PALM_BOXES]
    if gripper.name == "jaw":
        palm = [(jaw.PALM[0], tuple(float(v) for v in offset + jaw.PALM[1]))]
    parts += [
        _link("hand_base", _boxes(palm)),
        _fixed("hand_mount", parent, "hand_base", arm.T_flange_hand),
    ]
    parts += [
        _link("palm_link"),
        _fixed("palm_mount", "hand_base", "palm_link", gripper.T_hand_palm),
    ]
    parts += [_link(CAMERA_FRAME), _fixed("hand_eye", "hand_base", CAMERA_FRAME, T_hand_camera)]
    parts += _jaws() if gripper.name == "jaw" else _five_fingers()
    return f'<robot name="dgeval_arm_hand">{"".join(parts)}</robot>'


def _jaws() -> list[str]:
    parts = []
    for name, side in zip(jaw.JOINT_NAMES, (1.0, -1.0), strict=True):
        solids = [
            (half, (side * centre[0], *centre[1:])) for half, centre in (jaw.DISTAL, jaw.PROXIMAL)
        ]
        parts.append(_link(name, _boxes(solids)))
        xyz, limits = (
            tuple(float(v) for v in jaw.T_hand_grasp[:3, 3]),
            (0.0, jaw.TRAVEL, jaw.GRIP_FORCE, jaw.CLOSE_SPEED),
        )
        parts.append(
            _joint(
                name,
                "hand_base",
                name,
                xyz,
                (0, 0, 0),
                limits,
                kind="prismatic",
                axis=f"{side} 0 0",
            )
        )
    return parts


def _five_fingers() -> list[str]:
    parts = []
    for finger in hand.FINGERS:
        parent, T = "hand_base", hand.pose(*hand.FINGER_MOUNTS[finger])
        for k, joint in enumerate(hand.CHAIN):
            name = f"{finger}_{k}"
            parts.append(_link(name, _capsule(*hand.capsule_ends(joint))))
            xyz, rpy = _origin(T @ hand.pose(joint.xyz, joint.rpy))
            mimic = f'<mimic joint="{finger}_2"/>' if k == 3 else ""
            limits = (joint.lower, joint.upper, joint.effort, hand.MAX_SPEED)
            parts.append(_joint(name, parent, name, xyz, rpy, limits, mimic))
            parent, T = name, np.eye(4)
    return parts


def _boxes(boxes: Sequence[tuple[Numbers, Numbers]]) -> str:
    """Solids of half sizes and centres."""
    return "".join(
        _solid(centre, (0, 0, 0), f'<box size="{2 * half[0]} {2 * half[1]} {2 * half[2]}"/>')
        for half, centre in boxes
    )


def _origin(T: Array) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    with (
        warnings.catch_warnings()
    ):  # a finger that points straight up is at the pole of these angles
        warnings.simplefilter("ignore", UserWarning)
        rpy = Rotation.from_matrix(T[:3, :3]).as_euler("xyz")
    return tuple(float(v) for v in T[:3, 3]), tuple(float(v) for v in rpy)  # type: ignore[return-value]


def _text(values: tuple[float, ...]) -> str:
    return " ".join(f"{v:.9g}" for v in values)


def _solid(xyz: tuple[float, ...], rpy: tuple[float, ...], geometry: str) -> str:
    return f'<collision><origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/><geometry>{geometry}</geometry></collision>'


def _capsule(a: Array, b: Array) -> str:
    if not b.any():
        return ""
    length = float(np.linalg.norm(b - a))
    T = np.eye(4)
    T[:3, :3] = Rotation.align_vectors([(b - a) / length], [[0.0, 0.0, 1.0]])[0].as_matrix()
    T[:3, 3] = (a + b) / 2
    xyz, rpy = _origin(T)
    ends = "".join(_solid(tuple(e), (0, 0, 0), f'<sphere radius="{hand.RADIUS}"/>') for e in (a, b))
    return _solid(xyz, rpy, f'<cylinder radius="{hand.RADIUS}" length="{length:.9g}"/>') + ends


def _link(name: str, solids: str = "") -> str:
    return f'<link name="{name}">{solids}</link>'


def _joint(
    name: str, parent: str, child: str, xyz: Numbers, rpy: Numbers, limits: Numbers, more: str = "", kind: str = "revolute",
    axis: str = "0 0 1",
) -> str:  # fmt: skip
    lower, upper, effort, speed = limits
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/><axis xyz="{axis}"/>'
        f'<limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="{speed}"/>{more}</joint>'
    )


def _fixed(name: str, parent: str, child: str, T: Array) -> str:
    xyz, rpy = _origin(T)
    return (
        f'<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/></joint>'
    )
