"""What a replay believed, chose and commanded, as a robot would have recorded it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from dgeval.geometry import Array, pose_from_matrix
from dgeval.recording.contract import (
    ACCEPTED_TOPIC,
    BELIEF_PREFIX,
    COMMAND_TOPIC,
    EXECUTE_TOPIC,
    GRASP_TOPIC,
    SCORE_TOPIC,
    TARGET_TOPIC,
    VELOCITY_TOPIC,
)
from dgeval.recording.messages import StampedPose, StampedPoses
from dgeval.recording.trials import Trial
from dgeval.replay.causal import Step

if TYPE_CHECKING:
    from dgeval.planning.proposals import Proposals


@dataclass
class Replayed:
    """What the replay itself believed and chose, as a robot would have recorded it.

    targets: T_camera_model, in each frame; seen_ns: times of those that were accepted. velocities:
    (t_ns, twist (6,)), base frame. grasps: T_base_palm chosen, in each control period, and of these
    commands, scores of the hand and decisions by time, ns. accepted: by frame. candidates: time ns,
    T_base_model (4, 4) and the grasps drawn for it. model: its last points (n, 3) m, model frame.
    """

    targets: list[StampedPose] = field(default_factory=list)
    seen_ns: list[int] = field(default_factory=list)
    velocities: list[tuple[int, Array]] = field(default_factory=list)
    grasps: list[StampedPose] = field(default_factory=list)
    commands: list[tuple[int, Array]] = field(default_factory=list)
    scores: list[tuple[int, float]] = field(default_factory=list)
    decisions: list[tuple[int, float]] = field(default_factory=list)
    accepted: list[tuple[int, float]] = field(default_factory=list)
    candidates: list[tuple[int, Array, Proposals]] = field(default_factory=list)
    model: Array | None = None

    def add(self, step: Step) -> None:
        t_ns, estimate = step.frame.t_ns, step.perceived.estimate
        if step.T_camera_model is not None:
            self.targets.append(StampedPose(t_ns, "", "", pose_from_matrix(step.T_camera_model)))
        self.accepted.append((t_ns, float(step.accepted)))
        if step.accepted:
            self.seen_ns.append(t_ns)
        if step.model is not None:
            self.model = step.model.points
        T = step.T_camera_model
        if step.candidates is not None and T is not None and step.T_base_camera is not None:
            self.candidates.append((t_ns, step.T_base_camera @ T, step.candidates))
        if estimate is not None:
            self.velocities.append((t_ns, np.append(estimate.velocity, np.zeros(3))))
        for control in step.periods:
            choice = None if control.grasps is None else control.grasps.choice
            if choice is not None:
                pose = pose_from_matrix(choice.T_base_palm)
                self.grasps.append(StampedPose(control.t_ns, "", "", pose))
                if choice.hand_score is not None:
                    self.scores.append((control.t_ns, choice.hand_score))
            if control.command is not None:
                self.commands.append((control.t_ns, control.command.twist))
            if control.execute is not None:
                self.decisions.append((control.t_ns, float(control.execute)))

    def as_robot(self, trial: Trial) -> Trial:
        """The trial as a robot would have recorded it that is this replay; without its masks."""
        candidates, scores = [], []
        for t_ns, T_base_model, drawn in self.candidates:
            rows = drawn.eligible
            T = T_base_model @ drawn.T_object_palm[rows]
            poses = np.reshape([pose_from_matrix(pose) for pose in T], (-1, 7))
            candidates.append(StampedPoses(t_ns, t_ns, "", poses))
            scores.append((t_ns, drawn.scores[rows]))
        times = {k: v for k, v in trial.scan.times.items() if not k.startswith(BELIEF_PREFIX)}
        scan = replace(
            trial.scan,
            poses={TARGET_TOPIC: self.targets, GRASP_TOPIC: self.grasps},
            twists={VELOCITY_TOPIC: self.velocities, COMMAND_TOPIC: self.commands},
            numbers={
                SCORE_TOPIC: self.scores,
                EXECUTE_TOPIC: self.decisions,
                ACCEPTED_TOPIC: self.accepted,
            },
            candidates=candidates,
            candidate_scores=scores,
            times=times,
        )
        return replace(trial, scan=scan)
