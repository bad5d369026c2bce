"""What a run says and shows of its target: how it was found, and whether it can be relied on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from dgeval.config import Config
from dgeval.perception.target import candidates
from dgeval.recording.check import Check
from dgeval.recording.recorded_target import RECORDED, unusable
from dgeval.recording.trials import Trial
from dgeval.replay.causal import Step, replay
from dgeval.replay.notes import FrameCounts
from dgeval.replay.target_search import FoundTarget, search_target
from dgeval.runs.files import file_name

LEAST_FRAMES = 20  # of a trial, from which on the target must have been measured in one; ours
LEAST_PATCH_PX = 80.0  # px, of the first patch; a smaller one gives no surface to register; ours
# the recording's checks whose failing makes every measurement of the target wrong
SPOILS_DEPTH = ("depth_unit", "depth_offset", "alignment", "intrinsics", "camera_poses")
MANY_HOLES = 0.4  # share of the picture without depth, from which on it may be the cause; ours
LOST_AT_ONCE = 0.95  # share of the frames, in which a target that is lost was never followed; ours


@dataclass(frozen=True, slots=True)
class FirstSeen:
    """The frame in which the target was first tracked: the patch's size, px, and how many things
    were in view of which nothing tells the target; None where something told.
    """

    patch_px: float
    n_things: int | None


def target_source(trial: Trial, target: FoundTarget | None) -> str:
    """`bbox`, `recorded` where the log marks the target, else `automatic`."""
    if trial.spec.bbox is not None:
        return "bbox"
    return "recorded" if target is not None and target.topic is not None else "automatic"


def target_note(trial: Trial, target: FoundTarget | None) -> list[str]:
    """How the target was chosen where nobody gave a box, and where it can be looked at."""
    if trial.spec.bbox is not None:
        return []
    picture = f"pictures/{file_name(trial.spec.id)}-target.png"
    if target is None:
        how = "the thing nearest to the palm or the largest, in the first frames"
        if trial.roles.target:
            how += f", as {', '.join(trial.roles.target)} does not tell"
    elif target.apart_m is None:
        at = (target.t_ns - trial.pairs[0].t_ns) * 1e-9
        how = f"what {target.topic} marks at {at:+.2f} s"
    else:
        marked = f", of what {target.topic} marks" if target.topic else ""
        others = f"; {target.n_others} more can be followed" if target.n_others else ""
        how = f"what comes within {target.apart_m * 1000:.0f} mm of the grasp{marked}{others}"
        if trial.roles.target and not target.topic:
            how += f", as {', '.join(trial.roles.target)} marks none of it"
    other = [
        f"target: {what}"
        for topic in trial.roles.target
        if (what := unusable(trial.scan, topic, trial.reader.camera))
    ]
    note = f"target: no box is given; taken is {how}, drawn by replay in {picture}; another: "
    return [*other, f"{note}--bbox x0,y0,x1,y1"]


def write_target(path: Path, step: Step) -> None:
    """The picture in which the target was first tracked, with its box."""
    assert step.tracked.box is not None
    x0, y0, x1, y1 = (round(float(v)) for v in step.tracked.box)
    drawn = np.ascontiguousarray(step.frame.colour[:, :, ::-1])
    cv2.rectangle(drawn, (x0, y0), (x1, y1), (0, 0, 0), 4)
    cv2.rectangle(drawn, (x0, y0), (x1, y1), (0, 200, 255), 2)
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), drawn)


def first_seen(step: Step, trial: Trial, target: FoundTarget | None, config: Config) -> FirstSeen:
    """step: the first one with a tracked box. target: as `search_target` found it."""
    assert step.tracked.box is not None
    x0, y0, x1, y1 = step.tracked.box
    n_things = None
    if trial.spec.bbox is None and target is None:
        n_things = len(candidates(step.frame, config))
    return FirstSeen((x1 - x0) * (y1 - y0), n_things)


def target_checks(
    counts: FrameCounts,
    has_box: bool,
    seen: FirstSeen | None,
    method: str = "",
    failed_before: Sequence[str] = (),
) -> list[Check]:
    """Whether the right thing was followed, as far as a replay tells: it was chosen for a reason,
    large enough, followed in more than its first frames, and measured in at least one.

    failed_before: names of the recording's own checks that failed. Where depth or the camera's
    poses are wrong, another box mends nothing.
    """
    mend = "give its box with --bbox x0,y0,x1,y1"
    failed = []
    if seen is not None and seen.n_things is not None and seen.n_things > 1:
        what = f"nothing tells which of {seen.n_things} things in view is the target"
        failed.append(Check("target", what, mend))
    if seen is not None and seen.patch_px < LEAST_PATCH_PX:
        what = f"the target's first patch has {seen.patch_px:.0f} px, too few to follow"
        failed.append(Check("target", what, mend))
    if counts.frames < LEAST_FRAMES:
        return failed
    if has_box:
        mend = (
            "it has a box alone: is it nearer than the camera's least range, or the box beside it?"
        )
    if causes := [name for name in failed_before if name in SPOILS_DEPTH]:
        mend = f"mend {' and '.join(causes)} first"
    if method == RECORDED and counts.lost >= counts.frames - 1:
        what = f"of what the log marks the target is followed in none of {counts.frames} frames"
        mend = "is the box on what it marks (--bbox), and roles.target the target's topic?"
        return [*failed, Check("target", what, mend)]
    if counts.predicted >= counts.frames - 1:
        unseen = counts.lost + counts.no_depth + counts.not_started >= counts.frames - 1
        how = "was seen with usable depth" if unseen else "could be registered"
        what = f"the target {how} in none of {counts.frames} frames"
        if counts.holes > MANY_HOLES * counts.frames:
            what += f"; depth is missing in {counts.holes / counts.frames:.0%} of the picture"
            if not causes:
                mend = "record depth with fewer holes" + ("" if has_box else f", or {mend}")
        failed.append(Check("measured", what, mend))
    elif counts.lost > LOST_AT_ONCE * counts.frames:
        what = f"the target is followed in {counts.frames - counts.lost} of {counts.frames} frames"
        failed.append(Check("target", what, mend))
    return failed


def foretold_target(trial: Trial, config: Config) -> tuple[list[Check], list[str]]:
    """What a replay will say of the target: checks that will fail, and the note.

    By the same passes, which end as soon as nothing that follows can change the answer.
    """
    target = search_target(trial, config) if trial.spec.bbox is None else None
    # nothing behind perception has a part in the answer
    unplanned = config.grasps.model_copy(update={"source": "none"})
    alone = config.model_copy(update={"pipeline": "dynamic", "grasps": unplanned})
    counts, seen = FrameCounts(), None
    n = len(trial.pairs)
    for step in replay(trial, alone, target=target):
        counts = counts.with_frame(step)
        if seen is None and step.tracked.box is not None:
            seen = first_seen(step, trial, target, config)
        followed, measured = counts.frames - counts.lost, counts.frames - counts.predicted
        if seen is not None and measured > 1 and n - followed < LOST_AT_ONCE * n:
            break
    before = [check.name for check in trial.checks]
    checks = target_checks(
        counts, trial.spec.bbox is not None, seen, config.tracking.method, before
    )
    return checks, target_note(trial, target)
