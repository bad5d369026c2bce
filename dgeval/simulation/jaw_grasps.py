"""Jaw grasps tried in physics: a gripper on a handle over an object on a table, beside another."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.determinism import generator
from dgeval.geometry import Array, increment, invert, transform
from dgeval.robots.hand import hand_for
from dgeval.robots.mjcf import quat_wxyz
from dgeval.worlds.hand_and_object import CloseAndLift, HandOnHandle, UnstableError
from dgeval.worlds.objects import ObjectModel, at, surface_points
from dgeval.worlds.scene import Camera, build

HAND = hand_for("vfas")
OPENING = HAND.opening or 0.0  # m between the pads
PREGRASP_M = 0.10  # m before the grasp along its approach; ours, the paper gives no figure
SHAKE = 0.02  # m, travel of a shake of 1 g at 5 Hz; ours


class FlyingJaw(HandOnHandle):
    """A gripper on a handle over an object at rest at (0.5, 0) m, and a second object.

    The second object stands at T_base_other, at first far away.
    """

    def __init__(
        self, target: ObjectModel, other: ObjectModel, cameras: tuple[Camera, ...] = ()
    ) -> None:
        self.target, self.other_model = target, other
        model = build(target, robot="hand", cameras=cameras, gripper=HAND, others=(other,))
        super().__init__(model, HAND, target.rest_height())
        self._is_table = np.array([model.geom(g).name == "belt" for g in range(model.ngeom)])
        self._other = int(model.joint("other_0").qposadr[0])
        self.T_base_other = at(3.0, 0, other.rest_height())

    def put(self, T_base_grasp: Array) -> None:
        """Put the open gripper at a pose (4, 4), both objects at rest."""
        mujoco.mj_resetData(self.model, self.data)
        T = T_base_grasp @ invert(HAND.T_hand_palm)
        self.place_object(np.array([0.5, 0, self.rest, 1, 0, 0, 0]), np.zeros(6))
        self.data.qpos[self._other :][:7] = [
            *self.T_base_other[:3, 3],
            *quat_wxyz(self.T_base_other[:3, :3]),
        ]
        self.fly_to(np.concatenate([T[:3, 3], quat_wxyz(T[:3, :3])]))
        self.place_fingers(HAND.open)
        self.update_contacts()

    def touches(self) -> tuple[bool, bool]:
        """Whether the gripper penetrates an object, and the table, by more than 1 mm."""
        pairs, deep = self.data.contact.geom, self.data.contact.dist < -0.001
        if not len(pairs):
            return False, False
        hand = self.is_hand[pairs].any(axis=1) & deep
        table = hand & self._is_table[pairs].any(axis=1)
        return bool((hand & ~table).any()), bool(table.any())

    def approach_free(self, T_base_grasp: Array) -> tuple[bool, bool]:
        """Whether the approach from the pre-grasp pose is free of objects, and of the table."""
        objects = table = False
        for back in np.linspace(0.0, PREGRASP_M, 5):
            self.put(T_base_grasp @ at(0, 0, -back))
            hits_object, hits_table = self.touches()
            objects, table = objects or hits_object, table or hits_table
        return not objects, not table

    def lifts(self) -> bool:
        """Close, lift, hold, shake; True if the object came along and stayed."""
        try:
            return CloseAndLift(self, HAND.open, np.zeros(3), SHAKE).finish()
        except UnstableError:
            return False


def between_fingers(points: Array, T_grasp_points: Array) -> int:
    """How many points (n, 3) m lie between the fingers, where closing fingers would meet them."""
    p = np.abs(transform(T_grasp_points, points) - [0, 0, -0.012])
    return int((p < [OPENING / 2, 0.011, 0.022]).all(axis=1).sum())


def seed_pose(surface: Array, rng: np.random.Generator) -> Array | None:
    """A random T_object_grasp (4, 4) about a point of the surface (n, 3) m; None if nothing fits.

    It comes from above or from the side and closes across a narrow part.
    """
    point = surface[rng.integers(len(surface))]
    tilt, heading = np.radians(100) * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
    R = Rotation.from_rotvec(
        tilt * np.array([np.cos(heading), np.sin(heading), 0])
    ).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    best: tuple[float, Array] | None = None
    for roll in rng.uniform(0, np.pi, int(rng.integers(1, 7))):
        T = at(point[0], point[1], point[2], R @ Rotation.from_euler("z", roll).as_matrix())
        local = transform(invert(T), surface)
        inside = local[np.abs(local[:, 1]) < 0.011]
        top = inside[np.abs(inside[:, 0]) < OPENING / 2, 2].min(initial=0.0)
        T = T @ at(0, 0, max(top, -0.06) + rng.uniform(0.008, 0.035))
        slab = transform(invert(T), surface)
        slab = slab[
            (np.abs(slab[:, 1]) < 0.011)
            & (slab[:, 2] > -0.034)
            & (slab[:, 2] < 0.010)
            & (np.abs(slab[:, 0]) < 0.07)
        ]
        if len(slab) < 5:
            continue
        width = float(np.ptp(slab[:, 0]))
        if width < OPENING - 0.004 and (best is None or width < best[0]):
            best = width, T @ at(float(slab[:, 0].min() + slab[:, 0].max()) / 2, 0, 0)
    return None if best is None else best[1]


def search(target: ObjectModel, n: int, seed: int, tries: int = 4000) -> list[Array]:
    """Up to n T_object_grasp (4, 4) that lift an upright object.

    They must lift in 5 of 6 tries with the gripper displaced by 4 mm and 3 degrees (1 sigma).
    """
    world = FlyingJaw(target, target)
    surface = surface_points(target, 6000, generator(seed, f"jaw surface/{target.name}", 0))
    T_base_object = at(0.5, 0, target.rest_height())
    kept: list[Array] = []
    for k in range(tries):
        rng = generator(seed, f"jaw search/{target.name}", k)
        T_object_grasp = seed_pose(surface, rng)
        if T_object_grasp is None or not all(world.approach_free(T_base_object @ T_object_grasp)):
            continue
        lifted = 0
        for repetition in range(6):
            moved = T_base_object @ T_object_grasp
            if repetition:
                moved = moved @ increment(
                    np.concatenate([rng.normal(0, 0.004, 3), rng.normal(0, np.radians(3), 3)])
                )
            world.put(moved)
            lifted += not any(world.touches()) and world.lifts()
            if repetition + 1 - lifted > 1:
                break
        if lifted >= 5:
            kept.append(T_object_grasp)
            if len(kept) == n:
                break
    return kept
