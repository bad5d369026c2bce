"""One VFAS trial in closed loop: the stages of replay, on images drawn at the planner's rate."""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib import resources

import numpy as np

from dgeval.config import Config
from dgeval.determinism import generator
from dgeval.failure_rule import NEAR_M
from dgeval.geometry import Array, increment, matrix_from_pose, rotation_angle, transform
from dgeval.planning.schedule import Delayed
from dgeval.planning.vfas.contacts import by_room, contact_graspnet_of, seed_from_contacts
from dgeval.planning.vfas.gripper import trained_gripper
from dgeval.planning.vfas.loop import VfasLoop, proportional_twist, scene_cloud
from dgeval.planning.vfas.selection import Selected
from dgeval.robots.description import Description
from dgeval.robots.loading import load_description
from dgeval.robots.urdf import robot_urdf
from dgeval.simulation.jaw_grasps import search
from dgeval.simulation.render import Renderer
from dgeval.simulation.scenario import Plan, Scenario
from dgeval.simulation.seeing import Images, camera_frame
from dgeval.simulation.trial import FrameBelief, Run, Tick, arm_in, frame_ticks, limited
from dgeval.simulation.vfas_plan import waiting_pose
from dgeval.simulation.world import FINISH_S, Finish, World
from dgeval.worlds.closing import CONTROL_S, TRUTH_STEP
from dgeval.worlds.hand_and_object import CloseAndLift
from dgeval.worlds.objects import at

# The last advance ends this near to the grasp, m + 0.1 m per rad, or after this time, s; ours.
ARRIVED_M, ADVANCE_S = 0.003, 3.0
REACHED = 1e-3  # m + 0.1 m per rad, most error of inverse kinematics for a pose in reach; ours
NEAR_HOME = np.array([0.0, -0.37, 0.0, 2.32, 0.0, -1.19, 0.0])  # rad, start of the search; ours
WAYPOINTS = 6  # of the advance, checked for obstacles; ours


@dataclass(frozen=True)
class Seed:
    """T_base_seed (None in a handover: ahead of the gripper) and the arm's joints (7,) rad before
    it.
    """

    T_base_seed: Array | None
    q_arm: Array


def known_jaw_grasps(world: World) -> list[Array]:
    """T_object_grasp (4, 4) shipped for the eight objects; a search of some seconds for others."""
    shipped = json.loads(
        (resources.files("dgeval.simulation") / "known_jaw_grasps.json").read_text(encoding="utf-8")
    )
    if world.target.name in shipped:
        return [matrix_from_pose(np.array(g)) for g in shipped[world.target.name]]
    return search(world.target, 12, 5)


def proposed_seed(
    plan: Plan, config: Config, world: World, renderer: Renderer, hand: Description
) -> Seed | None:
    """Contact-GraspNet's seed on the target, seen from above the table; None if there is none.

    The target's true mask stands in for Mask R-CNN's. A pre-grasp pose at which the hand touches
    something is none that a motion planner would go to.
    """
    assert config.vfas.contact_graspnet is not None
    world.start(NEAR_HOME, world.gripper.open, plan.x, plan.y, plan.yaw, 0.0)
    frame, _, _ = camera_frame(0, 0, world, renderer, hand, 95)
    assert frame.T_base_camera is not None
    v, u = np.nonzero(renderer.mask() & (frame.depth > 0))
    points = frame.camera.backproject(u, v, frame.depth[v, u].astype(np.float64))
    target = transform(frame.T_base_camera, points)
    arm, back = arm_in(world), at(0, 0, -config.vfas.pregrasp)

    def reach(T: Array) -> float | None:
        q = arm.solve(T, NEAR_HOME)
        return None if q is None else arm.room(q)

    def rank(poses: Array) -> Array:
        marks = by_room(reach, config.vfas.pregrasp, poses)
        for k in np.flatnonzero(np.isfinite(marks)):
            world.q_set = NEAR_HOME
            world.put_arm(poses[k] @ back)
            touch = world.touch()
            if touch.object or touch.other:
                marks[k] = -np.inf
        return marks

    cloud = scene_cloud(frame, frame.T_base_camera, config.self_filter.margin)
    network = contact_graspnet_of(config.vfas.contact_graspnet)
    opening = trained_gripper().opening
    T = seed_from_contacts(cloud, target, network, rank, opening, config.seed)
    q = None if T is None else arm.solve(T @ back, NEAR_HOME)
    return None if q is None else Seed(T, q)


def seed_for(plan: Plan, scenario: Scenario, world: World) -> Seed | None:
    """A known grasp in reach with a free approach, displaced by the proposing planner's error.

    None if there is none.
    """
    rng = generator(plan.seed, f"seed/{scenario.name}", plan.index)
    if world.presenter is not None:
        q, residual = world.kinematics.solve(waiting_pose(), NEAR_HOME)
        return Seed(None, q) if residual < REACHED else None
    world.start(NEAR_HOME, world.gripper.open, plan.x, plan.y, plan.yaw, 0.0)
    T_base_object = world.T_base_object()
    known = known_jaw_grasps(world)
    half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])  # the same grasp, the camera on the other side
    back = at(0, 0, -scenario.pipeline.vfas.pregrasp)
    for k in rng.permutation(2 * len(known)):
        T = T_base_object @ known[k // 2] @ (half_turn if k % 2 else np.eye(4))
        q, residual = world.kinematics.solve(T @ back, NEAR_HOME)
        if residual > REACHED:
            continue
        world.q_set = q
        waypoints = (
            T @ at(0, 0, -share * scenario.pipeline.vfas.pregrasp)
            for share in np.linspace(1.0, 0.0, WAYPOINTS)
        )
        if all(
            world.put_arm(waypoint) < REACHED and not (world.touch().object or world.touch().other)
            for waypoint in waypoints
        ):
            error = scenario.seed_error
            xi = np.concatenate(
                [rng.normal(0, error.position, 3), rng.normal(0, np.radians(error.angle), 3)]
            )
            T_seed = T @ increment(xi)
            q_seed, residual = world.kinematics.solve(T_seed @ back, q)
            if residual < REACHED:
                return Seed(T_seed, q_seed)
    return None


def run_vfas(
    plan: Plan, scenario: Scenario, world: World, renderer: Renderer
) -> tuple[Run, dict[int, Images]]:
    """Simulate one trial to 1.6 s after the lift, or until it gives up.

    Also returns the images, by frame.
    """
    run = Run(plan, preshape=world.gripper.open.copy())
    kept: dict[int, Images] = {}
    config = scenario.pipeline.model_copy(update={"seed": plan.seed * 100_003 + plan.index})
    urdf = robot_urdf(world.gripper.T_hand_camera, world.gripper)
    hand_model = load_description(
        urdf, "the simulated robot", (), config.self_filter.radius_default
    )
    if world.presenter is None and config.vfas.contact_graspnet is not None:
        seed = proposed_seed(plan, config, world, renderer, hand_model)
    else:
        seed = seed_for(plan, scenario, world)
    world.start(
        NEAR_HOME if seed is None else seed.q_arm, world.gripper.open, plan.x, plan.y, plan.yaw, 0.0
    )
    if seed is None:
        run.ticks.append(
            Tick(
                world.save(),
                None,
                None,
                None,
                np.zeros(3),
                np.zeros(6),
                None,
                False,
                False,
                False,
                None,
            )
        )
        return run, kept
    run.T_base_seed = seed.T_base_seed
    loop = VfasLoop(config, seed.T_base_seed)
    arriving: Delayed[Selected] = Delayed(config.schedule.perception_latency_s)
    frames = set(frame_ticks(scenario.camera.rate, scenario.max_seconds + FINISH_S + 1))
    turn = world.setting.turn
    stopped = 0.0 if turn is None else turn.end
    closing: CloseAndLift | None = None
    advancing: int | None = None
    n_frame = tick = 0
    while True:
        t_ns = round(tick * CONTROL_S * 1e9)
        if tick in frames:
            frame, jpeg, depth = camera_frame(
                n_frame, t_ns, world, renderer, hand_model, scenario.camera.jpeg_quality
            )
            kept[n_frame] = Images(jpeg, depth, None)
            if advancing is None:
                assert frame.T_base_camera is not None
                selected = loop.step(frame, frame.T_base_camera, tick * CONTROL_S >= stopped)
                if selected is not None:
                    arriving.step(t_ns, selected)
            run.frames.append(FrameBelief(n_frame, tick, True, None, loop.velocity))
            n_frame += 1
        newest = arriving.at(t_ns)
        snapshot = world.save()
        touch = world.touch()
        still = np.zeros(3)
        if closing is not None:
            run.ticks.append(
                Tick(
                    snapshot,
                    None,
                    None,
                    None,
                    still,
                    np.zeros(6),
                    None,
                    True,
                    touch.object,
                    touch.other,
                    None,
                )
            )
            closing.step()
            tick += 1
            if closing.since_s >= FINISH_S:
                assert closing.success is not None
                run.finish = Finish(closing.success, closing.height)
                return run, kept
            continue
        hand = world.T_base_palm()
        twist, score, T_grasp, execute = np.zeros(6), None, None, False
        if newest is not None:
            chosen = newest[1]
            T_grasp, execute = chosen.T_base_seed, chosen.execute
            score = None if np.isnan(chosen.score) else chosen.score
            twist = limited(proportional_twist(hand, chosen.T_base_goal, config.vfas.gain))
            if execute and advancing is None:
                advancing = tick
        distance = world.hand_distance(NEAR_M) if tick % TRUTH_STEP == 0 else None
        run.ticks.append(
            Tick(
                snapshot,
                None,
                T_grasp,
                run.preshape,
                still,
                twist,
                None,
                execute,
                touch.object,
                touch.other,
                distance,
                score,
            )
        )
        if advancing is not None and T_grasp is not None:
            left = float(np.linalg.norm(hand[:3, 3] - T_grasp[:3, 3])) + 0.1 * rotation_angle(
                hand[:3, :3].T @ T_grasp[:3, :3]
            )
            if left < ARRIVED_M or (tick - advancing) * CONTROL_S > ADVANCE_S:
                run.close = tick
                closing = CloseAndLift(world, run.preshape, still)
                closing.step()
                tick += 1
                continue
        world.move_hand(twist, world.gripper.open)
        tick += 1
        if tick * CONTROL_S > scenario.max_seconds or world.data.qpos[world.object + 2] < -0.1:
            return run, kept
