"""The grasp that the robot itself chose, where the log has it, instead of one chosen here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array
from dgeval.planning.schedule import Delayed
from dgeval.planning.selection import grasp_metric

if TYPE_CHECKING:
    from dgeval.perception.types import Model
    from dgeval.recording.frame import Frame, RecordedGrasp


@dataclass(frozen=True)
class Choice:
    """The chosen grasp g*_t as T_base_palm (4, 4), and its scores; None where nobody gives one.

    hand_score: of the hand where it is (GraspEval). score: predicted success of the grasp. metric:
    its dynamic grasp metric, equations 3 to 5.
    """

    T_base_palm: Array
    hand_score: float | None
    score: float | None
    metric: float | None


@dataclass(frozen=True)
class GraspResult:
    """Number of candidates, and the one chosen; None where none is free and in reach."""

    n_candidates: int
    choice: Choice | None


class RecordedGrasps:
    """The newest recorded grasp, unchanged."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._coming: Delayed[RecordedGrasp | None] = Delayed(config.schedule.grasps_latency_s)

    def choose(
        self,
        frame: Frame,
        T_base_camera: Array | None,  # noqa: ARG002  as of `ModelGrasps`
        model: Model | None,  # noqa: ARG002
        T_camera_model: Array | None,  # noqa: ARG002
    ) -> GraspResult | None:
        """The grasp that was usable at the frame; None before there was one."""
        at = self._coming.step(frame.t_ns, frame.grasp)
        if at is None or at[1] is None:
            return None
        grasp, palm = at[1], frame.T_base_palm
        metric = None
        if palm is not None and grasp.score is not None:
            metrics = grasp_metric(
                grasp.T_base_palm[None], np.array([grasp.score]), palm, self._config.selection
            )
            metric = float(metrics[0])
        return GraspResult(1, Choice(grasp.T_base_palm, grasp.score, None, metric))
