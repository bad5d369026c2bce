"""Candidates that move with the target, and the choice among them: for replay and simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dgeval.config import GraspsConfig, SelectionConfig
from dgeval.geometry import Array, invert, transform
from dgeval.planning.grasps import (
    EncodedCloud,
    Feasible,
    Networks,
    approach_free,
    encode_cloud,
    evaluate,
    free_of,
    overlap_allowed,
    propose,
)
from dgeval.planning.selection import by_metric, grasp_metric


@dataclass(frozen=True)
class Proposals:
    """Candidates that move with the target as the robot believes it.

    Object: the target's own frame, in replay that of the model. T_object_palm (n, 4, 4), preshapes
    (n, k) rad, scores (n,). cloud: what they were drawn for, in axes view with T_view_object; None
    of known grasps. support: normal (3,) and height m of the support in those axes. kept: the last
    candidate is the grasp chosen before. left_out: rows that were found not free or out of reach so
    far.
    """

    T_object_palm: Array
    preshapes: Array
    scores: Array
    cloud: EncodedCloud | None = None
    T_view_object: Array | None = None
    config: GraspsConfig | None = None
    support: tuple[Array, float] | None = None
    kept: bool = False
    left_out: set[int] = field(default_factory=set)

    @property
    def eligible(self) -> NDArray[np.intp]:
        """Rows that nothing has ruled out so far."""
        return np.setdiff1d(np.arange(len(self.scores)), sorted(self.left_out))

    def free(self, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Whether the hand at candidates (k,) lies outside the cloud they were drawn for.

        Known grasps always do.
        """
        if self.cloud is None or self.T_view_object is None or self.config is None:
            return np.ones(len(rows), bool)
        poses = self.T_view_object @ self.T_object_palm[rows]
        most = overlap_allowed(rows, len(self.scores), self.kept, self.config.max_overlap)
        return free_of(self.cloud, poses, self.preshapes[rows], self.support, most)

    def approach_free(self, row: int, T_object_hand: Array) -> bool:
        """Whether the approach to a candidate from the palm's pose (4, 4) is free.

        The approach to the grasp chosen before is not checked again.
        """
        if (
            self.cloud is None
            or self.T_view_object is None
            or self.config is None
            or (self.kept and row == len(self.scores) - 1)
        ):
            return True
        hand = (self.T_view_object @ T_object_hand)[:3, 3]
        pose = self.T_view_object @ self.T_object_palm[row]
        return approach_free(self.cloud, pose, self.preshapes[row], hand, self.support, self.config)

    def hand_scores(self, T_object_palm: Array, preshapes: Array, networks: Networks) -> Array:
        """The evaluator's scores (k,) of palm poses (k, 4, 4) with preshapes (k, n) rad."""
        assert self.cloud is not None
        assert self.T_view_object is not None
        return evaluate(self.cloud, networks, self.T_view_object @ T_object_palm, preshapes)


def drawn_proposals(
    points: Array,
    T_base_object: Array,
    T_base_camera: Array,
    networks: Networks,
    config: GraspsConfig,
    seed: int,
    index: int,
    kept: tuple[Array, Array] | None,
) -> Proposals:
    """FFHNet's candidates for the model of an accepted frame, drawn by (seed, index) alone.

    points (n, 3) m, object frame. T_base_camera (4, 4): the authors' weights see the cloud in the
    camera's axes. kept: T_object_palm (4, 4) and preshape (k,) rad of the grasp chosen last.
    """
    T_view_object = np.eye(4)  # the cloud's axes are the networks', its origin the base's
    R_view_base = networks.R_cloud_base(T_base_camera)
    T_view_object[:3] = R_view_base @ T_base_object[:3]
    support = None if config.support_z is None else (R_view_base[:, 2], config.support_z)
    cloud = encode_cloud(transform(T_view_object, points), networks, support)
    again = None if kept is None else (T_view_object @ kept[0], kept[1])
    drawn = propose(cloud, networks, config.candidates, seed, index, again)
    return Proposals(
        invert(T_view_object) @ drawn.T_cloud_palm,
        drawn.joints,
        drawn.scores,
        cloud,
        T_view_object,
        config,
        support,
        drawn.kept,
    )


class Chooser:
    """The best candidate by the dynamic metric that is free and in reach.

    reaches: whether the arm reaches T_base_palm (4, 4). A candidate of a set that is not free or
    not in reach is left out for good.
    """

    def __init__(self, config: SelectionConfig, reaches: Callable[[Array], bool]) -> None:
        self._config, self._arm_reaches = config, reaches
        self._proposals: Proposals | None = None
        self._chosen: int | None = None

    def best(
        self, proposals: Proposals, T_base_object: Array, palm: Array | None, seen: bool
    ) -> tuple[int, float | None] | None:
        """Row of the chosen candidate and its dynamic metric; None where none is free and in reach.

        palm (4, 4): T_base_palm of the hand; None where it is not known, then scores decide and
        there is no metric. seen: the target is; while it is not, what was chosen stays chosen, as
        nothing new is known.
        """
        poses = T_base_object @ proposals.T_object_palm
        if proposals is not self._proposals:
            self._proposals, self._chosen = proposals, None
            self._feasible = Feasible(proposals.free, self._reaches)
        self._poses = poses
        self._T_object_hand = None if palm is None else invert(T_base_object) @ palm
        metric = proposals.scores
        if palm is not None:
            metric = grasp_metric(poses, proposals.scores, palm, self._config)
        if seen or self._chosen is None:
            margin = self._config.keep_margin if proposals.kept else 0.0
            self._chosen = self._feasible.first(by_metric(metric, margin))
            proposals.left_out.update(self._feasible.refused())
        if self._chosen is None:
            return None
        return self._chosen, None if palm is None else float(metric[self._chosen])

    def _reaches(self, row: int) -> bool:
        assert self._proposals is not None
        if self._T_object_hand is not None and not self._proposals.approach_free(
            row, self._T_object_hand
        ):
            return False
        return self._arm_reaches(self._poses[row])
