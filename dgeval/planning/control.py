"""Control at the rate of the robot's states: choice of a grasp, servo and execution.

Open loop: at each recorded state of the hand, on the newest results of perception that were usable
by then (docs/papers.md, "Time of control").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array
from dgeval.perception.types import Model
from dgeval.planning.carried import Belief
from dgeval.planning.execution import execute
from dgeval.planning.schedule import Delayed
from dgeval.planning.servo import Servo, ServoCommand
from dgeval.recording.choices import Numbers
from dgeval.robots.hand import Hand

if TYPE_CHECKING:
    from dgeval.planning.proposals import Proposals  # its module imports torch


@dataclass(frozen=True, slots=True)
class HandState:
    """T_base_palm and T_base_camera (4, 4) at a time, ns; None where they are not known."""

    t_ns: int
    T_base_palm: Array | None
    T_base_camera: Array | None


@dataclass(frozen=True)
class Choice:
    """The chosen grasp g*_t as T_base_palm (4, 4), and its scores; None where nobody gives one.

    hand_score: of the hand where it is (GraspEval). score: predicted success of the grasp. metric:
    its dynamic grasp metric, equations 3 to 5. joints (n,) rad: of the hand before it closes, of a
    grasp that FFHNet proposed.
    """

    T_base_palm: Array
    hand_score: float | None
    score: float | None
    metric: float | None
    joints: Array | None = None


@dataclass(frozen=True)
class GraspResult:
    """Number of candidates, and the one chosen; None where none is free and in reach."""

    n_candidates: int
    choice: Choice | None


@dataclass(frozen=True)
class Control:
    """One control period. grasps: None before there are candidates.

    execute: whether to close now, None where that is not known. command: of the servo, None without
    a grasp or a palm pose.
    """

    t_ns: int
    grasps: GraspResult | None
    execute: bool | None
    command: ServoCommand | None


class Grasps(Protocol):
    """Where grasps come from: the log, or the networks.

    c_e: threshold of their scores of the hand, above which it closes.
    """

    c_e: float

    def see(
        self, t_ns: int, frame: int, model: Model, belief: Belief, T_base_camera: Array
    ) -> Proposals | None:
        """An accepted frame by its time and index, with the model in it; new candidates, if any."""
        ...

    def choose(
        self, states: Sequence[HandState], beliefs: Sequence[Belief | None]
    ) -> list[GraspResult | None]:
        """What is chosen at each state, with what is believed of the target then."""
        ...


class Controller:
    """The control periods of a trial, with the servo's memory.

    A belief is usable from its image's time plus `schedule.perception_latency_s` on. decisions: the
    robot's own, whether to close, which count in place of the score; None where the score decides.
    """

    def __init__(
        self,
        grasps: Grasps | None,
        hand: Hand,
        config: Config,
        decisions: Numbers | None = None,
    ) -> None:
        self._grasps, self._config, self._decisions = grasps, config, decisions
        self._servo = Servo(config.servo, hand)
        self._null_after_ns = round(config.estimation.null_after_s * 1e9)
        self._coming: Delayed[tuple[Belief, Array] | None] = Delayed(
            config.schedule.perception_latency_s
        )

    def see(
        self,
        t_ns: int,
        frame: int,
        belief: Belief | None,
        model: Model | None,
        T_base_camera: Array,
    ) -> Proposals | None:
        """One frame's result, and the new candidates if there are any.

        belief: None where nothing is known of the target.
        """
        if belief is None or model is None:
            self._coming.step(t_ns, None)
            return None
        self._coming.step(t_ns, (belief, model.points.mean(axis=0)))
        if self._grasps is None or not belief.seen:
            return None
        return self._grasps.see(t_ns, frame, model, belief, T_base_camera)

    def run(self, states: Sequence[HandState]) -> list[Control]:
        """The control periods at states of the hand, in time order."""
        return self._at(states, is_period=True)

    def at(self, state: HandState) -> Control:
        """What a control period would give at a state that is none: the servo forgets it."""
        return self._at([state], is_period=False)[0]

    def _at(self, states: Sequence[HandState], is_period: bool) -> list[Control]:
        known = []
        for state in states:
            newest = self._coming.at(state.t_ns)
            late = newest is not None and state.t_ns - newest[0] > self._null_after_ns
            known.append(None if newest is None or late else newest[1])
        beliefs = [None if k is None else k[0] for k in known]
        chosen: list[GraspResult | None] = [None] * len(states)
        if self._grasps is not None:
            chosen = self._grasps.choose(states, beliefs)
        out = []
        for state, at, result in zip(states, known, chosen, strict=True):
            choice = None if result is None else result.choice
            palm, command = state.T_base_palm, None
            if choice is not None and palm is not None:
                target, velocity = choice.T_base_palm[:3, 3], np.zeros(3)
                if at is not None:
                    T = at[0].at(state.t_ns)
                    target, velocity = T[:3, :3] @ at[1] + T[:3, 3], at[0].velocity
                command = self._servo.step(
                    state.t_ns,
                    palm,
                    choice.T_base_palm,
                    state.T_base_camera,
                    target,
                    velocity,
                    is_period,
                )
            out.append(Control(state.t_ns, result, self._closes(state, choice), command))
        return out

    def _closes(self, state: HandState, choice: Choice | None) -> bool | None:
        """Whether to close now; None where that is not known."""
        if self._decisions is not None:
            decision = self._decisions.at(state.t_ns)
            return None if decision is None else bool(decision)
        if choice is None or self._grasps is None:
            return None
        return execute(
            choice.hand_score,
            self._grasps.c_e,
            self._config.execution,
            state.T_base_palm,
            choice.T_base_palm,
        )
