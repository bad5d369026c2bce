"""Outcome and class of a simulated trial, proved by simulating it again.

The hand closes at other times, the object is put back, and the palm is moved (docs/simulation.md,
"Truth rule"). The decisions are `failure_rule.classify`'s; this module gathers the facts.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from dgeval.failure_rule import (
    HANDED_OVER,
    NEAR_M,
    Facts,
    FailureClass,
    Needs,
    Outcome,
    Seen,
    Thresholds,
    Verdict,
    classify,
    observed,
    outcome_without_close,
)
from dgeval.geometry import Array, increment, invert, rotation_angle, transform
from dgeval.simulation.trial import Run
from dgeval.simulation.world import Snapshot, World, matrix_of, twin_path
from dgeval.worlds.closing import AFTER_CLOSE_S, CONTROL_S, TRUTH_STEP
from dgeval.worlds.closing_region import closing_region, points_within
from dgeval.worlds.hand_and_object import CloseAndLift

COARSE = 3  # times the tick, between close times far from the real one; ours
# m and degrees by which the palm is moved to find a pose without overlap; ours
FREE_STEPS_M, FREE_STEPS_DEG = (0.0025, 0.005, 0.0075, 0.010), (5.0, 10.0)
ERROR_STEPS_M = (0.004, 0.008, 0.012, 0.018, 0.026)  # m, palm offsets tried; ours


@dataclass(frozen=True)
class Truth:
    """What happened and why.

    curve: (offset s, success) of every close time tried, the real one at 0. pose_error_m: smallest
    palm offset at the close that would have worked; None if none worked or none was tried. near:
    thresholds whose shift by 20 % changes the class. twin: rows (pose 7 in MuJoCo's order, velocity
    6) per control period. observed_class, seen: of a failure, what a person at the video sees.
    """

    outcome: Outcome
    failure_class: FailureClass | None
    sub_cause: str | None
    shift_s: float | None
    curve: tuple[tuple[float, bool], ...]
    facts: Facts | None
    pose_error_m: float | None
    foreign_contact: bool
    t_first_contact: float | None
    near: tuple[str, ...]
    twin: Array = field(repr=False)
    observed_class: FailureClass | None = None
    seen: Seen | None = None


class Prover:
    """Simulates again from a run's snapshots, in the run's world.

    Every question starts from a restored state.
    """

    def __init__(self, run: Run, world: World) -> None:
        self.run, self.world = run, world
        seconds = len(run.ticks) * CONTROL_S + AFTER_CLOSE_S
        self.twin = twin_path(
            world.target,
            run.plan.speed,
            run.plan.x,
            run.plan.y,
            run.plan.yaw,
            seconds,
            world.setting,
        )
        self.end = run.close if run.close is not None else len(run.ticks) - 1

    def closes(self, snapshot: Snapshot, velocity: Array) -> bool:
        """Whether a close from a state, which follows at a velocity (3,) m/s, holds the object."""
        self.world.restore(snapshot)
        return self._close(velocity)

    def _close(self, velocity: Array) -> bool:
        return CloseAndLift(self.world, self.run.preshape, velocity).finish()

    def curve(self) -> tuple[tuple[float, bool], ...]:
        """Success over close time: from the first distance under 8 cm to 0.6 s after the real
        close.

        Close times are 30 ms apart within 0.6 s of the real close. Earlier ones, and all of a
        success, are 90 ms apart; where one of these succeeds alone, its neighbours at 30 ms are
        tried too.
        """
        near = self._near()
        if not near:
            return ()
        coarse = COARSE * TRUTH_STEP
        succeeded = self.run.finish is not None and self.run.finish.success
        fine_from = self.end - (0 if succeeded else round(AFTER_CLOSE_S / CONTROL_S))
        first = self.end - (self.end - near[0]) // coarse * coarse
        wanted = [
            k
            for k in range(first, self.end + 1, TRUTH_STEP)
            if k >= fine_from or (k - first) % coarse == 0
        ]
        tried = {k: self._closes_at(k) for k in wanted}
        for k in [k for k in wanted if tried[k] and k < fine_from]:
            if not tried.get(k - coarse) and not tried.get(k + coarse):
                tried.update(
                    {
                        n: self._closes_at(n)
                        for n in (k - TRUTH_STEP, k + TRUTH_STEP)
                        if n not in tried
                    }
                )
        out = [((k - self.end) * CONTROL_S, tried[k]) for k in sorted(tried)]
        if self.run.close is not None:
            tick = self.run.ticks[self.end]
            for offset, snapshot in self._held_open(
                tick.snapshot, tick.twist, coarse if succeeded else TRUTH_STEP
            ):
                out.append((offset, self.closes(snapshot, tick.velocity)))
        return tuple((round(offset, 3), success) for offset, success in out)

    def _near(self) -> list[int]:
        """The periods up to the close in which the hand is known to be near the object."""
        ticks = self.run.ticks
        return [
            k for k in range(self.end + 1) if (d := ticks[k].distance) is not None and d < NEAR_M
        ]

    def seen(self, metres: Array, degrees: Array) -> Seen:
        """What a person at the video sees.

        metres, degrees: off the undisturbed path, by control period up to the close.
        """
        w, run, near = self.world, self.run, self._near()
        region = closing_region(w.model, w.gripper, run.preshape)
        filled = np.concatenate([np.zeros((1, 3)), points_within(w.model, w.object_geoms)])
        last = self.end
        if run.close is not None:
            last = min(run.close + round(AFTER_CLOSE_S / CONTROL_S), len(run.ticks) - 1)
        reach, met_s = [], None
        for k in range(near[0] if near else self.end, last + 1):
            w.restore(run.ticks[k].snapshot)
            depth = region.depth(transform(invert(w.T_base_hand()) @ w.T_base_object(), filled))
            since_s = round((k - self.end) * CONTROL_S, 3)
            share = float(depth.max()) / region.deepest
            reach.append((since_s, round(share, 4), round(float(depth[0]), 5)))
            if run.close is None or k < run.close or met_s is not None:
                continue
            if w.fingers_touch() or since_s >= w.gripper.close_s:
                met_s = since_s
        touched = any(tick.contact for tick in run.ticks[: self.end + 1])
        return Seen(
            run.close is not None,
            touched,
            float(metres.max()),
            float(degrees.max()),
            tuple(reach),
            met_s,
        )

    def nearest(self) -> float:
        """Least distance of hand and object, m, of those that the run kept; NEAR_M for more."""
        kept = [t.distance for t in self.run.ticks if t.distance is not None]
        return min(kept, default=NEAR_M)

    def _closes_at(self, k: int) -> bool:
        tick = self.run.ticks[k]
        return tick.preshape is not None and self.closes(tick.snapshot, tick.velocity)

    def _held_open(self, start: Snapshot, twist: Array, step: int) -> list[tuple[float, Snapshot]]:
        """(offset s, state) after the close, with the approach continued at constant twist.

        The fingers stay open. twist (6,) m/s, rad/s.
        """
        w = self.world
        w.restore(start)
        out = []
        for k in range(1, round(AFTER_CLOSE_S / CONTROL_S) + 1):
            w.move_hand(twist, self.run.preshape)
            if k % step == 0:
                out.append((k * CONTROL_S, w.save()))
        return out

    def displacement(self) -> tuple[Array, Array]:
        """Distance m and angle degrees off the undisturbed path in each period up to the close."""
        metres, degrees = np.zeros(self.end + 1), np.zeros(self.end + 1)
        for k in range(self.end + 1):
            T, T_twin = self._object(k), matrix_of(self.twin[k, :7])
            metres[k] = np.linalg.norm(T[:3, 3] - T_twin[:3, 3])
            degrees[k] = np.degrees(rotation_angle(T[:3, :3].T @ T_twin[:3, :3]))
        return metres, degrees

    def _object(self, k: int) -> Array:
        # mjSTATE_INTEGRATION begins with time and then qpos
        at = 1 + self.world.object
        return matrix_of(self.run.ticks[k].snapshot.state[at : at + 7])

    def put_back(self, k: int) -> tuple[float, bool]:
        """Close with the object on its undisturbed path in period k.

        Returns the overlap of hand and object, m, and whether the close then works.
        """
        w = self.world
        w.restore(self.run.ticks[k].snapshot)
        w.put_object(self.twin[k, :7], self.twin[k, 7:])
        overlap = w.penetration()
        return overlap, self._close(self.run.ticks[k].velocity)

    def free_pose(self) -> bool:
        """As `put_back` at the close, with the palm moved to where nothing overlaps.

        It is moved by at most 10 mm or 10 degrees.
        """
        w, tick = self.world, self.run.ticks[self.end]
        moves = [np.zeros(6)]
        for step in FREE_STEPS_M:
            moves += [np.concatenate([step * d, np.zeros(3)]) for d in _directions()]
        for angle in FREE_STEPS_DEG:
            moves += [
                np.concatenate([np.zeros(3), np.radians(angle) * s * e])
                for e in np.eye(3)
                for s in (1, -1)
            ]
        for move in moves:
            w.restore(tick.snapshot)
            if w.put_arm(w.T_base_palm() @ increment(move)) > 1e-3:
                continue
            w.put_object(self.twin[self.end, :7], self.twin[self.end, 7:])
            if w.penetration() <= 1e-4:
                return self._close(tick.velocity)
        return False

    def pose_error(self) -> float | None:
        """Smallest palm offset at the executed close, m, from which it would have worked.

        A few directions are tried; None if none works.
        """
        w, tick = self.world, self.run.ticks[self.end]
        for step in ERROR_STEPS_M:
            for d in _directions()[:6]:
                w.restore(tick.snapshot)
                if (
                    w.put_arm(w.T_base_palm() @ increment(np.concatenate([step * d, np.zeros(3)])))
                    > 1e-3
                ):
                    continue
                if w.penetration() > 0.002:
                    continue
                if self._close(tick.velocity):
                    return step
        return None


def _directions() -> list[Array]:
    """Six axes, then eight diagonals."""
    axes = [s * e for e in np.eye(3) for s in (1.0, -1.0)]
    return axes + [
        np.array([a, b, c]) / np.sqrt(3) for a in (1, -1) for b in (1, -1) for c in (1, -1)
    ]


def prove(
    run: Run, world: World, thresholds: Thresholds | None = None, labels_only: bool = False
) -> Truth:
    """Outcome, class and evidence of a run.

    labels_only: neither other closes of a success, nor which thresholds decide by less than 20 %.
    """
    if thresholds is None:
        thresholds = Thresholds() if world.presenter is None else HANDED_OVER
    prover = Prover(run, world)
    contacts = [k for k in range(prover.end + 1) if run.ticks[k].contact]
    t_contact = contacts[0] * CONTROL_S if contacts else None
    foreign = any(t.foreign for t in run.ticks[: prover.end + 1])
    succeeded = run.finish is not None and run.finish.success
    curve = () if succeeded and labels_only else prover.curve()
    if succeeded:
        return Truth(
            "success", None, None, None, curve, None, None, foreign, t_contact, (), prover.twin
        )
    if run.close is None and outcome_without_close(1.0, prover.nearest(), True)[0] == "no_grasp":
        return Truth(
            "no_grasp", None, None, None, curve, None, None, foreign, t_contact, (), prover.twin
        )
    metres, degrees = prover.displacement()
    displaced = [k for k in range(prover.end + 1) if metres[k] > 0.001 or degrees[k] > 1.0]
    facts = Facts(
        closed=run.close is not None,
        displacement_m=float(metres.max()),
        displacement_deg=float(degrees.max()),
        curve=tuple(c for c in curve if c[0] != 0.0 or run.close is None),
        contact_s=(displaced[0] - 1 - prover.end) * CONTROL_S if displaced and contacts else None,
        height_m=run.finish.height if run.finish is not None else 0.0,
    )
    seen = prover.seen(metres, degrees)
    verdict, facts = _decide(prover, facts, thresholds, contacts)
    changed = []
    if not labels_only:
        for name in ("moved_m", "moved_deg", "overlap_m", "unstable_m"):
            for factor in (0.8, 1.2):
                other, facts = _decide(prover, facts, thresholds.scaled(name, factor), contacts)
                if other.failure_class != verdict.failure_class:
                    changed.append(f"{name} x {factor}")
    error = (
        prover.pose_error()
        if verdict.failure_class == "imprecise_pose" and run.close is not None
        else None
    )
    return Truth(
        "failure",
        verdict.failure_class,
        verdict.sub_cause,
        verdict.shift_s,
        curve,
        facts,
        error,
        foreign,
        t_contact,
        tuple(changed),
        prover.twin,
        observed(seen, thresholds),
        seen,
    )


def _decide(
    prover: Prover, facts: Facts, thresholds: Thresholds, contacts: list[int]
) -> tuple[Verdict, Facts]:
    """Apply the rule, gather the fact that it needs, and apply it again."""
    while isinstance(answer := classify(facts, thresholds), Needs):
        if answer.fact == "free_pose":
            facts = replace(facts, free_pose=prover.free_pose())
        else:
            k = prover.end if facts.closed or not contacts else contacts[0]
            overlap, works = prover.put_back(k)
            facts = replace(facts, overlap_m=overlap, put_back=works)
    return answer, facts
