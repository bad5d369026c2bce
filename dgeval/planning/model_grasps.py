"""The choice among candidates at every control period, by the dynamic metric.

Candidates come with every accepted frame and move with the target: FFHNet's on the model cloud, or
those that the robot recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array, invert
from dgeval.perception.types import Model
from dgeval.planning.carried import Belief
from dgeval.planning.control import Choice, GraspResult, HandState
from dgeval.planning.grasps import networks_of
from dgeval.planning.proposals import Chooser, Proposals, drawn_proposals
from dgeval.planning.schedule import Delayed

# of a hand to score: index of its result, time ns, proposals, T_object_palm (4, 4), joints (n,)
ToScore = tuple[int, int, Proposals, Array, Array]


class ProposalSource(Protocol):
    """Where candidates and the scores of the hand come from. c_e: threshold of those scores."""

    c_e: float

    def propose(
        self,
        t_ns: int,
        frame: int,
        model: Model,
        belief: Belief,
        T_base_camera: Array,
        kept: tuple[Array, Array] | None,
    ) -> Proposals | None:
        """Candidates of an accepted frame; None without new ones.

        kept: T_object_palm (4, 4) and joints (n,) rad of the grasp chosen last, which is one of
        them.
        """
        ...

    def hand_scores(self, hands: Sequence[ToScore]) -> list[float | None]:
        """Scores of the hand where it is."""
        ...


class FFHNetProposals:
    """FFHNet's candidates for the model cloud, and its evaluator's scores."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._networks = networks_of(config.grasps)
        self.c_e = self._networks.c_e

    def propose(
        self,
        t_ns: int,  # noqa: ARG002  as of `RecordedProposals`
        frame: int,
        model: Model,
        belief: Belief,
        T_base_camera: Array,
        kept: tuple[Array, Array] | None,
    ) -> Proposals:
        return drawn_proposals(
            model.points,
            belief.T_base_object,
            T_base_camera,
            self._networks,
            self._config.grasps,
            self._config.seed,
            frame,
            kept,
        )

    def hand_scores(self, hands: Sequence[ToScore]) -> list[float | None]:
        """All of one set of candidates at a time."""
        out: list[float | None] = [None] * len(hands)
        left = list(range(len(hands)))
        while left:
            proposals = hands[left[0]][2]
            same = [k for k in left if hands[k][2] is proposals]
            left = [k for k in left if hands[k][2] is not proposals]
            poses = np.array([hands[k][3] for k in same])
            preshapes = np.array([hands[k][4] for k in same])
            scores = proposals.hand_scores(poses, preshapes, self._networks)
            for k, score in zip(same, scores.tolist(), strict=True):
                out[k] = score
        return out


class ModelGrasps:
    """Candidates of the newest usable frame, carried with the model, and the one chosen last.

    reaches: whether the arm reaches T_base_palm (4, 4) at a time, ns.
    """

    def __init__(
        self, source: ProposalSource, reaches: Callable[[int, Array], bool], config: Config
    ) -> None:
        self._source = source
        self.c_e = source.c_e
        self._coming: Delayed[Proposals] = Delayed(config.schedule.grasps_latency_s)
        self._chooser = Chooser(config.selection, lambda T: reaches(self._t_ns, T))
        # T_model_palm (4, 4) and joint angles (n,) rad of the grasp chosen last
        self._kept: tuple[Array, Array] | None = None
        self._t_ns = 0

    def see(
        self, t_ns: int, frame: int, model: Model, belief: Belief, T_base_camera: Array
    ) -> Proposals | None:
        """Candidates of an accepted frame; the grasp chosen last is one of them."""
        drawn = self._source.propose(t_ns, frame, model, belief, T_base_camera, self._kept)
        if drawn is not None:
            self._coming.step(t_ns, drawn)
        return drawn

    def choose(
        self, states: Sequence[HandState], beliefs: Sequence[Belief | None]
    ) -> list[GraspResult | None]:
        """The best candidate at each state by the dynamic metric that is free and in reach.

        None before there were candidates, and where nothing is known of the target.
        """
        out: list[GraspResult | None] = []
        to_score: list[ToScore] = []
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
                to_score.append((len(out), state.t_ns, proposals, T_object_hand, preshape))
            joints = preshape if len(preshape) else None
            out.append(GraspResult(n, Choice(T_base_object @ pose, None, score, metric, joints)))
        for hand, hand_score in zip(to_score, self._source.hand_scores(to_score), strict=True):
            result = out[hand[0]]
            assert result is not None
            assert result.choice is not None
            out[hand[0]] = replace(result, choice=replace(result.choice, hand_score=hand_score))
        return out
