"""Each stage by itself: what it makes of the robot's own inputs, beside what the robot made.

A stage of the replay can be another only because an earlier one is. Here estimation, choice, servo
and execution are given the target, the velocity, the candidates, the grasp and the scores that the
robot recorded, so that a difference is their own: another parameter, or another delay. Nothing in
them is drawn, so no seed excuses a difference.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array, invert, pose_distance, transform
from dgeval.perception.estimation import VelocityFilter
from dgeval.planning.carried import Belief
from dgeval.planning.control import Control, Controller, HandState
from dgeval.planning.recorded_grasps import RecordedGrasps
from dgeval.recording.choices import accepted_flags
from dgeval.recording.trials import Trial
from dgeval.replay.causal import DEFAULT_HAND, Step, score_threshold
from dgeval.robots.hand import hand_named

# m per rad, by which a turn counts in a twist; m/s, the least size that a twist is measured by
ARM_M, LEAST_TWIST = 0.1, 0.02


class OwnInputs:
    """Estimation, choice, servo and execution of a replay on a robot's own inputs.

    errors: of `velocity`, m/s, `grasp`, m and rad, and `twist`, a share, by time, ns. decided_ns:
    when the fingers would first have closed by the robot's own grasp and score of the hand.
    decides: whether those are recorded.
    """

    def __init__(self, trial: Trial, config: Config) -> None:
        self.errors: dict[str, list[tuple[int, tuple[float, ...]]]] = defaultdict(list)
        self.decided_ns: int | None = None
        self._robot = trial.robot
        self._filter = VelocityFilter(config.estimation)
        self._accepted = accepted_flags(trial.scan, [pair.t_ns for pair in trial.pairs])
        self._feature: Array | None = None
        choices, self._controller = trial.choices, None
        self.decides = bool(choices.times and choices.hand_scores.times and choices.decisions.times)
        self._chooser: Controller | None = None
        self._choices = choices
        if not choices.times or config.pipeline == "vfas":
            return
        # what was recorded of a control period is what the robot had in it: no latency on top
        timed = config.schedule.model_copy(update={"grasps_latency_s": 0.0})
        grasps = RecordedGrasps(choices, config.model_copy(update={"schedule": timed}))
        hand = trial.robot.hand or hand_named(DEFAULT_HAND)
        if self.decides:
            grasps.c_e = score_threshold(trial, config)
        self._controller = Controller(grasps, hand, config)
        if choices.candidates:
            from dgeval.planning.model_grasps import ModelGrasps  # imports torch
            from dgeval.planning.recorded_candidates import RecordedProposals

            # what the robot chose from is in its reach
            among = ModelGrasps(RecordedProposals(choices), lambda *_: True, config)
            self._chooser = Controller(among, hand, config)

    def add(self, step: Step, T_camera_model: Array | None, velocity: Array | None) -> None:
        """One frame, with the control periods before it.

        T_camera_model (4, 4), in the axes of the replay's model, and velocity (3,) m/s, base frame:
        the robot's own; None where it recorded none.
        """
        t_ns, T_base_camera = step.frame.t_ns, step.T_base_camera
        if T_base_camera is None:
            return
        seen = self._accepted.get(t_ns)
        self._learn_feature(step)
        if self._accepted and self._feature is not None:
            measured = None
            if seen and T_camera_model is not None:
                measured = transform(T_base_camera @ T_camera_model, self._feature[None])[0]
            estimate = self._filter.step(t_ns, measured)
            if estimate is not None and velocity is not None and not estimate.stale:
                apart = float(np.linalg.norm(estimate.velocity - velocity))
                self.errors["velocity"].append((t_ns, (apart,)))
        if self._controller is not None and T_camera_model is not None and step.model is not None:
            still = np.zeros(3) if velocity is None else velocity
            belief = Belief(t_ns, T_base_camera @ T_camera_model, still, bool(seen))
            for controller in (self._controller, self._chooser):
                if controller is not None:
                    controller.see(t_ns, step.frame.index, belief, step.model, T_base_camera)

    def periods(self, step: Step) -> list[Control]:
        """The control periods before a frame, on what the robot had by then."""
        if self._controller is None:
            return []
        states = [
            HandState(c.t_ns, self._robot.T_base_palm(c.t_ns), self._robot.T_base_camera(c.t_ns))
            for c in step.periods
        ]
        out = self._controller.run(states)
        for control in [] if self._chooser is None else self._chooser.run(states):
            choice = None if control.grasps is None else control.grasps.choice
            theirs = self._choices.grasp_at(control.t_ns)
            if choice is not None and theirs is not None:
                self.errors["grasp"].append(
                    (control.t_ns, pose_distance(choice.T_base_palm, theirs))
                )
        if self.decided_ns is None:
            self.decided_ns = next((c.t_ns for c in out if c.execute), None)
        return out

    def add_twist(self, control: Control, command: Array) -> None:
        """A period beside the twist (6,) that the robot commanded in it."""
        if control.command is not None:
            self.errors["twist"].append((control.t_ns, (twist_error(control, command),)))

    def _learn_feature(self, step: Step) -> None:
        """The point whose velocity is estimated, model frame."""
        estimate, T = step.perceived.estimate, step.T_camera_model
        if self._feature is None and step.accepted and estimate is not None and T is not None:
            assert step.T_base_camera is not None
            T_model_base = invert(step.T_base_camera @ T)
            self._feature = transform(T_model_base, estimate.position[None])[0]


def twist_error(control: Control, command: Array) -> float:
    """How far a commanded twist is from another (6,), as a share of that."""
    assert control.command is not None
    scale = np.array([1.0] * 3 + [ARM_M] * 3)
    apart = float(np.linalg.norm((control.command.twist - command) * scale))
    return apart / max(float(np.linalg.norm(command * scale)), LEAST_TWIST)
