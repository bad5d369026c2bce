"""The causal pass: each frame through tracking, observation, registration and fusion, estimation, grasps, servo, execution.

Open loop: what such a system would have believed and commanded at the recorded states, seeing only the past.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array, transform
from dgeval.physics.hand import ACTUATED
from dgeval.recording.frame import Frame
from dgeval.recording.robot import JointTrack
from dgeval.recording.trials import GRASP_TOPIC, Trial
from dgeval.stages.execution import execute
from dgeval.stages.grasping import (
    Candidates,
    EncodedCloud,
    Feasible,
    Networks,
    encode_cloud,
    evaluate,
    free_of,
    networks_of,
    propose,
)
from dgeval.stages.perception import Perception, pose_columns
from dgeval.stages.reachability import Arm, arm_of
from dgeval.stages.schedule import Delayed
from dgeval.stages.selection import by_metric, grasp_metric
from dgeval.stages.servo import Servo
from dgeval.stages.target import find_target
from dgeval.stages.types import Model, Tracked


@dataclass(frozen=True)
class Step:
    """One frame's results: its table row, seconds per stage, and what the review recording draws."""

    frame: Frame
    row: dict[str, Any]
    seconds: dict[str, float]
    tracked: Tracked
    model: Model | None
    T_camera_model: Array | None
    T_base_camera: Array | None
    accepted: bool


def replay(trial: Trial, config: Config, perception: Perception | None = None) -> Iterator[Step]:
    """Frames of one trial in order. With no camera pose in the log, base quantities are in the camera frame.

    `perception`, a new one, is left as it is after the last frame, for the second pass.
    """
    state = perception or Perception(config)
    servo = Servo(config.servo)
    perceived: Delayed[Any] = Delayed(config.schedule.perception_latency_s)
    grasping = _Grasping(trial, config)
    moving_base = trial.robot.base_frame is not None
    given = trial.spec.bbox
    given_ns = trial.spec.bbox_time_ns
    frames = trial.frames()
    while True:
        clock = _Clock()
        frame = next(frames, None)
        if frame is None:
            return
        clock.lap("read")
        T_base_camera = frame.T_base_camera if moving_base else np.eye(4)
        box = None
        if given is not None and (given_ns is None or frame.t_ns >= given_ns):
            box, given = given, None
        elif trial.spec.bbox is None and not state.fusion.model and state.T_camera_model is None and frame.index < 30:
            box = find_target(frame, T_base_camera, _palm_at_close(trial), config)
        clock.lap("target")
        seen = state.step(frame, T_base_camera, box, clock.lap)
        row = seen.row
        usable = perceived.step(frame.t_ns, (seen.estimate, seen.model, seen.T_camera_model, T_base_camera))
        grasping.step(frame, T_base_camera, seen.model if seen.accepted else None, seen.T_camera_model)
        clock.lap("grasps")
        _control(frame, T_base_camera, usable, grasping.choose(frame, row), servo, row, config)
        clock.lap("control")
        shown = seen.T_camera_model if row.get("model_px") is not None else None
        yield Step(frame, row, clock.seconds, seen.tracked, seen.model, shown, T_base_camera, seen.accepted)


@dataclass(frozen=True)
class _Choice:
    """g*_t as T_base_palm (4, 4) and the score of the hand where it is (GraspEval); None where nobody scores it."""

    T_base_palm: Array
    hand_score: float | None


def grasp_source(trial: Trial, config: Config) -> str:
    """`recorded`, `ffhnet` or `none`: what `grasps.source` comes to in this trial."""
    if config.grasps.source != "auto":
        return config.grasps.source
    if trial.scan.poses.get(GRASP_TOPIC):
        return "recorded"
    description = trial.robot.description
    known = description is not None and {j.name for j in description.joints.values()}.issuperset(ACTUATED)
    return "ffhnet" if known and trial.robot.palm_frame is not None else "none"


class _Grasping:
    """Grasps of each frame, recorded or by FFHNet on the model cloud, and the choice among them."""

    def __init__(self, trial: Trial, config: Config) -> None:
        self._config = config
        source = grasp_source(trial, config)
        self._recorded = source == "recorded"
        self._networks: Networks | None = networks_of(config.grasps) if source == "ffhnet" else None
        self._coming: Delayed[Any] = Delayed(config.schedule.grasps_latency_s)
        self._arm: Arm | None = None
        robot = trial.robot
        if self._networks is not None and robot.description is not None and robot.base_frame and robot.palm_frame:
            self._arm = arm_of(robot.description, robot.base_frame, robot.palm_frame)
            self._joints = JointTrack.of(
                trial.scan.joints.get(trial.roles.hand_joints or "", []), config.clock.hand_joints.offset_ns
            )
        self._at: Any = None
        self._kept: tuple[Array, Array] | None = None  # T_model_palm and joints of the grasp chosen last

    def step(self, frame: Frame, T_base_camera: Array | None, model: Model | None, T_camera_model: Array | None) -> None:
        """Candidates for an accepted frame's model; what was recorded, as it was."""
        if self._recorded:
            self._at = self._coming.step(frame.t_ns, frame.grasp)
        elif self._networks is not None and model is not None and T_camera_model is not None and T_base_camera is not None:
            cloud = encode_cloud(transform(T_camera_model, model.points), self._networks)
            kept = None if self._kept is None else (T_camera_model @ self._kept[0], self._kept[1])
            drawn = propose(cloud, self._networks, self._config.grasps.candidates, self._config.seed, frame.index, kept)
            self._at = self._coming.step(frame.t_ns, (cloud, drawn, T_base_camera, T_camera_model))
        else:
            self._at = self._coming.at(frame.t_ns)

    def choose(self, frame: Frame, row: dict[str, Any]) -> _Choice | None:
        """The best by the dynamic metric that the arm can reach, and its columns."""
        if self._at is None or self._at[1] is None:
            return None
        palm, config = frame.T_base_palm, self._config
        if self._recorded:
            grasp = self._at[1]
            row["n_grasps"] = 1
            if palm is not None and grasp.score is not None:
                metric = grasp_metric(grasp.T_base_palm[None], np.array([grasp.score]), palm, config.selection)
                row["grasp_metric"] = float(metric[0])
            return _Choice(grasp.T_base_palm, grasp.score)
        assert self._networks is not None
        cloud, drawn, T_base_camera, T_camera_model = self._at[1]
        assert isinstance(cloud, EncodedCloud)
        assert isinstance(drawn, Candidates)
        poses = T_base_camera @ drawn.T_cloud_palm
        row["n_grasps"] = len(poses)
        z = config.grasps.support_z
        support = None if z is None else (T_base_camera[2, :3], z - float(T_base_camera[2, 3]))
        metric = drawn.scores if palm is None else grasp_metric(poses, drawn.scores, palm, config.selection)
        chosen = Feasible(
            lambda rows: free_of(cloud, drawn.T_cloud_palm[rows], drawn.joints[rows], support, config.grasps.max_overlap),
            self._reaches(poses, frame.t_ns),
        ).first(by_metric(metric))
        if chosen is None:
            return None
        self._kept = np.linalg.inv(T_camera_model) @ drawn.T_cloud_palm[chosen], drawn.joints[chosen]
        row["grasp_score"] = float(drawn.scores[chosen])
        if palm is None:
            return _Choice(poses[chosen], None)
        row["grasp_metric"] = float(metric[chosen])
        T_cloud_palm = np.linalg.inv(T_base_camera) @ palm
        score = evaluate(cloud, self._networks, T_cloud_palm[None], drawn.joints[chosen][None])
        return _Choice(poses[chosen], float(score[0]))

    def _reaches(self, poses: Array, t_ns: int) -> Callable[[int], bool] | None:
        """Whether the arm reaches a pose from where it is; None where its kinematics or joints are not known."""
        arm = self._arm
        if arm is None:
            return None
        gap = round(self._config.sync.max_pose_gap_s * 1e9)
        q = [self._joints.at(j.name, t_ns, gap) for j in arm.movable]
        if any(v is None for v in q):
            return None
        start = np.array(q, dtype=float)
        return lambda row: arm.solve(poses[row], start) is not None


def _control(
    frame: Frame,
    T_base_camera: Array | None,
    usable: tuple[int, Any] | None,
    grasp: _Choice | None,
    servo: Servo,
    row: dict[str, Any],
    config: Config,
) -> None:
    """Grasp, servo and execution columns; all null without a grasp or without the palm's pose."""
    palm = frame.T_base_palm
    if palm is not None:
        row.update(pose_columns("hand", palm))
    if grasp is None:
        return
    row.update(pose_columns("grasp", grasp.T_base_palm))
    row["hand_score"] = grasp.hand_score
    row["execute"] = execute(grasp.hand_score, config.execution)
    if palm is None:
        return
    estimate, model, T_camera_model, T_then = usable[1] if usable else (None, None, None, None)
    velocity = estimate.velocity if estimate is not None else np.zeros(3)
    target = grasp.T_base_palm[:3, 3]
    if model is not None and T_camera_model is not None and T_then is not None:
        target = transform(T_then @ T_camera_model, model.points.mean(axis=0)[None])[0]
    command = servo.step(frame.t_ns, palm, grasp.T_base_palm, T_base_camera, target, velocity)
    row["error_linear"], row["error_angular"] = command.error_linear, command.error_angular
    names = ("twist_vx", "twist_vy", "twist_vz", "twist_wx", "twist_wy", "twist_wz")
    row.update(zip(names, command.twist.tolist(), strict=True))


def _palm_at_close(trial: Trial) -> Array | None:
    """Position (3,) of the palm at the recorded close, base frame: where the target must have been."""
    close = trial.event_ns("close")
    T = None if close is None else trial.robot.T_base_palm(close)
    return None if T is None else np.asarray(T[:3, 3])


class _Clock:
    """Seconds per stage; wall time is a measurement of the run and goes into no digest."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] = now - self._last
        self._last = now
