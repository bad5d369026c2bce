"""What the robot recorded of its own choice: grasp, scores and decision, each by time."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from dgeval.geometry import Array, matrix_from_pose
from dgeval.recording.contract import (
    ACCEPTED_TOPIC,
    EXECUTE_TOPIC,
    GRASP_SCORE_TOPIC,
    GRASP_TOPIC,
    SCORE_TOPIC,
)
from dgeval.recording.scan import Scan

SCORE_LATE_NS = 1_000_000  # ns; a value logged this long after its grasp still belongs to it


@dataclass(frozen=True)
class Numbers:
    """Values of a topic without a header, by the time they were logged, ns, in time order."""

    times: tuple[int, ...] = ()
    values: tuple[float, ...] = ()

    def at(self, t_ns: int) -> float | None:
        """The newest value by then; None before the first."""
        k = bisect_right(self.times, t_ns + SCORE_LATE_NS)
        return self.values[k - 1] if k else None


@dataclass(frozen=True)
class RecordedChoices:
    """The robot's grasps T_base_palm (4, 4) with their stamps, ns, in time order.

    scores: of the chosen grasp. hand_scores: of the hand as it is. decisions: whether to close.
    """

    times: tuple[int, ...] = ()
    grasps: tuple[Array, ...] = ()
    scores: Numbers = Numbers()
    hand_scores: Numbers = Numbers()
    decisions: Numbers = Numbers()

    def grasp_at(self, t_ns: int) -> Array | None:
        """The newest grasp by then; None before the first."""
        k = bisect_right(self.times, t_ns)
        return self.grasps[k - 1] if k else None


def recorded_choices(found: Scan) -> RecordedChoices:
    """The choices that a recording holds."""
    poses = sorted(found.poses.get(GRASP_TOPIC, []), key=lambda pose: pose.t_ns)
    return RecordedChoices(
        tuple(pose.t_ns for pose in poses),
        tuple(matrix_from_pose(pose.pose) for pose in poses),
        *(_numbers(found, topic) for topic in (GRASP_SCORE_TOPIC, SCORE_TOPIC, EXECUTE_TOPIC)),
    )


def accepted_flags(found: Scan, times: Sequence[int]) -> dict[int, bool]:
    """Whether the robot merged a frame into its model, by the frame's stamp, ns.

    A flag has no stamp: it is taken to be of the newest frame by the time it was logged, of
    frames at `times`. A frame without one is left out.
    """
    out: dict[int, bool] = {}
    for t_ns, value in sorted(found.numbers.get(ACCEPTED_TOPIC, [])):
        k = bisect_right(times, t_ns + SCORE_LATE_NS)
        if k:
            out.setdefault(times[k - 1], bool(value))
    return out


def _numbers(found: Scan, topic: str) -> Numbers:
    listed = sorted(found.numbers.get(topic, []), key=lambda value: value[0])
    return Numbers(tuple(t_ns for t_ns, _ in listed), tuple(value for _, value in listed))
