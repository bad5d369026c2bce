"""Visual servoing at the recorded state: equations 6 and 7 of the dynamic-grasping paper.

Open loop: the commands don't move the recorded palm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgeval.config import ServoConfig
from dgeval.geometry import Array, rotation_angle, rotation_vector
from dgeval.robots.hand import Hand

GAP_NS = 100_000_000  # ns without a control period, over which the error's difference is none; ours


@dataclass(frozen=True, slots=True)
class ServoCommand:
    """Errors (m, rad) and the commanded twist (6,) m/s, rad/s, base axes, at the palm's origin."""

    error_linear: float
    error_angular: float
    twist: Array


def look_at_rotation(T_base_camera: Array, target: Array) -> Array:
    """r_O: smallest rotation vector (3,) rad, base axes, that turns the optical axis to the target.

    target (3,) m, base frame (A10).
    """
    axis = T_base_camera[:3, 2]
    direction = target - T_base_camera[:3, 3]
    distance = float(np.linalg.norm(direction))
    if distance < 1e-9:
        return np.zeros(3)
    direction = direction / distance
    cross = np.cross(axis, direction)
    sine, cosine = float(np.linalg.norm(cross)), float(axis @ direction)
    if sine < 1e-12:
        return np.zeros(3)
    return np.asarray(cross / sine * np.arctan2(sine, cosine))


def blend_rotation(distance: float, r_O: Array, r_G: Array, config: ServoConfig) -> Array:
    """Equation 6: rotation vector (3,) rad, from r_O (face the object, far) to r_G (grasp, near).

    distance: m from the palm to the grasp.
    """
    share = float(np.clip((distance - config.c_G) / (config.c_O - config.c_G), 0.0, 1.0))
    return share * r_O + (1 - share) * r_G


class Servo:
    """Equation 7, its derivative being the error's difference from one control period to the next.

    Divided by the period it diverges with Table V's gains (docs/papers.md, "Derivative of equation
    7").
    """

    def __init__(self, config: ServoConfig, hand: Hand) -> None:
        self.config = config
        self._approach = hand.T_hand_palm[:3, :3].T @ hand.approach  # palm frame
        self.reset()

    def reset(self) -> None:
        self._last: tuple[int, Array] | None = None
        self._difference = np.zeros(6)

    def step(
        self,
        t_ns: int,
        T_base_palm: Array,
        T_base_grasp: Array,
        T_base_camera: Array | None,
        target: Array,
        velocity: Array,
        is_period: bool = True,
    ) -> ServoCommand:
        """Command for the recorded palm towards the grasp; poses (4, 4), base frame.

        target (3,) m and velocity (3,) m/s: of the object, base frame. Without a camera pose the
        orientation error is that of the grasp at any distance. With `beyond_m` the hand passes
        through the grasp at some speed; commanded to the grasp itself it creeps, and it always
        closes short of the grasp. is_period: of the control loop; else nothing is remembered, and
        the error's difference is that of the last period.
        """
        c = self.config
        t_G = T_base_grasp[:3, 3] - T_base_palm[:3, 3]
        R = T_base_grasp[:3, :3] @ T_base_palm[:3, :3].T
        r_G = rotation_vector(R)
        distance = float(np.linalg.norm(t_G))
        axis = T_base_grasp[:3, :3] @ self._approach
        if t_G @ axis > 0:
            t_G = t_G + c.beyond_m * axis
        r = (
            r_G
            if T_base_camera is None
            else blend_rotation(distance, look_at_rotation(T_base_camera, target), r_G, c)
        )
        error = np.concatenate([t_G, r])
        if is_period and (self._last is None or t_ns > self._last[0]):
            apart_ns = 0 if self._last is None else t_ns - self._last[0]
            if self._last is None or apart_ns > GAP_NS:
                self._difference = np.zeros(6)  # over a gap it is no control period's
            else:
                self._difference = error - self._last[1]
            self._last = t_ns, error
        v = c.c_p_v * t_G + c.c_d_v * self._difference[:3] + velocity
        w = c.c_p_w * r + c.c_d_w * self._difference[3:]
        return ServoCommand(distance, rotation_angle(R), np.concatenate([v, w]))
