"""Which of the things in view is the target, where nobody gave a box.

What the hand closes on is the target. Each thing that stands on the dominant plane is followed for
a second; what can't be followed is none, and of the others the one whose path leads nearest to the
grasp centre at the close is taken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array, invert
from dgeval.perception.pipeline import Perception
from dgeval.perception.target import Box, candidates
from dgeval.recording.contract import CLOSE_EVENT
from dgeval.recording.frame import Frame
from dgeval.recording.frame_reader import LostFrames
from dgeval.recording.trials import Trial

STARTS = (0.0, 0.25, 0.5, 0.75)  # shares of the time to the close, at which things are looked for
FOLLOWED = 30  # frames, for which a thing is followed
LEAST_SEEN = 8  # frames in which it must be tracked
MOST_LOST = 4  # frames; a thing that is lost in more is given up
MOST_THINGS = 8  # of the largest are followed from one frame
# m from the grasp centre at the close, or from the palm of a hand without a known centre; ours
NEAR_CENTRE_M, NEAR_PALM_M = 0.15, 0.25


@dataclass(frozen=True)
class FoundTarget:
    """The target's box, x0 y0 x1 y1 px, in the frame of a time, ns; how near it comes, m, to the
    grasp; and how many other things could be followed from that frame.
    """

    box: Box
    t_ns: int
    apart_m: float
    n_others: int


def search_target(trial: Trial, config: Config) -> FoundTarget | None:
    """None without poses of camera and palm, or where nothing that is followed meets the hand."""
    centres, near_m = _grasp_centres(trial)
    close_ns = trial.event_ns(CLOSE_EVENT)
    n = len([p for p in trial.pairs if close_ns is None or p.t_ns <= close_ns])
    if trial.robot.base_frame is None or not centres or n < LEAST_SEEN:
        return None
    for share in STARTS:
        first = int(share * n)
        reader = replace(
            trial.reader, pairs=trial.pairs[first : min(first + FOLLOWED, n)], lost=LostFrames([])
        )
        frames = list(reader.frames())
        if not frames:
            continue
        followed = []
        for box in candidates(frames[0], config)[:MOST_THINGS]:
            path = _follow(frames, box, config)
            if path is not None:
                followed.append((_apart(path, centres, close_ns), box))
        followed.sort()
        if followed and followed[0][0] <= near_m:
            apart, box = followed[0]
            return FoundTarget(box, frames[0].t_ns, apart, len(followed) - 1)
    return None


def _grasp_centres(trial: Trial) -> tuple[dict[int, Array], float]:
    """The middle of the grasp (3,) m, base frame, by frame time, and at the close; and how near a
    target comes to it.
    """
    hand, robot = trial.robot.hand, trial.robot
    centre, near_m = np.array([0.0, 0.0, 0.0, 1.0]), NEAR_PALM_M
    if hand is not None:
        centre, near_m = invert(hand.T_hand_palm) @ np.append(hand.centre, 1.0), NEAR_CENTRE_M
    close_ns = trial.event_ns(CLOSE_EVENT)
    stamps = [p.t_ns for p in trial.pairs] + ([] if close_ns is None else [close_ns])
    known = ((t, robot.T_base_palm(t)) for t in stamps)
    return {t: (T @ centre)[:3] for t, T in known if T is not None}, near_m


def _follow(frames: list[Frame], box: Box, config: Config) -> list[tuple[int, Array]] | None:
    """Stamps, ns, and places (3,) m, base frame, of a thing; None where it is soon lost."""
    perception = Perception(config)
    path: list[tuple[int, Array]] = []
    lost = 0
    for k, frame in enumerate(frames):
        perceived = perception.step(
            replace(frame, index=k), frame.T_base_camera, box if k == 0 else None, lambda _: None
        )
        lost += perceived.tracked.state != "tracked"
        if lost > MOST_LOST:
            return None
        if perceived.estimate is not None:
            path.append((frame.t_ns, np.asarray(perceived.estimate.position)))
    return path if len(path) >= LEAST_SEEN else None


def _apart(path: list[tuple[int, Array]], centres: dict[int, Array], close_ns: int | None) -> float:
    """How near, m, a thing that goes on as it was seen comes to the grasp centre: at the close, or
    without one at its nearest.
    """
    seen = path[len(path) // 6 :]  # the first sightings settle the model
    seconds = np.array([(t - path[0][0]) * 1e-9 for t, _ in seen])
    A = np.column_stack([np.ones(len(seen)), seconds])
    start, velocity = np.linalg.lstsq(A, np.array([p for _, p in seen]), rcond=None)[0]
    at = [t for t in sorted(centres) if t >= path[-1][0]]
    if close_ns is not None and close_ns in centres:
        at = [close_ns]
    gaps = [
        float(np.linalg.norm(start + velocity * (t - path[0][0]) * 1e-9 - centres[t])) for t in at
    ]
    return min(gaps, default=np.inf)
