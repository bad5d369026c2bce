"""Where the closed loop's grasps come from: FFHNet on the model cloud, or known grasps.

Known grasps have an analytic score.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dgeval.config import GraspsConfig
from dgeval.geometry import Array, invert, rotation_angle
from dgeval.planning.grasps import (
    EncodedCloud,
    Networks,
    approach_free,
    encode_cloud,
    evaluate,
    free_of,
    overlap_allowed,
    propose,
)
from dgeval.simulation.grasps import KnownGrasp
from dgeval.simulation.perception import PerceivedObject
from dgeval.simulation.scenario import EvaluatorConfig


@dataclass(frozen=True)
class Proposals:
    """Candidates that move with the object as the robot believes it.

    T_object_palm (n, 4, 4), preshapes (n, 15) rad, scores (n,). cloud: what they were drawn for, in
    axes view with T_view_object; None of known grasps. support: normal (3,) and height m of the
    support in those axes. kept: the last candidate is the grasp chosen before.
    """

    T_object_palm: Array
    preshapes: Array
    scores: Array
    cloud: EncodedCloud | None = None
    T_view_object: Array | None = None
    config: GraspsConfig | None = None
    support: tuple[Array, float] | None = None
    kept: bool = False

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
        """Whether the approach to a candidate from the palm's pose is free.

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


class GraspSource(Protocol):
    """Gives candidates for a frame, and scores a palm pose (GraspEval of the paper)."""

    def propose(
        self,
        frame: int,
        perceived: PerceivedObject,
        T_base_object: Array,
        T_base_camera: Array,
        kept: tuple[Array, Array] | None,
    ) -> Proposals | None:
        """kept: T_object_palm (4, 4) and preshape (15,) of the grasp chosen last."""
        ...

    def score(
        self,
        proposals: Proposals,
        chosen: int,
        T_base_object: Array,
        T_base_palm: Array,
        T_base_grasp: Array,
    ) -> float: ...


class KnownGrasps:
    """Stand-in for FFHNet: grasps checked in physics.

    The score says how near the palm is to the chosen grasp.
    """

    def __init__(self, grasps: Sequence[KnownGrasp], config: EvaluatorConfig) -> None:
        self._config = config
        self._quality = np.array([g.quality for g in grasps])
        poses, preshapes = (
            np.array([g.T_object_palm for g in grasps]),
            np.array([g.preshape for g in grasps]),
        )
        self._proposals = Proposals(poses, preshapes, 0.5 + 0.5 * self._quality) if grasps else None

    def propose(self, *_: object) -> Proposals | None:
        return self._proposals

    def score(
        self,
        proposals: Proposals,
        chosen: int,
        T_base_object: Array,
        T_base_palm: Array,
        T_base_grasp: Array,
    ) -> float:
        return analytic_score(T_base_palm, T_base_grasp, float(self._quality[chosen]), self._config)


def analytic_score(
    T_base_palm: Array, T_base_grasp: Array, quality: float, c: EvaluatorConfig
) -> float:
    """Score of a palm pose: its nearness to a grasp that is known to hold, times that one's
    quality.
    """
    d = float(np.linalg.norm(T_base_palm[:3, 3] - T_base_grasp[:3, 3]))
    angle = rotation_angle(T_base_palm[:3, :3].T @ T_base_grasp[:3, :3])
    return float(
        (0.5 + 0.5 * quality)
        * np.exp(-0.5 * (d / c.position) ** 2 - 0.5 * (angle / np.radians(c.angle)) ** 2)
    )


class FFHNetGrasps:
    """The paper's grasps: drawn anew for the model cloud of every accepted frame,
    scored by FFHNet.
    """

    def __init__(self, networks: Networks, config: GraspsConfig, seed: int, index: int) -> None:
        self._networks, self._config, self._seed, self._index = networks, config, seed, index
        self._last: Proposals | None = None

    def propose(
        self,
        frame: int,
        perceived: PerceivedObject,
        T_base_object: Array,
        T_base_camera: Array,
        kept: tuple[Array, Array] | None,
    ) -> Proposals | None:
        if perceived.cloud is None:
            return (
                self._last
            )  # the model and its grasps as they were, moved along with the prediction
        R_cloud_base = self._networks.R_cloud_base(T_base_camera)  # its origin stays the base's
        z = self._config.support_z
        support = None if z is None else (R_cloud_base[:, 2], z)
        cloud = encode_cloud(perceived.cloud @ R_cloud_base.T, self._networks, support)
        T_view_object = np.eye(4)
        T_view_object[:3] = R_cloud_base @ T_base_object[:3]
        again = None if kept is None else (T_view_object @ kept[0], kept[1])
        index = self._index * 100_000 + frame
        drawn = propose(cloud, self._networks, self._config.candidates, self._seed, index, again)
        poses = invert(T_view_object) @ drawn.T_cloud_palm
        self._last = Proposals(
            poses,
            drawn.joints,
            drawn.scores,
            cloud,
            T_view_object,
            self._config,
            support,
            drawn.kept,
        )
        return self._last

    def score(
        self,
        proposals: Proposals,
        chosen: int,
        T_base_object: Array,
        T_base_palm: Array,
        T_base_grasp: Array,
    ) -> float:
        assert proposals.cloud is not None
        assert proposals.T_view_object is not None
        T = proposals.T_view_object @ invert(T_base_object) @ T_base_palm
        return float(
            evaluate(proposals.cloud, self._networks, T[None], proposals.preshapes[chosen][None])[0]
        )
