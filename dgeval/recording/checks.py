"""Consistency checks of a recording: what would give numbers that are wrong without a sign.

Each failed check has a name, a sentence, and the setting that mends it. `inspect` and `replay` run
the same ones. A check that a team knows of is accepted by name (`checks.accept`); it stays a note.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dgeval.config import ClockConfig, SyncConfig
from dgeval.recording.camera_poses import far_from_palm
from dgeval.recording.check import PART_CHECK, Check, Findings
from dgeval.recording.choices import unplaced, unscored
from dgeval.recording.clock_checks import (
    clock_check,
    clocks_apart,
    clocks_drift,
    move_camera,
    odd_clocks,
)
from dgeval.recording.containers.container import lacks_its_log
from dgeval.recording.containers.opening import missing_parts
from dgeval.recording.contract import (
    CANDIDATE_SCORES_TOPIC,
    CANDIDATES_TOPIC,
    CLOSE_EVENT,
    EVENT_KEY,
    EVENT_KINDS,
    FAILURE_LABELS,
    GIVE_A_LABEL,
    LIFT_EVENT,
    OWN_PREFIXES,
    SUCCESS_LABELS,
    TRIAL_END_EVENT,
    label_of,
)
from dgeval.recording.description_checks import other_hand
from dgeval.recording.events import Events
from dgeval.recording.frame_checks import SAMPLED, frame_checks, stamps_fit
from dgeval.recording.frame_reader import FrameReader
from dgeval.recording.frozen import frozen_streams
from dgeval.recording.joint_checks import joint_faults
from dgeval.recording.manifest import TrialSpec
from dgeval.recording.pairing import Window
from dgeval.recording.robot import NAMELESS, RobotStates
from dgeval.recording.roles import Roles
from dgeval.recording.scan import Scan
from dgeval.recording.splits import unread_part
from dgeval.recording.stamp_checks import stamp_checks

DRIFTS_S = 0.03  # s over a recording, that explain a scene that seems to move; ours
BY_MOTION = ("depth_unit", "depth_offset", "intrinsics", "camera_poses", "clocks")  # checks by it
MOSTLY = 0.5  # share of a topic's texts that must be events, to say so; ours
# of topics that may hold an outcome: words in their names, and their types
RESULT_WORDS = ("success", "result", "outcome", "failed", "failure", "grasped")
RESULT_TYPES = {f"std_msgs/msg/{kind}" for kind in ("Bool", "String", "Int32", "UInt8", "Int8")}
LEAST_POSES = 0.5  # share of the frames that must have a camera pose; ours
BESIDE_NS = 500_000_000  # ns, by which a command may lie before or after all images; ours
LONGEST_GAP_S = 1.0  # s, as long as velocity and model are carried on (`estimation`)
MOST_WORDS = 6  # that a sentence lists


def _by_a_drift(drift: str, checks: list[Check]) -> list[Check]:
    """The checks, without those that a clock that runs faster explains, and with the clock's."""
    explained = [check for check in checks if check.name in BY_MOTION]
    if not drift or not explained:
        return checks
    what = f"{drift} It would explain this: {explained[0].what}"
    others = [check for check in checks if check.name not in BY_MOTION]
    return [*others, Check("clocks", what, "mend the clock: no setting makes up for its rate")]


def failed_checks(
    scan: Scan,
    roles: Roles,
    robot: RobotStates,
    window: Window,
    reader: FrameReader,
    clock: ClockConfig,
    close_ns: int | None,
) -> Findings:
    """What all checks of a trial find. close_ns: of the trial."""
    failed: list[Check] = []
    approach = tuple(p for p in window.pairs if close_ns is None or p.t_ns <= close_ns)
    seen = approach if len(approach) >= SAMPLED else window.pairs
    clocks, note = clock_check(scan, roles, clock)
    apart = clocks_apart(scan, roles, clock)
    odd = odd_clocks(scan, roles, clock)
    told = apart is not None and (not odd or move_camera(odd, scan, robot))
    if clocks is not None and apart and told and stamps_fit(reader, seen, apart[1]):
        note = f"{clocks.what}; by what they show the stamps are right: they were logged late"
    elif clocks is not None:
        failed.append(clocks)
    failed += stamp_checks(scan, roles, window)
    failed += [*_gap(window), *_ends_early(scan, roles, window)]
    if clocks is None:
        failed += _states_missing(robot, window)
    is_stamped = all(scan.times[topic].arrays()[0].any() for topic in roles.joints)
    failed += [Check("joints", what, mend) for what, mend in joint_faults(robot, is_stamped)]
    other = other_hand(robot)
    if other is not None:
        mend = "is it another hand's description? Give the right one (calibration.description)"
        failed.append(Check("description", other, mend))
    failed += [Check("tree", *what) for what in robot.changed]
    if robot.conflict:
        mend = "name the camera's robot: --set frames.namespace=/NAME"
        failed.append(Check("robots", robot.conflict, mend))
    if robot.hands:
        named = ", ".join(robot.hands)
        what = f"of several hands ({named}) none carries the camera, and not one alone moves"
        mend = f"name the one that grasps: --set frames.palm={robot.hands[0]}"
        failed.append(Check("hands", what, mend))
    failed += _poses(scan, robot, window)
    if "poses" not in {check.name for check in failed}:
        mend = "it is not used; record that transform, or publish it in the base"
        failed += [Check("choices", what, mend) for what in unplaced(scan, robot)]
    if unscored(scan):
        what = f"no set of {CANDIDATES_TOPIC} has as many scores in {CANDIDATE_SCORES_TOPIC}"
        failed.append(
            Check("choices", what, "they are not used; publish the scores after each set")
        )
    failed += [
        Check("frozen", what, "what happens from there on is not seen; look at the driver")
        for what in frozen_streams(scan, roles, window, reader)
    ]
    assert roles.depth is not None
    later = window.pairs[len(seen) :]
    encoding = scan.images[roles.depth].encoding
    found = frame_checks(reader, seen, later, encoding != "32FC1", clock)
    against = _by_a_drift(clocks_drift(scan, roles, clock, DRIFTS_S), found.failed)
    failed += [check for check in against if check.name not in {c.name for c in failed}]
    if reader.camera.doubt:
        mend = "if so --set 'calibration.T_colour_depth=[0,0,0,0,0,0,1]', else the transform"
        failed.append(Check("cameras", reader.camera.doubt, mend))
    if roles.rival is not None:
        what = (
            f"{roles.rival} is another camera, and its frame has the same name as {roles.colour}'s"
        )
        failed.append(Check("cameras", what, "name one: --set roles.colour=… and roles.depth=…"))
    untested = found.untested if robot.palm_frame is not None else []
    return Findings(failed, [*([note] if note else []), *found.notes], untested)


def unread_results(scan: Scan) -> list[str]:
    """A note on topics that may say how the trial ended and are not read; none without."""
    listed = [
        f"{name} ({topic.type})"
        for name, topic in sorted(scan.opened.topics.items())
        if topic.type in RESULT_TYPES
        and any(word in name.lower() for word in RESULT_WORDS)
        and not name.startswith(OWN_PREFIXES)
    ]
    if not listed:
        return []
    what = f"{', '.join(listed)} may say how it ended, and is not read"
    return [f"{what}; if so: {GIVE_A_LABEL}, or label in a manifest"]


def events_elsewhere(scan: Scan) -> list[str]:
    """A note on topics that mostly say what an event may, where the topic of events has none."""
    if scan.events or scan.not_events:
        return []
    return [
        f"{n} of {count} messages of {topic} could be events, and are not read; if they are: "
        f"--set roles.events={topic}"
        for topic, (n, count) in sorted(scan.words.items())
        if n >= MOSTLY * count
    ]


def poses_elsewhere(scan: Scan, roles: Roles) -> list[str]:
    """A note on poses in the camera's frame that nothing uses, where the log marks no target: a
    pose estimator's, by whatever name. None without.
    """
    seen = {scan.images[t].frame_id for t in (roles.colour, roles.depth) if t in scan.images}
    used = {roles.camera_pose, roles.hand_pose, *roles.target}
    listed = [
        topic
        for topic, poses in sorted(scan.poses.items())
        if poses
        and poses[0].parent
        and poses[0].parent in seen
        and topic not in used
        and not topic.startswith(OWN_PREFIXES)
    ]
    if roles.target or not listed:
        return []
    what = f"{', '.join(listed)}: poses in the camera's frame, not read; if they are the target's"
    return [f"{what}: --set roles.target={listed[0]}"]


def _poses(scan: Scan, robot: RobotStates, window: Window) -> list[Check]:
    """Whether the camera's pose is known in most frames, and near the palm that it moves with."""
    if robot.base_frame is None:
        listed = robot.tree.frames()
        if robot.camera_frame != NAMELESS or NAMELESS in listed or not listed:
            return []
        what = "neither the images nor their camera_info have a frame_id: nothing says where the "
        mend = "record it, or name the camera's optical frame: --set frames.camera=…"
        return [Check("poses", f"{what}camera is on the robot", mend)]
    failed = []
    times = [p.t_ns for p in window.pairs]
    known = sum(robot.T_base_camera(t) is not None for t in times)
    if known < LEAST_POSES * len(times):
        what = f"the camera's pose in {robot.base_frame!r} is known in {known} of {len(times)}"
        mend = "look at the times of /tf or joint states in `dgeval inspect`; clock.*.offset_ns"
        unknown = _joints_without_states(robot)
        called = _called_otherwise(robot, unknown)
        if unknown:
            named = ", ".join(unknown[:MOST_WORDS])
            mend = f"no states are recorded of the joints above the camera: {named}"
            mend += f"; recorded are {', '.join(called)}: call them alike" if called else ""
            unread = [n for n, t in scan.opened.topics.items() if t.unread and "joint" in n]
            mend += f"; {', '.join(unread)} can't be read" if unread else ""
        failed.append(Check("poses", f"{what} frames", mend))
    if robot.palm_frame is not None:
        frames = robot.base_frame, robot.palm_frame, robot.camera_frame
        far = far_from_palm(robot.tree, *frames, times[:: max(1, len(times) // SAMPLED)])
        if far is not None:
            failed.append(Check("camera_poses", far, "mend the transform between them"))
    return failed


def _joints_without_states(robot: RobotStates) -> list[str]:
    """The joints above the camera in the description whose states nobody recorded."""
    if robot.description is None:
        return []
    tree = robot.tree
    above = [link for link in tree.ancestors(robot.camera_frame) if link in tree.computed]
    followed = [robot.description.joints[k].follows for k in above if k not in tree.moving]
    return sorted(name for name in followed if name not in robot.joints.times)


def _called_otherwise(robot: RobotStates, names: list[str]) -> list[str]:
    """The recorded joints whose names end as these do, after a prefix."""
    ends = tuple(f"{mark}{name}" for name in names for mark in "/_.:")
    return sorted(n for n in robot.joints.times if ends and n.endswith(ends))[:MOST_WORDS]


def _gap(window: Window) -> list[Check]:
    """Whether images are missing in mid-trial for longer than an estimate is carried on."""
    stamps = np.array([p.t_ns for p in window.pairs], dtype=np.int64)
    if len(stamps) < 3:
        return []
    steps = np.diff(stamps) * 1e-9
    k = int(np.argmax(steps))
    if steps[k] <= max(LONGEST_GAP_S, 5 * float(np.median(steps))):
        return []
    at = (stamps[k] - stamps[0]) * 1e-9
    what = f"no images for {steps[k]:.2f} s, from {at:+.2f} s on"
    return [Check("gap", what, "what happens there is not judged; look for the recorder's losses")]


def _ends_early(scan: Scan, roles: Roles, window: Window) -> list[Check]:
    """Whether the images stop and the robot goes on: in the trial, or up to the recording's end."""
    assert roles.colour is not None
    header, log = scan.times[roles.colour].arrays()
    robot = [scan.times[topic].arrays()[1] for topic in roles.joints]
    robot_ns = max((int(times.max()) for times in robot if len(times)), default=0)
    missing = (robot_ns - int(log.max())) * 1e-9  # by the recorder, whatever the clocks of stamps
    last_ns = int(header.max())
    ends = [e.t_ns for e in scan.events if e.kind == TRIAL_END_EVENT and e.t_ns >= last_ns]
    if ends:
        missing = min(missing, (min(ends) - last_ns) * 1e-9)
    if window.end_ns < last_ns or missing <= LONGEST_GAP_S:
        return []
    what = f"the images end {missing:.2f} s before the robot's states"
    return [Check("gap", what, "what happens there is not judged; look for the recorder's losses")]


def _states_missing(robot: RobotStates, window: Window) -> list[Check]:
    """Whether the joint states begin after, or end before, most of what the trial's images show."""
    times = [t for t in robot.joints.times.values() if t]
    if not times:
        return []
    first_ns, last_ns = min(t[0] for t in times), max(t[-1] for t in times)
    late = (first_ns - window.pairs[0].t_ns) * 1e-9
    early = (window.pairs[-1].t_ns - last_ns) * 1e-9
    told = [f"begin {late:.2f} s after the first image"] * (late > LONGEST_GAP_S)
    told += [f"end {early:.2f} s before the last image"] * (early > LONGEST_GAP_S)
    if not told:
        return []
    what = f"the joint states {' and '.join(told)}"
    mend = "where the robot is then, and whether it closes, is not known; record both all along"
    return [Check("gap", what, mend)]


def event_checks(
    events: Events, scan: Scan, window: Window, colour_ns: NDArray[np.int64], spec: TrialSpec
) -> list[Check]:
    """Whether what was marked can be used: words that are not understood or contradict each other,
    and commands at times without images. What a person gave in the spec needs no mark.

    colour_ns: of all usable colour images.
    """
    failed: list[Check] = []
    mend = f"give it with {GIVE_A_LABEL}, or label in a manifest"
    if scan.not_events:
        words = ", ".join(repr(text[:60]) for text in scan.not_events[:MOST_WORDS])
        what = f"{len(scan.not_events)} events are not understood: {words}"
        mend_words = f"understood are JSON with {EVENT_KEY!r} (its own t_ns in whole ns), or "
        failed.append(Check("events", what, mend_words + ", ".join(sorted(EVENT_KINDS))))
    known: dict[str, int] = {}
    for event, text in events.labels() if spec.label is None else ():
        label = label_of(text)
        if label is None:
            words = ", ".join((*SUCCESS_LABELS, *FAILURE_LABELS))
            what = f"the label {text!r} is not understood (understood are true, false, {words})"
            failed.append(Check("label", what, mend))
        else:
            known.setdefault(label, event.t_ns)
    closes = [e.t_ns for e in events if e.kind == CLOSE_EVENT]
    if closes and known and max(known.values()) < min(closes):
        before = (min(closes) - max(known.values())) * 1e-9
        what = f"the label is {before:.2f} s before the close: is it the trial's before?"
        failed.append(Check("label", what, mend))
    if len(known) > 1:
        first, second = sorted(known, key=lambda label: known[label])
        later = (known[second] - known[first]) * 1e-9
        what = f"two labels contradict each other: {first}, and {second} {later:.2f} s later"
        failed.append(Check("label", what, mend))
    given = {
        "close": (spec.close_ns, spec.close_after_s),
        "lift": (spec.lift_ns, spec.lift_after_s),
    }
    begins, ends = window.pairs[0].t_ns, window.pairs[-1].t_ns
    for name, (t_ns, after_s) in given.items():
        at = t_ns if after_s is None else begins + round(after_s * 1e9)
        if at is not None and not begins - BESIDE_NS <= at <= ends + BESIDE_NS:
            off, lasts = (at - begins) * 1e-9, (ends - begins) * 1e-9
            what = f"the {name} that is given, at {off:+.2f} s, is outside of the {lasts:.2f} s"
            failed.append(
                Check("events", f"{what} of the trial", "give +SECONDS after the first frame")
            )
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


def pair_check(window: Window, sync: SyncConfig) -> list[Check]:
    """Whether too many pictures have no partner, by the stream that has fewer of them: colour of
    60 Hz beside depth of 15 Hz loses nothing.
    """
    lone = {"colour": window.n_unmatched_colour, "depth": window.n_unmatched_depth}
    count = {role: n + len(window.pairs) for role, n in lone.items()}
    rarer = min(count, key=lambda role: count[role])
    if lone[rarer] <= sync.max_unmatched_share * count[rarer]:
        return []
    other = "depth" if rarer == "colour" else "colour"
    what = f"{lone[rarer]} of {count[rarer]} {rarer} images have no {other} image near enough in "
    mend = "are both recorded whole, and by one clock? sync.tolerance_s=… takes pictures farther "
    return [Check("pairs", what + "time", mend + "apart")]


def part_check(recording: Path, parts: tuple[Path, ...] = ()) -> list[Check]:
    """Whether the recording is a part of one that its recorder split, and the rest is not read.

    parts: those that are, where they are several.
    """
    gone = missing_parts(recording) if recording.is_dir() else []
    if gone:
        what = f"metadata.yaml lists {', '.join(gone)}, which is not in the folder"
        return [Check(PART_CHECK, what, "copy the whole folder")]
    given = parts or (recording,)
    files = sorted(recording.glob("*.db3")) if recording.is_dir() else given
    for file in files:
        if lacks_its_log(file):
            what = (
                f"{file.name} was recorded in SQLite's crash-safe mode, and there is neither a "
                f"metadata.yaml, which a recorder writes at its end, nor a {file.name}-wal"
            )
            mend = "copy the whole folder; if the recorder was killed and the -wal is lost, so "
            return [Check(PART_CHECK, what, mend + "are the last messages")]
    ends = dict.fromkeys((given[0], given[-1]))
    other = next((part for end in ends if (part := unread_part(end, given))), None)
    if other is None:
        return []
    return [
        Check(
            PART_CHECK,
            f"{other.name} beside it is a part of the same recording, and is not read",
            "give all parts, or their folder",
        )
    ]
