"""Consistency checks of a recording: what would give numbers that are wrong without a sign.

Each failed check has a name, a sentence, and the setting that mends it. `inspect` and `replay` run
the same ones. A check that a team knows of is accepted by name (`checks.accept`); it stays a note.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dgeval.config import ClockConfig
from dgeval.recording.containers.opening import missing_parts
from dgeval.recording.contract import (
    CLOSE_EVENT,
    FAILURE_LABELS,
    LIFT_EVENT,
    SUCCESS_LABELS,
    label_of,
)
from dgeval.recording.events import Events
from dgeval.recording.frame_reader import FrameReader, LostFrames
from dgeval.recording.manifest import TrialSpec
from dgeval.recording.messages import TF_TYPES
from dgeval.recording.pairing import Window
from dgeval.recording.robot import RobotStates
from dgeval.recording.roles import Roles
from dgeval.recording.scan import Scan
from dgeval.recording.splits import unread_part

SAMPLED = 3  # frames whose depth is looked at
# m, between which the middle depth of a manipulation scene lies; ours
LEAST_DEPTH_M, MOST_DEPTH_M = 0.08, 10.0
MOST_CLOCKS_APART_S = 0.5  # s, between two roles' clocks; no transport takes that long; ours
CLOCKS_TOLD_S = 0.08  # s, from which on a note says it; ours
LEAST_POSES = 0.5  # share of the frames that must have a camera pose; ours
BESIDE_NS = 5_000_000_000  # ns, by which a command may lie before or after all images; ours
MOST_DROPPED = 0.1  # share of a stream whose stamps can't be used; ours


@dataclass(frozen=True)
class Check:
    """A check that failed: its name, what is wrong, and what mends it."""

    name: str
    what: str
    mend: str

    def __str__(self) -> str:
        return f"check {self.name}: {self.what}; {self.mend}"


def clock_check(scan: Scan, roles: Roles, clock: ClockConfig) -> tuple[Check | None, str]:
    """Whether the camera's clock is that of the robot, by each one's delay to the recorder.

    Also a note where it is off by less, as a slow transport is too; "" without.
    """
    camera = _delay(scan, roles.colour, clock.colour.offset_ns)
    tf = [n for n, t in scan.opened.topics.items() if t.type in TF_TYPES and "static" not in n]
    offsets = dict.fromkeys(tf, clock.camera_pose.offset_ns)
    offsets |= dict.fromkeys(roles.joints, clock.hand_joints.offset_ns)
    robots = {
        topic: d
        for topic, offset in sorted(offsets.items())
        if (d := _delay(scan, topic, offset)) is not None
    }
    if camera is None or not robots:
        return None, ""
    topic, robot = max(robots.items(), key=lambda item: abs(item[1] - camera))
    apart = camera - robot
    if abs(apart) <= CLOCKS_TOLD_S:
        return None, ""
    side = "behind" if apart > 0 else "ahead of"
    what = f"the camera's stamps are {abs(apart):.2f} s {side} those of {topic}, by the recorder"
    colour, depth = (round(apart * 1e9) + c.offset_ns for c in (clock.colour, clock.depth))
    mend = f"set clock.colour.offset_ns={colour} and clock.depth.offset_ns={depth}"
    if abs(apart) <= MOST_CLOCKS_APART_S:
        return None, f"{what}; if that is no delay of the images: {mend}"
    return Check("clocks", what, mend), ""


def _delay(scan: Scan, topic: str | None, offset_ns: int) -> float | None:
    """Median log time less header time of a topic, s; None where its stamps are not kept."""
    if topic is None or topic not in scan.times:
        return None
    header, log = scan.times[topic].arrays()
    if len(header) != len(log) or not len(log) or not header.any():
        return None
    return float(np.median(log - header - offset_ns)) * 1e-9


def failed_checks(
    scan: Scan,
    roles: Roles,
    robot: RobotStates,
    window: Window,
    reader: FrameReader,
    clock: ClockConfig,
) -> tuple[list[Check], list[str]]:
    """The checks that fail, and notes on what is near to failing."""
    failed: list[Check] = []
    clocks, note = clock_check(scan, roles, clock)
    if clocks is not None:
        failed.append(clocks)
    for role, faults in sorted(window.stamp_faults.items()):
        count = len(scan.times[getattr(roles, role)].log_ns)
        if faults.dropped > MOST_DROPPED * count:
            what = f"{faults.dropped} of {count} {role} images have stamps out of order"
            failed.append(
                Check("stamps", f"{what} and are not used", "see `dgeval inspect` for its clock")
            )
    if robot.conflict:
        mend = "name the camera's robot: --set frames.namespace=/NAME"
        failed.append(Check("robots", robot.conflict, mend))
    if robot.base_frame is not None:
        times = [p.t_ns for p in window.pairs]
        known = sum(robot.T_base_camera(t) is not None for t in times)
        if known < LEAST_POSES * len(times):
            what = f"the camera's pose in {robot.base_frame!r} is known in {known} of {len(times)}"
            mend = "look at the times of /tf or joint states in `dgeval inspect`; clock.*.offset_ns"
            failed.append(Check("poses", f"{what} frames", mend))
    unit = _depth_unit(reader)
    if unit is not None:
        failed.append(unit)
    return failed, [note] if note else []


def event_checks(
    events: Events, scan: Scan, colour_ns: NDArray[np.int64], spec: TrialSpec
) -> list[Check]:
    """Whether what was marked can be used: words that are not understood or contradict each other,
    and commands at times without images. What a person gave in the spec needs no mark.

    colour_ns: of all usable colour images.
    """
    failed: list[Check] = []
    mend = "give it with --label success|failure, or label in a manifest"
    known: dict[str, int] = {}
    for event, text in events.labels() if spec.label is None else ():
        label = label_of(text)
        if label is None:
            words = ", ".join((*SUCCESS_LABELS, *FAILURE_LABELS))
            what = f"the label {text!r} is not understood (understood are true, false, {words})"
            failed.append(Check("label", what, mend))
        else:
            known.setdefault(label, event.t_ns)
    if len(known) > 1:
        first, second = sorted(known, key=lambda label: known[label])
        later = (known[second] - known[first]) * 1e-9
        what = f"two labels contradict each other: {first}, and {second} {later:.2f} s later"
        failed.append(Check("label", what, mend))
    if len(colour_ns) and spec.close_ns is None and spec.close_after_s is None:
        first_ns, last_ns = int(colour_ns[0]) - BESIDE_NS, int(colour_ns[-1]) + BESIDE_NS
        for event in scan.events:
            if event.kind in (CLOSE_EVENT, LIFT_EVENT) and not first_ns <= event.t_ns <= last_ns:
                off = (event.t_ns - int(colour_ns[0])) * 1e-9
                what = f"a {event.kind} is marked {off:+.2f} s from the first image, outside of all"
                failed.append(
                    Check("events", what, "its t_ns is a stamp in ns; or give --close TIME")
                )
                break
    return failed


def part_check(recording: Path) -> list[Check]:
    """Whether the recording is a part of one that its recorder split, and the rest is not read."""
    gone = missing_parts(recording) if recording.is_dir() else []
    if gone:
        what = f"metadata.yaml lists {', '.join(gone)}, which is not in the folder"
        return [Check("parts", what, "copy the whole folder")]
    other = unread_part(recording)
    if other is None:
        return []
    return [
        Check(
            "parts",
            f"{other.name} beside it is a part of the same recording, and is not read",
            "give all parts, or their folder",
        )
    ]


def _depth_unit(reader: FrameReader) -> Check | None:
    """Whether the depth of the first frames can be metres."""
    quiet = replace(reader, lost=LostFrames([]))
    depths = [f.depth[f.depth > 0] for f in islice(quiet.frames(), SAMPLED)]
    readings = np.concatenate(depths) if depths else np.zeros(0)
    if not len(readings):
        return None
    middle = float(np.median(readings))
    if LEAST_DEPTH_M <= middle <= MOST_DEPTH_M:
        return None
    scale = reader.camera.depth_scale
    stated = "as the file says it" if scale is None else f"with calibration.depth_scale={scale:g}"
    factor = 1e-3 if middle > MOST_DEPTH_M else 1e3
    proposed = f"{(scale or 1.0) * factor:g}"
    return Check(
        "depth_unit",
        f"the middle depth of the first frames is {middle:.3g} m {stated}, which no scene has",
        f"set calibration.depth_scale, in m per unit (millimetres in floats: {proposed})",
    )
