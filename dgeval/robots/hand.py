"""What differs between the grippers that the simulator's world can carry."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dgeval.geometry import Array
from dgeval.robots import dlr_hit_hand as hand
from dgeval.robots import parallel_jaw as jaw


@dataclass(frozen=True)
class Gripper:
    """joints: all, in the order of joint states; drives: those with a drive; fingers: first words of geoms' names.

    T_hand_palm: the frame of grasps; T_hand_camera: its colour camera, as calibrated; centre (3,) m in hand_base: where held
    things are. positions: all joints of a preshape; targets: of the drives, s after the close command.
    mismatch_sd: rad or m, of where the closing fingers come to rest in the twin against the log.
    """

    name: Literal["fingers", "jaw"]
    joints: tuple[str, ...]
    drives: tuple[str, ...]
    fingers: tuple[str, ...]
    T_hand_palm: Array
    T_hand_camera: Array
    centre: Array
    positions: Callable[[Array], Array]
    targets: Callable[[float, Array], Array]
    mismatch_sd: float


def _coupled(preshape: Array) -> Array:
    """The last joint of each finger follows the one before it."""
    fingers = preshape.reshape(5, 3)
    return np.concatenate([fingers, fingers[:, 2:]], axis=1).ravel()


FIVE_FINGERS = Gripper(
    "fingers", hand.JOINT_NAMES, hand.ACTUATED, hand.FINGERS, hand.T_hand_palm, hand.T_hand_camera,
    hand.GRASP_CENTRE, _coupled, hand.finger_targets, 0.03,
)  # fmt: skip
JAW = Gripper(
    "jaw", jaw.JOINT_NAMES, jaw.JOINT_NAMES, jaw.FINGERS, jaw.T_hand_grasp, jaw.T_hand_camera,
    jaw.T_hand_grasp[:3, 3], np.copy, jaw.finger_targets, 0.002,
)  # fmt: skip


def gripper_of(joints: Collection[str]) -> Gripper | None:
    """Which one has these joints; None for a hand of which there is no model."""
    return next((g for g in (FIVE_FINGERS, JAW) if set(g.drives) <= set(joints)), None)
