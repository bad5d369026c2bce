"""One trial in closed loop, from the start until the arm has lifted.

Estimation, selection, servo, execution and schedule are the stages that replay runs, at 100 Hz on
the newest usable frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from dgeval.determinism import generator
from dgeval.failure_rule import NEAR_M
from dgeval.geometry import Array, increment
from dgeval.perception.estimation import VelocityFilter
from dgeval.planning.carried import Belief
from dgeval.planning.execution import execute
from dgeval.planning.proposals import Chooser, Proposals
from dgeval.planning.reachability import Arm, arm_of
from dgeval.planning.schedule import Delayed
from dgeval.planning.servo import Servo
from dgeval.robots.loading import load_description
from dgeval.robots.urdf import robot_urdf
from dgeval.simulation.perception import Perceiver
from dgeval.simulation.proposals import GraspSource
from dgeval.simulation.scenario import Plan, Scenario
from dgeval.simulation.world import FINISH_S, Finish, Snapshot, World, home
from dgeval.worlds.closing import CONTROL_S, TRUTH_STEP
from dgeval.worlds.hand_and_object import CloseAndLift

MAX_TWIST = np.array([0.7, 0.7, 0.7, 2.0, 2.0, 2.0])  # m/s, rad/s, of the palm; ours
REACH = 0.62  # m along the belt; beyond it the arm gives up; ours


@dataclass(frozen=True)
class Tick:
    """One control period: the state before it, and what the robot believed and commanded in it.

    preshape (15,) rad: of the chosen grasp. velocity (3,) m/s: of the object. twist (6,) m/s,
    rad/s: of the palm. contact, foreign: the hand touches the object, or anything else. distance:
    hand to object, m, up to NEAR_M, in every third period of the approach. score: of the hand where
    it is; grasp_score: of the chosen grasp; None without one.
    """

    snapshot: Snapshot
    T_base_object: Array | None
    T_base_grasp: Array | None
    preshape: Array | None
    velocity: Array
    twist: Array
    score: float | None
    execute: bool
    contact: bool
    foreign: bool
    distance: float | None
    grasp_score: float | None = None


@dataclass(frozen=True)
class FrameBelief:
    """A camera frame: its number (dropped ones count), control period, and acceptance.

    accepted: whether its registration was. T_base_object: believed then, predicted where not
    accepted. velocity: the filter's estimate, m/s. proposals: grasps drawn for it, if any.
    """

    index: int
    tick: int
    accepted: bool
    T_base_object: Array | None
    velocity: Array | None
    proposals: Proposals | None = None


@dataclass
class Run:
    """A finished trial. `close` is the period of the close command, None if it never came."""

    plan: Plan
    preshape: Array
    ticks: list[Tick] = field(default_factory=list)
    frames: list[FrameBelief] = field(default_factory=list)
    dropped: list[int] = field(default_factory=list)
    close: int | None = None
    finish: Finish | None = None
    T_base_seed: Array | None = None


def frame_ticks(rate: float, seconds: float) -> list[int]:
    """The control periods nearest to the camera's images. rate in Hz."""
    return [round(k / rate / CONTROL_S) for k in range(int(seconds * rate))]


def run_trial(
    plan: Plan, scenario: Scenario, world: World, grasps: GraspSource, perceiver: Perceiver
) -> Run:
    """Simulate one trial from start to 1.6 s after the lift, or until it gives up."""
    hand = world.gripper
    run = Run(plan, hand.open.copy())
    config = scenario.pipeline
    faults = plan.faults
    world.start(home(world, plan.home_y), hand.open, plan.x, plan.y, plan.yaw, plan.speed)
    velocity_filter = VelocityFilter(config.estimation)
    servo = Servo(config.servo, hand)
    arriving: Delayed[tuple[Belief, Proposals | None]] = Delayed(
        config.schedule.perception_latency_s + faults.latency
    )
    frames = set(frame_ticks(scenario.camera.rate, scenario.max_seconds + FINISH_S + 1))
    believed: Belief | None = None
    due: int | None = None
    fault_ns = round(faults.latency * 1e9)
    arm = arm_in(world)
    chooser = Chooser(config.selection, lambda pose: arm.solve(pose, world.q_set) is not None)
    kept: tuple[Array, Array] | None = None
    fingers = hand.open.copy()
    closing: CloseAndLift | None = None
    n_frame = 0
    tick = 0
    while True:
        t_ns = round(tick * CONTROL_S * 1e9)
        if tick in frames:
            if generator(plan.seed, f"drop/{plan.index}", n_frame).random() < scenario.camera.drop:
                run.dropped.append(tick)
            else:
                perceived = perceiver.perceive(n_frame, t_ns, world)
                T_perceived = perceived.T_base_object
                estimate = velocity_filter.step(
                    t_ns, None if T_perceived is None else T_perceived[:3, 3]
                )
                velocity = (
                    None if estimate is None else estimate.velocity + np.array(faults.velocity_bias)
                )
                seen, T = T_perceived is not None, T_perceived
                if T is None and believed is not None and velocity is not None:
                    T = replace(believed, velocity=velocity).at(t_ns)
                proposals = None
                if T is not None and velocity is not None:
                    believed = Belief(t_ns, T, velocity, seen)
                    proposals = grasps.propose(
                        n_frame, perceived, T, world.T_base_hand() @ hand.T_hand_camera, kept
                    )
                    arriving.step(t_ns, (believed, proposals))
                run.frames.append(FrameBelief(n_frame, tick, seen, T, velocity, proposals))
            n_frame += 1
        newest = arriving.at(t_ns)
        snapshot = world.save()
        touch = world.touch()
        if closing is not None:
            tick_record = Tick(
                snapshot,
                None,
                None,
                None,
                closing.velocity,
                np.zeros(6),
                None,
                True,
                touch.object,
                touch.other,
                None,
            )
            run.ticks.append(tick_record)
            closing.step()
            tick += 1
            if closing.since_s >= FINISH_S:
                assert closing.success is not None
                run.finish = Finish(closing.success, closing.height)
                return run
            continue
        palm = world.T_base_palm()
        twist, score, fire, T_object, T_grasp, preshape = np.zeros(6), None, False, None, None, None
        velocity_now, grasp_score = np.zeros(3), None
        if newest is not None:
            usable, proposals = newest[1]
            velocity_now = usable.velocity
            # the controller makes up for its stated latency; it doesn't know of a fault
            T_object = usable.at(t_ns - fault_ns)
            best = (
                None if proposals is None else chooser.best(proposals, T_object, palm, usable.seen)
            )
            if proposals is not None and best is not None:
                chosen = best[0]
                grasp_score = float(proposals.scores[chosen])
                T_grasp = (
                    T_object
                    @ proposals.T_object_palm[chosen]
                    @ increment(np.array(faults.grasp_offset))
                )
                command = servo.step(
                    t_ns,
                    palm,
                    T_grasp,
                    world.T_base_hand() @ hand.T_hand_camera,
                    T_object[:3, 3],
                    velocity_now,
                )
                demanded = command.twist.copy()
                demanded[2] += faults.descent * config.servo.c_p_v * (T_grasp[2, 3] - palm[2, 3])
                twist = limited(demanded)
                early = max(0.0, -faults.close_shift)
                nearer = _ahead(palm, T_grasp, early * config.servo.c_p_v)
                score = (
                    grasps.score(proposals, chosen, T_object, nearer, T_grasp)
                    + faults.evaluator_bias
                )
                score = float(np.clip(score, 0.0, 1.0))
                fire = bool(execute(score, grasps.c_e, config.execution, nearer, T_grasp))
                run.preshape = preshape = proposals.preshapes[chosen]
                kept = proposals.T_object_palm[chosen], preshape
        distance = world.hand_distance(NEAR_M) if tick % TRUTH_STEP == 0 else None
        run.ticks.append(
            Tick(
                snapshot,
                T_object,
                T_grasp,
                preshape,
                velocity_now,
                twist,
                score,
                fire,
                touch.object,
                touch.other,
                distance,
                grasp_score,
            )
        )
        if fire and due is None:
            due = tick + round((max(0.0, faults.close_shift) + plan.close_jitter) / CONTROL_S)
        if due is not None and tick >= due:
            run.close = tick
            closing = CloseAndLift(world, run.preshape, velocity_now)
            closing.step()
            tick += 1
            continue
        fingers += np.clip(
            run.preshape - fingers, -hand.drive_speed * CONTROL_S, hand.drive_speed * CONTROL_S
        )
        world.move_hand(twist, fingers)
        tick += 1
        away = plan.speed and abs(world.data.qpos[world.object + 1]) > REACH
        if (
            away
            or tick * CONTROL_S > scenario.max_seconds
            or world.data.qpos[world.object + 2] < -0.1
        ):
            return run


def limited(twist: Array) -> Array:
    """A twist (6,) scaled to what the arm may do, its direction kept."""
    return np.asarray(twist * min(1.0, float((MAX_TWIST / (np.abs(twist) + 1e-12)).min())))


def arm_in(world: World) -> Arm:
    """The arm as its description has it, with which replay asks for its reach."""
    hand = world.gripper
    description = load_description(robot_urdf(hand.T_hand_camera, hand), "the arm", (), 0.01)
    arm = arm_of(description, "base_link", hand.palm_frame or "palm_link")
    assert isinstance(arm, Arm)
    return arm


def _ahead(palm: Array, T_grasp: Array, share: float) -> Array:
    """The palm pose after the servo has run for `share` more time constants."""
    T = palm.copy()
    T[:3, 3] = T_grasp[:3, 3] + (palm[:3, 3] - T_grasp[:3, 3]) * np.exp(-share)
    return T
