"""The seven-joint arm: the kinematics of the Diana 7, links drawn as capsules without contact, and its inverse kinematics."""

from __future__ import annotations

import mujoco
import numpy as np

from dgeval.geometry import Array, rotation_vector
from dgeval.robots.mjcf import place, pose

# origin xyz m and rpy rad in the parent link, limits rad, speed rad/s; every joint turns about its local z
JOINTS = (
    ((0.0, 0.0, 0.2856), (-np.pi, 0.0, 0.0), -3.1241, 3.1241, 2.967),
    ((0.0, 0.0, 0.0), (np.pi / 2, 0.0, 0.0), -1.5708, 1.5708, 2.618),
    ((0.0, -0.4586, 0.0), (-np.pi / 2, 0.0, 0.0), -3.1241, 3.1241, 2.618),
    ((0.065, 0.0, 0.0), (np.pi / 2, 0.0, 0.0), 0.0, 3.0543, 2.618),
    ((-0.0528, -0.4554, 0.0), (-np.pi / 2, 0.0, 0.0), -3.1241, 3.1241, 3.1416),
    ((-0.0122, 0.0, 0.0), (np.pi / 2, 0.0, np.pi), -3.1241, 3.1241, 3.1416),
    ((0.087, -0.1169, 0.0), (-np.pi / 2, 0.0, 0.0), -3.1241, 3.1241, 3.840),
)
JOINT_NAMES = tuple(f"arm_{k}" for k in range(1, 8))
LOWER = np.array([j[2] for j in JOINTS])
UPPER = np.array([j[3] for j in JOINTS])
MAX_SPEED = np.array([j[4] for j in JOINTS])
STIFFNESS = np.array([4000.0, 4000, 4000, 4000, 2000, 2000, 2000])  # Nm/rad of the position drives
DAMPING = 0.1 * STIFFNESS  # Nm s/rad; the drives are told the velocity too, so this causes no lag
LINK_RADIUS = 0.05
# the last joint's z axis points back into the arm
T_flange_hand = pose((0.0, 0.0, -0.05), (np.pi, 0.0, 0.0))


def add_arm(spec: mujoco.MjSpec, base: mujoco.MjsBody) -> mujoco.MjsBody:
    """Put the arm below `base`; returns the body `hand_base` at its flange."""
    parent = base
    for k, (xyz, rpy, lower, upper, _) in enumerate(JOINTS):
        if np.linalg.norm(xyz) > 1e-6:
            parent.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0, 0, 0, *xyz], size=[LINK_RADIUS, 0, 0], contype=0, conaffinity=0,
                mass=0, rgba=[0.75, 0.76, 0.78, 1],
            )  # fmt: skip
        parent = parent.add_body(name=f"link_{k + 1}", gravcomp=1)
        place(parent, pose(xyz, rpy))
        parent.mass, parent.inertia, parent.explicitinertial = 2.0, [0.01] * 3, True
        parent.add_joint(
            name=JOINT_NAMES[k],
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[0, 0, 1],
            range=[lower, upper],
            limited=True,
            armature=0.1,
        )
        drive = spec.add_actuator(
            name=JOINT_NAMES[k], target=JOINT_NAMES[k], trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        drive.set_to_position(kp=STIFFNESS[k], kv=DAMPING[k])
    hand = parent.add_body(name="hand_base")
    place(hand, T_flange_hand)
    return hand


class ArmKinematics:
    """Forward and differential inverse kinematics of the palm, or of another tool, on a model of the arm alone."""

    def __init__(self, T_hand_tool: Array) -> None:
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        hand = add_arm(spec, spec.worldbody.add_body(name="base_link"))
        hand.mass, hand.inertia, hand.explicitinertial = 1.0, [0.01] * 3, True
        place(hand.add_site(name="tool"), T_hand_tool)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._J = np.zeros((6, 7))

    def palm(self, q: Array) -> Array:
        """T_base_palm (4, 4) at joint positions (7,)."""
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)
        T = np.eye(4)
        T[:3, :3] = self.data.site_xmat[0].reshape(3, 3)
        T[:3, 3] = self.data.site_xpos[0]
        return T

    def joint_velocity(self, q: Array, twist: Array) -> Array:
        """Joint speeds (7,) for a palm twist (6,) [m/s, rad/s] in base axes at the palm's origin.

        Damped least squares; the free direction turns the elbow into the vertical plane, and joints stop at their limits.
        """
        self.palm(q)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_jacSite(self.model, self.data, self._J[:3], self._J[3:], 0)
        J = self._J
        inverse = J.T @ np.linalg.inv(J @ J.T + 1e-5 * np.eye(6))
        dq = inverse @ twist
        dq += (np.eye(7) - inverse @ J)[:, 2] * (-0.8 * q[2])
        dq *= min(1.0, 1.0 / float((np.abs(dq) / MAX_SPEED).max() + 1e-12))
        near_low, near_high = q < LOWER + 0.02, q > UPPER - 0.02
        dq[near_low] = np.maximum(dq[near_low], 0.0)
        dq[near_high] = np.minimum(dq[near_high], 0.0)
        return np.asarray(dq)

    def solve(
        self, T_base_palm: Array, q: Array, iterations: int = 200, enough: float = 1e-6
    ) -> tuple[Array, float]:
        """Joint positions (7,) near q that bring the palm to a pose, and what is left of the error (m + 0.1 m per rad)."""
        q = q.copy()
        residual = np.inf
        for _ in range(iterations):
            T = self.palm(q)
            error = np.concatenate(
                [T_base_palm[:3, 3] - T[:3, 3], rotation_vector(T_base_palm[:3, :3] @ T[:3, :3].T)]
            )
            residual = float(np.linalg.norm(error[:3]) + 0.1 * np.linalg.norm(error[3:]))
            if residual < enough:
                break
            q = np.clip(q + 0.3 * self.joint_velocity(q, error / 0.3), LOWER + 0.021, UPPER - 0.021)
        return q, residual
