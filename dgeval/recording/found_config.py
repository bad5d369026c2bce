"""The configuration that dgeval takes for a recording, as a file to edit."""

from __future__ import annotations

import json
from pathlib import Path

from dgeval.config import Config
from dgeval.geometry import Array, invert, transform
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import open_trial
from dgeval.robots.described_hand import DescribedHand


def found_config(path: Path, config: Config) -> str:
    """TOML for `--pipeline`: topics and frames as found, and how to mend the checks that fail.

    What can't be told is a comment. UnreadableError, UsageError where `replay` would refuse.
    """
    trial = open_trial(find_trials([path], config.roles.events)[0], config)
    roles, robot, camera = trial.roles, trial.robot, trial.reader.camera
    used = {
        "colour": roles.colour,
        "depth": roles.depth,
        "intrinsics": roles.intrinsics,
        "camera_pose": roles.camera_pose,
        "hand_pose": roles.hand_pose,
        "target": roles.target[0] if roles.target else None,
    }
    lines = [
        f"# What dgeval takes for {path.name}, to edit:",
        f"#   dgeval replay {path.name} --pipeline THIS.toml",
        "",
        "[roles]",
    ]
    for role, topic in used.items():
        without = "from tf, or joints and description" if role.endswith("_pose") else "none found"
        if role == "target":
            without = "no mask, detection or object's pose is recorded; it is looked for"
        lines.append(f"{role} = {_text(topic)}" if topic else f"# {role}: {without}")
        others = roles.passed_over.get(role)
        if others:
            lines.append(f"# {role} could also be: {', '.join(others)}")
    joints = ", ".join(roles.joints)
    lines.append(
        f"# hand_joints: all of {joints}, by joint name" if joints else "# hand_joints: none"
    )
    lines += ["", "[frames]", f"camera = {_text(robot.camera_frame)}"]
    for name, frame in (("base", robot.base_frame), ("palm", robot.palm_frame)):
        known = frame is not None and frame in robot.tree.frames()
        lines.append(f"{name} = {_text(frame)}" if known and frame else f"# {name}: none found")
    k = camera.intrinsics
    lines += [
        "",
        "[calibration]",
        f"# as recorded: intrinsics = [{k.fx:g}, {k.fy:g}, {k.cx:g}, {k.cy:g}]",
    ]
    if camera.depth_scale is not None:
        lines.append(f"depth_scale = {camera.depth_scale:g}  # m per unit")
    else:
        lines.append("# depth_scale: millimetres in whole numbers, metres in floats")
    if camera.depth_offset_m:
        lines.append(f"depth_offset_m = {camera.depth_offset_m:g}  # added to depth")
    hand = robot.hand_found
    lines += ["", "[hand]", f"# {hand if isinstance(hand, str) else hand.told}"]
    if isinstance(hand, DescribedHand):
        geometry = hand.geometry
        closed = zip(geometry.names, geometry.closed.tolist(), strict=True)
        listed = ", ".join(f"{_text(name)} = {value:.4g}" for name, value in closed)
        lines += [
            f"root = {_text(geometry.links.base)}",
            "# where the fingers go at a close that the trial does not show: the joints' limits",
            f"# closed = {{ {listed} }}",
            f"# close_s = {hand.close_s:g}",
            "# where held objects are, m, and how the hand comes to them, in the palm's frame",
            f"# centre = {_listed(transform(invert(hand.T_hand_palm), hand.centre[None])[0])}",
            f"# approach = {_listed(hand.T_hand_palm[:3, :3].T @ hand.approach)}",
        ]
    if trial.checks:
        names = json.dumps(sorted({c.name for c in trial.checks}))
        lines += ["", "[checks]", *(f"# {check}" for check in trial.checks), f"# accept = {names}"]
    return "\n".join(lines) + "\n"


def _listed(values: Array) -> str:
    """(n,) as a TOML array, to a tenth of a millimetre; no negative zeros."""
    return json.dumps([round(value, 4) + 0.0 for value in values.tolist()])


def _text(value: str | None) -> str:
    """A TOML string; JSON's are such."""
    return json.dumps(value, ensure_ascii=False)
