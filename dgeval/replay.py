"""The causal pass: each frame through tracking, observation, registration and fusion, estimation, grasps, servo, execution.

Open loop: what such a system would have believed and commanded at the recorded states, seeing only the past.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dgeval.config import Config
from dgeval.determinism import generator
from dgeval.geometry import Array, invert, orthonormalise, pose_from_matrix, transform
from dgeval.recording.frame import Frame
from dgeval.recording.trials import Trial
from dgeval.stages.estimation import Estimate, VelocityFilter
from dgeval.stages.execution import execute
from dgeval.stages.fusion import Fusion
from dgeval.stages.observation import observe
from dgeval.stages.registration import gate, register
from dgeval.stages.schedule import Delayed
from dgeval.stages.selection import Grasp, select
from dgeval.stages.servo import Servo
from dgeval.stages.target import find_target
from dgeval.stages.tracking_csrt import CsrtTracker
from dgeval.stages.tracking_model import ModelTracker, TrackingInput
from dgeval.stages.types import Model, Observation, Registration, Tracked

TRACKERS: dict[str, type[ModelTracker] | type[CsrtTracker]] = {"model": ModelTracker, "csrt": CsrtTracker}
POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")


@dataclass(frozen=True)
class Step:
    """One frame's results: its table row, seconds per stage, and what the review recording draws."""

    frame: Frame
    row: dict[str, Any]
    seconds: dict[str, float]
    tracked: Tracked
    model: Model | None
    T_camera_model: Array | None


@dataclass
class Perception:
    """The state that tracking, registration, fusion and estimation share: where the model is, and since when."""

    config: Config
    fusion: Fusion = field(init=False)
    velocity: VelocityFilter = field(init=False)

    def __post_init__(self) -> None:
        self.tracker = TRACKERS[self.config.tracking.method](self.config)
        self.fusion = Fusion(self.config.fusion)
        self.velocity = VelocityFilter(self.config.estimation)
        self.T_camera_model: Array | None = None
        self.T_prior: Array | None = None
        self.T_accepted: Array | None = None
        self.accepted_ns = 0
        self.feature: Array | None = None
        self.T_base_camera: Array | None = None
        self.accepted = False

    def predict(self, frame: Frame, T_base_camera: Array | None) -> Array | None:
        """T_camera_model at this frame before looking: carried by camera and velocity, without rotation of its own."""
        if self.T_prior is None:
            return None
        if T_base_camera is None or self.T_base_camera is None:
            return self.T_prior
        T_base_model = self.T_base_camera @ self.T_prior
        T_base_model[:3, 3] += self.velocity.ahead(frame.t_ns)
        return orthonormalise(invert(T_base_camera) @ T_base_model)


def replay(trial: Trial, config: Config) -> Iterator[Step]:
    """Frames of one trial in order. With no camera pose in the log, base quantities are in the camera frame."""
    state = Perception(config)
    servo = Servo(config.servo)
    perceived: Delayed[Any] = Delayed(config.schedule.perception_latency_s)
    proposed: Delayed[Any] = Delayed(config.schedule.grasps_latency_s)
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
        predicted = state.predict(frame, T_base_camera)
        tracked = state.tracker.step(
            TrackingInput(frame, box, state.fusion.model, predicted, state.T_camera_model, state.accepted)
        )
        clock.lap("tracking")
        row: dict[str, Any] = {"frame": frame.index, "t_ns": frame.t_ns, "tracking": tracked.state}
        if tracked.box is not None:
            row.update(zip(("box_x0", "box_y0", "box_x1", "box_y1"), tracked.box, strict=True))
            row["mask_area"] = tracked.mask_area
        if tracked.features is not None:
            row["n_features"] = len(tracked.features.points)
        wanted = config.observation
        if state.fusion.model is None:
            # the first observation is the whole model: thin on a large target, it would fail the gate's 5 mm for ever
            wanted = wanted.model_copy(update={"max_points": max(wanted.max_points, config.fusion.max_model_points)})
        observation = observe(frame, tracked, generator(config.seed, "observation", frame.index), wanted)
        clock.lap("observation")
        registration = _register(state, frame, tracked, observation, predicted, config)
        clock.lap("registration")
        _fuse(state, frame, tracked, observation, registration, predicted, row, config)
        clock.lap("fusion")
        estimate = _estimate(state, frame, T_base_camera, row)
        clock.lap("estimation")
        usable = perceived.step(frame.t_ns, (estimate, state.fusion.model, state.T_camera_model, T_base_camera))
        _control(frame, T_base_camera, usable, proposed, servo, row, config)
        clock.lap("control")
        state.T_base_camera = T_base_camera
        shown = state.T_camera_model if row.get("model_px") is not None else None
        yield Step(frame, row, clock.seconds, tracked, state.fusion.model, shown)


def _register(
    state: Perception,
    frame: Frame,
    tracked: Tracked,
    observation: Observation | None,
    predicted: Array | None,
    config: Config,
) -> Registration | None:
    """None where nothing can be registered: no model yet, target lost, too few points."""
    if state.fusion.model is None or observation is None or tracked.state != "tracked" or predicted is None:
        return None
    start = tracked.T_camera_model if tracked.T_camera_model is not None else predicted
    result = register(observation, state.fusion.model, start, tracked.features, frame.camera, config.registration)
    assert state.T_accepted is not None
    seconds = (frame.t_ns - state.accepted_ns) * 1e-9
    reason = gate(result, state.T_accepted, state.fusion.model.points.mean(axis=0), seconds, config.registration)
    return Registration(result.T_camera_model, result.fitness, result.gate_fitness, result.rmse, reason)


def _fuse(
    state: Perception,
    frame: Frame,
    tracked: Tracked,
    observation: Observation | None,
    registration: Registration | None,
    predicted: Array | None,
    row: dict[str, Any],
    config: Config,
) -> None:
    """Accept or predict, merge, and write what came of it into the row."""
    rng = generator(config.seed, "fusion", frame.index)
    first = state.fusion.model is None and observation is not None and tracked.state == "tracked"
    state.accepted = first or (registration is not None and registration.accepted)
    if first:
        state.T_camera_model = state.T_prior = np.eye(4)
    elif registration is not None and registration.accepted:
        state.T_camera_model = state.T_prior = orthonormalise(registration.T_camera_model)
    else:
        state.T_camera_model = predicted
        # the image tracker's pose is no accepted registration, but the best place to look from next
        state.T_prior = tracked.T_camera_model if tracked.T_camera_model is not None else predicted
    if observation is not None:
        row["n_observed"] = len(observation.points)
    if registration is not None:
        row["icp_accepted"] = registration.accepted
        row["icp_fitness"], row["icp_gate_fitness"] = registration.fitness, registration.gate_fitness
        row["icp_rmse"], row["icp_reject_reason"] = registration.rmse, registration.reject_reason
    elif not first and tracked.state != "not_started":
        row["icp_reject_reason"] = "lost" if tracked.state == "lost" else "too_few_points"
    row["predicted"] = not state.accepted
    if state.accepted:
        assert observation is not None
        assert state.T_camera_model is not None
        T_model_camera = invert(state.T_camera_model)
        if registration is not None and state.fusion.model is not None:
            centre = transform(T_model_camera, observation.points).mean(axis=0)
            row["residual_translation"] = float(np.linalg.norm(centre - state.fusion.model.points.mean(axis=0)))
        row["n_filtered"] = state.fusion.step(observation, T_model_camera, rng)
        state.T_accepted, state.accepted_ns = state.T_camera_model, frame.t_ns
    model = state.fusion.model
    if model is None or state.T_camera_model is None:
        return
    row["n_model"] = len(model.points)
    if state.feature is None:
        centre = model.points.mean(axis=0)
        state.feature = model.points[int(np.argmin(np.linalg.norm(model.points - centre, axis=1)))]
    if frame.t_ns - state.accepted_ns <= config.estimation.null_after_s * 1e9:
        row.update(_pose_columns("model", state.T_camera_model))
        centroid = transform(state.T_camera_model, model.points.mean(axis=0)[None])[0]
        row.update(zip(("centroid_px", "centroid_py", "centroid_pz"), centroid.tolist(), strict=True))


def _estimate(state: Perception, frame: Frame, T_base_camera: Array | None, row: dict[str, Any]) -> Estimate | None:
    """The velocity filter's step, and its columns where it is not stale."""
    measured = None
    if state.accepted and state.feature is not None and T_base_camera is not None:
        assert state.T_camera_model is not None
        measured = transform(T_base_camera @ state.T_camera_model, state.feature[None])[0]
    estimate = state.velocity.step(frame.t_ns, measured)
    if estimate is None or estimate.stale:
        return None
    place = estimate.position
    if measured is not None:
        place = measured
    row.update(zip(("feature_px", "feature_py", "feature_pz"), place.tolist(), strict=True))
    row.update(zip(("velocity_x", "velocity_y", "velocity_z"), estimate.velocity.tolist(), strict=True))
    row["velocity_sd"], row["nis"] = estimate.velocity_sd, estimate.nis
    return estimate


def _control(
    frame: Frame,
    T_base_camera: Array | None,
    usable: tuple[int, Any] | None,
    proposed: Delayed[Any],
    servo: Servo,
    row: dict[str, Any],
    config: Config,
) -> None:
    """Grasp, servo and execution columns; all null without a grasp in the log or without the palm's pose."""
    palm = frame.T_base_palm
    if palm is not None:
        row.update(_pose_columns("hand", palm))
    recorded = frame.grasp if config.grasps.source == "recorded" else None
    at = proposed.step(frame.t_ns, recorded)
    grasp = at[1] if at else None
    if grasp is None:
        return
    row.update(_pose_columns("grasp", grasp.T_base_palm))
    row["n_grasps"] = 1
    row["hand_score"] = grasp.score
    row["execute"] = execute(grasp.score, config.execution)
    if palm is None:
        return
    chosen = select([Grasp(grasp.T_base_palm, grasp.score)], palm, config.selection)
    if chosen is not None:
        row["grasp_metric"] = chosen[1] if grasp.score is not None else None
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


def _pose_columns(prefix: str, T: Array) -> dict[str, float]:
    return {f"{prefix}_{name}": float(value) for name, value in zip(POSE, pose_from_matrix(T), strict=True)}


class _Clock:
    """Seconds per stage; wall time is a measurement of the run and goes into no digest."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] = now - self._last
        self._last = now
