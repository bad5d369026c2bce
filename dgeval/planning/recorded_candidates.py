"""The grasps that the robot could choose from, where the log has them, in place of FFHNet's."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np

from dgeval.geometry import Array, invert, pose_distance
from dgeval.perception.types import Model
from dgeval.planning.carried import Belief
from dgeval.planning.execution import PAPER_C_E
from dgeval.planning.model_grasps import ToScore
from dgeval.planning.proposals import Proposals
from dgeval.recording.choices import RecordedChoices

# ns between an image's time and that of its candidates; m and rad, within which the last candidate
# is the grasp chosen before, on a target that is tracked to some mm; ours
SAME_IMAGE_NS, SAME_M, SAME_RAD = 16_000_000, 5e-3, np.radians(3.0)


class RecordedProposals:
    """The robot's own candidates; of those the choice is made here."""

    def __init__(self, recorded: RecordedChoices) -> None:
        self._recorded = recorded
        self._times = [one.t_ns for one in recorded.candidates]
        self.c_e = PAPER_C_E

    def propose(
        self,
        t_ns: int,
        frame: int,  # noqa: ARG002  as of `FFHNetProposals`
        model: Model,  # noqa: ARG002
        belief: Belief,
        T_base_camera: Array,  # noqa: ARG002
        kept: tuple[Array, Array] | None,
    ) -> Proposals | None:
        """The candidates of an image."""
        at = bisect_left(self._times, t_ns - SAME_IMAGE_NS)
        near = [k for k in range(at, len(self._times)) if self._times[k] <= t_ns + SAME_IMAGE_NS]
        if not near:
            return None
        one = self._recorded.candidates[min(near, key=lambda k: abs(self._times[k] - t_ns))]
        poses = invert(belief.T_base_object) @ one.T_base_palm
        is_kept = kept is not None and _is_same(poses[-1], kept[0])
        return Proposals(poses, np.zeros((len(poses), 0)), one.scores, kept=is_kept)

    def hand_scores(self, hands: Sequence[ToScore]) -> list[float | None]:
        """As recorded: of the hand where it is, with the grasp that the robot chose."""
        return [self._recorded.hand_scores.at(t_ns) for _, t_ns, *_ in hands]


def _is_same(T: Array, other: Array) -> bool:
    """Whether two poses (4, 4) are one."""
    metres, turn = pose_distance(T, other)
    return metres < SAME_M and bool(turn < SAME_RAD)
