"""Grasps by FFHNet on the model cloud of every accepted frame, and the choice of one of them.

The choice is by the dynamic metric, among those that are free of overlap and in reach.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array, invert
from dgeval.perception.types import Model
from dgeval.planning.carried import Belief
from dgeval.planning.control import Choice, GraspResult, HandState
from dgeval.planning.grasps import networks_of
from dgeval.planning.proposals import Chooser, Proposals, drawn_proposals
from dgeval.planning.recorded_arm import RecordedArm
from dgeval.planning.schedule import Delayed
from dgeval.recording.robot import RobotStates


class ModelGrasps:
    """Candidates of the newest usable frame, carried with the model, and the one chosen last."""

    def __init__(self, robot: RobotStates, config: Config) -> None:
        self._config = config
        self._networks = networks_of(config.grasps)
        self.c_e = self._networks.c_e
        self._coming: Delayed[Proposals] = Delayed(config.schedule.grasps_latency_s)
        self._chooser = Chooser(config.selection, self._reaches)
        # T_model_palm (4, 4) and joint angles (n,) rad of the grasp chosen last
        self._kept: tuple[Array, Array] | None = None
        self._arm = RecordedArm(robot, config.sync.max_pose_gap_s)
        self._t_ns = 0

    def see(
        self, t_ns: int, frame: int, model: Model, belief: Belief, T_base_camera: Array
    ) -> None:
        """Candidates of an accepted frame; the grasp chosen last is one of them."""
        drawn = drawn_proposals(
            model.points,
            belief.T_base_object,
            T_base_camera,
            self._networks,
            self._config.grasps,
            self._config.seed,
            frame,
            self._kept,
        )
        self._coming.step(t_ns, drawn)

    def choose(
        self, states: Sequence[HandState], beliefs: Sequence[Belief | None]
    ) -> list[GraspResult | None]:
        """The best candidate at each state by the dynamic metric that is free and in reach.

        None before there were candidates, and where nothing is known of the target.
        """
        out: list[GraspResult | None] = []
        # of states with a palm pose: index, and proposals, T_object_palm of the hand, preshape
        to_score: list[tuple[int, Proposals, Array, Array]] = []
        for state, belief in zip(states, beliefs, strict=True):
            at = self._coming.at(state.t_ns)
            if at is None or belief is None:
                out.append(None)
                continue
            proposals, self._t_ns = at[1], state.t_ns
            T_base_object, palm = belief.at(state.t_ns), state.T_base_palm
            best = self._chooser.best(proposals, T_base_object, palm, belief.seen)
            n = len(proposals.scores)
            if best is None:
                out.append(GraspResult(n, None))
                continue
            row, metric = best
            pose, preshape = proposals.T_object_palm[row], proposals.preshapes[row]
            self._kept = pose, preshape
            score = float(proposals.scores[row])
            if palm is not None:
                T_object_hand = invert(T_base_object) @ palm
                to_score.append((len(out), proposals, T_object_hand, preshape))
            out.append(GraspResult(n, Choice(T_base_object @ pose, None, score, metric, preshape)))
        self._score(out, to_score)
        return out

    def _score(
        self,
        results: list[GraspResult | None],
        to_score: list[tuple[int, Proposals, Array, Array]],
    ) -> None:
        """Fill in the evaluator's scores of the hand, all of one set of candidates at a time."""
        while to_score:
            proposals = to_score[0][1]
            same = [entry for entry in to_score if entry[1] is proposals]
            to_score = [entry for entry in to_score if entry[1] is not proposals]
            poses = np.array([T for _, _, T, _ in same])
            preshapes = np.array([preshape for _, _, _, preshape in same])
            scores = proposals.hand_scores(poses, preshapes, self._networks)
            for (index, _, _, _), score in zip(same, scores.tolist(), strict=True):
                result = results[index]
                assert result is not None
                assert result.choice is not None
                choice = replace(result.choice, hand_score=score)
                results[index] = replace(result, choice=choice)

    def _reaches(self, T_base_palm: Array) -> bool:
        """Whether the arm reaches a pose (4, 4) from where it is; True where that is not known."""
        arm = self._arm.at(self._t_ns)
        return arm is None or arm.solve(T_base_palm) is not None
