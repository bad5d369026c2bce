"""The five-finger hand: kinematics of the DLR-HIT Hand II, with capsules of our own for its links.

Hand frame `hand_base`: +z along the extended fingers, +x out of the palm, +y towards index and
thumb. Metres, radians. Dimensions come from the hand's published URDF (docs/simulation.md,
"Five-finger hand"): five equal fingers of abduction, flexion, flexion and a distal joint coupled
1:1 to the one before it.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.geometry import Array, invert
from dgeval.robots import urdf
from dgeval.robots.hand import Grip, KnownHand, Solids
from dgeval.robots.mjcf import place, pose

# The order of the 15 joint values, three for each finger.
FINGERS = ("thumb", "index", "middle", "ring", "little")
# Each finger's abduction joint in hand_base: xyz m, rpy rad (fixed axes). From the hand's URDF.
FINGER_MOUNTS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "thumb": ((0.062176, 0.044373, 0.078735), (0.225810, -1.083656, 0.411355)),
    "index": ((-0.002530, 0.036800, 0.107784), (3.054326, -1.570796, 0.0)),
    "middle": ((-0.0037, 0.01, 0.117784), (-3.141593, -1.570796, 0.0)),
    "ring": ((0.0, -0.016800, 0.112584), (-3.054326, -1.570796, 0.0)),
    "little": ((0.000972, -0.043396, 0.093584), (-2.967060, -1.570796, 0.0)),
}
# The frame of grasps, `palm_link`, in hand_base: xyz m, rpy rad; docs/simulation.md.
PALM_XYZ, PALM_RPY = (0.02, 0.0, 0.06), (-0.15, -1.3, 0.0)


@dataclass(frozen=True, slots=True)
class FingerJoint:
    """One joint of the chain that all fingers share. It turns about its local z.

    xyz m, rpy rad: its frame in the parent's. lower, upper: limits, rad. effort: Nm. tip m: end of
    the link's capsule in the joint's frame, zero for the cover link. mass: of the link, kg.
    """

    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]
    lower: float
    upper: float
    effort: float
    tip: tuple[float, float, float]
    mass: float


# The chain of every finger: origins, limits, effort and mass from the hand's URDF.
CHAIN = (
    FingerJoint((0, 0, 0), (0, 0, 0), -0.261799, 0.261799, 15.0, (0, 0, 0), 0.0176),
    FingerJoint((0, 0, 0), (np.pi / 2, 0, 0), 0.0, 1.48353, 1.15, (0.055, 0, 0), 0.0232),
    FingerJoint((0.055, 0, 0), (0, 0, 0), 0.0, 1.13446, 0.6, (0.025, 0, 0), 0.0158),
    FingerJoint((0.025, 0, 0), (0, 0, -np.pi / 2), 0.0, 1.13446, 0.35, (0, 0.0266, 0), 0.0137),
)
FINGERTIP = CHAIN[3].tip  # m, in the distal joint's frame; from the hand's URDF
RADIUS = 0.0108  # m, of the capsules; ours: the fingers are 21 to 24 mm wide
# Half sizes m, centres m in hand_base, mass kg; ours, fitted to slices of the palm's mesh.
PALM_BOXES = (
    ((0.0325, 0.053, 0.05), (0.0005, -0.005, 0.05), 0.9),
    ((0.022, 0.05, 0.014), (-0.009, -0.003, 0.114), 0.1),
    ((0.024, 0.02, 0.038), (0.055, 0.04, 0.047), 0.15),
)
# All 20 joints; the last of each finger is coupled. The 15 with a drive.
JOINT_NAMES = tuple(f"{finger}_{k}" for finger in FINGERS for k in range(4))
ACTUATED = tuple(f"{finger}_{k}" for finger in FINGERS for k in range(3))
MAX_SPEED = 3.14  # rad/s, of every joint; docs/simulation.md
# rad, (15,): where the drives go at a close; ours. Their limited torque stops them on the object.
CLOSED = np.tile([0.0, 1.25, 1.0], 5)
CLOSE_S = 0.4  # s, closing ramp; ours: it closes as a hand that is sent to CLOSED at once
# Nm, mean effort of a finger's flexion joints above which it presses; ours. Empty fingers show up
# to 0.01 Nm in simulated trials.
HELD_NM = 0.05
GRASP_CENTRE = np.array([0.05, 0.012, 0.165])  # m in hand_base, where held objects are; ours
OVER_NOISE = 4.0  # times the error of its mean, that an effort must be; ours
MOST_NM = 10.0  # five times what its strongest drive gives; more is no effort in Nm; ours
# Of the three drives of a finger, Nm/rad and Nm; ours, so that known grasps hold.
STIFFNESS, FORCE = (3.0, 3.0, 1.8), (2.0, 1.15, 0.95)


T_hand_palm = pose(PALM_XYZ, PALM_RPY)
# The colour camera sits beside the thumb and looks along the fingers, 12 degrees towards them
# (m, degrees); ours. Optical y is hand -x.
_TILT = Rotation.from_euler("x", -12, degrees=True).as_matrix()
T_hand_camera = np.eye(4)
T_hand_camera[:3, :3] = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ _TILT
T_hand_camera[:3, 3] = (0.115, -0.045, -0.06)


def capsule_ends(joint: FingerJoint) -> tuple[Array, Array]:
    """Ends (3,) m of the axis of a finger link's capsule, in the joint's frame.

    The distal capsule's axis ends a radius before the fingertip, so that its surface ends at the
    tip.
    """
    end = np.array(joint.tip, dtype=float)
    if joint is CHAIN[3]:
        end *= 1 - RADIUS / np.linalg.norm(end)
    return np.zeros(3), end


def add_hand(spec: mujoco.MjSpec, hand_base: mujoco.MjsBody) -> None:
    """Put palm, fingers, drives and the coupling of the distal joints below the body `hand_base`.

    Hand geoms have contype 2 and conaffinity 1: they meet objects and supports (1/3), never each
    other.
    """
    hand_base.gravcomp = 1
    for k, (half, centre, mass) in enumerate(PALM_BOXES):
        _solid(
            hand_base.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=centre, mass=mass, name=f"palm_{k}"
            )
        )
    place(hand_base.add_site(name="palm_link", size=[0.002] * 3, group=4), T_hand_palm)
    for finger in FINGERS:
        parent, T = hand_base, pose(*FINGER_MOUNTS[finger])
        for k, joint in enumerate(CHAIN):
            body = parent.add_body(name=f"{finger}_{k}", gravcomp=1)
            place(body, T @ pose(joint.xyz, joint.rpy))
            body.add_joint(
                name=f"{finger}_{k}",
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=[0, 0, 1],
                range=[joint.lower, joint.upper],
                limited=True,
                damping=0.025,  # Nm s/rad; ours
                armature=1.5e-4,  # kg m^2; ours
            )
            a, b = capsule_ends(joint)
            if b.any():
                geom = body.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                    fromto=[*a, *b],
                    size=[RADIUS, 0, 0],
                    mass=joint.mass,
                    name=f"{finger}_{k}",
                )
                _solid(geom)
                geom.rgba = [0.45, 0.46, 0.49, 1] if k % 2 else [0.30, 0.31, 0.33, 1]
            else:
                body.mass, body.inertia, body.explicitinertial = joint.mass, [4e-6] * 3, True
            parent, T = body, np.eye(4)
        parent.add_site(name=f"{finger}_tip", pos=FINGERTIP, size=[0.002] * 3, group=4)
        couple = spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT,
            name1=f"{finger}_3",
            name2=f"{finger}_2",
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            solref=[0.004, 1],  # s, damping ratio; ours
        )
        couple.data = [0, 1, *[0] * (len(couple.data) - 2)]
        for k in range(3):
            drive = spec.add_actuator(
                name=f"{finger}_{k}", target=f"{finger}_{k}", trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            drive.set_to_position(kp=STIFFNESS[k], kv=0.05 * STIFFNESS[k])
            drive.forcelimited, drive.forcerange = True, [-FORCE[k], FORCE[k]]


def _solid(geom: mujoco.MjsGeom) -> None:
    # friction: sliding, torsional m, rolling m; the URDF says 0.6 to 0.8 sliding, 0.9 is ours.
    # solref: time constant s and damping ratio; solimp: MuJoCo's impedance; both ours. The
    # benchmark contact_settings measures what time step and friction cone do to known grasps.
    """Set contact, friction and colour of a solid of the hand."""
    geom.contype, geom.conaffinity, geom.condim, geom.priority = 2, 1, 4, 1
    geom.friction, geom.solref, geom.solimp = (
        [0.9, 0.005, 0.0001],
        [0.006, 1],
        [0.9, 0.97, 0.001, 0.5, 2],
    )
    geom.rgba = [0.34, 0.35, 0.38, 1]


def finger_targets(since_close: float, preshape: Array) -> Array:
    """Targets (15,) rad of the finger drives, a time in s after the close command."""
    closing = float(np.clip(since_close / CLOSE_S, 0.0, 1.0))
    return np.asarray(preshape + closing * (np.maximum(CLOSED, preshape) - preshape))


def finger_axes(joints: Array) -> Array:
    """Ends of the 15 finger links' axes: (n, 15, 2, 3) m, palm frame.

    joints: positions (n, 15) rad of the driven joints.
    """
    n = len(joints)
    out = np.empty((n, 15, 2, 3))
    T_palm_hand = invert(T_hand_palm)
    for f, finger in enumerate(FINGERS):
        T = np.tile(T_palm_hand @ pose(*FINGER_MOUNTS[finger]), (n, 1, 1))
        for k, joint in enumerate(CHAIN):
            turn = np.tile(np.eye(4), (n, 1, 1))
            q = joints[:, 3 * f + min(k, 2)]  # the last joint follows the one before it
            turn[:, :3, :3] = Rotation.from_euler("z", q[:, None]).as_matrix()
            T = T @ pose(joint.xyz, joint.rpy) @ turn
            for end, point in enumerate(capsule_ends(joint)):
                if k > 0:
                    out[:, 3 * f + k - 1, end] = T[:, :3, :3] @ point + T[:, :3, 3]
    return out


def links() -> list[str]:
    """The fingers' links and joints below `hand_base` as URDF text."""
    parts = []
    for finger in FINGERS:
        parent, T = "hand_base", pose(*FINGER_MOUNTS[finger])
        for k, joint in enumerate(CHAIN):
            name = f"{finger}_{k}"
            parts.append(urdf.link(name, urdf.capsule(*capsule_ends(joint), RADIUS)))
            xyz, rpy = urdf.origin(T @ pose(joint.xyz, joint.rpy))
            mimic = f'<mimic joint="{finger}_2"/>' if k == 3 else ""
            limits = (joint.lower, joint.upper, joint.effort, MAX_SPEED)
            parts.append(urdf.joint(name, parent, name, xyz, rpy, limits, mimic))
            parent, T = name, np.eye(4)
    return parts


def grip(efforts: Array) -> tuple[bool, str]:
    """Whether the hand holds something, and a sentence that gives the efforts.

    efforts (n, 10) Nm: of the two flexion joints of each finger, over some time. Two pressing
    fingers hold something.
    """
    mean: Array = np.abs(np.mean(efforts, axis=0)).reshape(5, 2)
    # what the noise of the samples leaves of a mean is no effort
    noise: Array = (np.std(efforts, axis=0) / np.sqrt(len(efforts))).reshape(5, 2)
    effort = mean.max(axis=1)
    pressing = int((mean > np.maximum(HELD_NM, OVER_NOISE * noise)).any(axis=1).sum())
    listed = ", ".join(f"{v:.2f}" for v in effort)
    if pressing >= 2:
        return True, f"{pressing} fingers still press at the end ({listed} Nm)"
    return False, f"the fingers hold nothing at the end ({listed} Nm)"


def coupled(drives: Array) -> Array:
    """All joints (20,) rad from the drives (15,): the last of each finger follows the one before
    it.
    """
    fingers = drives.reshape(5, 3)
    return np.concatenate([fingers, fingers[:, 2:]], axis=1).ravel()


def random_preshape(rng: np.random.Generator) -> Array:
    """Drives (15,) rad: the fingers bent alike, the thumb nearly open."""
    preshape = np.zeros(15)
    preshape[1::3], preshape[2::3] = rng.uniform(0.0, 0.6), rng.uniform(0.1, 0.6)
    preshape[1] = rng.uniform(0.0, 0.2)
    return preshape


HAND = KnownHand(
    name="dlr_hit_hand",
    joints=JOINT_NAMES,
    drives=ACTUATED,
    fingers=FINGERS,
    grasp_network="ffhnet",
    T_hand_palm=T_hand_palm,
    T_hand_camera=T_hand_camera,
    centre=GRASP_CENTRE,
    open=np.tile([0.0, 0.15, 0.25], 5),
    drive_limits=np.tile([[j.lower for j in CHAIN[:3]], [j.upper for j in CHAIN[:3]]], 5),
    drive_speed=MAX_SPEED,
    close_s=CLOSE_S,
    positions=coupled,
    targets=finger_targets,
    solids=lambda drives: Solids(finger_axes(drives), RADIUS, tuple(b[:2] for b in PALM_BOXES)),
    grip=Grip("effort", tuple(n for n in ACTUATED if not n.endswith("_0")), 5, grip, MOST_NM),
    mismatch_sd=0.03,  # rad; ours
    add=add_hand,
    links=links,
    random_preshape=random_preshape,
    palm_solids=urdf.boxes([(half, centre) for half, centre, _ in PALM_BOXES]),
)
