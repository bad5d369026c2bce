"""The physical side of a trial: arm, hand, belt and object stepped in time.

The state is saved and restored to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from dgeval.geometry import Array, transform
from dgeval.robots.diana7 import DAMPING, STIFFNESS, ArmKinematics
from dgeval.robots.diana7 import JOINT_NAMES as ARM_JOINTS
from dgeval.robots.hand import SimulatedHand
from dgeval.simulation.setting import Setting, present
from dgeval.worlds.closing import CLOSE_S, CONTROL_S, LIFT_S, SETTLE_S, SUBSTEPS
from dgeval.worlds.hand_and_object import HandAndObject
from dgeval.worlds.objects import ObjectModel
from dgeval.worlds.scene import TURNTABLE_TOP, Camera, build, pose_of

RECORDED_S = 1.6  # s, recorded after the lift; ours
FINISH_S = CLOSE_S + SETTLE_S + LIFT_S + RECORDED_S  # s, from the close command to the end


@dataclass(frozen=True)
class Snapshot:
    """Everything a continuation needs: time, s, physical state, and the arm's set
    point (7,), rad.
    """

    t: float
    state: Array
    q_set: Array


class World(HandAndObject):
    """The hand on its arm, the belt and the object, stepped in time.

    Base frame: the arm's base. target: the object to grasp. belt_speed in m/s along +y.
    """

    gripper: SimulatedHand

    def __init__(
        self,
        target: ObjectModel,
        belt_speed: float,
        cameras: tuple[Camera, ...] = (),
        setting: Setting | None = None,
        *,
        gripper: SimulatedHand,
    ) -> None:
        self.target, self.setting = target, setting or Setting()
        self.presenter = self.setting.presenter
        model = _build_model(target, belt_speed, "arm", cameras, self.setting, gripper)
        top = TURNTABLE_TOP if self.setting.turn is not None else 0.0
        super().__init__(model, gripper, target.rest_height() + top)
        self.kinematics = ArmKinematics(gripper.T_hand_palm)
        self.arm = np.array([model.joint(n).qposadr[0] for n in ARM_JOINTS])
        self.arm_dof = np.array([model.joint(n).dofadr[0] for n in ARM_JOINTS])
        self._arm_drives = np.array([model.actuator(n).id for n in ARM_JOINTS])
        self.q_set = np.zeros(7)

    def start(
        self, q_arm: Array, preshape: Array, x: float, y: float, yaw: float, object_velocity: float
    ) -> None:
        """Put arm and fingers at rest, and the object on the belt or in the presenter's hand.

        On the belt it stands at x, y m and yaw rad and moves at object_velocity, m/s, unless the
        belt starts later. q_arm (7,) and preshape (k,) in rad.
        """
        d = self.data
        mujoco.mj_resetData(self.model, d)
        d.qpos[self.arm] = self.q_set = q_arm.copy()
        d.qpos[self.fingers] = self.gripper.positions(preshape)
        d.qpos[self.object : self.object + 7] = [
            x,
            y,
            self.rest,
            np.cos(yaw / 2),
            0,
            0,
            np.sin(yaw / 2),
        ]
        d.qvel[self.object_dof + 1] = 0.0 if self.setting.belt is not None else object_velocity
        self.setting.put(self.model, d)
        if self.presenter is not None:
            present(self.presenter, d)
            d.qpos[self.object : self.object + 7] = np.concatenate(
                [d.mocap_pos[0], d.mocap_quat[0]]
            )
        self.command(np.zeros(7), preshape)
        mujoco.mj_forward(self.model, d)

    @property
    def t(self) -> float:
        return float(self.data.time)

    def command(self, dq: Array, fingers: Array) -> None:
        """Advance the arm's set point by one control period, and set the fingers' drives.

        dq (7,): joint speeds, rad/s. fingers (k,): drive targets, rad or m.
        """
        self.q_set = self.q_set + dq * CONTROL_S
        # giving the drive the speed too cancels the lag that its damping would cause
        self.data.ctrl[self._arm_drives] = self.q_set + dq * (DAMPING / STIFFNESS)
        self.data.ctrl[self.drives] = fingers

    def save(self) -> Snapshot:
        return Snapshot(self.t, self.state(), self.q_set.copy())

    def restore(self, snapshot: Snapshot) -> None:
        self.set_state(snapshot.state)
        self.q_set = snapshot.q_set.copy()
        mujoco.mj_forward(self.model, self.data)

    def put_object(self, pose_wxyz: Array, velocity: Array) -> None:
        """Set the object's pose (7,) in MuJoCo's order and its velocity (6,); call it after
        restore.
        """
        self.place_object(pose_wxyz, velocity)
        mujoco.mj_forward(self.model, self.data)

    def put_arm(self, T_base_palm: Array) -> float:
        """Move the arm to a palm pose (4, 4) at once; the fingers stay as they are.

        Returns the error that inverse kinematics leaves, m + 0.1 m per rad.
        """
        q, residual = self.kinematics.solve(T_base_palm, self.q_set, 60)
        self.data.qpos[self.arm] = self.q_set = q
        self.data.qacc_warmstart[:] = 0
        self.command(np.zeros(7), self.data.ctrl[self.drives].copy())
        mujoco.mj_forward(self.model, self.data)
        return residual

    def T_base_hand(self) -> Array:
        return pose_of(self.data, "hand_base")

    def T_base_palm(self) -> Array:
        return self.T_base_hand() @ self.gripper.T_hand_palm

    def T_base_object(self) -> Array:
        return pose_of(self.data, "object")

    def hand_distance(self, limit: float) -> float:
        """Least distance of hand and object, m, at most `limit`."""
        m, d = self.model, self.data
        reach = limit + 0.15
        if (
            np.linalg.norm(
                transform(self.T_base_hand(), self.gripper.centre[None])[0]
                - d.xpos[m.body("object").id]
            )
            > reach + 0.15
        ):
            return limit
        return self.distance(limit)

    def advance(self, steps: int = SUBSTEPS) -> None:
        self.setting.drive(self.model, self.data)
        mujoco.mj_step(self.model, self.data, steps)
        self.check_stable()

    def move_hand(self, twist: Array, fingers: Array) -> None:
        """As in `HandAndObject`; the arm follows the twist."""
        self.command(self.kinematics.joint_velocity(self.q_set, twist), fingers)
        self.advance()


@dataclass(frozen=True, slots=True)
class Finish:
    """How closing and lifting ended.

    height: greatest height of the object over its support, m.
    """

    success: bool
    height: float


def _build_model(
    target: ObjectModel,
    belt_speed: float,
    robot: Literal["arm", "none"],
    cameras: tuple[Camera, ...],
    setting: Setting,
    gripper: SimulatedHand | None,
) -> mujoco.MjModel:
    others = tuple(o[0] for o in setting.others)
    presented, turntable = setting.presenter is not None, setting.turn is not None
    return build(target, belt_speed, robot, cameras, presented, gripper, others, turntable)


def twin_path(
    target: ObjectModel,
    belt_speed: float,
    x: float,
    y: float,
    yaw: float,
    seconds: float,
    setting: Setting | None = None,
) -> Array:
    """The object's path without any robot.

    Rows are (pose 7, velocity 6) in MuJoCo's order, one per control period from t = 0. x, y in m,
    yaw in rad.
    """
    setting = setting or Setting()
    presenter = setting.presenter
    model = _build_model(target, belt_speed, "none", (), setting, None)
    data = mujoco.MjData(model)
    z = target.rest_height() + (TURNTABLE_TOP if setting.turn is not None else 0.0)
    data.qpos[:7] = [x, y, z, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
    data.qvel[1] = belt_speed if setting.belt is None else 0.0
    setting.put(model, data)
    if presenter is not None:
        present(presenter, data)
        data.qpos[:7] = np.concatenate([data.mocap_pos[0], data.mocap_quat[0]])
    mujoco.mj_forward(model, data)
    rows = [np.concatenate([data.qpos[:7], data.qvel[:6]])]
    for _ in range(round(seconds / CONTROL_S)):
        setting.drive(model, data)
        mujoco.mj_step(model, data, SUBSTEPS)
        rows.append(np.concatenate([data.qpos[:7], data.qvel[:6]]))
    return np.array(rows)


def matrix_of(pose_wxyz: Array) -> Array:
    """MuJoCo's (7,) x y z qw qx qy qz -> T (4, 4)."""
    T = np.eye(4)
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, pose_wxyz[3:7])
    T[:3, :3], T[:3, 3] = R.reshape(3, 3), pose_wxyz[:3]
    return T


def home(world: World, y: float, height: float = 0.54) -> Array:
    """Arm joints (7,) rad with the hand over the belt, pointing straight down.

    Its palm normal is along base +x. y, height in m. ValueError if the arm does not reach the pose.
    """
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[:3, 3] = (0.36, y, height)
    turn = np.arctan2(y, 0.45)
    q, residual = world.kinematics.solve(
        T @ world.gripper.T_hand_palm, np.array([turn, -0.37, 0.0, 2.32, 0.0, -1.19, -turn])
    )
    if residual > 1e-4:
        raise ValueError(f"the arm does not reach its home over y = {y} m")
    return q
