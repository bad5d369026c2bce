"""Which of the things in view is the target, where nobody gave a box.

What the log itself marks goes first: a mask, a detection, an object's pose. Where it marks several
things, or none, what the hand closes on is the target. Each thing that stands on the dominant plane
is followed for a second; what can't be followed is none, and of the others the one whose path leads
nearest to the grasp centre at the close is taken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array, Box, invert, matrix_from_pose
from dgeval.perception.pipeline import Perception
from dgeval.perception.target import candidates, nearest_thing
from dgeval.recording.contract import CLOSE_EVENT, GRASP_TOPIC, SEED_TOPIC
from dgeval.recording.frame import Frame
from dgeval.recording.frame_reader import LostFrames
from dgeval.recording.recorded_target import Mark, marks_of
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
    """The target's box, x0 y0 x1 y1 px, in the frame of a time, ns.

    apart_m: how near it comes to the grasp; None where it was marked alone. n_others: other things
    that could be followed from that frame. topic: of the mark; None without one.
    """

    box: Box
    t_ns: int
    apart_m: float | None
    n_others: int
    topic: str | None = None


def search_target(trial: Trial, config: Config) -> FoundTarget | None:
    """None without a mark and without poses of camera and palm, or where nothing that is followed
    meets the hand.
    """
    marks = marks_of(trial.scan, trial.roles.target, trial.pairs, trial.reader.camera, trial.robot)
    is_alone = bool(marks) and max(len(m.boxes) for m in marks) == 1
    at_mark, is_sure = _marked_alone(trial, marks, config) if is_alone else (None, False)
    if is_sure:
        return at_mark
    centres, near_m = _grasp_centres(trial)
    if trial.robot.base_frame is None or not centres:
        return at_mark
    found = _nearest_the_grasp(trial, [] if is_alone else marks, centres, near_m, config)
    return found or at_mark or _at_the_chosen_grasp(trial, config)


def _nearest_the_grasp(
    trial: Trial, marks: list[Mark], centres: dict[int, Array], near_m: float, config: Config
) -> FoundTarget | None:
    """The thing whose way leads nearest to the grasp centre at the close: of those that are marked,
    else of those in view. centres, near_m: as `_grasp_centres` gives them.
    """
    close_ns = trial.event_ns(CLOSE_EVENT)
    n = len([p for p in trial.pairs if close_ns is None or p.t_ns <= close_ns])
    if n < LEAST_SEEN:
        return None
    stamps = [p.t_ns for p in trial.pairs]
    # after an attempt before the one that is judged, the object may be put elsewhere
    begin = sum(t <= (trial.close.before_ns or 0) for t in stamps)
    starts: list[tuple[int, Mark | None]] = [
        (begin + int(share * (n - begin)), None) for share in STARTS
    ]
    marked = [(stamps.index(m.t_ns), m) for m in _spread(marks)]
    for first, mark in [*(m for m in marked if begin <= m[0] < n), *starts]:
        reader = replace(
            trial.reader, pairs=trial.pairs[first : min(first + FOLLOWED, n)], lost=LostFrames([])
        )
        frames = list(reader.frames())
        if not frames:
            continue
        followed = []
        boxes = candidates(frames[0], config) if mark is None else list(mark.boxes)
        for box in boxes[:MOST_THINGS]:
            path = _follow(frames, box, config)
            if path is not None:
                followed.append((_apart(path, centres, close_ns), box))
        followed.sort()
        if followed and followed[0][0] <= near_m:
            apart, box = followed[0]
            topic = None if mark is None else mark.topic
            return FoundTarget(box, frames[0].t_ns, apart, len(followed) - 1, topic)
    return None


def _marked_alone(
    trial: Trial, marks: list[Mark], config: Config
) -> tuple[FoundTarget | None, bool]:
    """The first mark, or for a point on the object the smallest of the things there, in the first
    mark from which it can be followed; and whether it can, else it is that of the first mark.
    """
    if not marks[0].is_point:
        return FoundTarget(marks[0].boxes[0], marks[0].t_ns, None, 0, marks[0].topic), True
    stamps = [p.t_ns for p in trial.pairs]
    at_first = None
    for mark in _spread(marks):
        first = stamps.index(mark.t_ns)
        pairs = trial.pairs[first : first + FOLLOWED]
        frames = list(replace(trial.reader, pairs=pairs, lost=LostFrames([])).frames())
        x0, y0, x1, y1 = mark.boxes[0]
        u, v = (x0 + x1) / 2, (y0 + y1) / 2
        things = candidates(frames[0], config) if frames else []
        there = [b for b in things if b[0] <= u < b[2] and b[1] <= v < b[3]]
        if not there:
            continue
        smallest = min(there, key=lambda b: (b[2] - b[0]) * (b[3] - b[1]))
        found = FoundTarget(smallest, mark.t_ns, None, len(things) - 1, mark.topic)
        if _follow(frames, smallest, config) is not None:
            return found, True
        at_first = at_first or found
    return at_first, False


def _spread(marks: list[Mark]) -> list[Mark]:
    """Some of the marks, over all their time, each once."""
    return (
        [marks[k] for k in sorted({int(share * len(marks)) for share in STARTS})] if marks else []
    )


def _at_the_chosen_grasp(trial: Trial, config: Config) -> FoundTarget | None:
    """The thing at the grasp that the robot's own planner chose, or started from, in the first
    frame that shows one.
    """
    poses = trial.scan.poses
    chosen = sorted(poses.get(GRASP_TOPIC) or poses.get(SEED_TOPIC, []), key=lambda p: p.t_ns)
    if not chosen:
        return None
    centre, near_m = _centre_in_palm(trial)
    pairs = trial.pairs[:FOLLOWED]
    for frame in replace(trial.reader, pairs=pairs, lost=LostFrames([])).frames():
        if frame.T_base_camera is None:
            continue
        before = [p for p in chosen if p.t_ns <= frame.t_ns]
        T = matrix_from_pose((before[-1] if before else chosen[0]).pose)
        found = nearest_thing(frame, frame.T_base_camera, (T @ centre)[:3], config)
        if found is not None and found[0] <= near_m:
            return FoundTarget(found[1], frame.t_ns, found[0], 0)
    return None


def _grasp_centres(trial: Trial) -> tuple[dict[int, Array], float]:
    """The middle of the grasp (3,) m, base frame, by frame time, and at the close; and how near a
    target comes to it.
    """
    robot = trial.robot
    centre, near_m = _centre_in_palm(trial)
    close_ns = trial.event_ns(CLOSE_EVENT)
    stamps = [p.t_ns for p in trial.pairs] + ([] if close_ns is None else [close_ns])
    known = ((t, robot.T_base_palm(t)) for t in stamps)
    return {t: (T @ centre)[:3] for t, T in known if T is not None}, near_m


def _centre_in_palm(trial: Trial) -> tuple[Array, float]:
    """The middle of the grasp (4,) m, palm frame, or its origin; how near a target comes, m."""
    hand = trial.robot.hand
    if hand is None:
        return np.array([0.0, 0.0, 0.0, 1.0]), NEAR_PALM_M
    return invert(hand.T_hand_palm) @ np.append(hand.centre, 1.0), NEAR_CENTRE_M


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
