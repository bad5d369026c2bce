"""Physics against closed forms, the published tables of hand and arm, and pinocchio.

The tables are those of docs/simulation.md, "Five-finger hand" and "Arm". Catches a sign, an axis, a
unit, an order of rotations or a missing attribute in the MuJoCo models and in the URDF made of the
same tables.
"""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from dgeval.geometry import rotation_angle, rotation_vector
from dgeval.robots import diana7 as arm
from dgeval.robots import dlr_hit_hand as hand
from dgeval.robots.description import Description
from dgeval.robots.diana7 import LOWER, MAX_SPEED, UPPER, ArmKinematics
from dgeval.robots.dlr_hit_hand import HAND as FIVE_FINGERS
from dgeval.robots.loading import load_description
from dgeval.robots.urdf import robot_urdf
from dgeval.worlds.objects import (
    ObjectModel,
    add_object,
    ball,
    box,
    procedural_object,
    surface_points,
    ten_objects,
)
from dgeval.worlds.scene import TIMESTEP, build, pose_of
from dgeval.worlds.textures import Look
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

G, MU = 9.81, 0.6  # m/s²; object on belt
LOOK = Look("mottled", (120, 120, 120))
TEN = ten_objects()
HOME = np.array([0.0, 0.3, 0.0, 1.6, 0.0, 0.5, 0.0])  # over the belt, fingers down
JOINTS = (*arm.JOINT_NAMES, *hand.JOINT_NAMES)
STATE = mujoco.mjtState.mjSTATE_INTEGRATION

# mm (docs/simulation.md, "Objects"): the two horizontal sizes, then the height
TABLE_MM = {
    "sugar_box": (38, 89, 175),
    "pudding_box": (35, 110, 89),
    "gelatin_box": (28, 85, 73),
    "mustard_bottle": (58, 95, 190),
    "apple": (75, 75, 75),
    "mug": (93, 117, 81),
    "baseball": (73, 73, 73),
    "cup": (75, 75, 68),
    "foam_brick": (50, 75, 50),
    "rubiks_cube": (57, 57, 57),
}
# m in hand_base (docs/simulation.md, "Five-finger hand"): fingertip at q = (0, 0, 0), and at (0,
# .6, .5) with the distal joint at .5 too
TIPS = {
    "thumb": ((0.1079, 0.0643, 0.1729), (0.0302, 0.0109, 0.1646)),
    "index": ((-0.0025, 0.0368, 0.2144), (0.0771, 0.0298, 0.1637)),
    "middle": ((-0.0037, 0.0100, 0.2244), (0.0762, 0.0100, 0.1737)),
    "ring": ((0.0, -0.0168, 0.2192), (0.0796, -0.0098, 0.1685)),
    "little": ((0.0010, -0.0434, 0.2002), (0.0797, -0.0295, 0.1495)),
}
# the Diana 7's joints (docs/simulation.md, "Arm"): origin xyz in mm, roll and yaw in quarter turns
# (no pitch)
DIANA = [
    (0, 0, 285.6, -2, 0),
    (0, 0, 0, 1, 0),
    (0, -458.6, 0, -1, 0),
    (65, 0, 0, 1, 0),
    (-52.8, -455.4, 0, -1, 0),
    (-12.2, 0, 0, 1, 2),
    (87, -116.9, 0, -1, 0),
]
PALM_R = [[0.2675, 0.1440, -0.9527], [0, 0.9888, 0.1494], [0.9636, -0.0400, 0.2645]]


def on_belt(target: ObjectModel, belt: float = 0.0, speed: float = 0.0, yaw: float = 0.0) -> tuple:
    """Model and data of the object alone, standing on a belt, at a speed along it."""
    model = build(target, belt, robot="none")
    data = mujoco.MjData(model)
    data.qpos[:] = [0.5, 0.0, target.rest_height(), np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
    data.qvel[1] = speed
    return model, data


def run(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> np.ndarray:
    """Object velocities (steps, 6) of a scene without robot."""
    out = np.empty((round(seconds / TIMESTEP), 6))
    for k in range(len(out)):
        mujoco.mj_step(model, data)
        out[k] = data.qvel
    return out


@cache
def arm_scene() -> mujoco.MjModel:
    return build(TEN["rubiks_cube"], gripper=FIVE_FINGERS)


@cache
def hand_scene() -> mujoco.MjModel:
    return build(TEN["rubiks_cube"], 0.1, robot="hand", gripper=FIVE_FINGERS)


def addresses(model: mujoco.MjModel, names: tuple[str, ...]) -> np.ndarray:
    return np.array([model.joint(n).qposadr[0] for n in names])


def limits(model: mujoco.MjModel, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    return tuple(np.array([model.joint(n).range for n in names]).T)


@cache
def urdf() -> pin.Model:
    return pin.buildModelFromXML(robot_urdf(np.eye(4), FIVE_FINGERS))


@cache
def description() -> Description:
    return load_description(robot_urdf(np.eye(4), FIVE_FINGERS), "robot", (), 0.01)


def configurations(n: int, seed: int = 0) -> np.ndarray:
    """Joint values (n, 27) rad within limits, in the order of JOINTS.

    Each distal finger joint has the value of the one before it.
    """
    lower, upper = limits(arm_scene(), JOINTS)
    q = np.random.default_rng(seed).uniform(lower, upper, (n, len(JOINTS)))
    q[:, 10::4] = q[:, 9::4]
    return q


def pinocchio_frames(q: np.ndarray) -> tuple[pin.Model, pin.Data, np.ndarray]:
    """Model, data with frames placed, and the velocity columns of JOINTS."""
    model = urdf()
    joints = [model.joints[model.getJointId(n)] for n in JOINTS]
    data, full = model.createData(), np.zeros(model.nq)
    full[[j.idx_q for j in joints]] = q
    pin.computeJointJacobians(model, data, full)
    pin.updateFramePlacements(model, data)
    return model, data, np.array([j.idx_v for j in joints])


def frame(model: pin.Model, data: pin.Data, link: str) -> np.ndarray:
    return data.oMf[model.getFrameId(link, pin.FrameType.BODY)].homogeneous


# belt


@pytest.mark.parametrize("speed", [0.2, -0.1])
@pytest.mark.parametrize("name", ["rubiks_cube", "mug", "cup", "mustard_bottle"])
def test_belt_brings_an_object_to_its_speed(name: str, speed: float) -> None:
    """Catches a belt that runs the other way or along x, or is too slick."""
    v = run(*on_belt(TEN[name], speed), 0.6)
    assert np.abs(v[250:, 1] / speed - 1).max() < 0.01
    assert np.abs(v[250:, 0]).max() < 0.01 * abs(speed)


@pytest.mark.parametrize("speed", [0.2, -0.1])
@pytest.mark.parametrize("name", ["rubiks_cube", "mug", "cup", "mustard_bottle", "apple"])
def test_object_that_moves_with_the_belt_stays_with_it(name: str, speed: float) -> None:
    """Catches drag between object and belt, and a belt speed in another unit."""
    v = run(*on_belt(TEN[name], speed, speed), 0.8)
    # 30 ms to settle: the cup gets a kick of 6 mm/s where its walls touch down
    assert np.abs(v[15:, 1] / speed - 1).max() < 0.01


def test_box_slips_on_the_belt_as_far_as_friction_says() -> None:
    """A box put on at rest falls behind by v²/(2 mu g).

    Catches a friction that is not that of the tables.
    """
    model, data = on_belt(box("slab", (80, 80, 20), 0.2, LOOK), 0.4)
    run(model, data, 0.5)
    assert 0.4 * data.time - data.qpos[1] == pytest.approx(0.4**2 / (2 * MU * G), rel=0.05)


@pytest.mark.parametrize("name", ["apple", "baseball"])
def test_ball_on_the_belt_slips_then_rolls_then_is_braked_by_rolling_friction(name: str) -> None:
    """A ball takes 2/7 of the belt's speed at once, and the rest at 5/7 g mu_r / r.

    Catches a wrong condim, inertia, or third number of the friction.
    """
    target, belt, mu_r = TEN[name], 0.2, 0.001
    slipping = 2 / 7 * belt / (MU * G)
    v = run(*on_belt(target, belt), 1.2)[:, 1]
    for t in (0.1, 0.3, 0.5):
        expected = 2 / 7 * belt + 5 / 7 * G * mu_r / target.rest_height() * (t - slipping)
        assert v[round(t / TIMESTEP) - 1] == pytest.approx(expected, rel=0.02)
    assert v[-1] == pytest.approx(belt, rel=0.01)


# gravity, friction


def test_free_fall_is_the_integrators_parabola() -> None:
    """After n steps z is -g dt² n (n + 1) / 2, exactly.

    Catches a wrong time step or gravity, drag, and gravity compensation.
    """
    model, data = on_belt(TEN["mug"])
    assert model.opt.timestep == TIMESTEP == 0.002  # at 4 ms and more grips slip
    data.qpos[:3] = [2.0, 0.0, 0.5]  # beside the belt
    mujoco.mj_forward(model, data)
    start = data.subtree_com[model.body("object").id].copy()
    n = 150
    run(model, data, n * TIMESTEP)
    mujoco.mj_forward(model, data)
    fallen = start - data.subtree_com[model.body("object").id]
    assert np.allclose(fallen, [0, 0, G * TIMESTEP**2 * n * (n + 1) / 2], rtol=0, atol=1e-9)
    assert fallen[2] == pytest.approx(G * (n * TIMESTEP) ** 2 / 2, rel=0.01)
    assert data.qvel[2] == pytest.approx(-G * n * TIMESTEP, abs=1e-9)
    run(model, data, 0.6)
    # and there is a floor
    assert data.qpos[2] == pytest.approx(-0.60 + TEN["mug"].rest_height(), abs=0.01)


@pytest.mark.parametrize("direction", [(0, 1), (0, -1), (1, 0)])
def test_friction_cone(direction: tuple[int, int]) -> None:
    """Below atan(mu) a slab stays, above it slides, in all directions alike.

    Catches a wrong cone or mu, and the wrong one of two frictions.
    """
    model, data = on_belt(box("slab", (80, 80, 20), 0.2, LOOK))
    ground, target = model.geom("belt"), model.geom("object_0")
    assert ground.priority[0] == target.priority[0]
    mu = max(ground.friction[0], target.friction[0])
    assert mu == MU
    for part, slides in ((0.93, False), (1.07, True), (1.2, True)):
        angle = part * np.arctan(mu)
        mujoco.mj_resetData(model, data)
        start = np.array([0.5, 0.0]) - 0.2 * np.array(direction)
        data.qpos[:7] = [*start, 0.01, 1, 0, 0, 0]
        model.opt.gravity[:] = G * np.array(
            [*(np.sin(angle) * np.array(direction)), -np.cos(angle)]
        )
        v = run(model, data, 0.5)[:, :2] @ direction
        moved = (data.qpos[:2] - start) @ direction
        if slides:
            acceleration = (v[-1] - v[49]) / ((len(v) - 50) * TIMESTEP)
            slid_with = np.tan(angle) - acceleration / (
                G * np.cos(angle)
            )  # from a = g (sin - mu cos)
            assert slid_with == pytest.approx(mu, rel=0.015)
            assert moved > 0.03
        else:
            assert np.abs(v[50:]).max() < 2e-4  # soft contacts creep
            assert abs(moved) < 2e-4


# hand


@pytest.mark.parametrize("robot", ["hand", "arm"])
def test_coupled_joints_and_limits_while_the_hand_closes(robot: str) -> None:
    """Catches a coupling of the wrong joint or ratio, limits in degrees, drives of the wrong sign,
    and an arm that sags.
    """
    model = arm_scene() if robot == "arm" else hand_scene()
    data = mujoco.MjData(model)
    data.qpos[model.joint("object").qposadr[0]] = 2.0  # out of the way
    names = hand.JOINT_NAMES
    fingers, (lower, upper) = addresses(model, names), limits(model, names)
    drives = np.array([model.actuator(n).id for n in hand.ACTUATED])
    if robot == "arm":
        data.qpos[addresses(model, arm.JOINT_NAMES)] = HOME
        data.ctrl[[model.actuator(n).id for n in arm.JOINT_NAMES]] = HOME
    else:
        data.mocap_pos[0] = [0, 0, 0.8]
        free = model.joint("hand").qposadr[0]
        data.qpos[free : free + 3] = [0, 0, 0.8]
    for k in range(350):
        data.ctrl[drives] = hand.CLOSED * min(k / 200, 1.0)
        mujoco.mj_step(model, data)
        q = data.qpos[fingers].reshape(5, 4)
        assert np.abs(q[:, 3] - q[:, 2]).max() < 2e-3
        assert ((q.ravel() > lower - 1e-3) & (q.ravel() < upper + 1e-3)).all()
    assert np.abs(q[:, :3].ravel() - hand.CLOSED).max() < 0.01
    if robot == "arm":
        assert np.abs(data.qpos[addresses(model, arm.JOINT_NAMES)] - HOME).max() < 2e-3
    else:
        assert np.linalg.norm(data.body("hand_base").xpos - [0, 0, 0.8]) < 1e-3


def test_fingertips_and_palm_are_where_the_hands_tables_put_them() -> None:
    """Catches a wrong mount of a finger, order of angles, axis or link length, and a wrong palm
    frame.
    """
    model = hand_scene()
    data = mujoco.MjData(model)
    free = model.joint("hand").qposadr[0]
    for column, q in enumerate([(0, 0, 0, 0), (0, 0.6, 0.5, 0.5)]):
        data.qpos[free : free + 7] = [0, 0, 0, 1, 0, 0, 0]
        data.qpos[addresses(model, hand.JOINT_NAMES)] = np.tile(q, 5)
        mujoco.mj_kinematics(model, data)
        for finger, tips in TIPS.items():
            assert np.abs(data.site(f"{finger}_tip").xpos - tips[column]).max() < 1e-4, (finger, q)
    palm = data.site("palm_link")
    assert np.abs(palm.xmat.reshape(3, 3) - PALM_R).max() < 5.1e-5
    assert np.allclose(palm.xpos, [0.02, 0, 0.06])


def test_solid_of_the_distal_link_ends_at_the_fingertip() -> None:
    """The outermost point of the capsule is the tip site.

    Catches a fingertip that is a radius too long or too short.
    """
    model = hand_scene()
    for finger in hand.FINGERS:
        geom = model.geom(f"{finger}_3")
        R = Rotation.from_quat(geom.quat, scalar_first=True).as_matrix()
        ends = geom.pos + np.outer([1, -1], R[:, 2]) * geom.size[1]
        assert np.abs(ends[:, 1].max() + geom.size[0] - model.site(f"{finger}_tip").pos[1]) < 1e-9


# arm, URDF


def test_palm_and_jacobian_against_pinocchio() -> None:
    """Catches a joint's origin, axis or angle convention in the arm alone or in its URDF."""
    kinematics = ArmKinematics(FIVE_FINGERS.T_hand_palm)
    for q in configurations(20):
        model, data, columns = pinocchio_frames(q)
        assert np.abs(frame(model, data, "palm_link") - kinematics.palm(q[:7])).max() < 1e-6
        frame_id = model.getFrameId("palm_link", pin.FrameType.BODY)
        J = pin.getFrameJacobian(model, data, frame_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[
            :, columns[:7]
        ]
        T = kinematics.palm(q[:7])
        for k in range(7):  # central differences
            step = np.eye(7)[k] * 1e-3
            a, b = kinematics.palm(q[:7] - step), kinematics.palm(q[:7] + step)
            assert np.abs((b - a)[:3, 3] / 2e-3 - J[:3, k]).max() < 1e-6
            assert np.abs(rotation_vector(b[:3, :3] @ a[:3, :3].T) / 2e-3 - J[3:, k]).max() < 1e-6
        if (
            np.linalg.svd(J)[1][-1] > 0.05
        ):  # away from limits and singular poses the speeds give the twist
            inner = np.clip(q[:7], LOWER + 0.03, UPPER - 0.03)
            if np.array_equal(inner, q[:7]):
                twist = np.array([0.02, -0.03, 0.01, 0.05, 0.02, -0.04])
                assert (
                    np.abs(J @ kinematics.joint_velocity(q[:7], twist) - twist).max()
                    < 2e-3 * np.abs(twist).max() + 1e-4
                )
        assert np.array_equal(kinematics.palm(q[:7]), T)


def test_arm_is_the_diana_7() -> None:
    """The seven links composed by hand.

    Catches a wrong entry in the table that physics and URDF share.
    """
    model = arm_scene()
    data = mujoco.MjData(model)
    for q in configurations(5, seed=6)[:, :7]:
        data.qpos[addresses(model, arm.JOINT_NAMES)] = q
        mujoco.mj_kinematics(model, data)
        R, p = Rotation.identity(), np.zeros(3)
        for k, (*xyz, roll, yaw) in enumerate(DIANA):
            p = p + R.apply(np.array(xyz) / 1000)
            R = (
                R
                * Rotation.from_euler("ZX", [90 * yaw, 90 * roll], degrees=True)
                * Rotation.from_rotvec([0, 0, q[k]])
            )
            T = pose_of(data, f"link_{k + 1}")
            assert np.abs(T[:3, 3] - p).max() < 1e-9, k
            assert np.abs(T[:3, :3] - R.as_matrix()).max() < 1e-9, k


def test_every_link_of_the_compiled_robot_against_pinocchio() -> None:
    """Catches a difference between physics and URDF in any of the 28 links."""
    model = arm_scene()
    data = mujoco.MjData(model)
    for q in configurations(10, seed=1):
        data.qpos[addresses(model, JOINTS)] = q
        mujoco.mj_kinematics(model, data)
        other, placed, _ = pinocchio_frames(q)
        for link in [*(f"link_{k}" for k in range(1, 8)), "hand_base", *hand.JOINT_NAMES]:
            assert np.abs(frame(other, placed, link) - pose_of(data, link)).max() < 1e-5, link
        palm = data.site("palm_link")
        assert np.abs(frame(other, placed, "palm_link")[:3, 3] - palm.xpos).max() < 1e-5
        assert (
            np.abs(frame(other, placed, "palm_link")[:3, :3] - palm.xmat.reshape(3, 3)).max() < 1e-5
        )


def test_limits_are_those_of_the_tables_in_physics_and_urdf() -> None:
    """Catches degrees read as radians, limits in another order, and an arm that
    is not the Diana 7.
    """
    model, lower, upper = urdf(), *limits(arm_scene(), JOINTS)
    joints = [model.joints[model.getJointId(n)] for n in JOINTS]
    index, speed = [j.idx_q for j in joints], [j.idx_v for j in joints]
    assert np.abs(model.lowerPositionLimit[index] - lower).max() < 1e-9
    assert np.abs(model.upperPositionLimit[index] - upper).max() < 1e-9
    assert np.allclose(
        lower, [-3.1241, -1.5708, -3.1241, 0, -3.1241, -3.1241, -3.1241, *[-0.261799, 0, 0, 0] * 5]
    )
    assert np.allclose(
        upper,
        [
            3.1241,
            1.5708,
            3.1241,
            3.0543,
            3.1241,
            3.1241,
            3.1241,
            *[0.261799, 1.48353, 1.13446, 1.13446] * 5,
        ],
    )
    assert np.allclose(
        model.velocityLimit[speed],
        [2.967, 2.618, 2.618, 2.618, 3.1416, 3.1416, 3.840, *[3.14] * 20],
    )
    assert arm_scene().jnt_limited[[arm_scene().joint(n).id for n in JOINTS]].all()


def test_camera_in_the_urdf_is_where_it_was_calibrated() -> None:
    """Catches an inverted hand-eye transform."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec([0.3, -0.7, 1.1]).as_matrix(), (0.11, -0.04, -0.06)
    joint = load_description(robot_urdf(T, FIVE_FINGERS), "robot", (), 0.01).joints[
        "camera_color_optical_frame"
    ]
    assert joint.parent == "hand_base"
    assert np.abs(joint.at(0.0) - T).max() < 1e-8


def test_description_reads_the_urdf_with_its_mimic_joints() -> None:
    """All 28 links chained by the product's own reader, with the distal joints left out of its
    input.

    Catches mimic tags that get lost.
    """
    joints = description().joints
    assert not description().notes
    assert all(joints[f"{finger}_3"].follows == f"{finger}_2" for finger in hand.FINGERS)
    q = configurations(1, seed=2)[0]
    values = {
        n: v for n, v in zip(JOINTS, q, strict=True) if not n.endswith("_3") or n.startswith("arm")
    }
    model, data, _ = pinocchio_frames(q)
    for link in (*hand.JOINT_NAMES, "palm_link", "link_7"):
        T, at = np.eye(4), link
        while at != "base_link":
            joint = joints[at]
            T, at = joint.at(values.get(joint.follows, 0.0)) @ T, joint.parent
        assert np.abs(T - frame(model, data, link)).max() < 1e-6, link


def test_description_has_the_solids_that_the_physics_has() -> None:
    """Catches half lengths for full ones, a capsule laid along another axis, and a link without
    shape.
    """
    model, shapes = arm_scene(), description().shapes
    for k, shape in enumerate(shapes["hand_base"]):
        geom = model.geom(f"palm_{k}")
        assert shape.kind == "box"
        assert np.allclose(shape.size, geom.size)
        assert np.allclose(shape.T_link_shape[:3, 3], geom.pos)
    assert len(shapes["hand_base"]) == len(hand.PALM_BOXES)
    for name in hand.JOINT_NAMES:
        if name.endswith("_0"):
            assert not shapes[name]
            continue
        geom = model.geom(name)
        axis = Rotation.from_quat(geom.quat, scalar_first=True).as_matrix()[:, 2]
        (cylinder,) = (s for s in shapes[name] if s.kind == "cylinder")
        assert np.allclose(cylinder.size, geom.size[:2])
        assert np.allclose(cylinder.T_link_shape[:3, 3], geom.pos, atol=1e-8)
        assert abs(cylinder.T_link_shape[:3, 2] @ axis) == pytest.approx(1.0)
        spheres = [s for s in shapes[name] if s.kind == "sphere"]
        assert all(s.size[0] == pytest.approx(geom.size[0]) for s in spheres)
        ends = sorted(float((s.T_link_shape[:3, 3] - geom.pos) @ axis) for s in spheres)
        assert np.allclose(ends, [-geom.size[1], geom.size[1]], atol=1e-8)


def test_solve_brings_the_palm_to_poses_it_can_reach() -> None:
    """From one posture over the belt to poses near it.

    Catches an error in the wrong frame, and a step of the wrong sign.
    """
    kinematics, rng = ArmKinematics(FIVE_FINGERS.T_hand_palm), np.random.default_rng(0)
    for _ in range(20):
        goal = kinematics.palm(HOME + rng.uniform(-0.5, 0.5, 7))
        q, residual = kinematics.solve(goal, HOME)
        T = kinematics.palm(q)
        assert residual < 1e-4
        assert np.linalg.norm(T[:3, 3] - goal[:3, 3]) < 1e-4
        assert rotation_angle(T[:3, :3].T @ goal[:3, :3]) < 1e-3
        assert ((q >= LOWER) & (q <= UPPER)).all()


def test_solve_owns_up_to_a_pose_out_of_reach() -> None:
    """A pose 3 m away leaves an error of at least 1.5 m. Catches a residual in another unit."""
    goal = ArmKinematics(FIVE_FINGERS.T_hand_palm).palm(HOME)
    goal[0, 3] = 3.0
    assert ArmKinematics(FIVE_FINGERS.T_hand_palm).solve(goal, HOME, 50)[1] > 1.5


def test_joint_velocity_gives_the_twist_demanded() -> None:
    """The twist is measured by differences of palm().

    Catches angular and linear parts swapped, and axes of the palm in place of the base.
    """
    kinematics, rng = ArmKinematics(FIVE_FINGERS.T_hand_palm), np.random.default_rng(3)
    for _ in range(30):
        q = HOME + rng.uniform(-0.4, 0.4, 7)
        twist = rng.uniform(-1, 1, 6) * [0.1, 0.1, 0.1, 0.3, 0.3, 0.3]
        step = kinematics.joint_velocity(q, twist) * 1e-3
        a, b = kinematics.palm(q - step), kinematics.palm(q + step)
        got = np.concatenate([(b - a)[:3, 3], rotation_vector(b[:3, :3] @ a[:3, :3].T)]) / 2e-3
        assert np.abs(got - twist).max() < 1e-3


def test_joint_velocity_keeps_speed_limits_and_direction() -> None:
    """Catches a clipped joint, which bends the path, where all should slow down; limits in wrong
    order.
    """
    kinematics, rng = ArmKinematics(FIVE_FINGERS.T_hand_palm), np.random.default_rng(4)
    fastest = np.zeros(7)
    for _ in range(60):
        q = np.clip(HOME + rng.uniform(-1, 1, 7), LOWER + 0.1, UPPER - 0.1)
        q[2] = 0.0  # no motion of the elbow of its own
        twist = rng.normal(0, 5, 6)
        fast, slow = kinematics.joint_velocity(q, twist), kinematics.joint_velocity(q, 1e-3 * twist)
        assert (np.abs(fast) <= MAX_SPEED * (1 + 1e-9)).all()
        assert fast @ slow == pytest.approx(np.linalg.norm(fast) * np.linalg.norm(slow), rel=1e-9)
        fastest = np.maximum(fastest, np.abs(fast) / MAX_SPEED)
    assert fastest.max() > 0.999
    assert np.allclose(MAX_SPEED, [2.967, 2.618, 2.618, 2.618, 3.1416, 3.1416, 3.840])


@pytest.mark.parametrize("joint", range(7))
def test_joints_at_a_limit_do_not_move_further_out(joint: int) -> None:
    """Catches a limit's sign, and one joint's limit applied to another."""
    kinematics, rng = ArmKinematics(FIVE_FINGERS.T_hand_palm), np.random.default_rng(5)
    stopped = 0
    for bound, outward in ((LOWER, -1), (UPPER, 1)):
        q = HOME.copy()
        q[joint] = bound[joint] - 0.005 * outward
        inner = q.copy()
        inner[joint] -= 0.05 * outward
        for _ in range(20):
            twist = rng.normal(0, 0.2, 6)
            assert outward * kinematics.joint_velocity(q, twist)[joint] <= 0
            stopped += outward * kinematics.joint_velocity(inner, twist)[joint] > 0
    assert stopped > 5  # the same twists would have moved it


# objects


@pytest.mark.parametrize("name", TEN)
def test_mass_extent_and_stand_of_the_ten(name: str) -> None:
    """Catches a mass counted twice in overlapping parts, mm for m, an object that lies, walls that
    lean, and parts below the bottom.
    """
    target = TEN[name]
    model, data = on_belt(target, yaw=0.7)
    assert model.body("object").mass[0] == pytest.approx(target.mass, rel=1e-6)
    size = 1e3 * target.extent()
    assert np.abs([*np.sort(size[:2]), size[2]] - np.array(TABLE_MM[name])).max() <= 1.0 + 1e-6
    start = data.qpos.copy()
    run(model, data, 1.0)
    assert np.linalg.norm(data.qpos[:3] - start[:3]) < 1e-3
    turn = (
        Rotation.from_quat(data.qpos[3:7], scalar_first=True)
        * Rotation.from_quat(start[3:7], scalar_first=True).inv()
    )
    assert np.degrees(turn.magnitude()) < (5.0 if target.rolls else 1.0)


def test_walls_of_a_vessel_lean_outwards_all_round() -> None:
    """Catches rotations composed in the wrong order: all walls would lean in one direction."""
    walls = [p for p in TEN["cup"].parts if p.kind == "box"]
    top = [(p.T_object_part @ [0, 0, p.size[2], 1])[:2] for p in walls]
    bottom = [(p.T_object_part @ [0, 0, -p.size[2], 1])[:2] for p in walls]
    assert np.allclose(
        np.linalg.norm(top, axis=1) - np.linalg.norm(bottom, axis=1), 0.0375 - 0.030, atol=1e-6
    )


def compiled(target: ObjectModel) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_object(spec, target)
    return spec.compile()


def facts(target: ObjectModel) -> list[float]:
    numbers = [target.mass, *target.look.colour]
    for p in target.parts:
        numbers += [
            *p.size,
            *p.T_object_part.ravel(),
            *([] if p.vertices is None else p.vertices.ravel()),
        ]
    return numbers


def like_one_of_the_ten(target: ObjectModel) -> list[str]:
    return [
        n
        for n, t in TEN.items()
        if np.abs(np.sort(t.extent()) - np.sort(target.extent())).max() < 2e-3
    ]


def test_procedural_objects_compile_within_bounds_and_repeat() -> None:
    """Catches a degenerate hull, a mass in grams, a size out of reach, and a draw that depends on
    earlier draws.
    """
    made = [procedural_object(k) for k in range(60)]
    assert len({m.name for m in made}) == 60
    assert not {m.name for m in made} & set(TEN)
    for k, target in enumerate(made):
        body = compiled(target).body("object")
        assert body.mass[0] == pytest.approx(target.mass, rel=1e-6)
        assert (body.inertia > 0).all()
        assert 0.03 <= target.mass <= 0.6
        assert target.extent().min() > 0.020
        assert target.extent().max() < 0.260
        assert facts(procedural_object(k)) == facts(target)
    assert len({tuple(facts(m)[:4]) for m in made}) == 60
    assert facts(procedural_object(0, seed=1)) != facts(made[0])


def test_no_procedural_object_has_the_size_of_one_of_the_ten() -> None:
    """Extents are compared to 2 mm in all three dimensions, whichever way up.

    Catches training on objects that are held out.
    """
    assert [like_one_of_the_ten(procedural_object(k)) for k in range(60)] == [[]] * 60


# points on the surface


def test_surface_points_of_a_box_are_on_it_and_uniform_by_area() -> None:
    """Catches points drawn by triangle instead of by area, and half a triangle left out or
    overshot.
    """
    n, half = 6000, np.array([0.019, 0.0445, 0.0875])
    points = surface_points(TEN["sugar_box"], n, np.random.default_rng(0))
    assert points.shape == (n, 3)
    assert np.abs((np.abs(points) / half).max(1) - 1).max() < 1e-9
    areas = np.array([half[1] * half[2], half[0] * half[2], half[0] * half[1]])
    for axis in range(3):
        for sign in (1, -1):
            face = points[np.abs(points[:, axis] - sign * half[axis]) < 1e-9]
            share = areas[axis] / (2 * areas.sum())
            assert abs(len(face) - n * share) < 3 * np.sqrt(n * share * (1 - share))
            for other in {0, 1, 2} - {axis}:
                u = face[:, other] / half[other]
                assert abs(u.mean()) < 3 * np.sqrt(1 / 3 / len(u))
                assert abs((u**2).mean() - 1 / 3) < 3 * np.sqrt(4 / 45 / len(u))


def test_surface_points_of_a_sphere_are_on_it_all_round() -> None:
    """The sphere is a fine mesh, within 0.5 mm of round.

    Catches radius for diameter, and half a sphere.
    """
    n = 4000
    points = surface_points(ball("ball", 0.06, 0.1, LOOK), n, np.random.default_rng(0))
    r = np.linalg.norm(points, axis=1)
    assert np.abs(r - 0.03).max() < 5e-4
    unit = points / r[:, None]
    assert (np.abs(unit.mean(0)) < 3 * np.sqrt(1 / 3 / n)).all()
    assert (np.abs((unit**2).mean(0) - 1 / 3) < 3 * np.sqrt(4 / 45 / n)).all()


@pytest.mark.parametrize("name", ["cup", "foam_brick", "apple", "mustard_bottle"])
def test_surface_points_fill_the_extent_of_the_object(name: str) -> None:
    """Catches parts left out or misplaced in what is seen."""
    points = surface_points(TEN[name], 4000, np.random.default_rng(0))
    assert np.abs(np.ptp(points, axis=0) - TEN[name].extent()).max() < 1.5e-3


def test_surface_points_fill_the_extent_of_the_mug() -> None:
    """Catches a model without the mug's handle: its points end at the wall, 24 mm too early."""
    points = surface_points(TEN["mug"], 4000, np.random.default_rng(0))
    assert np.abs(np.ptp(points, axis=0) - TEN["mug"].extent()).max() < 2e-3


def test_surface_points_are_not_inside_the_object() -> None:
    """Catches points where two parts of an object meet, which no camera sees."""
    target = TEN["mustard_bottle"]
    points = surface_points(target, 2000, np.random.default_rng(0))
    hulls = [ConvexHull(p.vertices).equations for p in target.parts]
    inside = [(points @ h[:, :3].T + h[:, 3]).max(1) < 1e-9 for h in hulls]
    assert np.mean(np.sum(inside, axis=0) > 1) < 0.01


# determinism


def closing(model: mujoco.MjModel) -> mujoco.MjData:
    """The hand over a cube on a moving belt, fingers down, about to close on it."""
    data = mujoco.MjData(model)
    free, target = model.joint("hand").qposadr[0], model.joint("object").qposadr[0]
    place = [0.445, -0.012, 0.2, 0, 1, 0, 0]
    data.qpos[free : free + 7] = place
    data.mocap_pos[0], data.mocap_quat[0] = place[:3], place[3:]
    data.qpos[target : target + 7] = [0.5, -0.02, 0.0285, 1, 0, 0, 0]
    data.ctrl[:] = hand.CLOSED
    return data


def test_two_builds_and_a_restored_state_run_bit_equal() -> None:
    """Catches random textures that reach the physics, a warm start left out of the state, and a
    seed that is not set.
    """
    finals, touching = [], 0
    for _ in range(2):
        model = build(TEN["rubiks_cube"], 0.1, robot="hand", gripper=FIVE_FINGERS)
        data = closing(model)
        for k in range(300):
            if k == 120:
                saved = np.empty(mujoco.mj_stateSize(model, STATE))
                mujoco.mj_getState(model, data, saved, STATE)
            mujoco.mj_step(model, data)
            touching += any(
                {model.geom(g).contype[0] for g in pair} == {1, 2} for pair in data.contact.geom
            )
        finals.append(data.qpos.copy())
    assert touching > 20  # the hand meets the cube, so the contact solver was at work
    assert finals[0].tobytes() == finals[1].tobytes()
    for other in (data, mujoco.MjData(model)):
        mujoco.mj_setState(model, other, saved, STATE)
        mujoco.mj_forward(model, other)
        for _ in range(180):
            mujoco.mj_step(model, other)
        assert other.qpos.tobytes() == finals[0].tobytes()
