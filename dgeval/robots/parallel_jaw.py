"""A parallel-jaw gripper: two fingers of a proximal and a distal link that slide together.

VFAS-Grasp's gripper is a four-bar linkage of unknown size, whose fingertips stay parallel. Sliding
fingers stand for it; their dimensions are dgeval's own. Grasp frame: origin between the fingertips,
10 mm behind their ends, +z the approach, +x the closing direction (the paper's Figure 3). Hand
frame `hand_base`: at the flange, the same axes. Metres, radians.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.geometry import Array
from dgeval.robots import urdf
from dgeval.robots.hand import Grip, KnownHand, Solids
from dgeval.robots.mjcf import place

# All dimensions, forces and speeds in this file are dgeval's own.
OPENING = 0.10  # m between the pads
TRAVEL = OPENING / 2  # m, of each finger
JOINT_NAMES = ("left_jaw", "right_jaw")
FINGERS = ("left", "right")
# Half sizes m and centres m in the grasp frame; of the closed fingers, the one at +x.
PALM = ((0.052, 0.030, 0.030), (0.0, 0.0, -0.110))
DISTAL = ((0.006, 0.011, 0.022), (0.006, 0.0, -0.012))
PROXIMAL = ((0.009, 0.010, 0.024), (0.011, 0.0, -0.057))
GRIP_FORCE = 20.0  # N, at most, of each finger's drive
STIFFNESS = 1500.0  # N/m, of each finger's drive
CLOSE_SPEED = 0.15  # m/s of each finger
PRESSED = -0.02  # m, target of a closed finger; the limited force stops it on the object
CLOSE_S = TRAVEL / CLOSE_SPEED + 0.15  # s, ramp and time to grip
HELD_M = 0.002  # m between jaws that hold something; walls of cups are 3 mm and more
OPEN = np.full(2, TRAVEL)  # m, (2,)
T_hand_grasp = np.eye(4)  # m
T_hand_grasp[2, 3] = 0.14
# The camera sits behind and above the fingers. Its tilt puts a point 10 cm before the fingertips
# into the middle of the image (m, degrees).
T_hand_camera = np.eye(4)
T_hand_camera[:3, :3] = Rotation.from_euler("x", -20, degrees=True).as_matrix()
T_hand_camera[:3, 3] = (0.0, -0.07, 0.03)


def add_gripper(spec: mujoco.MjSpec, hand_base: mujoco.MjsBody) -> None:
    """Put palm, fingers and their drives below the body `hand_base`; the fingers move alike.

    Contact as the five-finger hand's: contype 2, conaffinity 1.
    """
    hand_base.gravcomp = 1
    offset = T_hand_grasp[:3, 3]
    palm = hand_base.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=PALM[0], pos=offset + PALM[1], mass=0.7, name="palm"
    )
    _solid(palm, (0.34, 0.35, 0.38, 1))
    place(hand_base.add_site(name="grasp_link", size=[0.002] * 3, group=4), T_hand_grasp)
    for name, side in zip(JOINT_NAMES, (1.0, -1.0), strict=True):
        finger = hand_base.add_body(name=name, pos=offset, gravcomp=1)
        finger.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[side, 0, 0],
            range=[0, TRAVEL],
            limited=True,
            damping=20,  # N s/m
            armature=0.1,  # kg
        )
        for part, (half, centre) in (("distal", DISTAL), ("proximal", PROXIMAL)):
            geom = finger.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=half,
                pos=[side * centre[0], *centre[1:]],
                mass=0.05,
                name=f"{name.removesuffix('_jaw')}_{part}",
            )
            _solid(geom, (0.25, 0.26, 0.28, 1) if part == "distal" else (0.45, 0.46, 0.49, 1))
        drive = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        drive.set_to_position(kp=STIFFNESS, kv=30.0)
        drive.forcelimited, drive.forcerange = True, [-GRIP_FORCE, GRIP_FORCE]
    couple = spec.add_equality(
        type=mujoco.mjtEq.mjEQ_JOINT,
        name1=JOINT_NAMES[0],
        name2=JOINT_NAMES[1],
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        solref=[0.004, 1],  # s, damping ratio
    )
    couple.data = [0, 1, *[0] * (len(couple.data) - 2)]


def _solid(geom: mujoco.MjsGeom, rgba: tuple[float, float, float, float]) -> None:
    # friction and solver values are those of the five-finger hand (ours)
    """Set contact, friction and colour of a solid of the gripper."""
    geom.contype, geom.conaffinity, geom.condim, geom.priority = 2, 1, 4, 1
    geom.friction, geom.solref, geom.solimp = (
        [0.9, 0.005, 0.0001],
        [0.006, 1],
        [0.9, 0.97, 0.001, 0.5, 2],
    )
    geom.rgba = rgba


def finger_targets(since_close: float, preshape: Array) -> Array:
    """Targets (2,) m of the finger drives, a time in s after the close command."""
    return np.asarray(np.clip(preshape - CLOSE_SPEED * max(since_close, 0.0), PRESSED, TRAVEL))


def link_points(n: int, rng: np.random.Generator) -> Array:
    """Points (n, 3) m on an open gripper's links, grasp frame, uniform by area.

    They lie on the surfaces of the proximal and distal links. This is the gripper's cloud of
    VFAS-Grasp (docs/papers.md, "Grasp evaluator").
    """
    boxes = [
        (np.array(half), np.array([side * (centre[0] + OPENING / 2), *centre[1:]]))
        for half, centre in (DISTAL, PROXIMAL)
        for side in (1.0, -1.0)
    ]
    # a quarter of the area, m^2, of a face across each axis
    areas = np.array([[h[1] * h[2], h[0] * h[2], h[0] * h[1]] for h, _ in boxes])
    faces = rng.choice(areas.size, n, p=areas.ravel() / areas.sum())
    out = np.empty((n, 3))
    for i, cell in enumerate(faces):
        half, centre = boxes[cell // 3]
        point = rng.uniform(-1, 1, 3)
        point[cell % 3] = rng.choice([-1.0, 1.0])
        out[i] = centre + point * half
    return out


def links() -> list[str]:
    """The fingers' links and joints below `hand_base` as URDF text."""
    parts = []
    for name, side in zip(JOINT_NAMES, (1.0, -1.0), strict=True):
        solids = [(half, (side * centre[0], *centre[1:])) for half, centre in (DISTAL, PROXIMAL)]
        parts.append(urdf.link(name, urdf.boxes(solids)))
        xyz, limits = (
            tuple(float(v) for v in T_hand_grasp[:3, 3]),
            (0.0, TRAVEL, GRIP_FORCE, CLOSE_SPEED),
        )
        parts.append(
            urdf.joint(
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


def between_jaws(positions: Array) -> tuple[bool, str]:
    """Whether closed jaws hold something, and a sentence that gives the gap.

    positions (n, 2) m: how far each finger is from the middle, over some time.
    """
    gap = float(np.median(positions.sum(axis=1)))
    text = f"the jaws are {gap * 1000:.0f} mm apart at the end"
    return (True, text) if gap > HELD_M else (False, f"{text}: they hold nothing")


def fixed_solids(drives: Array) -> Solids:
    """Palm and open fingers as boxes; no capsules.

    drives (n, 2) m: only their number counts, since the boxes do not move.
    """
    offset = T_hand_grasp[:3, 3]
    boxes = [(PALM[0], tuple(float(v) for v in offset + PALM[1]))]
    for side in (1.0, -1.0):
        for half, centre in (DISTAL, PROXIMAL):
            at = offset + np.array([side * (centre[0] + TRAVEL), *centre[1:]])
            boxes.append((half, tuple(float(v) for v in at)))
    return Solids(np.zeros((len(drives), 0, 2, 3)), 0.0, tuple(boxes))


HAND = KnownHand(
    name="parallel_jaw",
    joints=JOINT_NAMES,
    drives=JOINT_NAMES,
    fingers=FINGERS,
    grasp_network="vfas",
    T_hand_palm=T_hand_grasp,
    T_hand_camera=T_hand_camera,
    centre=T_hand_grasp[:3, 3],
    open=OPEN,
    drive_limits=np.tile([[0.0], [TRAVEL]], 2),
    drive_speed=CLOSE_SPEED,
    close_s=CLOSE_S,
    positions=np.copy,
    targets=finger_targets,
    solids=fixed_solids,
    grip=Grip("position", JOINT_NAMES, 1, between_jaws),
    mismatch_sd=0.002,  # m; ours
    add=add_gripper,
    links=links,
    random_preshape=lambda rng: OPEN.copy(),
    link_points=link_points,
    opening=OPENING,
    palm_solids=urdf.boxes([(PALM[0], tuple(float(v) for v in T_hand_grasp[:3, 3] + PALM[1]))]),
)
