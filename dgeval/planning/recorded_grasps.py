"""The grasp that the robot itself chose, where the log has it, instead of one chosen here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array
from dgeval.perception.types import Model
from dgeval.planning.carried import Belief
from dgeval.planning.control import Choice, GraspResult, HandState
from dgeval.planning.execution import PAPER_C_E
from dgeval.planning.selection import grasp_metric
from dgeval.recording.choices import RecordedChoices


class RecordedGrasps:
    """The newest recorded grasp, unchanged, with the scores recorded by then."""

    def __init__(self, recorded: RecordedChoices, config: Config) -> None:
        self._recorded, self._config = recorded, config
        self._late_ns = round(config.schedule.grasps_latency_s * 1e9)
        self.c_e = PAPER_C_E

    def see(
        self, t_ns: int, frame: int, model: Model, belief: Belief, T_base_camera: Array
    ) -> None:
        """Nothing: what was recorded does not depend on the replay."""

    def choose(
        self,
        states: Sequence[HandState],
        beliefs: Sequence[Belief | None],  # noqa: ARG002  as of `ModelGrasps`
    ) -> list[GraspResult | None]:
        """The grasp that was usable at each state; None before there was one."""
        return [self._at(state) for state in states]

    def _at(self, state: HandState) -> GraspResult | None:
        t_ns, palm = state.t_ns - self._late_ns, state.T_base_palm
        grasp = self._recorded.grasp_at(t_ns)
        if grasp is None:
            return None
        score = self._recorded.scores.at(t_ns)
        metric = None
        if palm is not None and score is not None:
            one = grasp_metric(grasp[None], np.array([score]), palm, self._config.selection)
            metric = float(one[0])
        return GraspResult(1, Choice(grasp, self._recorded.hand_scores.at(t_ns), score, metric))
