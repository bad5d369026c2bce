"""Whether an arm can bring its palm to a pose: inverse kinematics within the joint limits.

The arm is read from the robot's description.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from dgeval.geometry import Array, cross, rotation_vector
from dgeval.robots.description import Description, Joint

POSITION_M, ANGLE_RAD = 0.001, 0.01  # m, rad; a pose is reached when both errors are below these
WEIGHT = 0.1  # m/rad, weight of the rotation error against the position error
EVALUATIONS = 40  # most evaluations of the error in one solution


@dataclass(frozen=True)
class Arm:
    """The joints from the base to the palm in order, including fixed ones."""

    joints: tuple[Joint, ...]

    @property
    def movable(self) -> list[Joint]:
        """The joints that are not fixed, in order."""
        return [j for j in self.joints if j.kind != "fixed"]

    def palm(self, q: Array) -> tuple[Array, Array]:
        """T_base_palm (4, 4) at joint positions (n,) rad or m, and its Jacobian (6, n).

        The Jacobian is in base axes, at the palm's origin; linear velocity first.
        """
        T, frames, k = np.eye(4), [], 0
        for joint in self.joints:
            if joint.kind == "fixed":
                T = T @ joint.origin
                continue
            frames.append(T @ joint.origin)
            T = T @ joint.at(float(q[k]))
            k += 1
        axes = np.array([F[:3, :3] @ j.axis for F, j in zip(frames, self.movable, strict=True)])
        origins = np.array([F[:3, 3] for F in frames])
        J = np.concatenate([cross(axes, T[:3, 3] - origins), axes], axis=1).T
        sliding = [j.kind == "prismatic" for j in self.movable]
        J[:3, sliding], J[3:, sliding] = axes[sliding].T, 0.0
        return T, J

    def solve(self, T_base_palm: Array, q: Array) -> Array | None:
        """Joint positions (n,) within the limits that bring the palm to a pose (4, 4), or None.

        The search starts at q (n,); None if it finds no solution.
        """
        low, high = (
            np.array([getattr(j, edge) for j in self.movable]) for edge in ("lower", "upper")
        )
        inside = np.where(np.isfinite(high - low), np.minimum(1e-3, 0.01 * (high - low)), 1e-3)
        scale = np.array([1.0] * 3 + [WEIGHT] * 3)

        def error(x: Array) -> Array:
            T = self.palm(x)[0]
            turn = rotation_vector(T[:3, :3] @ T_base_palm[:3, :3].T)
            return np.asarray(np.concatenate([T[:3, 3] - T_base_palm[:3, 3], turn]) * scale)

        def jacobian(x: Array) -> Array:
            return np.asarray(self.palm(x)[1] * scale[:, None])

        start = np.clip(q, low + inside, high - inside)
        solution = least_squares(
            error, start, jacobian, bounds=(low, high), max_nfev=EVALUATIONS, xtol=1e-10
        )
        reached = (
            np.linalg.norm(solution.fun[:3]) < POSITION_M
            and np.linalg.norm(solution.fun[3:]) < ANGLE_RAD * WEIGHT
        )
        return np.asarray(solution.x) if reached else None


def arm_of(description: Description, base: str, palm: str) -> Arm | None:
    """The arm between the links `base` and `palm`.

    None if the description has no such chain, if it has no movable joint, or if a joint in it
    follows another one.
    """
    chain: list[Joint] = []
    link = palm
    while link != base:
        joint = description.joints.get(link)
        if joint is None or joint.follows != joint.name:
            return None
        chain.append(joint)
        link = joint.parent
    arm = Arm(tuple(reversed(chain)))
    return arm if arm.movable else None
