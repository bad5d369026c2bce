"""What a recording and its second pass would hold of a simulated run, without drawing an image.

Log and robot states are those that `dgeval simulate` would have recorded. Sightings of the object
are its true poses through the calibrated camera, with errors as `benchmarks.truth` measures them on
rendered recordings; path, push, contact and gap are then found by dgeval's own second pass.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from dgeval.config import Config
from dgeval.determinism import generator
from dgeval.failure_rule import Unknown
from dgeval.geometry import Array, increment, invert, pose_from_matrix, transform
from dgeval.hindsight.second_pass import Hindsight, hindsight_from
from dgeval.hindsight.smoothing import Sighting
from dgeval.hindsight.surface import CausalFrame
from dgeval.perception.plane import Plane
from dgeval.perception.types import Model
from dgeval.recording.containers.container import Opened, RawMessage
from dgeval.recording.contract import ROBOT_DESCRIPTION
from dgeval.recording.messages import JointSample, StampedPose
from dgeval.recording.robot import robot_states
from dgeval.recording.roles import Roles
from dgeval.recording.scan import ImageHead, Scan
from dgeval.robots.diana7 import JOINT_NAMES as ARM_JOINTS
from dgeval.robots.urdf import CAMERA_FRAME, robot_urdf
from dgeval.simulation.record import EFFORT_NOISE, JOINT_NOISE, START_NS
from dgeval.simulation.trial import Run
from dgeval.simulation.world import World, matrix_of, twin_path
from dgeval.verdict.evidence import Scene, scene_of
from dgeval.verdict.log import Recorded, TrialLog
from dgeval.worlds.closing import CONTROL_S
from dgeval.worlds.objects import surface_points

PERIOD_NS = round(CONTROL_S * 1e9)
COLOUR, JOINTS = "/camera/color/image_raw", "/joint_states"
# Standard deviations of modelled hindsight, as `benchmarks.truth` measures them on rendered
# recordings: position m, turn degrees, sighting m, cloud m.
PLACE_M, TURN_DEG, SIGHTING_M, CLOUD_M = 0.002, 2.0, 0.001, 0.0012
# Registration wanders as views change: standard deviation m, and the time, s, in which it forgets;
# ours.
WANDER_M, WANDER_S = 0.001, 1.0
HIDDEN_M = 0.02  # m, lower end of an object that is handed over: it is in the person's hand; ours
UNSEEN_M = 0.006  # m over the support, below which nothing is told from it; ours
POINTS, OWN_POINTS = 1500, 500  # of hindsight's cloud and of the robot's own; ours


@dataclass
class Nothing:
    """A container without messages."""

    kind: str = "memory"
    checksums: str = "none"
    path: Path = Path("modelled")
    topics: dict[str, Any] = field(default_factory=dict)
    damage: list[Any] = field(default_factory=list)

    def messages(self, _: frozenset[str]) -> Iterator[RawMessage]:
        return iter(())


def at_ns(tick: int) -> int:
    """Time stamp of a control period."""
    return START_NS + tick * PERIOD_NS


def log_of_run(
    run: Run, world: World, config: Config, changed: Callable[[str], str] = str
) -> TrialLog:
    """What a verdict would read of a recording of this run.

    changed: what becomes of the robot's description.
    """
    samples, T_base_cameras = _states(run, world)
    scan = Scan(Opened(Nothing(), Path("modelled")))
    text = robot_urdf(world.gripper.T_hand_camera, world.gripper)
    scan.descriptions[ROBOT_DESCRIPTION] = changed(text)
    scan.images[COLOUR] = ImageHead("rgb8", 640, 480, CAMERA_FRAME, "rgb8")
    scan.joints[JOINTS] = samples
    robot = robot_states(
        scan, Roles(COLOUR, None, None, JOINTS, None, None, joints=(JOINTS,)), config
    )
    grasps, targets, velocities = [], [], []
    for f in run.frames:
        t_ns, grasp = at_ns(f.tick), run.ticks[f.tick].T_base_grasp
        if grasp is not None:
            grasps.append(StampedPose(t_ns, "base_link", "", pose_from_matrix(grasp)))
        if f.T_base_object is not None:
            T_camera_object = invert(T_base_cameras[f.tick]) @ f.T_base_object
            pose = pose_from_matrix(T_camera_object)
            targets.append(StampedPose(t_ns, CAMERA_FRAME, "", pose))
        if f.velocity is not None:
            velocities.append((t_ns, np.array([*f.velocity, 0.0, 0.0, 0.0])))
    until = len(run.ticks) if run.close is None else run.close + 1
    rng = generator(run.plan.seed, "model", run.plan.index)
    own_model = surface_points(world.target, OWN_POINTS, rng)
    return TrialLog(
        first_ns=at_ns(run.frames[0].tick),
        last_ns=at_ns(run.frames[-1].tick),
        limit_ns=None,
        close_ns=None if run.close is None else at_ns(run.close),
        close_missing=None,
        label=None,
        damaged=False,
        robot=robot,
        hand_samples=tuple(samples),
        max_gap_ns=round(config.sync.max_pose_gap_s * 1e9),
        servo_gain=config.servo.c_p_v,
        recorded=Recorded(
            tuple(grasps),
            tuple(targets),
            np.array([at_ns(f.tick) for f in run.frames if f.accepted], dtype=np.int64),
            tuple(velocities),
            tuple((at_ns(k), tick.twist) for k, tick in enumerate(run.ticks[:until])),
            lambda _: own_model,
        ),
    )


def _states(run: Run, world: World) -> tuple[list[JointSample], list[Array]]:
    """Joint states as recorded, and T_base_camera as calibrated, by control period."""
    names = [*ARM_JOINTS, *world.gripper.joints]
    where = np.concatenate([world.arm, world.fingers])
    dofs = np.concatenate([world.arm_dof, world.finger_dof])
    samples, cameras = [], []
    for k, tick in enumerate(run.ticks):
        world.restore(tick.snapshot)
        noise = generator(run.plan.seed, f"joints/{run.plan.index}", k).normal(size=(3, len(names)))
        position = world.data.qpos[where] + JOINT_NOISE * noise[0]
        effort = world.data.qfrc_actuator[dofs] + EFFORT_NOISE * noise[2]
        samples.append(
            JointSample(
                at_ns(k),
                dict(zip(names, position.tolist(), strict=True)),
                dict(zip(names, effort.tolist(), strict=True)),
            )
        )
        cameras.append(world.T_base_hand() @ world.gripper.T_hand_camera)
    return samples, cameras


def scene_of_run(run: Run, world: World, config: Config, seed: int) -> Scene | Unknown:
    """The scene that a verdict would make of a recording of this run.

    seed: of hindsight's errors.
    """
    log = log_of_run(run, world, config)
    hindsight = hindsight_of_run(run, world, log, seed)
    return (
        Unknown("the object was never tracked") if hindsight is None else scene_of(log, hindsight)
    )


def hindsight_of_run(run: Run, world: World, log: TrialLog, seed: int) -> Hindsight | None:
    """What the second pass would have made of the images; None where nothing was ever seen.

    seed: of the drawn errors. All sightings share an error of place and one of turn; one wanders
    from sighting to sighting, and each has its own besides.
    """
    rng = generator(seed, "modelled hindsight", run.plan.index)
    end = run.close if run.close is not None else len(run.ticks) - 1
    accepted = [f.tick for f in run.frames if f.accepted and f.tick <= end]
    if not accepted:
        return None
    held = world.presenter is not None
    # an object that stands lies level and moves level
    level = np.array([1.0, 1.0, float(held)])
    place = rng.normal(0, PLACE_M, 3) * [1, 1, 0.5]
    wander = rng.normal(0, WANDER_M, 3)
    model = _model(world, _undisturbed(run, world, end), rng)
    T_hand_camera = world.gripper.T_hand_camera
    true_camera = T_hand_camera @ increment(np.array(run.plan.faults.hand_eye))
    wrong_camera = T_hand_camera @ invert(true_camera)
    sightings = []
    for before, k in zip([accepted[0], *accepted], accepted, strict=False):
        kept = np.exp(-(k - before) * CONTROL_S / WANDER_S)
        wander = kept * wander + rng.normal(0, WANDER_M, 3) * np.sqrt(1 - kept**2)
        world.restore(run.ticks[k].snapshot)
        T_base_hand = world.T_base_hand()
        T = T_base_hand @ wrong_camera @ invert(T_base_hand) @ world.T_base_object()
        T[:3, 3] += place + wander * level + rng.normal(0, SIGHTING_M, 3)
        sightings.append(Sighting(at_ns(k), T, "registration"))
    world.restore(run.ticks[end].snapshot)
    through = world.T_base_hand() @ wrong_camera @ invert(world.T_base_hand())
    height = world.rest - world.target.rest_height()
    support = Plane(np.array([0.0, 0.0, 1.0]), -height, 1.0).moved(through)
    seen = [
        CausalFrame(f.index, at_ns(f.tick), np.eye(4), None, None, 0, 0, None) for f in run.frames
    ]
    attempt = run.close is not None or bool(log.recorded.grasps)
    return hindsight_from(log.robot, seen, sightings, model, support, log.close_ns, attempt)


def _undisturbed(run: Run, world: World, tick: int) -> Array:
    """(7,) pose, MuJoCo's order, of the object in the same world without a robot."""
    p, seconds = run.plan, len(run.ticks) * CONTROL_S + 1
    rows = twin_path(world.target, p.speed, p.x, p.y, p.yaw, seconds, world.setting)
    return np.asarray(rows[tick, :7])


def _model(world: World, pose_wxyz: Array, rng: np.random.Generator) -> Model:
    """The part of the surface that a camera above sees, object frame, with errors."""
    R = matrix_of(pose_wxyz)[:3, :3].T
    points = surface_points(world.target, POINTS, rng)
    heights = points @ R[:, 2]  # over the object's origin
    lowest = HIDDEN_M - world.target.extent()[2] / 2
    if world.presenter is None:
        lowest = UNSEEN_M - world.target.rest_height()
    points = points[heights > lowest]
    turn = np.radians(rng.normal(0, TURN_DEG)) * R[:, 2]
    points = transform(increment(np.concatenate([np.zeros(3), turn])), points)
    points = points + rng.normal(0, CLOUD_M, points.shape)
    return Model(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
