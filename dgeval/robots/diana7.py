"""The seven-joint arm: the kinematics of the Diana 7, and its inverse kinematics.

Its links are drawn as capsules and have no contact.
"""

from __future__ import annotations

import mujoco
import numpy as np

from dgeval.geometry import Array, rotation_vector
from dgeval.robots.mjcf import place, pose

# Of each joint: origin xyz, m, and rpy, rad, in the parent link; lower and upper limit, rad; speed
# limit, rad/s. Every joint turns about its local z. From the Diana 7's URDF.
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
# Joint limits, rad, and speed limits, rad/s, (7,) each, from the table above.
LOWER = np.array([j[2] for j in JOINTS])
UPPER = np.array([j[3] for j in JOINTS])
MAX_SPEED = np.array([j[4] for j in JOINTS])
# Nm/rad, stiffness of the position drives; ours.
STIFFNESS = np.array([4000.0, 4000, 4000, 4000, 2000, 2000, 2000])
# Nm s/rad; ours. The drives get the velocity too, so the damping causes no lag.
DAMPING = 0.1 * STIFFNESS
LINK_RADIUS = 0.05  # m, of the capsules drawn for the links; ours
# The hand on the flange (m, rad); ours. The last joint's z axis points back into the arm.
T_flange_hand = pose((0.0, 0.0, -0.05), (np.pi, 0.0, 0.0))


def add_arm(spec: mujoco.MjSpec, base: mujoco.MjsBody) -> mujoco.MjsBody:
    """Put the arm below `base`; returns the body `hand_base` at its flange."""
    parent = base
    for k, (xyz, rpy, lower, upper, _) in enumerate(JOINTS):
        if np.linalg.norm(xyz) > 1e-6:
            parent.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                fromto=[0, 0, 0, *xyz],
                size=[LINK_RADIUS, 0, 0],
                contype=0,
                conaffinity=0,
                mass=0,
                rgba=[0.75, 0.76, 0.78, 1],
            )
        # mass kg, inertia kg m^2 and armature kg m^2 are ours: gravity is compensated
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
    """Forward and differential inverse kinematics of the palm, or of another tool.

    T_hand_tool (4, 4): the tool in the frame `hand_base`. The model is the arm alone.
    """

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
        """T_base_palm (4, 4) at joint positions (7,), rad."""
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)
        T = np.eye(4)
        T[:3, :3] = self.data.site_xmat[0].reshape(3, 3)
        T[:3, 3] = self.data.site_xpos[0]
        return T

    def joint_velocity(self, q: Array, twist: Array) -> Array:
        """Joint speeds (7,) rad/s for a palm twist (6,) [m/s, rad/s] in base axes at the palm's
        origin.

        Damped least squares. The free direction turns the elbow into the vertical plane. Speeds are
        scaled down together to the limits, and a joint within 0.02 rad of a limit does not move
        towards it.
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
        self, T_base_palm: Array, q: Array, iterations: int = 200, tolerance: float = 1e-6
    ) -> tuple[Array, float]:
        """Joint positions (7,) near q that bring the palm to a pose, and the error that is left.

        The error is the distance in m plus 0.1 m per rad. The search ends when it is below
        `tolerance`, or after `iterations` steps.
        """
        q = q.copy()
        residual = np.inf
        for _ in range(iterations):
            T = self.palm(q)
            error = np.concatenate(
                [T_base_palm[:3, 3] - T[:3, 3], rotation_vector(T_base_palm[:3, :3] @ T[:3, :3].T)]
            )
            residual = float(np.linalg.norm(error[:3]) + 0.1 * np.linalg.norm(error[3:]))
            if residual < tolerance:
                break
            q = np.clip(q + 0.3 * self.joint_velocity(q, error / 0.3), LOWER + 0.021, UPPER - 0.021)
        return q, residual
