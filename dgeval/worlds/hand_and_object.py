"""One physics of a hand at an object: set poses, read contacts, close, lift, save and restore.

The simulator's world (hand on an arm), the verdict's twin (the recorded hand) and the grasp
samplers (a hand on a mocap handle) are `HandAndObject` with another way to move the hand. All of
them close and lift by `CloseAndLift`, which holds the one rule of success.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from dgeval.geometry import Array
from dgeval.robots.hand import Hand
from dgeval.worlds.closing import (
    CONTROL_S,
    GIVEN_UP_SHARE,
    HOLD_S,
    LEFT_BEHIND_M,
    LIFT_S,
    MAX_FROM_HAND,
    MIN_LIFT,
    SHAKE_S,
    Finish,
    finishing_twist,
    swing,
)
from dgeval.worlds.presenter import GRIP, GRIPPED_N, RELEASE_S
from dgeval.worlds.scene import finger_forces, least_distance

# MuJoCo's warnings after which it starts anew
UNSTABLE = tuple(
    int(k)
    for k in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
)
# else MuJoCo writes each into a file where the program was started; `check_stable` reads its counts
mujoco.set_mju_user_warning(lambda text: None)
INTEGRATION = mujoco.mjtState.mjSTATE_INTEGRATION  # the part of the state that is saved
# Version of the rule in `CloseAndLift`. Recordings, shipped grasps and weights that name no version
# were made with 1; docs/simulation.md, "Success", says what differed.
SUCCESS_RULE = 2


class UnstableError(Exception):
    """The physics left the range of numbers; MuJoCo has put everything back to its start."""


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
        self.is_finger = self.is_hand & np.array(
            [s.name.split("_")[0] in gripper.fingers for s in solids]
        )
        self.is_object = np.array([s.name.startswith("object_") for s in solids])
        self.hand_geoms: list[int] = np.flatnonzero(self.is_hand).tolist()
        self.object_geoms: list[int] = np.flatnonzero(self.is_object).tolist()
        # -1 in a world without a person who holds the object
        self._grip = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_EQUALITY, GRIP)
        self._names = {g: solids[g].name for g in self.hand_geoms}
        self._size = mujoco.mj_stateSize(model, INTEGRATION)

    # state

    def state(self) -> Array:
        """The state from which the physics continues bit for bit."""
        out = np.empty(self._size)
        mujoco.mj_getState(self.model, self.data, out, INTEGRATION)
        return out

    def check_stable(self) -> None:
        """UnstableError where MuJoCo has met a huge value since the last reset."""
        if any(self.data.warning[k].number for k in UNSTABLE):
            raise UnstableError(self.gripper.name)

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

    def fingers_touch(self) -> bool:
        """Whether a finger touches the object."""
        pairs = self.data.contact.geom
        if not len(pairs):
            return False
        return bool((self.is_finger[pairs].any(axis=1) & self.is_object[pairs].any(axis=1)).any())

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

    # move

    def T_base_hand(self) -> Array:
        """Pose (4, 4) of the hand's base frame."""
        raise NotImplementedError

    def move_hand(self, twist: Array, fingers: Array) -> None:
        """One control period with the hand at a twist (6,), m/s and rad/s, base axes.

        fingers (k,): targets of the drives, rad or m.
        """
        raise NotImplementedError


class HandOnHandle(HandAndObject):
    """A flying hand: it hangs on a mocap handle by a soft weld."""

    def __init__(self, model: mujoco.MjModel, gripper: Hand, rest: float) -> None:
        super().__init__(model, gripper, rest)
        self._hand = int(model.joint("hand").qposadr[0])
        self._handle = int(model.body("handle").mocapid[0])

    def fly_to(self, pose_wxyz: Array) -> None:
        """Move a hand on its handle to a pose (7,) of its base, in MuJoCo's order."""
        self.data.qpos[self._hand : self._hand + 7] = pose_wxyz
        self.data.mocap_pos[self._handle] = pose_wxyz[:3]
        self.data.mocap_quat[self._handle] = pose_wxyz[3:]

    def T_base_hand(self) -> Array:
        pose = self.data.qpos[self._hand : self._hand + 7]
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, pose[3:])
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R.reshape(3, 3), pose[:3]
        return T

    def move_hand(self, twist: Array, fingers: Array) -> None:
        """As in `HandAndObject`; the handle moves without a turn."""
        self.data.ctrl[self.drives] = fingers
        step = self.model.opt.timestep
        for _ in range(round(CONTROL_S / step)):
            self.data.mocap_pos[self._handle] += twist[:3] * step
            mujoco.mj_step(self.model, self.data)
        self.check_stable()


class CloseAndLift:
    """The hand closes, follows the object, lifts and holds, from the present state.

    drives (k,): drive positions before closing, rad or m. velocity (3,) m/s: at which the hand
    follows. shake_m: travel of a shake at 5 Hz in the first 0.3 s of the hold, 0 for none.
    finish: how the hand followed and lifted, in place of ours.

    The close succeeds if, in every control period of the 1.0 s after the lift, the object is at
    least 0.10 m above where it stood (in a person's hand: where it was at the close), touches the
    hand, is within 0.15 m of the grasp centre, and is held by nobody else. After a lift as recorded
    half of the palm's rise is enough, if that is less. A hand that has left the object behind
    half-way up is given up early. UnstableError where the physics became unstable.

    success: None until the outcome is certain. height m: the greatest rise so far.
    """

    def __init__(
        self,
        world: HandAndObject,
        drives: Array,
        velocity: Array,
        shake_m: float = 0.0,
        finish: Finish | None = None,
    ) -> None:
        self.world, self.preshape, self.velocity, self.shake_m = world, drives, velocity, shake_m
        self.recorded = finish
        self.success: bool | None = None
        self.height = 0.0
        self._rest = self._object()[2] if world.held_by_presenter else world.rest
        self._gripped_s = 0.0
        self._periods = 0
        # control periods after the close command: the lift is over, the hold is over, and from when
        # on a hand that has left the object behind is given up
        self._lift_s = world.gripper.lift_after_s
        self._lifted = round((self._lift_s + LIFT_S) / CONTROL_S)
        self._held = self._lifted + round(HOLD_S / CONTROL_S)
        self._given_up = math.floor((self._lift_s + GIVEN_UP_SHARE * LIFT_S) / CONTROL_S)
        self._needed, self._left_behind = MIN_LIFT, LEFT_BEHIND_M
        if finish is not None:
            self._lifted, self._given_up = len(finish.twists), finish.given_up
            self._held = self._lifted + round(HOLD_S / CONTROL_S)
            self._needed = finish.needed_m
            self._left_behind = min(LEFT_BEHIND_M, 0.2 * self._needed)

    @property
    def since_s(self) -> float:
        """Time since the close command, s."""
        return self._periods * CONTROL_S

    def step(self) -> None:
        """Run one control period."""
        since, w = self.since_s, self.world
        twist = self._twist(since)
        held_s = since - self._lift_s - LIFT_S
        if self.shake_m and 0 <= held_s < SHAKE_S - 1e-9:
            moved = swing(held_s + CONTROL_S, self.shake_m) - swing(held_s, self.shake_m)
            twist[:2] += moved / CONTROL_S
        w.move_hand(twist, w.gripper.targets(since, self.preshape))
        self._periods += 1
        if w.held_by_presenter:
            # the person lets go when the object has been gripped for a moment
            gripped = int((w.finger_forces() > GRIPPED_N).sum()) >= 2
            self._gripped_s = self._gripped_s + CONTROL_S if gripped else 0.0
            if self._gripped_s >= RELEASE_S:
                w.hand_over()
        self.height = max(self.height, self._object()[2] - self._rest)
        if self.success is None:
            self.success = self._decided()

    def _twist(self, since: float) -> Array:
        if self.recorded is None:
            return finishing_twist(since, self.velocity, self._lift_s)
        twists = self.recorded.twists
        return twists[self._periods].copy() if self._periods < len(twists) else np.zeros(6)

    def finish(self) -> bool:
        """Run until the outcome is certain, and return it."""
        while self.success is None:
            self.step()
        return self.success

    def _decided(self) -> bool | None:
        if self._periods > self._given_up and self._object()[2] < self._rest + self._left_behind:
            return False
        if self._periods < self._lifted:
            return None
        if not self._in_hand():
            return False
        return True if self._periods >= self._held else None

    def _object(self) -> Array:
        w = self.world
        return np.asarray(w.data.qpos[w.object : w.object + 3])

    def _in_hand(self) -> bool:
        w, position = self.world, self._object()
        if position[2] < self._rest + self._needed or not w.touch().object or w.held_by_presenter:
            return False
        T = w.T_base_hand()
        centre = T[:3, :3] @ w.gripper.centre + T[:3, 3]
        return bool(np.linalg.norm(position - centre) < MAX_FROM_HAND)
