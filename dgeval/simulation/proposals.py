"""Where the closed loop's grasps come from: FFHNet on the model cloud, or known grasps.

Known grasps have an analytic score.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from dgeval.config import GraspsConfig
from dgeval.geometry import Array, invert, pose_distance, transform
from dgeval.planning.execution import PAPER_C_E
from dgeval.planning.grasps import Networks
from dgeval.planning.proposals import Proposals, drawn_proposals
from dgeval.simulation.grasps import KnownGrasp
from dgeval.simulation.perception import PerceivedObject
from dgeval.simulation.scenario import EvaluatorConfig


class GraspSource(Protocol):
    """Gives candidates for a frame, and scores a palm pose (GraspEval of the paper).

    c_e: threshold of these scores, above which the hand closes.
    """

    c_e: float

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
        self._config, self.c_e = config, PAPER_C_E
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
    d, angle = pose_distance(T_base_palm, T_base_grasp)
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
        self.c_e = networks.c_e

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
        points = transform(invert(T_base_object), perceived.cloud)
        self._last = drawn_proposals(
            points,
            T_base_object,
            T_base_camera,
            self._networks,
            self._config,
            self._seed,
            self._index * 100_000 + frame,
            kept,
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
        T_object_palm = invert(T_base_object) @ T_base_palm
        return float(
            proposals.hand_scores(
                T_object_palm[None], proposals.preshapes[chosen][None], self._networks
            )[0]
        )
