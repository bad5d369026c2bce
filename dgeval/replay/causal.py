"""The causal pass: every frame through perception, grasps, servo and execution, in this order.

Open loop: what such a system would have estimated and commanded at the recorded states of the
robot, from past frames alone.
"""

from __future__ import annotations

import time
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from dgeval.config import Config, GraspsConfig
from dgeval.errors import Place, UsageError
from dgeval.geometry import Array
from dgeval.perception.pipeline import Perceived, Perception
from dgeval.perception.target import find_target
from dgeval.perception.types import Model, Tracked
from dgeval.planning.carried import Belief
from dgeval.planning.control import Control, Controller, Grasps, HandState
from dgeval.planning.execution import PAPER_C_E
from dgeval.planning.recorded_arm import RecordedArm
from dgeval.planning.recorded_grasps import RecordedGrasps
from dgeval.recording.choices import Numbers, RecordedChoices, in_base, logged_poses
from dgeval.recording.contract import (
    CANDIDATES_TOPIC,
    CLOSE_EVENT,
    EXECUTE_TOPIC,
    GRASP_TOPIC,
    SEED_TOPIC,
)
from dgeval.recording.frame import Frame
from dgeval.recording.messages import StampedPose
from dgeval.recording.robot import RobotStates
from dgeval.recording.trials import Trial
from dgeval.replay.row import row_of
from dgeval.replay.target_search import FoundTarget
from dgeval.robots.hand import KnownHand, hand_named

if TYPE_CHECKING:
    from dgeval.planning.proposals import Proposals
    from dgeval.planning.vfas.replayed import VfasGrasps, VfasResult

DEFAULT_HAND = "dlr_hit_hand"  # its palm frame is used where no known hand is described
# Frames in which a target is searched for where no box is given; at 30 Hz the first second.
MAX_SEARCHED = 30


@dataclass(frozen=True)
class Step:
    """One frame's stage results, and the wall time of each stage, s.

    control: of the dynamic pipeline, at the frame's time; None with the other. periods: the control
    periods since the frame before. vfas: of the pipeline `vfas`; None before there is a seed.
    candidates: new ones of this frame, if any.
    T_base_camera (4, 4): None where the pose of the camera is not known.
    """

    frame: Frame
    T_base_camera: Array | None
    seconds: dict[str, float]
    perceived: Perceived
    control: Control | None
    periods: tuple[Control, ...]
    vfas: VfasResult | None
    candidates: Proposals | None = None

    @property
    def tracked(self) -> Tracked:
        """The image tracker's result."""
        return self.perceived.tracked

    @property
    def model(self) -> Model | None:
        """The model Q_t."""
        return self.perceived.model

    @property
    def T_camera_model(self) -> Array | None:
        """(4, 4), accepted or predicted; None where it is older than `null_after_s`."""
        fused = self.perceived.fused
        return None if fused.centroid is None else fused.T_camera_model

    @property
    def accepted(self) -> bool:
        """The frame was merged into the model."""
        return self.perceived.accepted

    @property
    def execute(self) -> bool | None:
        """Whether either pipeline would close the fingers now, or would have since the frame
        before; None where that is not known.
        """
        if self.vfas is not None:
            return self.vfas.selected.execute
        if self.execute_ns is not None:
            return True
        return None if self.control is None else self.control.execute

    @property
    def execute_ns(self) -> int | None:
        """The first time since the frame before at which the fingers would have closed."""
        if self.vfas is not None:
            return self.frame.t_ns if self.vfas.selected.execute else None
        executed = self.executed
        return None if executed is None else executed.t_ns

    @property
    def executed(self) -> Control | None:
        """The first control period since the frame before in which the fingers would have closed;
        of the dynamic pipeline.
        """
        at_frame = () if self.control is None else (self.control,)
        return next((c for c in (*self.periods, *at_frame) if c.execute), None)

    @cached_property
    def row(self) -> dict[str, Any]:
        """The frame's row of the table `frames`."""
        return row_of(self)


def replay(
    trial: Trial,
    config: Config,
    perception: Perception | None = None,
    target: FoundTarget | None = None,
) -> Iterator[Step]:
    """The frames of a trial in order, each with the results of its stages.

    Without a camera pose in the log, base quantities are in the camera frame. perception: a new
    one; the second pass uses its state after the last frame. target: as `search_target` found it;
    without it and a box the target is looked for in the first frames.
    """
    perception = perception or Perception(config)
    planner = _planner(trial, config)
    controller = None if planner is not None else _controller(trial, config)
    stamps = trial.robot.palm_stamps(config.schedule.control_period_s)
    palm_at_close = _palm_at(trial.robot, trial.event_ns(CLOSE_EVENT))
    moving_base = trial.robot.base_frame is not None
    given_box, given_box_ns = trial.spec.bbox, trial.spec.bbox_time_ns
    if given_box is None and target is not None:
        given_box, given_box_ns = target.box, target.t_ns
    searches = given_box is None
    last_ns = trial.pairs[0].t_ns
    frames = trial.frames()
    while True:
        clock = _Clock()
        frame = next(frames, None)
        if frame is None:
            return
        clock.lap("read")
        T_base_camera = frame.T_base_camera if moving_base else np.eye(4)
        box = None
        if given_box is not None and (given_box_ns is None or frame.t_ns >= given_box_ns):
            box, given_box = given_box, None
        elif (
            searches
            and not perception.fusion.model
            and perception.T_camera_model is None
            and frame.index < MAX_SEARCHED
        ):
            box = find_target(frame, T_base_camera, palm_at_close, config)
        clock.lap("target")
        periods: list[Control] = []
        if controller is not None:
            since, until = bisect_left(stamps, last_ns), bisect_left(stamps, frame.t_ns)
            periods = controller.run(_states(trial.robot, stamps[since:until]))
            last_ns = frame.t_ns
        clock.lap("control")
        perceived = perception.step(frame, T_base_camera, box, clock.lap)
        seen = perceived.observation
        vfas = None if planner is None else planner.step(frame, T_base_camera, seen)
        control, drawn = None, None
        if controller is not None:
            if T_base_camera is not None:  # else the belief before is carried on
                belief = _belief(frame, perceived, T_base_camera)
                drawn = controller.see(
                    frame.t_ns, frame.index, belief, perceived.model, T_base_camera
                )
            clock.lap("grasps")
            control = controller.at(HandState(frame.t_ns, frame.T_base_palm, T_base_camera))
        clock.lap("control")
        yield Step(
            frame, T_base_camera, clock.seconds, perceived, control, tuple(periods), vfas, drawn
        )


def grasp_source(robot: RobotStates, recorded: RecordedChoices, config: GraspsConfig) -> str:
    """`recorded`, `candidates`, `ffhnet` or `none`: what the setting `grasps.source` means for a
    trial.

    recorded: what its log holds.
    """
    if config.source != "auto":
        return config.source
    if recorded.times:
        return "recorded"
    if recorded.candidates:
        return "candidates"
    known = isinstance(robot.hand, KnownHand) and robot.hand.grasp_network == "ffhnet"
    return "ffhnet" if known and robot.palm_frame is not None else "none"


def _controller(trial: Trial, config: Config) -> Controller:
    recorded = trial.choices
    source = grasp_source(trial.robot, recorded, config.grasps)
    grasps: Grasps | None = None
    needed = {"recorded": GRASP_TOPIC, "candidates": CANDIDATES_TOPIC}
    found = {"recorded": bool(recorded.times), "candidates": bool(recorded.candidates)}
    if not found.get(source, True):
        raise UsageError(
            f"grasps.source = {source!r}, but in this trial {needed[source]} has nothing to use",
            Place(str(trial.spec.recording)),
        )
    if source == "recorded":
        grasps = RecordedGrasps(recorded, config)
    elif source != "none":
        # imports torch, which takes longer than all other imports together
        from dgeval.planning.model_grasps import FFHNetProposals, ModelGrasps
        from dgeval.planning.recorded_candidates import RecordedProposals

        arm = RecordedArm(trial.robot, config.sync.max_pose_gap_s)
        of_robot = source == "candidates"
        proposals = RecordedProposals(recorded) if of_robot else FFHNetProposals(config)
        grasps = ModelGrasps(proposals, arm.reaches, config)
    if config.execution.decision == "recorded" and not recorded.decisions.times:
        raise UsageError(
            f"execution.decision = 'recorded', but {EXECUTE_TOPIC} is not recorded",
            Place(str(trial.spec.recording)),
        )
    hand, decisions = trial.robot.hand, recorded_decisions(recorded, source, config)
    return Controller(grasps, hand or hand_named(DEFAULT_HAND), config, decisions)


def closing_threshold(trial: Trial, config: Config) -> float | None:
    """The score of the hand above which the replay closes, c_e.

    None where the robot's own decisions count, or nothing is scored.
    """
    source = grasp_source(trial.robot, trial.choices, config.grasps)
    if config.pipeline == "vfas" or source == "none":
        return None
    if recorded_decisions(trial.choices, source, config) is not None:
        return None
    if source != "ffhnet" and not trial.choices.hand_scores.times:
        return None
    return score_threshold(trial, config)


def score_threshold(trial: Trial, config: Config) -> float:
    """c_e of whatever scores the hand in a replay, without regard to the robot's own decisions."""
    if config.execution.c_e is not None:
        return config.execution.c_e
    if grasp_source(trial.robot, trial.choices, config.grasps) != "ffhnet":
        return PAPER_C_E
    from dgeval.planning.grasps import networks_of  # imports torch

    return networks_of(config.grasps).c_e


def recorded_decisions(recorded: RecordedChoices, source: str, config: Config) -> Numbers | None:
    """The robot's own decisions where they count in place of the score; None where they don't.

    source: of the grasps, as `grasp_source` says.
    """
    if config.execution.decision == "auto":
        # they speak of the grasps as the robot had them: with another threshold or later, it would
        # have decided otherwise
        is_own = config.execution.c_e is None and not config.schedule.grasps_latency_s
        taken = source == "recorded" and is_own
        return recorded.decisions if taken and recorded.decisions.times else None
    return recorded.decisions if config.execution.decision == "recorded" else None


def _states(robot: RobotStates, stamps: list[int]) -> list[HandState]:
    """The states of the hand at recorded stamps, ns, where its pose is known."""
    states = (HandState(t, robot.T_base_palm(t), robot.T_base_camera(t)) for t in stamps)
    return [state for state in states if state.T_base_palm is not None]


def _belief(frame: Frame, perceived: Perceived, T_base_camera: Array) -> Belief | None:
    """The target as of a frame; None where nothing is known of it, or not any more."""
    if perceived.model is None or perceived.fused.centroid is None:
        return None
    assert perceived.T_camera_model is not None
    estimate = perceived.estimate
    velocity = np.zeros(3) if estimate is None else estimate.velocity
    return Belief(
        frame.t_ns, T_base_camera @ perceived.T_camera_model, velocity, perceived.accepted
    )


def recorded_seed(
    seeds: Sequence[tuple[StampedPose, int]], start_ns: int, end_ns: int, robot: RobotStates
) -> Array | None:
    """T_base_seed (4, 4): another planner's proposal; None where none is recorded.

    The newest at the trial's first frame, else the first one up to its end. seeds: each with the
    time it was logged, ns, which counts where it has no stamp.
    """
    placed = [(p.t_ns or log_ns, in_base(p, log_ns, robot)) for p, log_ns in seeds]
    during = sorted(
        ((t, T) for t, T in placed if T is not None and t <= end_ns), key=lambda seed: seed[0]
    )
    before = [T for t, T in during if t <= start_ns]
    return before[-1] if before else during[0][1] if during else None


def seed_of(trial: Trial) -> Array | None:
    """The recorded seed of a trial, see `recorded_seed`."""
    end_ns = trial.spec.end_ns or trial.pairs[-1].t_ns
    seeds = logged_poses(trial.scan, SEED_TOPIC)
    return recorded_seed(seeds, trial.pairs[0].t_ns, end_ns, trial.robot)


def _planner(trial: Trial, config: Config) -> VfasGrasps | None:
    if config.pipeline != "vfas":
        return None
    from dgeval.planning.vfas.gripper import gripper_of
    from dgeval.planning.vfas.replayed import VfasGrasps  # imports torch

    gripper = gripper_of(trial.robot.hand)
    arm = RecordedArm(trial.robot, config.sync.max_pose_gap_s)
    return VfasGrasps(config, seed_of(trial), None if isinstance(gripper, str) else gripper, arm)


def _palm_at(robot: RobotStates, close_ns: int | None) -> Array | None:
    """Position (3,) of the palm at the recorded close, m, base frame: the target was near it.

    None where no close or no palm pose is recorded.
    """
    T = None if close_ns is None else robot.T_base_palm(close_ns)
    return None if T is None else np.asarray(T[:3, 3])


class _Clock:
    """Wall time per stage, s. It differs from run to run, so it is part of no digest."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now
