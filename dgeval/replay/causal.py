"""The causal pass: each frame through tracking, observation, registration and fusion, estimation, grasps, servo, execution.

Open loop: what such a system would have believed and commanded at the recorded states, seeing only the past.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dgeval.config import Config, GraspsConfig
from dgeval.geometry import Array, matrix_from_pose, transform
from dgeval.perception.pipeline import Perception, pose_columns
from dgeval.perception.target import find_target
from dgeval.perception.types import Model, Tracked
from dgeval.planning.execution import execute
from dgeval.planning.recorded_grasps import Choice, RecordedGrasps
from dgeval.planning.schedule import Delayed
from dgeval.planning.servo import Servo
from dgeval.recording.contract import CLOSE_EVENT, GRASP_TOPIC, SEED_TOPIC
from dgeval.recording.frame import Frame
from dgeval.recording.trials import Trial
from dgeval.robots.hand import Hand, hand_named, hand_of

if TYPE_CHECKING:
    from dgeval.planning.model_grasps import ModelGrasps
    from dgeval.planning.vfas.replayed import VfasGrasps


DEFAULT_HAND = "dlr_hit_hand"  # whose palm frame is taken where no known hand is described


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
    servo = Servo(config.servo, recorded_hand(trial) or hand_named(DEFAULT_HAND))
    perceived: Delayed[Any] = Delayed(config.schedule.perception_latency_s)
    planner = _planner(trial, config)
    grasps = _grasps(trial, config) if planner is None else None
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
        elif (
            trial.spec.bbox is None
            and not state.fusion.model
            and state.T_camera_model is None
            and frame.index < 30
        ):
            box = find_target(frame, T_base_camera, _palm_at_close(trial), config)
        clock.lap("target")
        seen = state.step(frame, T_base_camera, box, clock.lap)
        row = seen.row
        usable = perceived.step(
            frame.t_ns, (seen.estimate, seen.model, seen.T_camera_model, T_base_camera)
        )
        model = seen.model if seen.accepted else None
        if planner is not None:
            planner.step(frame, T_base_camera, row)
        choice = (
            None
            if grasps is None
            else grasps.choose(frame, T_base_camera, model, seen.T_camera_model, row)
        )
        clock.lap("grasps")
        if planner is None:
            _control(frame, T_base_camera, usable, choice, servo, row, config)
        clock.lap("control")
        shown = seen.T_camera_model if row.get("model_px") is not None else None
        yield Step(
            frame, row, clock.seconds, seen.tracked, seen.model, shown, T_base_camera, seen.accepted
        )


def grasp_source(trial: Trial, config: GraspsConfig) -> str:
    """`recorded`, `ffhnet` or `none`: what `grasps.source` comes to in this trial."""
    if config.source != "auto":
        return config.source
    if trial.scan.poses.get(GRASP_TOPIC):
        return "recorded"
    hand = recorded_hand(trial)
    known = hand is not None and hand.grasp_network == "ffhnet"
    return "ffhnet" if known and trial.robot.palm_frame is not None else "none"


def recorded_hand(trial: Trial) -> Hand | None:
    """The hand of the recorded description; None without one, or of a hand that has no model."""
    description = trial.robot.description
    if description is None:
        return None
    return hand_of({j.name for j in description.joints.values()})


def _grasps(trial: Trial, config: Config) -> RecordedGrasps | ModelGrasps | None:
    source = grasp_source(trial, config.grasps)
    if source == "recorded":
        return RecordedGrasps(config)
    if source == "none":
        return None
    from dgeval.planning.model_grasps import (
        ModelGrasps,
    )  # brings torch, which takes longer to import than all the rest

    return ModelGrasps(trial.robot, config)


def recorded_seed(trial: Trial) -> Array | None:
    """T_base_seed (4, 4): another planner's newest proposal at the trial's start, else the first in it; None: none recorded."""
    start_ns, end_ns = trial.pairs[0][0], trial.spec.end_ns or trial.pairs[-1][0]
    seeds = sorted(
        (p for p in trial.scan.poses.get(SEED_TOPIC, []) if p.t_ns <= end_ns), key=lambda p: p.t_ns
    )
    before = [p for p in seeds if p.t_ns <= start_ns]
    chosen = before[-1] if before else seeds[0] if seeds else None
    return None if chosen is None else matrix_from_pose(chosen.pose)


def _planner(trial: Trial, config: Config) -> VfasGrasps | None:
    if config.pipeline != "vfas":
        return None
    from dgeval.planning.vfas.replayed import VfasGrasps  # brings torch

    return VfasGrasps(config, recorded_seed(trial))


def _control(
    frame: Frame,
    T_base_camera: Array | None,
    usable: tuple[int, Any] | None,
    grasp: Choice | None,
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
    row["execute"] = execute(grasp.hand_score, config.execution, palm, grasp.T_base_palm)
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
    close = trial.event_ns(CLOSE_EVENT)
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
