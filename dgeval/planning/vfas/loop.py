"""One VFAS iteration from a frame: cloud of the wrist camera, motion field, sampling, command."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np

from dgeval.config import Config, VfasConfig
from dgeval.determinism import generator
from dgeval.geometry import Array, invert, rotation_vector, transform
from dgeval.networks.checkpoints import shipped, version_of
from dgeval.networks.pointnet2 import GraspEvaluator, load_evaluator
from dgeval.perception.self_filter import hand_pixels
from dgeval.planning.vfas.contacts import (
    Reach,
    by_room,
    contact_graspnet_of,
    seed_from_contacts,
)
from dgeval.planning.vfas.gripper import Gripper
from dgeval.planning.vfas.motion_field import Flow, MotionField, dis_flow, gmflow
from dgeval.planning.vfas.selection import GraspJudge, Selected, Vfas, perturbed
from dgeval.recording.frame import Frame

FAR = 0.8  # m; points farther away are not part of the scene
MOST_PIXELS = 40_000  # pixels of a frame that the cloud is thinned to, about
# side of a window (px), and the depth range in it (m) from which on it shows an edge with flying
# pixels
EDGE_PX, EDGE_M = 5, 0.025
SAMPLED = 256  # poses from which the evaluator chooses a seed
SEED_TRIES = 5  # frames in which Contact-GraspNet is asked for a seed; ours


def evaluator_of(path: str | None) -> GraspEvaluator:
    """The evaluator of a file of weights; the shipped one for None."""
    file = shipped("vfas_evaluator.safetensors") if path is None else Path(path)
    return _read(file, version_of(file))


@cache
def _read(file: Path, _: tuple[int, int]) -> GraspEvaluator:
    return load_evaluator(file)


def scene_cloud(frame: Frame, T_base_camera: Array, margin: float) -> Array:
    """Points (n, 3) m of a frame, base frame, without the robot's own hand and flying pixels.

    Flying pixels lie in the air between an edge and the surface behind it, where a finger should
    go. The evaluator has learned from depth without them; with them it gives known grasps a fifth
    of their quality. margin: m about the hand's solids.
    """
    depth = frame.depth
    valid = (depth > 0) & (depth < FAR)
    window = np.ones((EDGE_PX, EDGE_PX), np.uint8)
    jump = cv2.dilate(depth, window) - cv2.erode(
        np.where(depth > 0, depth, np.float32(1e3)), window
    )
    valid &= jump < EDGE_M
    if frame.hand is not None:
        valid &= ~hand_pixels(depth, (0, 0), frame.camera, frame.hand, margin)
    v, u = np.nonzero(valid)
    step = max(1, round(len(v) / MOST_PIXELS))
    v, u = v[::step], u[::step]
    return transform(T_base_camera, frame.camera.backproject(u, v, depth[v, u].astype(np.float64)))


def seed_from_cloud(
    cloud: Array, judge: GraspJudge, T_base_camera: Array, seed: int
) -> Array | None:
    """T_base_grasp (4, 4), the best of the grasps drawn on a cloud (n, 3) m, base frame, or None.

    Grasps lie at the cloud's points, across what is narrower than the opening; None if there is no
    such place. Used in place of Contact-GraspNet if no seed is given and `vfas.contact_graspnet`
    names no weights.
    """
    opening = judge.gripper.opening
    rng = generator(seed, "vfas seed", 0)
    poses = []
    for _ in range(SAMPLED):
        target = cloud[rng.integers(len(cloud))]
        R = perturbed(T_base_camera[None], np.zeros(3), np.radians(40), rng)[0][:3, :3]
        turn = rng.uniform(0, np.pi)
        R = R @ np.array(
            [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]]
        )
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, target
        local = transform(invert(T), cloud)
        slab = local[
            (np.abs(local[:, 1]) < 0.011)
            & (np.abs(local[:, 2]) < 0.02)
            & (np.abs(local[:, 0]) < 0.07)
        ]
        if len(slab) > 5 and np.ptp(slab[:, 0]) < opening:
            T[:3, 3] += R @ [
                float(slab[:, 0].min() + slab[:, 0].max()) / 2,
                0,
                rng.uniform(0.0, 0.02),
            ]
            poses.append(T)
    if not poses:
        return None
    quality = judge.quality([cloud[rng.permutation(len(cloud))]], np.array(poses))[0]
    return poses[int(np.argmax(quality))]


def flow_of(config: VfasConfig) -> Flow:
    """The optical flow that is configured. UsageError if its weights can't be read."""
    if config.flow == "dis" or not config.motion_field:
        return dis_flow()
    assert config.flow_weights is not None  # the configuration refuses it
    return gmflow(Path(config.flow_weights))


def proportional_twist(T_base_hand: Array, T_base_goal: Array, gain: float) -> Array:
    """Twist (6,) m/s, rad/s, base axes, at the hand's origin: the pose error times gain (1/s).

    The paper's Cartesian controller.
    """
    turn = rotation_vector(T_base_goal[:3, :3] @ T_base_hand[:3, :3].T)
    return np.asarray(gain * np.concatenate([T_base_goal[:3, 3] - T_base_hand[:3, 3], turn]))


class VfasLoop:
    """The planner with its cloud and motion field.

    T_base_seed (4, 4); None: config.vfas.search_ahead in front of the gripper if
    config.vfas.search; of Contact-GraspNet on the target if its weights are given, once the target
    is seen; else drawn on the cloud. gripper: default: the trained one; all poses are of its grasp
    frame. reach: of the arm at a time, ns, ranks Contact-GraspNet's seeds; where it is None the
    evaluator does. After SEED_TRIES frames without a seed none is asked for.
    """

    def __init__(
        self,
        config: Config,
        T_base_seed: Array | None,
        gripper: Gripper | None = None,
        reach: Callable[[int], Reach | None] | None = None,
    ) -> None:
        self._config, self._given_seed, self._reach = config, T_base_seed, reach
        self._tries = 0
        network, c = evaluator_of(config.vfas.evaluator), config.vfas
        if c.labels is not None or c.centre is not None:
            sizes = replace(
                network.sizes,
                labels=c.labels or network.sizes.labels,
                centre=c.centre or network.sizes.centre,
            )
            network, trained = GraspEvaluator(sizes).eval(), network
            network.load_state_dict(trained.state_dict())
        self._judge = GraspJudge(network, c, gripper)
        self._motion = MotionField(flow_of(config.vfas))
        self._planner: Vfas | None = None
        self._last_ns = 0
        self.velocity: Array | None = None

    def step(
        self,
        frame: Frame,
        T_base_camera: Array,
        may_execute: bool = True,
        target: Array | None = None,
    ) -> Selected | None:
        """One iteration; None before there is a seed.

        may_execute: False while it must wait. target (n, 3) m, base frame: the target's points,
        where a seed of Contact-GraspNet lies; None where they are not known.
        """
        c = self._config.vfas
        cloud = scene_cloud(frame, T_base_camera, self._config.self_filter.margin)
        if self._planner is None:
            seed = self._seed(frame, cloud, T_base_camera, target)
            if seed is None:
                return None
            self._planner = Vfas(self._judge, c, self._config.seed, seed, c.search)
            self._last_ns = frame.t_ns - round(c.period_s * 1e9)
        centre = self._planner.T_base_seed[:3, 3]
        self.velocity = None
        if c.motion_field:
            self.velocity = self._motion.step(
                frame.t_ns, frame.colour, frame.depth, frame.camera, T_base_camera, centre, c.rho
            )
        seconds = max((frame.t_ns - self._last_ns) * 1e-9, 1e-3)
        self._last_ns = frame.t_ns
        return self._planner.step(
            frame.index, seconds, cloud, self.velocity, frame.T_base_palm if may_execute else None
        )

    def _seed(
        self, frame: Frame, cloud: Array, T_base_camera: Array, target: Array | None
    ) -> Array | None:
        if self._given_seed is not None:
            return self._given_seed
        c = self._config.vfas
        if c.search:
            if frame.T_base_palm is None:
                return None
            ahead = np.eye(4)
            ahead[2, 3] = c.search_ahead
            return frame.T_base_palm @ ahead
        if c.contact_graspnet is not None:
            if target is None or self._tries == SEED_TRIES:
                return None
            self._tries += 1
            reach = None if self._reach is None else self._reach(frame.t_ns)
            network, opening = contact_graspnet_of(c.contact_graspnet), self._judge.gripper.opening
            by_quality = partial(self._quality, cloud)
            rank = by_quality if reach is None else partial(by_room, reach, c.pregrasp)
            return seed_from_contacts(cloud, target, network, rank, opening, self._config.seed)
        return (
            seed_from_cloud(cloud, self._judge, T_base_camera, self._config.seed)
            if len(cloud)
            else None
        )

    def _quality(self, cloud: Array, poses: Array) -> Array:
        """Quality (m,) of poses (m, 4, 4) in a cloud (n, 3), by the evaluator."""
        order = generator(self._config.seed, "contacts", 0).permutation(len(cloud))
        return np.asarray(self._judge.quality([cloud[order]], poses)[0])
