"""The perception of one frame: tracking, observation, registration, fusion and estimation.

Replay and simulator share it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.config import Config, RegistrationConfig
from dgeval.determinism import generator
from dgeval.geometry import Array, Box, invert, orthonormalise, transform
from dgeval.perception.depth_noise import DepthNoise
from dgeval.perception.estimation import Estimate, VelocityFilter
from dgeval.perception.free_space import seen_through
from dgeval.perception.fusion import Fusion
from dgeval.perception.observation import observe
from dgeval.perception.registration import fit, gate, register
from dgeval.perception.trackers import tracker_named
from dgeval.perception.trackers.model import TrackingInput
from dgeval.perception.types import Fused, Model, Observation, Registration, Tracked
from dgeval.recording.frame import Frame

# after so many frames in a row that the gate refused by their fit, though more than this share of
# each lies within the search radius of the model: what all of them show counts in the next as well
REFUSED_FRAMES, NEAR_ALL = 3, 0.95
# a turn that is slower, rad/s, or differs from that of the frame before by this share, is noise
LEAST_TURN, UNSTEADY = 1.0, 0.5


@dataclass(frozen=True)
class Perceived:
    """The results of tracking, observation, registration, fusion and estimation on one frame.

    registration: None where nothing was registered. estimate: None where it is stale; its position
    is that of the feature point as measured in the frame, else as predicted.
    """

    tracked: Tracked
    observation: Observation | None
    registration: Registration | None
    fused: Fused
    estimate: Estimate | None

    @property
    def model(self) -> Model | None:
        """The model Q_t."""
        return self.fused.model

    @property
    def T_camera_model(self) -> Array | None:
        """(4, 4), accepted or predicted."""
        return self.fused.T_camera_model

    @property
    def accepted(self) -> bool:
        """The frame was merged into the model."""
        return self.fused.accepted


@dataclass
class Perception:
    """The state that the stages share from frame to frame: where the model is, and since when.

    T_camera_model (4, 4): of the last frame, accepted or predicted. T_prior: near which the tracker
    looks next. T_carried: from which a target goes on while it is not registered: T_prior, but not
    by colours alone, which tell it no better than the prediction does. T_accepted, accepted_ns: the
    last accepted pose and its time, ns. turn (3,): rad/s, rotation vector in base axes, of the time
    turn_ns. feature (3,): the feature point whose velocity is estimated, m, model frame.
    T_base_camera: of the last frame. All None before there is one. accepted: whether the last frame
    was merged.
    """

    config: Config
    fusion: Fusion = field(init=False)
    velocity: VelocityFilter = field(init=False)

    def __post_init__(self) -> None:
        self.tracker = tracker_named(self.config.tracking.method).TRACKER(self.config)
        self.fusion = Fusion(self.config.fusion)
        self.velocity = VelocityFilter(self.config.estimation)
        self.noise = DepthNoise()
        self.refused: list[Model] = []  # the last frames, refused in a row, by their fit alone
        self.T_camera_model: Array | None = None
        self.T_prior: Array | None = None
        self.T_carried: Array | None = None
        self.T_accepted: Array | None = None
        self.accepted_ns = 0
        self.feature: Array | None = None
        self.T_base_camera: Array | None = None
        self.accepted = False
        self.turn, self.turn_ns = np.zeros(3), 0
        self._R_before: Array | None = None
        self._turned = np.zeros(3)

    def predict(
        self, frame: Frame, T_base_camera: Array | None, start: Array | None, moves: bool = True
    ) -> Array | None:
        """T_camera_model (4, 4) at this frame, before its images are used, from the pose `start` at
        the last frame; None without one.

        The camera's motion and the estimated velocity carry it, and its turn if the object was seen
        to turn. moves: else the object stands still in the base frame.
        """
        if start is None:
            return None
        if T_base_camera is None or self.T_base_camera is None:
            return start
        T_base_model = self.T_base_camera @ start
        if not moves:
            return orthonormalise(invert(T_base_camera) @ T_base_model)
        model = self.fusion.model
        if model is not None and float(np.linalg.norm(self.turn)) > LEAST_TURN:
            R = Rotation.from_rotvec(self.turn * (frame.t_ns - self.turn_ns) * 1e-9).as_matrix()
            centre = transform(T_base_model, model.points.mean(axis=0)[None])[0]
            T_base_model[:3, :3] = R @ T_base_model[:3, :3]
            T_base_model[:3, 3] = centre + R @ (T_base_model[:3, 3] - centre)
        T_base_model[:3, 3] += self.velocity.ahead(frame.t_ns)
        return orthonormalise(invert(T_base_camera) @ T_base_model)

    def learn_turn(self, t_ns: int, T_base_camera: Array | None, is_measured: bool) -> None:
        """The object's turn from the last frame to this; none where it was not seen in both."""
        before, self._R_before = self._R_before, None
        if T_base_camera is None or self.T_prior is None or not is_measured:
            self.turn = np.zeros(3)
            return
        R = T_base_camera[:3, :3] @ self.T_prior[:3, :3]
        if before is not None and t_ns > self.turn_ns:
            seconds = (t_ns - self.turn_ns) * 1e-9
            turned = Rotation.from_matrix(R @ before.T).as_rotvec() / seconds
            apart, most = (float(np.linalg.norm(v)) for v in (turned - self._turned, turned))
            self.turn = (turned + self._turned) / 2 if apart < UNSTEADY * most else np.zeros(3)
            self._turned = turned
        self._R_before, self.turn_ns = R, t_ns

    def step(
        self, frame: Frame, T_base_camera: Array | None, box: Box | None, lap: Callable[[str], None]
    ) -> Perceived:
        """Process one frame. T_base_camera (4, 4): None where it is not known.

        box: starts tracking the target in it; None goes on. lap(stage): called after each stage,
        to time it.
        """
        config = self.config
        self.noise.see(frame, T_base_camera)
        predicted = self.predict(frame, T_base_camera, self.T_prior)
        tracked = self.tracker.step(
            TrackingInput(
                frame, box, self.fusion.model, predicted, self.T_camera_model, self.accepted
            )
        )
        lap("tracking")
        settings = config.observation
        if self.fusion.model is None:
            # the first observation is the whole model: with few points on a large target, later
            # frames would never have enough of them within the gate's 5 mm
            settings = settings.model_copy(
                update={"max_points": max(settings.max_points, config.fusion.max_model_points)}
            )
        observation = observe(
            frame, tracked, generator(config.seed, "observation", frame.index), settings
        )
        lap("observation")
        registration = _register(self, frame, tracked, observation, predicted, config)
        lap("registration")
        # where it is looked for is one thing, where a lost target is taken to be another
        moves = config.estimation.loss_policy != "zero"
        carried = predicted
        if not moves or self.T_carried is not self.T_prior:
            carried = self.predict(frame, T_base_camera, self.T_carried, moves)
        fused = _fuse(self, frame, tracked, observation, registration, (predicted, carried), config)
        lap("fusion")
        estimate = _estimate(self, frame, T_base_camera)
        lap("estimation")
        followed = 0 if tracked.features is None else len(tracked.features.points)
        self.learn_turn(frame.t_ns, T_base_camera, followed >= config.tracking.min_corners)
        self.T_base_camera = T_base_camera
        return Perceived(tracked, observation, registration, fused, estimate)


def _register(
    state: Perception,
    frame: Frame,
    tracked: Tracked,
    observation: Observation | None,
    predicted: Array | None,
    config: Config,
) -> Registration | None:
    """Register the observation to the model and apply the gate.

    None where nothing can be registered: no model yet, target lost, too few points.
    """
    if (
        state.fusion.model is None
        or observation is None
        or tracked.state != "tracked"
        or predicted is None
    ):
        state.refused = []
        return None
    start = tracked.T_camera_model if tracked.T_camera_model is not None else predicted
    model, settings, noise = state.fusion.model, config.registration, state.noise
    if tracked.pose_stands:
        result = fit(observation, model, start, settings, noise)
    else:
        result = register(
            observation, model, start, tracked.features, frame.camera, settings, noise
        )
    result = _gated(state, frame.t_ns, result, model, settings)
    if settings.accept == "recorded" and frame.accepted is not None:
        state.refused = []
        if result.reject_reason == "not_finite":
            return result
        return replace(result, reject_reason=None if frame.accepted else "recorded")
    # the frame shows more than the model; a pose that nothing has fitted may as well be wrong
    more = result.reject_reason == "fitness" and result.fitness > NEAR_ALL
    if not more or tracked.pose_stands:
        state.refused = []
        return result
    if len(state.refused) == REFUSED_FRAMES:
        again = fit(observation, model, result.T_camera_model, settings, noise, state.refused)
        again = _gated(state, frame.t_ns, again, model, settings)
        if again.accepted:
            state.refused = []
            return again
    T_model_camera = invert(result.T_camera_model)
    seen = Model(
        transform(T_model_camera, observation.points),
        observation.normals @ T_model_camera[:3, :3].T,
    )
    state.refused = [*state.refused, seen][-REFUSED_FRAMES:]
    return result


def _gated(
    state: Perception, t_ns: int, result: Registration, model: Model, config: RegistrationConfig
) -> Registration:
    """The registration with the gate's decision."""
    assert state.T_accepted is not None
    seconds = (t_ns - state.accepted_ns) * 1e-9
    centroid = model.points.mean(axis=0)
    reason = gate(result, state.T_accepted, centroid, seconds, config)
    return replace(result, reject_reason=reason)


def _fuse(
    state: Perception,
    frame: Frame,
    tracked: Tracked,
    observation: Observation | None,
    registration: Registration | None,
    expected: tuple[Array | None, Array | None],
    config: Config,
) -> Fused:
    """Accept the frame and merge it into the model, or carry the model.

    expected: T_camera_model (4, 4) where the target was looked for, and as it is carried on.
    """
    predicted, carried = expected
    rng = generator(config.seed, "fusion", frame.index)
    first = state.fusion.model is None and observation is not None and tracked.state == "tracked"
    state.accepted = first or (registration is not None and registration.accepted)
    if first:
        state.T_camera_model = state.T_prior = state.T_carried = np.eye(4)
    elif registration is not None and registration.accepted:
        registered = orthonormalise(registration.T_camera_model)
        state.T_camera_model = state.T_prior = state.T_carried = registered
    else:
        own = tracked.T_camera_model
        state.T_camera_model = own if tracked.pose_stands else carried
        # the tracker's pose is no accepted registration, but the best place to look from next
        state.T_prior = predicted if own is None else own
        by_depth = own is not None and (tracked.pose_stands or observation is not None)
        state.T_carried = own if by_depth else carried
    reason = None
    if registration is not None:
        reason = registration.reject_reason
    elif not first and tracked.state != "not_started":
        reason = "lost" if tracked.state == "lost" else "too_few_points"
    n_filtered = residual = None
    if state.accepted:
        assert observation is not None
        assert state.T_camera_model is not None
        T_model_camera = invert(state.T_camera_model)
        if registration is not None and state.fusion.model is not None:
            centre = transform(T_model_camera, observation.points).mean(axis=0)
            residual = float(np.linalg.norm(centre - state.fusion.model.points.mean(axis=0)))
        through = None
        if state.fusion.model is not None:
            in_camera = transform(state.T_camera_model, state.fusion.model.points)
            through = seen_through(in_camera, frame.depth, frame.camera)
        n_filtered = state.fusion.step(observation, T_model_camera, rng, through)
        state.T_accepted, state.accepted_ns = state.T_camera_model, frame.t_ns
    model, centroid = state.fusion.model, None
    if model is not None and state.T_camera_model is not None:
        centre = model.points.mean(axis=0)
        if state.feature is None:
            distances = np.linalg.norm(model.points - centre, axis=1)
            state.feature = model.points[int(np.argmin(distances))]
        age_ns = frame.t_ns - state.accepted_ns
        if tracked.pose_stands or age_ns <= config.estimation.null_after_s * 1e9:
            centroid = transform(state.T_camera_model, centre[None])[0]
    return Fused(
        state.accepted, reason, n_filtered, residual, model, state.T_camera_model, centroid
    )


def _estimate(state: Perception, frame: Frame, T_base_camera: Array | None) -> Estimate | None:
    """The velocity filter's step, with the measured feature point where there is one.

    None before the first measurement and where the estimate is stale.
    """
    measured = None
    if state.accepted and state.feature is not None and T_base_camera is not None:
        assert state.T_camera_model is not None
        measured = transform(T_base_camera @ state.T_camera_model, state.feature[None])[0]
    estimate = state.velocity.step(frame.t_ns, measured)
    if estimate is None or estimate.stale:
        return None
    return estimate if measured is None else replace(estimate, position=measured)
