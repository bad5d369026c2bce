"""The twin: the object on its hindsight path with the recorded hand, closed at other times.

The recorded hand is a fact: it moves exactly as recorded and can't be pushed. The object and the
fingers obey physics. After a close at another time the hand goes on as it did after the recorded
one; where the log doesn't hold its lift, it follows the object at the velocity believed then and
lifts straight up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from dgeval.failure_rule import NEAR_M, Facts, Needs, Seen, Thresholds, Unknown, Verdict, classify
from dgeval.geometry import Array, invert, rotation_vector
from dgeval.robots.described_hand import DescribedHand
from dgeval.verdict.decide import Draw
from dgeval.verdict.evidence import Scene
from dgeval.worlds.closing import AFTER_CLOSE_S, CONTROL_S, SUBSTEPS
from dgeval.worlds.closing_region import closing_region, points_within
from dgeval.worlds.hand_and_object import CloseAndLift, HandOnHandle
from dgeval.worlds.objects import ObjectModel
from dgeval.worlds.scene import TIMESTEP, build

# control periods between the close times tried; half of it around lone successes, and for `reach`
STEP = 6
# m, at which a free pose is looked for: the truth's 10 mm, and more where the place is uncertain
FREE_STEPS_M = 0.003, 0.006, 0.010, 0.014
# m from the grasp's centre to the object's, where the window of close times begins
NEAR_CENTRE = 0.20
RESYNC_M, RESYNC_RAD = 0.006, 0.10  # a sighting farther than this from the physics' object moves it
REACHED_M = 0.02  # m, hand to object; before that, what lies off the path is an error of the path
# rad; a finger farther than this from where it was recorded says no more than that
MISMATCH_MOST = 0.3
ERROR_LEAST_M = 0.001  # of the palm; smaller ones put nothing right
CLEAR_M = 0.001  # hand in object, up to which it is not in it yet; ours
WORLD_X = 0.5  # where the object stands in the world of `worlds.scene`


@dataclass(frozen=True)
class Approach:
    """The recorded approach in physics.

    states: by tick. off_m, off_deg: furthest off the undisturbed path. contact, link: tick and
    solid of the first contact that moves the object. reach: as in `Seen`.
    """

    states: dict[int, Array]
    off_m: float
    off_deg: float
    contact: int | None
    link: str | None
    reach: tuple[tuple[float, float, float], ...]


class Twin(HandOnHandle):
    """One draw: the scene with a solid of its cloud, displaced by (dx, dy m, turn rad).

    friction, mass: factors on the solid's sliding friction and mass. force: factor on what the
    drives of the fingers give, as far as a description allows.
    """

    def __init__(
        self,
        scene: Scene,
        solid: tuple[ObjectModel, Array],
        offset: tuple[float, float, float],
        friction: float,
        mass: float,
        force: float = 1.0,
    ) -> None:
        self.scene = scene
        self.target, centre = replace(solid[0], mass=solid[0].mass * mass), solid[1]
        speed = 0.0 if scene.held else float(scene.velocity[1])
        model = build(self.target, speed, "hand", presented=scene.held, gripper=scene.gripper)
        rest = float(centre[2]) if scene.held else self.target.rest_height()
        super().__init__(model, scene.gripper, rest)
        model.geom_friction[self.object_geoms, 0] *= friction
        given: Array = np.full(len(self.drives), force)
        if isinstance(scene.gripper, DescribedHand):
            given = scene.gripper.force_factors(force)
        model.actuator_forcerange[self.drives] *= given[:, None]
        model.actuator_gainprm[self.drives] *= given[:, None]
        model.actuator_biasprm[self.drives] *= given[:, None]
        self._hand_dof = int(model.joint("hand").dofadr[0])
        # nothing pushes a recorded hand: with a small inertia the solver would let part of each
        # contact go into moving it
        model.dof_armature[self._hand_dof : self._hand_dof + 6] = 1e5
        self._presenter = int(model.body("presenter").mocapid[0]) if scene.held else None
        self._first = self._begin(centre, scene)
        # the belt is not endless: its middle is the middle of the path
        first = scene.reference if self._first is None else self._first
        along = scene.free[first : scene.reference + 1, 1]
        self._shift = np.array(
            [WORLD_X - centre[0], -centre[1] - (along.min() + along.max()) / 2, 0.0]
        )
        self._start = self._shift + np.array(
            [centre[0] + offset[0], centre[1] + offset[1], self.rest]
        )
        self._turn = offset[2]
        self._moved = np.zeros(3)  # of the whole approach, from where it was recorded

    def _begin(self, centre: Array, scene: Scene) -> int | None:
        """The tick from which the hand is near the undisturbed object; None where it never is."""
        end = scene.reference
        T = scene.hand.T_support_hand[: end + 1]
        palms = T[:, :3, :3] @ self.gripper.centre + T[:, :3, 3]
        reach = NEAR_CENTRE + 0.5 * float(np.linalg.norm(self.target.extent()))
        near = np.flatnonzero(
            np.linalg.norm(palms - centre - scene.free[: end + 1], axis=1) < reach
        )
        return end - (end - int(near[0])) // 3 * 3 if len(near) else None

    # the world at a tick

    def hand_at(self, tick: int) -> Array:
        T = np.array(self.scene.hand.T_support_hand[tick])
        T[:3, 3] += self._shift + self._moved
        return T

    def undisturbed(self, tick: int) -> Array:
        """(7,) pose of the object in MuJoCo's order."""
        half = self._turn / 2
        place = self._start + self.scene.free[tick]
        return np.array([*place, np.cos(half), 0.0, 0.0, np.sin(half)])

    def _put_hand(self, T: Array, velocity: Array, spin: Array) -> None:
        d = self.data
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, T[:3, :3].ravel())
        self.fly_to(np.concatenate([T[:3, 3], quat]))
        d.qvel[self._hand_dof : self._hand_dof + 3] = velocity
        # a free joint's spin is in the body's axes
        d.qvel[self._hand_dof + 3 : self._hand_dof + 6] = T[:3, :3].T @ spin

    def put_object(self, tick: int) -> None:
        """The object undisturbed at a tick; `mj_forward` is the caller's."""
        self.place_object(self.undisturbed(tick), np.array([*self.scene.velocity, 0, 0, 0]))
        self._present(tick)

    def _present(self, tick: int) -> None:
        """Move the presenter's hand to its undisturbed pose."""
        if self._presenter is not None:
            pose = self.undisturbed(tick)
            self.data.mocap_pos[self._presenter], self.data.mocap_quat[self._presenter] = (
                pose[:3],
                pose[3:],
            )

    def _resync(self, tick: int) -> list[float]:
        """Move the object to where it was seen, if that is far from where physics has it.

        Sightings are facts too. Returns how far apart both were, m, where it was seen.
        """
        moved = self.scene.seen[tick]
        if not np.isfinite(moved[0, 0]):
            return []
        d = self.data
        place = (moved[:3, :3] @ (self._start - self._shift) + moved[:3, 3]) + self._shift
        now = d.qpos[self.object : self.object + 7]
        R = moved[:3, :3]
        if R[2, 2] > 0.97 and abs(place[2] - now[2]) < 0.02:
            # it stands: a tilt of some degrees is noise, and would set it on its edge
            place[2] = now[2]
            yaw = np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
            turn = np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
        else:
            turn = np.empty(4)
            mujoco.mju_mat2Quat(turn, R.ravel())
        mujoco.mju_mulQuat(turn, turn.copy(), self.undisturbed(self.scene.reference)[3:])
        apart = float(np.linalg.norm(place[:2] - now[:2]))
        angle = 2 * np.arccos(min(1.0, abs(float(turn @ now[3:]))))
        if apart < RESYNC_M and (self.target.rolls or angle < RESYNC_RAD):
            return [apart]
        velocity = np.array([*self.scene.velocity, 0, 0, 0])
        self.place_object(np.array([*place, *turn]), velocity)
        mujoco.mj_forward(self.model, d)
        return [apart]

    def reset_to(self, tick: int) -> None:
        """Hand and fingers as recorded, the object undisturbed."""
        mujoco.mj_resetData(self.model, self.data)
        self._put_hand(self.hand_at(tick), *self.twist(tick))
        self.place_fingers(self.scene.hand.fingers[tick])
        self.put_object(tick)
        mujoco.mj_forward(self.model, self.data)

    def twist(self, tick: int) -> tuple[Array, Array]:
        """Velocity m/s and spin rad/s, support axes, of the recorded hand at a tick, over 50 ms."""
        T = self.scene.hand.T_support_hand
        a, b = max(tick - 2, 0), min(tick + 3, len(T) - 1)
        dt = max(b - a, 1) * CONTROL_S
        return (T[b][:3, 3] - T[a][:3, 3]) / dt, rotation_vector(T[b][:3, :3] @ T[a][:3, :3].T) / dt

    def restore(self, state: Array) -> None:
        self.set_state(state)
        self.fly_to(self.data.qpos[self._hand : self._hand + 7].copy())
        mujoco.mj_forward(self.model, self.data)

    def move_hand(self, twist: Array, fingers: Array) -> None:
        """As in `HandAndObject`; who still holds the object goes on as before."""
        if self.held_by_presenter:
            self.data.mocap_pos[self._presenter] += self.scene.velocity * CONTROL_S
        self._carry(twist, fingers)

    def _carry(self, twist: Array, fingers: Array) -> None:
        """One control period in which nothing pushes the hand."""
        d, a, b = self.data, self._hand, self._hand_dof
        d.ctrl[self.drives] = fingers
        T = self.T_base_hand()
        velocity, spin = twist[:3], twist[3:]
        self._put_hand(T, velocity, spin)
        moving = np.concatenate([velocity, T[:3, :3].T @ spin])
        pose = d.qpos[a : a + 7].copy()
        turn, turning = pose[3:], bool(spin.any())
        hand, speed = d.qpos[a : a + 7], d.qvel[b : b + 6]
        place, heading = d.mocap_pos[self._handle], d.mocap_quat[self._handle]
        step = velocity * TIMESTEP
        for _ in range(SUBSTEPS):
            # neither the object nor the fingers may push the recorded hand
            hand[:], speed[:], place[:], heading[:] = pose, moving, pose[:3], turn
            mujoco.mj_step(self.model, d)
            pose[:3] += step
            if turning:
                mujoco.mju_quatIntegrate(turn, moving[3:], TIMESTEP)
        self.check_stable()
        self.fly_to(pose)

    # what is asked

    def close(self, tick: int) -> CloseAndLift:
        """A close from the present state, with the fingers of a tick.

        The hand goes on as recorded after the real close, else at the velocity believed then.
        """
        hand = self.scene.hand
        return CloseAndLift(self, hand.fingers[tick], hand.velocity[tick], finish=hand.finish)

    def _close_at(self, state: Array, tick: int) -> bool:
        self.restore(state)
        return self.close(tick).finish()

    def approach(self) -> bool:
        """The recorded hand up to the close; whether the recorded failure happens here too.

        Sets `mismatch`, rad or m: how far the closing fingers are from where they were recorded,
        and `strayed`, m: how far the object, with the hand at it, is from where it was seen. Both
        are 0 where that is not known. `pressed`, m: how deep the closing hand went into the object,
        0 where it was in it before. `seen`: what a person at the video sees in this draw.
        """
        self.mismatch = self.strayed = self.pressed = 0.0
        scene, end = self.scene, self.scene.reference
        self._approached = None
        self.seen = Seen(scene.close is not None, False, 0.0, 0.0, (), None)
        if self._first is None:
            return True
        self._region = closing_region(self.model, self.gripper, scene.hand.fingers[end])
        filled = points_within(self.model, self.object_geoms)
        self._filled = np.concatenate([np.zeros((1, 3)), filled])
        made = self._approached = self._approach(self._first, end)
        self.seen = replace(
            self.seen,
            touched=made.contact is not None,
            displacement_m=made.off_m,
            displacement_deg=made.off_deg,
            reach=made.reach,
        )
        self._height = 0.0
        return scene.close is None or not self._closes_as_recorded(made, end)

    def _closes_as_recorded(self, made: Approach, end: int) -> bool:
        """Whether the recorded close holds the object; sets what `approach` says of the close."""
        self.restore(made.states[end])
        closing, fingers = self.close(end), list[Array]()
        reach, met_s = list(made.reach), None
        clear = self.penetration() < CLEAR_M
        while closing.success is None:
            if met_s is None and (self.fingers_touch() or closing.since_s >= self.gripper.close_s):
                met_s = min(closing.since_s, AFTER_CLOSE_S)
            closing.step()
            if (len(fingers) + 1) % (STEP // 2) == 0 and closing.since_s <= AFTER_CLOSE_S:
                reach.append(self._reach(closing.since_s))
            fingers.append(self.data.qpos[self.driven].copy())
            if clear:
                self.pressed = max(self.pressed, self.penetration())
        self.seen = replace(self.seen, reach=tuple(reach), met_s=met_s)
        self._height = closing.height
        recorded = self.scene.hand.closing
        n = min(len(fingers), len(recorded))
        if n:
            apart = np.abs(np.array(fingers[n // 2 : n]) - recorded[n // 2 : n])
            self.mismatch = float(np.sqrt(np.mean(np.minimum(apart, MISMATCH_MOST) ** 2)))
        return bool(closing.success)

    def _reach(self, since_s: float) -> tuple[float, float, float]:
        """How far the object now reaches into the region that the hand closes in, as in `Seen`."""
        pose = self.data.qpos[self.object : self.object + 7]
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, pose[3:])
        T = self.T_base_hand()
        points = (self._filled @ R.reshape(3, 3).T + pose[:3] - T[:3, 3]) @ T[:3, :3]
        depth = self._region.depth(points)
        return round(since_s, 3), float(depth.max()) / self._region.deepest, float(depth[0])

    def without(self, error: Array) -> bool:
        """Whether the approach displaced by -error, m (3,), lifts the object; after `approach`."""
        end = self.scene.reference
        if self._approached is None or self.scene.close is None:
            return False
        self._moved = -error
        works = self._close_at(
            self._approach(min(self._approached.states), end, resync=False).states[end], end
        )
        self._moved = np.zeros(3)
        return works

    def _goal(self) -> dict[str, bool]:
        """Of a hand that never closed, whether the grasp it was sent to would have held."""
        beliefs, end = self.scene.beliefs, self.scene.reference
        if isinstance(beliefs, Unknown) or beliefs.goal is None or self.scene.close is not None:
            return {}
        T = beliefs.goal @ invert(self.gripper.T_hand_palm)
        T[:3, 3] += self._shift
        self.reset_to(end)
        self._put_hand(T, self.scene.velocity, np.zeros(3))
        mujoco.mj_forward(self.model, self.data)
        inside = self.touch().penetration > Thresholds().overlap_m
        closing = CloseAndLift(self, self.scene.hand.fingers[end], self.scene.velocity)
        return {"goal": not inside and closing.finish()}

    def ask(self, thresholds: Thresholds, reproduced: bool, weight: float) -> Draw:
        """The curve of close times, the rule over it, and the approach without each error.

        Call after `approach`.
        """
        scene, end, made = self.scene, self.scene.reference, self._approached
        if made is None:
            facts = Facts(scene.close is not None, 0.0, 0.0, (), None, 0.0)
            return Draw(
                Verdict("imprecise_pose", "missed"),
                facts,
                scene.close is None,
                weight,
                self._goal(),
                None,
                None,
            )
        contact = made.contact
        tried = self._earlier(made.states, min(made.states), contact)
        if scene.close is not None:
            tried[end] = False  # what was recorded, whatever the twin says
        curve = [((k - end) * CONTROL_S, tried[k]) for k in sorted(tried)]
        if scene.close is not None:
            curve += self._later(made.states[end], end)
        facts = Facts(
            scene.close is not None,
            made.off_m,
            made.off_deg,
            tuple((round(a, 3), b) for a, b in curve),
            None if contact is None else round((contact - 1 - end) * CONTROL_S, 3), self._height,
        )  # fmt: skip
        while isinstance(answer := classify(facts, thresholds), Needs):
            if answer.fact == "free_pose":
                facts = replace(facts, free_pose=self._free_pose(end))
            else:
                k = end if scene.close is not None or contact is None else contact
                self.reset_to(k)
                overlap = self.touch().penetration
                facts = replace(facts, overlap_m=overlap, put_back=self.close(k).finish())
        restored: dict[str, bool] = {}
        if scene.close is None:
            restored = self._goal()
        elif answer.failure_class != "collision" and not isinstance(scene.beliefs, Unknown):
            parts = {
                k: e for k, e in scene.beliefs.errors.items() if np.linalg.norm(e) > ERROR_LEAST_M
            }
            restored = {k: self.without(e) for k, e in parts.items()}
            if len(parts) > 1 and not any(restored.values()):
                restored["all"] = self.without(np.sum(list(parts.values()), axis=0))
        t_contact = None if contact is None else (contact - end) * CONTROL_S
        return Draw(answer, facts, reproduced, weight, restored, t_contact, made.link)

    def _earlier(
        self, states: dict[int, Array], first: int, contact: int | None
    ) -> dict[int, bool]:
        """Close times up to the real one: tick -> success.

        Backwards until two in a row succeed; past a push, until two before it do.
        """
        scene, end = self.scene, self.scene.reference
        fine = end - round(AFTER_CLOSE_S / CONTROL_S) if scene.close is not None else end
        step = 2 * STEP if scene.close is not None else STEP
        wanted = [
            *range(end, max(fine, first) - 1, -STEP),
            *range(max(fine, first) - STEP, first - 1, -step),
        ]
        tried: dict[int, bool] = {}
        successes_in_a_row = 0
        for k in wanted:
            if k not in states or (k == end and scene.close is not None):
                continue
            tried[k] = self._worth(states[k]) and self._close_at(states[k], k)
            successes_in_a_row = successes_in_a_row + 1 if tried[k] else 0
            if successes_in_a_row == 2 and (contact is None or scene.close is None or k < contact):
                break
        for k in [
            k
            for k in sorted(tried)
            if tried[k] and not tried.get(k - STEP) and not tried.get(k + STEP)
        ]:
            for n in (k - STEP // 2, k + STEP // 2):
                if n in states and n not in tried:
                    tried[n] = self._close_at(states[n], n)
        return tried

    def _worth(self, state: Array) -> bool:
        """Whether the object is within the hand's reach in this state."""
        self.restore(state)
        T = self.T_base_hand()
        off = (
            self.data.qpos[self.object : self.object + 3]
            - T[:3, :3] @ self.gripper.centre
            - T[:3, 3]
        )
        return bool(np.linalg.norm(off) < NEAR_M + 0.5 * np.linalg.norm(self.target.extent()))

    def _approach(self, first: int, end: int, resync: bool = True) -> Approach:
        self.reset_to(first)
        states: dict[int, Array] = {}
        off = np.zeros((end - first + 1, 2))
        reach: list[tuple[float, float, float]] = []
        contact, link, reached = None, None, False
        strayed: list[float] = []
        for k in range(first, end + 1):
            reached = reached or self.distance(REACHED_M) < REACHED_M
            pose, free = self.data.qpos[self.object : self.object + 7], self.undisturbed(k)
            if not reached:
                pose[:2] = free[:2]
            elif resync and self._presenter is None:
                strayed += self._resync(k)
            if (end - k) % (STEP // 2) == 0:
                reach.append(self._reach((k - end) * CONTROL_S))
            off[k - first, 0] = np.linalg.norm(pose[:3] - free[:3])
            dot = abs(float(pose[3:7] @ free[3:7]))
            off[k - first, 1] = (
                0.0 if self.target.rolls else np.degrees(2 * np.arccos(min(1.0, dot)))
            )
            if contact is None and (off[k - first, 0] > 0.001 or off[k - first, 1] > 1.0):
                touch = self.touch()
                if touch.object and touch.solid is not None:
                    contact, link = k, self.gripper.link_of(touch.solid)
            if (end - k) % 3 == 0:
                states[k] = self.state()
            if k < end:
                self._present(k + 1)
                a, b = self.hand_at(k), self.hand_at(k + 1)
                turn = rotation_vector(b[:3, :3] @ a[:3, :3].T)
                step = np.concatenate([b[:3, 3] - a[:3, 3], turn])
                self._carry(step / CONTROL_S, self.scene.hand.fingers[k])
                self._put_hand(b, *self.twist(k + 1))
        if resync and strayed:
            self.strayed = float(np.mean(strayed))
        furthest_m, furthest_deg = off.max(axis=0)
        return Approach(states, float(furthest_m), float(furthest_deg), contact, link, tuple(reach))

    def _later(self, state: Array, end: int) -> list[tuple[float, bool]]:
        """The approach gone on with at constant twist and open fingers after the close."""
        self.restore(state)
        held = []
        for k in range(1, round(AFTER_CLOSE_S / CONTROL_S) + 1):
            self.move_hand(self.scene.hand.going, self.scene.hand.fingers[end])
            if k % STEP == 0:
                held.append((k * CONTROL_S, self.state()))
        out: list[tuple[float, bool]] = []
        for offset, state in held:
            out.append((offset, self._close_at(state, end)))
            if len(out) > 1 and out[-1][1] and out[-2][1]:
                break  # two in a row: nothing later is nearer
        return out

    def _free_pose(self, end: int) -> bool:
        """As put back at the close, from the nearest palm position that penetrates nothing."""
        directions = [
            np.array([a, b, c], dtype=float)
            for a in (0, 1, -1)
            for b in (0, 1, -1)
            for c in (0, 1, -1)
            if a or b or c
        ]
        for move in [
            np.zeros(3),
            *(step * w / np.linalg.norm(w) for step in FREE_STEPS_M for w in directions),
        ]:
            self.reset_to(end)
            T = self.hand_at(end)
            T[:3, 3] += T[:3, :3] @ move
            self._put_hand(T, *self.twist(end))
            mujoco.mj_forward(self.model, self.data)
            if self.touch().penetration <= 1e-4:
                return self.close(end).finish()
        return False
