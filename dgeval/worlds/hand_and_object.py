"""One physics of a hand at an object: set poses, read contacts, grip, lift, save and restore.

The simulator's world (hand on an arm), the verdict's twin (the recorded hand) and the grasp
samplers (a hand on a mocap handle) are this class with another way to move the hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from dgeval.geometry import Array
from dgeval.robots.hand import Hand
from dgeval.worlds.closing import MAX_FROM_HAND, MIN_LIFT, swing
from dgeval.worlds.presenter import GRIP
from dgeval.worlds.scene import TIMESTEP, finger_forces, least_distance

INTEGRATION = mujoco.mjtState.mjSTATE_INTEGRATION  # the part of the state that is saved
CHECK_EVERY = 25  # physics steps between two checks of a lift test; ours
LEFT_BEHIND_M = 0.02  # m over its rest: below this, a half lifted hand has lost the object; ours


@dataclass(frozen=True, slots=True)
class Touch:
    """What the hand touches: the object, and anything else.

    penetration m: deepest of hand and object, 0 without contact. solid: name of the hand's solid
    that penetrates deepest, None without contact.
    """

    object: bool
    other: bool
    penetration: float
    solid: str | None


@dataclass(frozen=True, slots=True)
class LiftTest:
    """How a flying hand tries a grasp: close, wait, lift, hold, shake.

    It waits settle_s s after the close, lifts by height_m m along a smooth step in lift_s s and
    holds for hold_s s. shake_m m: travel of a shake at 5 Hz (`closing.swing`), 0 for none. A grasp
    holds if the object ends at least 0.8 of the height up.
    """

    settle_s: float
    lift_s: float
    height_m: float
    hold_s: float
    shake_m: float


class HandAndObject:
    """A compiled world with one hand and one object, and its state.

    rest m: height of the object's origin when it stands, base frame.
    """

    def __init__(self, model: mujoco.MjModel, gripper: Hand, rest: float) -> None:
        self.model, self.gripper, self.rest = model, gripper, rest
        self.data = mujoco.MjData(model)
        self.fingers = np.array([model.joint(n).qposadr[0] for n in gripper.joints])
        self.finger_dof = np.array([model.joint(n).dofadr[0] for n in gripper.joints])
        self.driven = np.array([model.joint(n).qposadr[0] for n in gripper.drives])
        self.drives = np.array([model.actuator(n).id for n in gripper.drives])
        self.object = int(model.joint("object").qposadr[0])
        self.object_dof = int(model.joint("object").dofadr[0])
        solids = [model.geom(g) for g in range(model.ngeom)]
        self.is_hand = np.array([s.contype[0] == 2 for s in solids])
        self.is_object = np.array([s.name.startswith("object_") for s in solids])
        self.hand_geoms: list[int] = np.flatnonzero(self.is_hand).tolist()
        self.object_geoms: list[int] = np.flatnonzero(self.is_object).tolist()
        # -1 in a world without a person who holds the object
        self._grip = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_EQUALITY, GRIP)
        if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "handle") >= 0:  # a flying hand
            self._hand = int(model.joint("hand").qposadr[0])
            self._handle = int(model.body("handle").mocapid[0])
        self._names = {g: solids[g].name for g in self.hand_geoms}
        self._size = mujoco.mj_stateSize(model, INTEGRATION)

    # state

    def state(self) -> Array:
        """The state from which the physics continues bit for bit."""
        out = np.empty(self._size)
        mujoco.mj_getState(self.model, self.data, out, INTEGRATION)
        return out

    def set_state(self, state: Array) -> None:
        """Restore a state. Call `mj_forward` to get its positions and contacts."""
        mujoco.mj_setState(self.model, self.data, state, INTEGRATION)

    # put

    def place_object(self, pose_wxyz: Array, velocity: Array) -> None:
        """Set the object's pose (7,) in MuJoCo's order and its velocity (6,).

        The caller calls `mj_forward`.
        """
        self.data.qpos[self.object : self.object + 7] = pose_wxyz
        self.data.qvel[self.object_dof : self.object_dof + 6] = velocity
        self.data.qacc_warmstart[:] = 0

    def place_fingers(self, drives: Array) -> None:
        """Set finger joints and their drives to drive positions (k,), rad or m."""
        self.data.qpos[self.fingers] = self.gripper.positions(drives)
        self.data.ctrl[self.drives] = drives

    def fly_to(self, pose_wxyz: Array) -> None:
        """Move a hand on its handle to a pose (7,) of its base, in MuJoCo's order."""
        self.data.qpos[self._hand : self._hand + 7] = pose_wxyz
        self.data.mocap_pos[self._handle] = pose_wxyz[:3]
        self.data.mocap_quat[self._handle] = pose_wxyz[3:]

    def update_contacts(self) -> None:
        """Compute positions and contacts of the poses that were set, without dynamics."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)

    # touch

    def touch(self) -> Touch:
        """What the hand touches now."""
        pairs = self.data.contact.geom
        if not len(pairs):
            return Touch(False, False, 0.0, None)
        hand = self.is_hand[pairs].any(axis=1)
        target = self.is_object[pairs].any(axis=1)
        both = hand & target
        other = bool((hand & ~target).any())
        if not both.any():
            return Touch(False, other, 0.0, None)
        rows = np.flatnonzero(both)
        k = int(rows[np.argmin(self.data.contact.dist[both])])
        geom = next(int(g) for g in pairs[k] if self.is_hand[g])
        return Touch(True, other, max(0.0, -float(self.data.contact.dist[k])), self._names[geom])

    def penetration(self, anything: bool = False) -> float:
        """Deepest penetration of the hand with the object, m; 0 without contact.

        anything: with anything the hand meets.
        """
        pairs = self.data.contact.geom
        if not len(pairs):
            return 0.0
        counted = self.is_hand[pairs].any(axis=1)
        counted &= anything | self.is_object[pairs].any(axis=1)
        return float(max(0.0, -self.data.contact.dist[counted].min())) if counted.any() else 0.0

    def distance(self, limit: float) -> float:
        """Least distance of hand and object, m, at most `limit`."""
        return least_distance(self.model, self.data, self.hand_geoms, self.object_geoms, limit)

    def finger_forces(self) -> Array:
        """Sum of normal contact forces on each finger, N."""
        return finger_forces(self.model, self.data, self._names, self.gripper.fingers)

    # a person who holds the object

    @property
    def held_by_presenter(self) -> bool:
        """Whether a person still holds the object."""
        return self._grip >= 0 and bool(self.data.eq_active[self._grip])

    def hand_over(self) -> None:
        """The person lets go."""
        self.data.eq_active[self._grip] = 0

    # grip and lift

    def in_hand(self, T_base_hand: Array, position: Array) -> bool:
        """Whether the object is lifted, touched, near the grasp centre, and let go by the
        presenter.

        position (3,) m: the object's, base frame. Lifted: off its support by MIN_LIFT. This is the
        success rule of docs/simulation.md at one instant.
        """
        if position[2] < self.rest + MIN_LIFT or not self.touch().object or self.held_by_presenter:
            return False
        centre = T_base_hand[:3, :3] @ self.gripper.centre + T_base_hand[:3, 3]
        return bool(np.linalg.norm(position - centre) < MAX_FROM_HAND)

    def lift_test(self, drives: Array, test: LiftTest) -> bool:
        """Whether a flying hand that closes from these drives (k,) keeps the object
        through a test.
        """
        m, d = self.model, self.data
        start = d.mocap_pos[0].copy()
        low = float(d.qpos[self.object + 2])
        close_s = self.gripper.close_s
        lifted = close_s + test.settle_s + test.lift_s
        for k in range(round((lifted + test.hold_s) / TIMESTEP)):
            t = k * TIMESTEP
            if test.shake_m and t > lifted:
                d.mocap_pos[0, :2] = start[:2] + swing(t - lifted, test.shake_m)
            d.ctrl[self.drives] = self.gripper.targets(t, drives)
            rise = float(np.clip((t - close_s - test.settle_s) / test.lift_s, 0, 1))
            d.mocap_pos[0, 2] = start[2] + test.height_m * rise * rise * (3 - 2 * rise)
            mujoco.mj_step(m, d)
            left = d.qpos[self.object + 2] < low + LEFT_BEHIND_M
            if k % CHECK_EVERY == 0 and rise > 0.5 and left:
                return False
        return bool(d.qpos[self.object + 2] > low + 0.8 * test.height_m)
