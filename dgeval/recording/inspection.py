"""The summary of a recording: contents, faults, and which questions it can answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dgeval.config import Config
from dgeval.errors import DgevalError, UnreadableError
from dgeval.recording.check import Check
from dgeval.recording.containers.container import sha256_of
from dgeval.recording.containers.opening import open_container
from dgeval.recording.contract import (
    BELIEF_PREFIX,
    GIVE_A_LABEL,
    GRASP_TOPIC,
    TARGET_TOPIC,
    TRUTH_PREFIX,
)
from dgeval.recording.manifest import TrialSpec, find_trials
from dgeval.recording.pairing import pair_images
from dgeval.recording.robot import RobotStates, robot_states
from dgeval.recording.roles import Roles, find_roles
from dgeval.recording.scan import Scan, add_to_stamps, scan
from dgeval.recording.trials import Trial, open_trial
from dgeval.robots.hand import KnownHand

Foretell = Callable[[Trial, Config], tuple[list[Check], list[str]]]


def inspect_recording(
    path: Path, config: Config, foretell: Foretell | None = None
) -> dict[str, Any]:
    """A summary for JSON: file, damage, topics, roles, timing, events, notes, answers, checks that
    fail, what nothing in it tests, and what `replay` will say.

    foretell: gives the checks and notes that only a replay's own stages tell. UnreadableError,
    UsageError.
    """
    specs = find_trials([path], config.roles.events)
    closed = _that_cant_be_opened(specs)
    first = next((spec for spec in specs if spec.id not in closed), specs[0])
    recording = first.recording
    opened = open_container(recording, first.parts)
    scanned = scan(opened, config.roles.events)
    add_to_stamps(scanned, config.clock.topics)
    roles = find_roles(scanned, config.roles)
    robot: RobotStates | None = None
    robot_error = None
    try:
        robot = robot_states(scanned, roles, config)
    except DgevalError as error:
        robot_error = str(error)
    files = list(first.parts) or [recording]
    if recording.is_dir():
        files = [p for p in recording.iterdir() if p.is_file()]
    out: dict[str, Any] = {
        "file": str(recording),
        "kind": opened.container.kind,
        "bytes": sum(p.stat().st_size for p in files),
        "sha256": sha256_of(recording, first.parts),
        "checksums": opened.container.checksums,
        "damage": [*closed.values(), *(str(d) for d in opened.damage)],
        "topics": [_topic(scanned, name) for name in sorted(opened.topics)],
        "roles": _roles(scanned, roles, robot),
        "timing": _timing(scanned, roles, config),
        "events": [{"t_ns": e.t_ns, "event": e.kind, **e.fields} for e in scanned.events],
        "notes": [*(() if robot is None else robot.notes), *([robot_error] if robot_error else [])],
    }
    if len(specs) > 1:
        of = "the first that can be opened" if closed else "the first"
        out["notes"].insert(0, f"{len(specs)} trials; this is of {of}, {first.id}")
    trial = _trial(first, config)
    out["answers"] = _answers(out, roles, robot, trial)
    if isinstance(trial, Trial):
        for event in out["events"]:
            event["after_s"] = round((event["t_ns"] - trial.pairs[0].t_ns) * 1e-9, 3)
    later: tuple[list[Check], list[str]] = ([], [])
    if foretell is not None and isinstance(trial, Trial):
        later = foretell(trial, config)
    out["checks"], out["replay"], notes = _replay_preview(trial, *later)
    out["notes"] += [n for n in notes if n not in out["notes"]]
    out["untested"] = [] if isinstance(trial, DgevalError) else list(trial.untested)
    return out


def _trial(spec: TrialSpec, config: Config) -> Trial | DgevalError:
    """A trial as `replay` opens it, or why it is refused."""
    try:
        return open_trial(spec, config)
    except DgevalError as error:
        return error


def _replay_preview(
    trial: Trial | DgevalError, checks_later: list[Check], notes_later: list[str]
) -> tuple[list[dict[str, str]], str, list[str]]:
    """The checks that fail, what `replay` will say first, and its notes."""
    if isinstance(trial, DgevalError):
        return [], f"refused: {trial}", []
    failed = (*trial.checks, *checks_later)
    checks = [{"name": c.name, "what": c.what, "mend": c.mend} for c in failed]
    close = (
        trial.close.missing
        or {
            "event": "the close is recorded",
            "command": "the close is a command to the gripper",
            "joints": "the close is inferred from the fingers",
            "width": "the close is inferred from the gripper's width",
            "manifest": "the close is given",
            None: "the fingers never close",
        }[trial.close.source]
    )
    return checks, f"{len(trial.pairs)} frames; {close}", [*trial.notes, *notes_later]


def _that_cant_be_opened(specs: Sequence[TrialSpec]) -> dict[str, str]:
    """By trial, why its recording can't be opened; nothing of a single one, which then says so."""
    why: dict[str, str] = {}
    for spec in specs if len(specs) > 1 else ():
        try:
            open_container(spec.recording, spec.parts)
        except UnreadableError as error:
            why[spec.id] = str(error)
    return why


def _topic(scanned: Scan, name: str) -> dict[str, Any]:
    topic = scanned.opened.topics[name]
    header, log = (
        scanned.times[name].arrays() if name in scanned.times else (np.zeros(0, np.int64),) * 2
    )
    out: dict[str, Any] = {"name": name, "type": topic.type, "count": len(log)}
    if len(log) > 1:
        gaps = np.diff(log) * 1e-9
        span = float(log[-1] - log[0]) * 1e-9
        out.update(
            rate_hz=round((len(log) - 1) / span, 3) if span > 0 else None,
            largest_gap_s=round(float(gaps.max()), 4),
        )
        is_stamped = header > 0 if len(header) == len(log) else np.zeros(len(log), bool)
        if len(header) == len(log) and not is_stamped.any():
            out["unstamped"] = True
        if is_stamped.sum() > 1 and np.ptp(header[is_stamped]) > 0:
            header, log = header[is_stamped], log[is_stamped]
            span = float(log[-1] - log[0]) * 1e-9
            # recorder time less header time, s: a straight line through it gives offset and drift,
            # and what is left of it is jitter
            late = (log - header) * 1e-9
            x = (log - log[0]) * 1e-9
            slope, offset = np.polyfit(x, late - late[0], 1) if span > 0 else (0.0, 0.0)
            out.update(
                recorder_delay_s=round(float(offset + late[0]), 6),
                drift_ppm=round(float(slope) * 1e6, 1),
                jitter_s=round(float(np.std(late - late[0] - offset - slope * x)), 6),
            )
    head = scanned.images.get(name)
    if head:
        out.update(
            image=f"{head.width}x{head.height} {head.encoding}",
            frame_id=head.frame_id,
            stated=head.format,
        )
    if scanned.undecodable.get(name):
        out["undecodable"] = scanned.undecodable[name]
    return out


def _roles(scanned: Scan, roles: Roles, robot: RobotStates | None) -> dict[str, Any]:
    out: dict[str, Any] = {
        r: getattr(roles, r) for r in ("colour", "depth", "intrinsics", "hand_joints")
    }
    out["target"] = list(roles.target) or None
    camera = palm = None
    if robot is not None:
        if robot.base_frame is not None:
            camera = f"{robot.base_frame} → {robot.camera_frame}"
        palm = robot.palm_frame
    out["camera_pose"] = camera
    out["hand_pose"] = palm
    out["description"] = (
        "recorded or configured" if robot is not None and robot.description else None
    )
    out["hand"] = None if robot is None or robot.hand is None else robot.hand.told
    out["events"] = "recorded" if scanned.events else None
    out["belief"] = sorted(t for t in scanned.opened.topics if t.startswith(BELIEF_PREFIX)) or None
    out["truth"] = sorted(t for t in scanned.opened.topics if t.startswith(TRUTH_PREFIX)) or None
    if roles.passed_over:
        out["passed_over"] = roles.passed_over
    return out


def _timing(scanned: Scan, roles: Roles, config: Config) -> dict[str, Any]:
    if roles.colour is None or roles.depth is None:
        return {}
    out: dict[str, Any] = {}
    pairing = pair_images(scanned, roles.colour, roles.depth, config)
    colour_ns, depth_ns, pairs = pairing.colour_ns, pairing.depth_ns, pairing.indices
    for role, stamps in (("colour", colour_ns), ("depth", depth_ns)):
        faults = pairing.faults[role]
        out[f"{role}_stamps"] = {
            "used": len(stamps),
            "zero": faults.zero,
            "backward": faults.backward,
            "ahead": faults.ahead,
            "duplicate": faults.duplicate,
            "jump": faults.jump,
        }
    skew = np.array([int(depth_ns[d]) - int(colour_ns[c]) for c, d in pairs]) * 1e-9
    out.update(
        tolerance_s=pairing.tolerance_ns * 1e-9,
        pairs=len(pairs),
        unmatched_colour=len(colour_ns) - len(pairs),
        unmatched_depth=len(depth_ns) - len(pairs),
    )
    if len(skew):
        out.update(skew_median_s=float(np.median(skew)), skew_largest_s=float(np.abs(skew).max()))
        if abs(float(np.median(skew))) > 0.002:
            proposed = -round(float(np.median(skew)) * 1e9)
            out["proposal"] = (
                f"clock.depth.offset_ns = {proposed} would centre depth on colour; "
                "nothing is applied by itself"
            )
    return out


def _answers(
    out: dict[str, Any],
    roles: Roles,
    robot: RobotStates | None,
    trial: Trial | DgevalError,
) -> list[dict[str, Any]]:
    """Each question, whether this recording can answer it, what is missing, and what an answer
    depends on.
    """

    def answer(question: str, missing: list[str], provided: str = "") -> dict[str, Any]:
        named = list(dict.fromkeys(missing))
        return {
            "question": question, "can": not missing, "missing": named, "provided": provided
        }  # fmt: skip

    images = [
        n
        for n, v in (
            ("colour", roles.colour),
            ("depth", roles.depth),
            ("intrinsics", roles.intrinsics),
        )
        if v is None
    ]
    if not images and not out["timing"].get("pairs"):
        images = ["colour and depth that pair up in time"]
    pose = [] if robot is not None and robot.base_frame else ["camera_pose"]
    failed = {c.name for c in trial.checks} if isinstance(trial, Trial) else set[str]()
    if failed & {"poses", "camera_poses"}:
        pose = ["camera poses that can be used"]
    if failed & {"depth_unit", "depth_offset", "intrinsics", "frames"}:
        images = ["depth and intrinsics that can be used"]
    hand = [] if robot is not None and robot.palm_frame else ["hand_pose"]
    geometry: list[str] = []
    if robot is None or robot.description is None:
        geometry = ["a robot description"]
        if robot is None or not robot.samples:
            geometry = ["joint states of the hand", *geometry]
    elif isinstance(robot.hand_found, str):
        geometry = [f"a hand ({robot.hand_found})"]
    # inferred closes count, and a hand that is known not to have closed
    known = isinstance(trial, Trial) and trial.close.missing is None
    closed = [] if known else ["a close event"]
    said = isinstance(trial, Trial) and trial.events.label() is not None
    label = [] if said else ["a label event"]
    if not isinstance(trial, Trial):  # what is marked is known with the trial
        closed = label = ["a trial that can be opened"]
        images = images or closed
    poses = trial.scan.poses if isinstance(trial, Trial) else {}
    presses = robot is not None and any(e for s in robot.samples for e in s.efforts.values())
    seen = "the object is seen after the lift, as neither a label nor efforts say how it ended; "
    seen += f"else {GIVE_A_LABEL}"
    belief = [topic for topic in (GRASP_TOPIC, TARGET_TOPIC) if len(poses.get(topic, ())) < 2]
    own_hand = robot.hand if robot is not None else None
    plans = isinstance(own_hand, KnownHand) and own_hand.grasp_network == "ffhnet"
    grasp = [] if plans or poses.get(GRASP_TOPIC) else ["a grasp in the log"]
    return [
        answer("where is the target in the camera, frame by frame", images),
        answer("how does it move in the base frame", images + pose),
        answer(
            "what would the controller have commanded",
            images + pose + hand + grasp,
        ),
        answer("how did it end, by an operator's word", label),
        answer(
            "why did it fail",
            images + pose + hand + geometry + closed,
            "" if said or presses else seen,
        ),
        answer(
            "which part of the robot's own belief is to blame",
            images + pose + hand + closed + belief,
        ),
    ]
