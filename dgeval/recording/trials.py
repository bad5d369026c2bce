"""From a manifest entry to a trial that is ready to be read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dgeval.config import Config
from dgeval.errors import Damage, Place, UnreadableError, UsageError
from dgeval.geometry import Intrinsics
from dgeval.recording.camera import Camera, camera_of
from dgeval.recording.check import Check
from dgeval.recording.checks import (
    event_checks,
    events_elsewhere,
    failed_checks,
    pair_check,
    part_check,
    poses_elsewhere,
    unread_results,
)
from dgeval.recording.choices import (
    RecordedChoices,
    accepted_flags,
    choice_span,
    recorded_choices,
)
from dgeval.recording.clock_checks import clock_check
from dgeval.recording.closes import NOT_BY_THESE, CloseKnown, close_of, gripper_tracks
from dgeval.recording.containers.container import Opened, sha256_of
from dgeval.recording.containers.opening import open_container
from dgeval.recording.contract import ACCEPTED_TOPIC, CLOSE_EVENT, EventKind
from dgeval.recording.copies import COUNTS_TWICE
from dgeval.recording.events import Events, events_within, started_twice
from dgeval.recording.frame import Frame, MarkedThing
from dgeval.recording.frame_reader import FrameReader, LostFrames
from dgeval.recording.manifest import TrialSpec, find_trials
from dgeval.recording.pairing import Pair, Window, pair_images, stamp_notes, window_of
from dgeval.recording.recorded_target import RECORDED, UNDECODABLE, marks_of, unusable
from dgeval.recording.robot import RobotStates, robot_states
from dgeval.recording.roles import Roles, find_roles, image_topics
from dgeval.recording.scan import Scan, add_to_stamps, scan
from dgeval.recording.splits import of_another_computer

__all__ = ["Trial", "find_trials", "open_trial"]  # scripts outside the package find all three here


PAUSES = (
    "no trial's start is marked: one trial is taken between each two pauses of the recorder; if "
    "that is wrong: a manifest with start_ns and end_ns"
)


@dataclass(frozen=True)
class Trial:
    """One trial of a recording, by what each part of it knows.

    spec: the manifest entry, with the window's times filled in. sha256: of the whole recording.
    opened, scan, roles: the recording, what one pass over it kept, and which topic is what.
    notes: what was assumed or is wrong, for the trial's row. untested: what the recording is taken
    at its word for, as nothing in it shows whether it is right.
    """

    spec: TrialSpec
    sha256: str
    config: Config
    opened: Opened
    scan: Scan
    roles: Roles
    robot: RobotStates
    window: Window
    events: Events
    close: CloseKnown
    reader: FrameReader
    checks: tuple[Check, ...]
    notes: tuple[str, ...]
    untested: tuple[str, ...] = ()

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """The paired images of the window, in time order."""
        return self.window.pairs

    @property
    def n_unmatched_colour(self) -> int:
        return self.window.n_unmatched_colour

    @property
    def n_unmatched_depth(self) -> int:
        return self.window.n_unmatched_depth

    @property
    def camera(self) -> Intrinsics:
        return self.reader.camera.intrinsics

    @property
    def static_mask(self) -> NDArray[np.uint8] | None:
        """(H, W); depth is dropped where it is not 0. None without one."""
        return self.reader.camera.static_mask

    @property
    def n_undecodable_frames(self) -> int:
        """Frames that could not be used, added up over every pass of `frames` so far."""
        return self.reader.lost.count

    @property
    def damage(self) -> list[Damage]:
        """What is wrong with the recording; grows while it is read."""
        return self.opened.damage

    @cached_property
    def choices(self) -> RecordedChoices:
        """What the robot recorded of its own choice in this trial, and none of another's."""
        start_ns = self.spec.start_ns or self.pairs[0].t_ns
        end_ns = max(self.spec.end_ns or 0, self.pairs[-1].t_ns)
        marks = [event.t_ns for event in self.scan.events]
        return recorded_choices(self.scan, choice_span(start_ns, end_ns, marks), self.robot)

    def event_ns(self, kind: EventKind) -> int | None:
        """Time of the first event of a kind in this trial, ns."""
        return self.events.first_ns(kind)

    def frames(self) -> Iterator[Frame]:
        """Frames in the order of their stamps, index from 0; see `FrameReader.frames`."""
        return self.reader.frames()


def open_trial(spec: TrialSpec, config: Config, sha256: str | None = None) -> Trial:
    """Read the recording once, find roles, pair images, cut the trial's window out.

    sha256: of the recording where the caller knows it; else it is computed here. The trial's
    configuration is that of its scenario. UnreadableError, UsageError: what a part of a split
    recording lacks stands in the others, and the error says so.
    """
    try:
        return _opened(spec, config, sha256)
    except (UnreadableError, UsageError) as error:
        alone = spec.recording.exists() and not spec.parts
        for part in part_check(spec.recording) if alone else []:
            raise type(error)(f"{error.what}: {part.what}", error.place, part.mend) from error
        if alone and (beside := _beside(spec.recording)):
            hints = [text for text in (error.hint, beside) if text]
            raise type(error)(error.what, error.place, "; ".join(hints)) from error
        raise


def _beside(recording: Path) -> str:
    """In words, which file beside a recording may be of the same trial; "" for none."""
    other = of_another_computer(recording)
    if other is None:
        return ""
    both = f'recording = ["{recording.name}", "{other.name}"]'
    return (
        f"{other.name} beside it was recorded at the same time: if it is of the same trial, "
        f"an entry of a manifest puts them together: {both}"
    )


def _opened(spec: TrialSpec, config: Config, sha256: str | None) -> Trial:
    place, config = Place(str(spec.recording)), config.of_scenario(spec.scenario)
    opened = open_container(spec.recording, spec.parts)
    if sha256 is None:
        sha256 = sha256_of(spec.recording, spec.parts)
    if spec.sha256 is not None and spec.sha256.lower() != sha256:
        raise UnreadableError(
            f"sha256 is {sha256}, the manifest says {spec.sha256}: not the recording it names",
            place,
        )
    scanned = scan(opened, config.roles.events)
    add_to_stamps(scanned, config.clock.topics)
    clock, clock_note = scanned.recorder_clock, []
    if clock is not None:
        clock_note = [
            f"the recorder's clock is {clock.apart_s:+.2f} s from the stamps (simulated time?): "
            "what has no stamp is placed by it"
        ]
        if spec.window_is_log_time:
            start, end = spec.start_ns, spec.end_ns
            spec = replace(
                spec,
                start_ns=None if start is None else clock.stamp_ns(start),
                end_ns=None if end is None else clock.stamp_ns(end),
            )
    roles = find_roles(scanned, config.roles)
    colour, depth = image_topics(scanned, roles)
    robot = robot_states(scanned, roles, config)
    try:
        pairing = pair_images(scanned, colour, depth, config)
        window = window_of(pairing, spec, opened.damage)
    except UnreadableError as error:
        clocks, _ = clock_check(scanned, roles, config.clock)
        if clocks is None:
            raise
        raise UnreadableError(f"{error.what}: {clocks.what}", place, clocks.mend) from error
    camera = camera_of(
        scanned, colour, depth, roles, robot.tree, window.pairs[0].t_ns, config.calibration
    )
    _check_box(spec.bbox, camera.intrinsics, place)
    if spec.bbox is not None and camera.lens is not None:
        spec = replace(spec, bbox=camera.lens.box(spec.bbox))
    next_ns = spec.end_ns if spec.is_between_pauses else None
    marked = events_within(scanned.events, window.start_ns, window.end_ns, spec.end_ns, next_ns)
    first_ns = window.pairs[0].t_ns
    given = (
        _given(spec.close_ns, spec.close_after_s, first_ns),
        _given(spec.lift_ns, spec.lift_after_s, first_ns),
    )
    if None not in given and (given[1] or 0) <= (given[0] or 0):
        raise UsageError(
            "the lift that is given is not after the close that is given",
            place,
            "--lift is when the palm was told to rise, after --close",
        )
    grippers = gripper_tracks(scanned, robot)
    close = close_of(marked, robot, first_ns, window.pairs[-1].t_ns, *given, grippers)
    events = close.events
    lacks_robot = robot.base_frame is None and not spec.parts
    notes = [
        *opened.notes,
        *([f"this file is {spec.repeats}: {COUNTS_TWICE}"] if spec.repeats else []),
        *([PAUSES] if spec.is_between_pauses else []),
        *([beside] if lacks_robot and (beside := _beside(spec.recording)) else []),
        *clock_note,
        *roles.notes,
        *robot.notes,
        *camera.notes,
        *started_twice(scanned.events, window.start_ns, window.end_ns),
        *events.notes(),
        *([] if spec.label or events.label() else unread_results(scanned)),
        *_label_not_used(spec, events),
        *events_elsewhere(scanned),
        *poses_elsewhere(scanned, roles),
        *stamp_notes(window.stamp_faults),
    ]
    lost = LostFrames(opened.damage)
    codec = scanned.images[colour].codec
    things: dict[int, tuple[MarkedThing, ...]] = {}
    if config.tracking.method == RECORDED:
        things, told = _marked(scanned, roles.target, window.pairs, camera, robot, place)
        notes += told
    accepted: dict[int, bool] = {}
    if config.registration.accept == "recorded":
        accepted = accepted_flags(scanned, [pair.t_ns for pair in window.pairs])
        if not accepted:
            raise UsageError(
                f"registration.accept = 'recorded', but {ACCEPTED_TOPIC} is not recorded", place
            )
    reader = FrameReader(
        opened, colour, depth, window.pairs, camera, robot, lost, codec, things, accepted
    )
    close_ns = events.first_ns(CLOSE_EVENT)
    found = failed_checks(scanned, roles, robot, window, reader, config.clock, close_ns)
    checks = [*found.failed, *pair_check(window, config.sync)]
    checks += part_check(spec.recording, spec.parts)
    if close.source is None and any(c.name == "joints" for c in checks):
        close = replace(close, missing=close.missing or NOT_BY_THESE, motion_ns=None)
    if close.late:
        began = ((close.fingers_ns or first_ns) - first_ns) * 1e-9
        checks.append(Check("events", close.late, f"if the mark is late: --close {began:+.2f}"))
    checks += event_checks(marked, scanned, window, pairing.colour_ns, spec)
    notes += [*([close.note] if close.note else []), *found.notes, *(str(c) for c in checks)]
    return Trial(
        replace(spec, start_ns=window.start_ns, end_ns=window.end_ns),
        sha256,
        config,
        opened,
        scanned,
        roles,
        robot,
        window,
        events,
        close,
        reader,
        tuple(checks),
        tuple(notes),
        tuple(found.untested),
    )


def _label_not_used(spec: TrialSpec, events: Events) -> list[str]:
    """A note where a label is given and the log says the other."""
    recorded = events.label()
    if spec.label is None or recorded is None or recorded == spec.label:
        return []
    return [f"the recorded label, {recorded}, is not used: {spec.label} is given"]


def _given(t_ns: int | None, after_s: float | None, first_ns: int) -> int | None:
    """A time that a person gave, as a stamp, ns, or s after the first frame."""
    return first_ns + round(after_s * 1e9) if after_s is not None else t_ns


def _marked(
    scanned: Scan,
    topics: tuple[str, ...],
    pairs: tuple[Pair, ...],
    camera: Camera,
    robot: RobotStates,
    place: Place,
) -> tuple[dict[int, tuple[MarkedThing, ...]], list[str]]:
    """What the log marks, by the time of its picture, ns, and notes. What can't be decoded is
    damage of the recording. UnreadableError where nothing is marked.
    """
    unused: Counter[str] = Counter()
    marks = marks_of(scanned, topics, pairs, camera, robot, None, unused)
    broken = {what: n for what, n in unused.items() if what.endswith(UNDECODABLE)}
    for what, n in broken.items():
        scanned.opened.damage.append(
            Damage(f"{what}, in {n} messages with the target's mask", place)
        )
    others = [what for topic in topics if (what := unusable(scanned, topic, camera))]
    others += [f"{what} ({n})" for what, n in sorted(unused.items())]
    if marks:
        notes = [f"not used of what marks the target: {'; '.join(others)}"] if others else []
        if len(marks) < len(pairs):
            notes.append(
                f"{', '.join(topics)} marks something in {len(marks)} of {len(pairs)} frames; in "
                "the others the target counts as lost"
            )
        return {mark.t_ns: mark.things for mark in marks}, notes
    if not topics:
        why = "no topic holds masks of the picture's shape, detections or an object's poses"
        hint = "name the topic with --set roles.target=…"
    else:
        why = f"{', '.join(topics)} marks nothing that can be used"
        why += f": {'; '.join(others)}" if others else ""
        hint = "mend it in the log, or name another topic with --set roles.target=…"
    hint += ", or leave --set tracking.method=… out"
    raise UnreadableError(f"tracking.method = {RECORDED!r}: {why}", place, hint)


def _check_box(
    box: tuple[float, float, float, float] | None, camera: Intrinsics, place: Place
) -> None:
    """UsageError for a box that is no box, or outside the image."""
    if box is None:
        return
    x0, y0, x1, y1 = box
    if not (np.isfinite(box).all() and x0 < x1 and y0 < y1):
        raise UsageError(f"the box {box} is not x0, y0, x1, y1 with x0 < x1 and y0 < y1", place)
    if x1 <= 0 or y1 <= 0 or x0 >= camera.width or y0 >= camera.height:
        raise UsageError(
            f"the box {box} lies outside the image of {camera.width}x{camera.height}", place
        )
