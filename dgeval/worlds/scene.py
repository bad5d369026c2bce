"""A world: floor, belt, one object, and the robot or the hand alone.

Base frame: z up, the belt's surface at z = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from dgeval.geometry import Array, Intrinsics
from dgeval.robots.diana7 import add_arm
from dgeval.robots.hand import Hand
from dgeval.robots.mjcf import place
from dgeval.worlds.objects import ObjectModel, add_object
from dgeval.worlds.presenter import add_presenter
from dgeval.worlds.textures import add_ground

# Places and sizes, m, base frame; ours.
BELT_CENTRE, BELT_HALF = (0.50, 0.0), (0.22, 0.95)  # x, y; the belt runs along y
FLOOR = -0.60  # z
# The turntable's disc; docs/simulation.md says what it stands for.
TURNTABLE_CENTRE, TURNTABLE_RADIUS, TURNTABLE_HEIGHT = (0.50, 0.0), 0.20, 0.02
TURNTABLE_TOP = TURNTABLE_HEIGHT + 0.001  # z; it stands clear of the belt
BELT_GROUP = 1  # MuJoCo's geom group of the belt, so that it can be drawn apart from the floor
# s. At 4 ms and more, grasps that hold at 1 ms begin to slip (docs/simulation.md, "Time step and
# friction cone"); measured by `python -m benchmarks.contact_settings`.
TIMESTEP = 0.002
# what makes the contacts, as every truth names it
ENGINE = f"MuJoCo {mujoco.__version__}, nativeccd off"
# MuJoCo's camera looks along -z with y up; the optical frame looks along +z with y down.
OPTICAL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera fixed to hand_base; T_hand_camera (4, 4) of its optical frame."""

    name: str
    intrinsics: Intrinsics
    T_hand_camera: Array


def build(
    target: ObjectModel,
    belt_speed: float = 0.0,
    robot: Literal["arm", "hand", "none"] = "arm",
    cameras: tuple[Camera, ...] = (),
    presented: bool = False,
    gripper: Hand | None = None,
    others: tuple[ObjectModel, ...] = (),
    turntable: bool = False,
) -> mujoco.MjModel:
    """Compile a world.

    belt_speed m/s along +y; its sign gives the direction. robot: `arm` for the hand on its arm,
    `hand` for the hand on a mocap body, `none` for no robot. gripper: the hand; ValueError if a
    robot has none. presented: a person's hand holds the object. others: more objects, bodies
    `other_0`, …; turntable: a disc that turns.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    o = spec.option
    o.timestep, o.integrator, o.cone = (
        TIMESTEP,
        mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
        mujoco.mjtCone.mjCONE_ELLIPTIC,
    )
    o.impratio = 10  # measured by contact_settings too, as the cone and the time step
    # With it a cylinder at an edge of a box gets the normal of the box's other face
    # (docs/simulation.md, "Contact normals").
    o.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    spec.stat.extent, spec.stat.center = 1.0, [0.5, 0, 0]
    spec.visual.map.znear, spec.visual.map.zfar = 0.01, 6.0
    spec.visual.quality.offsamples = 0
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.25] * 3
    largest = max([(c.intrinsics.width, c.intrinsics.height) for c in cameras] or [(640, 480)])
    spec.visual.global_.offwidth, spec.visual.global_.offheight = largest
    world = spec.worldbody
    world.add_light(
        pos=[0.2, 0.5, 2.0],
        dir=[0.15, -0.25, -1],
        diffuse=[0.55] * 3,
        specular=[0.1] * 3,
        castshadow=False,
    )
    floor = world.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[3, 3, 0.1], pos=[0, 0, FLOOR], name="floor"
    )
    floor.material = add_ground(spec, "floor_look", (150, 148, 142))
    belt = world.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[*BELT_HALF, 0.02],
        pos=[*BELT_CENTRE, -0.02],
        name="belt",
    )
    belt.material = add_ground(spec, "belt_look", (62, 66, 70))
    belt.group = BELT_GROUP
    belt.surfacevel = [0, belt_speed, 0, 0, 0, 0]
    for ground in (floor, belt):
        ground.contype, ground.conaffinity, ground.condim = 1, 3, 4
        # sliding, torsional m, rolling m; time constant s, damping ratio; ours
        ground.friction, ground.solref = [0.6, 0.005, 0.0001], [0.008, 1]
    add_object(spec, target)
    for index, other in enumerate(others):
        add_object(spec, other, f"other_{index}")
    if turntable:
        _add_turntable(spec)
    if presented:
        add_presenter(spec, target.extent())
    if robot != "none" and gripper is None:
        raise ValueError(f"a world with robot {robot!r} needs a hand")
    if robot == "arm" and gripper is not None:
        gripper.add(spec, add_arm(spec, world.add_body(name="base_link")))
    elif robot == "hand" and gripper is not None:
        gripper.add(spec, _add_flying_base(spec))
        _weld_to_handle(spec)
    for camera in cameras:
        mounted = spec.body("hand_base").add_camera(name=camera.name)
        k = camera.intrinsics
        place(mounted, camera.T_hand_camera @ OPTICAL)
        mounted.fovy = 2 * np.arctan(k.height / 2 / k.fy)
        if not spec.compiler.degree:
            mounted.fovy = np.degrees(mounted.fovy)
    return spec.compile()


def _add_turntable(spec: mujoco.MjSpec) -> None:
    """A disc on the table that a velocity drive turns about its axis."""
    disc = spec.worldbody.add_body(
        name="turntable", pos=[*TURNTABLE_CENTRE, TURNTABLE_TOP - TURNTABLE_HEIGHT / 2], gravcomp=1
    )
    disc.add_joint(name="turntable", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1], armature=1.0)
    plate = disc.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[TURNTABLE_RADIUS, TURNTABLE_HEIGHT / 2, 0],
        mass=1.0,
    )
    plate.name, plate.contype, plate.conaffinity, plate.condim = "turntable", 1, 3, 4
    plate.friction, plate.solref = [0.6, 0.005, 0.0001], [0.008, 1]
    plate.material = add_ground(spec, "turntable_look", (95, 88, 80))
    drive = spec.add_actuator(
        name="turntable", target="turntable", trntype=mujoco.mjtTrn.mjTRN_JOINT
    )
    drive.set_to_velocity(kv=200.0)


def _add_flying_base(spec: mujoco.MjSpec) -> mujoco.MjsBody:
    """`hand_base` on its own, and the mocap body `handle` that it follows."""
    handle = spec.worldbody.add_body(name="handle", mocap=True)
    handle.add_site(name="handle", size=[0.002] * 3, group=4)
    hand = spec.worldbody.add_body(name="hand_base")
    hand.add_freejoint(name="hand")
    hand.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[0.02, 0, 0],
        mass=2.0,
        contype=0,
        conaffinity=0,
        group=4,
    )
    return hand


def _weld_to_handle(spec: mujoco.MjSpec) -> None:
    """A soft weld draws the hand after its handle (docs/simulation.md, "Five-finger hand")."""
    weld = spec.add_equality(
        type=mujoco.mjtEq.mjEQ_WELD,
        name1="handle",
        name2="hand_base",
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        solref=[0.01, 1],  # s, damping ratio; ours
    )
    data = np.zeros(len(weld.data))
    data[6], data[10] = 1.0, 0.3  # identity relative rotation, torque scale
    weld.data = data


def least_distance(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    geoms_a: Sequence[int],
    geoms_b: Sequence[int],
    limit: float,
) -> float:
    """Least distance between two groups of geoms, m, at most `limit`."""
    best = limit
    for a in geoms_a:
        for b in geoms_b:
            gap = (
                np.linalg.norm(data.geom_xpos[a] - data.geom_xpos[b])
                - model.geom_rbound[a]
                - model.geom_rbound[b]
            )
            if gap < best:
                best = min(best, mujoco.mj_geomDistance(model, data, a, b, best, None))
    return float(best)


def finger_forces(
    model: mujoco.MjModel, data: mujoco.MjData, names: dict[int, str], fingers: Sequence[str]
) -> Array:
    """Sum of normal contact forces on each finger, (k,) N.

    names: of the hand's geoms by id; the part before the first "_" is their finger.
    """
    out = np.zeros(len(fingers))
    force = np.zeros(6)
    for k in range(data.ncon):
        for g in data.contact.geom[k]:
            finger = names.get(int(g), "").split("_")[0]
            if finger in fingers:
                mujoco.mj_contactForce(model, data, k, force)
                out[fingers.index(finger)] += abs(force[0])
    return out


def pose_of(data: mujoco.MjData, body: str) -> Array:
    """T_base_body (4, 4)."""
    item = data.body(body)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = item.xmat.reshape(3, 3), item.xpos
    return T
