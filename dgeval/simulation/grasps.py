"""Grasps checked in physics by a flying hand.

They are random palm poses, free of contact, that close on the object and lift it. They stand in for
FFHNet in the closed loop and are its positive training data. `quality` is the share of slightly
displaced repetitions that still lift.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib import resources

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.determinism import generator
from dgeval.geometry import Array, increment, invert, matrix_from_pose
from dgeval.robots.hand import SimulatedHand, hand_for
from dgeval.robots.mjcf import quat_wxyz
from dgeval.worlds.hand_and_object import CloseAndLift, HandOnHandle, UnstableError
from dgeval.worlds.objects import ObjectModel, at
from dgeval.worlds.scene import build

HAND = hand_for("ffhnet")
AROUND_M = 0.006  # m, 1 sigma of where any hand's grasp centre comes; ours
REPETITIONS = 6  # displaced tries of a grasp that lifted; ours
SHAKE = 2 * 2 * 9.81 / (2 * np.pi * 5.0) ** 2  # m, travel of a shake of 2 g at 5 Hz; ours


@dataclass(frozen=True)
class KnownGrasp:
    """A grasp that lifts its object.

    T_object_palm (4, 4); preshape (15,) rad: joint positions before closing; quality: share of
    displaced repetitions that lifted.
    """

    T_object_palm: Array
    preshape: Array
    quality: float


def known_grasps(target: ObjectModel) -> list[KnownGrasp]:
    """Shipped grasps of one of the ten objects; for any other object, a search.

    The search takes some seconds to a minute and gives the same grasps each time.
    """
    shipped = json.loads(
        (resources.files("dgeval.simulation") / "known_grasps.json").read_text(encoding="utf-8")
    )
    if target.name not in shipped:
        return search(target, 8, 11, 20_000)
    return [
        KnownGrasp(
            matrix_from_pose(np.array(g["T_object_palm"])), np.array(g["preshape"]), g["quality"]
        )
        for g in shipped[target.name]
    ]


class FlyingHand(HandOnHandle):
    """A hand on a handle over an object at rest at x 0.5 m, y 0 m."""

    def __init__(self, target: ObjectModel, hand: SimulatedHand = HAND) -> None:
        super().__init__(build(target, robot="hand", gripper=hand), hand, target.rest_height())

    def put(self, T_base_hand: Array, preshape: Array) -> None:
        """Put the hand at a pose (4, 4) with preshaped fingers (15,) rad, and the
        object at rest.
        """
        mujoco.mj_resetData(self.model, self.data)
        self.place_object(np.array([0.5, 0.0, self.rest, 1, 0, 0, 0]), np.zeros(6))
        self.fly_to(np.concatenate([T_base_hand[:3, 3], quat_wxyz(T_base_hand[:3, :3])]))
        self.place_fingers(preshape)
        self.update_contacts()

    def put_palm(self, T_object_palm: Array, preshape: Array) -> None:
        """As `put`, with a palm pose in the object's frame."""
        T_hand_palm = self.gripper.T_hand_palm
        self.put(at(0.5, 0.0, self.rest) @ T_object_palm @ invert(T_hand_palm), preshape)

    def touches(self) -> bool:
        """Whether the hand meets anything."""
        touch = self.touch()
        return touch.object or touch.other

    def lowest(self) -> float:
        """Height m over the belt of the hand's lowest point; of a solid that is no capsule, that of
        the box around it.
        """
        m, g = self.model, self.hand_geoms
        up = self.data.geom_xmat[g].reshape(-1, 3, 3)[:, 2]
        centre, half = np.split(m.geom_aabb[g], 2, axis=1)
        reach = (np.abs(up) * half).sum(axis=1)
        capsule = m.geom_type[g] == mujoco.mjtGeom.mjGEOM_CAPSULE
        radius, length = m.geom_size[g, 0], m.geom_size[g, 1]
        reach[capsule] = (np.abs(up[:, 2]) * length + radius)[capsule]
        return float((self.data.geom_xpos[g, 2] + (up * centre).sum(axis=1) - reach).min())

    def lifts(self, preshape: Array, shake: bool = False) -> bool:
        """Whether a close and lift holds the object.

        shake: it must also stay through a shake of 2 g.
        """
        try:
            return CloseAndLift(self, preshape, np.zeros(3), SHAKE if shake else 0.0).finish()
        except UnstableError:
            return False


def candidate(
    rng: np.random.Generator, target: ObjectModel, hand: SimulatedHand = HAND
) -> tuple[Array, Array]:
    """A random T_base_hand over the object at rest at (0.5, 0) m, and drives (k,) before the close.

    Where the object comes to lie in the hand: of the five-finger hand, where most grasps were
    found; of any other near its grasp centre.
    """
    extent = target.extent()
    tilt, heading, roll = (
        np.radians(40) * np.sqrt(rng.random()),
        rng.uniform(0, 2 * np.pi),
        rng.uniform(0, 2 * np.pi),
    )
    down = np.diag([1.0, -1.0, -1.0])
    R = (
        Rotation.from_rotvec(tilt * np.array([np.cos(heading), np.sin(heading), 0])).as_matrix()
        @ down
    )
    R = R @ Rotation.from_euler("z", roll).as_matrix()
    if hand is HAND:
        inside = np.array(
            [rng.uniform(0.025, 0.075), rng.uniform(-0.005, 0.03), rng.uniform(0.13, 0.20)]
        )
    else:
        inside = hand.centre + rng.normal(0, AROUND_M, 3)
    top = max(target.rest_height() - 0.035, 0.0)  # tall objects are taken by their upper part
    centre = (
        np.array([0.5, 0, target.rest_height() + rng.uniform(-0.5, 1.0) * top])
        + rng.normal(0, 0.10, 3) * extent
    )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, centre - R @ inside
    return T, hand.random_preshape(rng)


def search(
    target: ObjectModel,
    n: int,
    seed: int,
    tries: int = 100_000,
    hand: SimulatedHand = HAND,
) -> list[KnownGrasp]:
    """Up to n grasps that lift the object, with a free approach, and survive most repetitions.

    seed, tries: of the random candidates.
    """
    world = FlyingHand(target, hand)
    kept: list[KnownGrasp] = []
    T_object_base = invert(at(0.5, 0.0, target.rest_height()))
    for k in range(tries):
        rng = generator(seed, f"grasps/{target.name}", k)
        T, preshape = candidate(rng, target, hand)
        world.put(T, preshape)
        # raise fingers that would reach into the belt
        T[2, 3] += min(max(0.003 - world.lowest(), 0.0), 0.05)
        if not _approach_free(world, T, preshape):
            continue
        world.put(T, preshape)
        if not world.lifts(preshape):
            continue
        lifted = 0
        for _ in range(REPETITIONS):
            moved = T @ increment(
                np.concatenate([rng.normal(0, 0.004, 3), rng.normal(0, np.radians(3), 3)])
            )
            world.put(moved, preshape)
            lifted += not world.touches() and world.lifts(preshape)
        if lifted / REPETITIONS >= 0.66:
            kept.append(
                KnownGrasp(T_object_base @ T @ hand.T_hand_palm, preshape, lifted / REPETITIONS)
            )
            if len(kept) == n:
                break
    return kept


def _approach_free(world: FlyingHand, T_base_hand: Array, preshape: Array) -> bool:
    """Whether the hand, and its straight approach from 12 cm above, touch nothing."""
    for height in (0.0, 0.02, 0.04, 0.08, 0.12):
        T = T_base_hand.copy()
        T[2, 3] += height
        world.put(T, preshape)
        if world.touches():
            return False
    return True
