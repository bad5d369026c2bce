"""Consistency checks by what a few frames of a trial show: depth's unit, the camera's poses.

Those of camera and scene: a camera that moves by a known way past things that stand still, or that
move evenly, sees them move by that way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dgeval.recording.camera_motion import moved_pairs
from dgeval.recording.camera_poses import wrong_poses
from dgeval.recording.check import Check
from dgeval.recording.depth_unit import wrong_unit
from dgeval.recording.frame import Frame
from dgeval.recording.frame_reader import FrameReader, LostFrames
from dgeval.recording.pairing import Pair
from dgeval.recording.scene_motion import (
    CONTRADICTS,
    NOT_QUITE,
    Correction,
    corrections,
    scene_steps,
    seeming_motion,
)

SAMPLED = 12  # frames of a trial that are looked at
UNITS_M = (1.0, 1e-2, 1e-3, 1e-4, 2.5e-4)  # m per unit of depth, of cameras in use
NEAR_UNIT = 0.15  # in the logarithm; a measured unit so near to one of them is that one


def frame_checks(
    reader: FrameReader, approach: tuple[Pair, ...], is_integer: bool
) -> tuple[list[Check], str]:
    """The checks that fail, and a note, "" without, on what is near to failing.

    approach: pairs before the hand lifts what it holds, which then moves with the camera; a few are
    looked at. is_integer: whether depth is recorded in whole numbers.
    """
    at = np.unique(np.linspace(0, len(approach) - 1, SAMPLED).astype(int))
    lost = LostFrames([])
    frames = list(replace(reader, pairs=tuple(approach[k] for k in at), lost=lost).frames())
    if not frames:
        mend = "see encodings and sizes in `dgeval inspect`"
        return [Check("frames", damage.what, mend) for damage in lost.damage], ""
    by_depth = _against_depth(reader, frames, is_integer)
    if any(check.name == "depth_unit" for check in by_depth):
        return by_depth, ""
    by_pictures, note = _against_pictures(reader, frames, is_integer)
    # wrong depth contradicts the poses too, and is the better answer where it explains everything
    if by_depth and not any(check.name != "camera_poses" for check in by_pictures):
        return by_depth, ""
    return by_pictures, note


def _against_depth(reader: FrameReader, frames: Sequence[Frame], is_integer: bool) -> list[Check]:
    """Whether depth can be metres, and the camera's poses those of its optical frame, by depth."""
    pairs_moved = moved_pairs(frames)
    found = wrong_unit(frames, pairs_moved)
    if found is not None:
        return [_unit_check(reader, is_integer, *found)]
    robot = reader.robot
    if robot.base_frame is None:
        return []
    what = wrong_poses(pairs_moved, robot.tree, robot.base_frame, robot.camera_frame)
    mend = "is it the optical frame (frames.camera), is the hand-eye calibration right, and are "
    mend += "the camera's stamps on the robot's clock (clock.colour.offset_ns)?"
    return [] if what is None else [Check("camera_poses", what, mend)]


def _unit_check(reader: FrameReader, is_integer: bool, what: str, factor: float) -> Check:
    """That depth must be `factor` times as large. what: by which it shows."""
    given = reader.camera.depth_scale
    stated = "" if given is None else f" with a scale of {given:g}"
    return Check("depth_unit", f"{what}{stated}", _unit_mend(reader, is_integer, factor))


def _unit_mend(reader: FrameReader, is_integer: bool, factor: float) -> str:
    used = reader.camera.depth_scale or (1e-3 if is_integer else 1.0)
    scale = used * factor
    near = min(UNITS_M, key=lambda unit: abs(np.log(unit / scale)))
    is_near = abs(np.log(near / scale)) < NEAR_UNIT and near != used
    proposed = near if is_near else scale
    return f"set calibration.depth_scale, in m per unit (probably {proposed:.2g})"


def _correction(reader: FrameReader, is_integer: bool, c: Correction) -> tuple[str, str, str]:
    """The check's name, what would fit, and the setting that makes it so."""
    if c.factor != 1.0:
        mend = _unit_mend(reader, is_integer, c.factor)
        return "depth_unit", f"depth {c.factor:.2f} times as large", mend
    if c.focal != 1.0:
        k = reader.camera.intrinsics
        numbers = (k.fx * c.focal, k.fy * c.focal, k.cx, k.cy)
        given = ", ".join(f"{v:.6g}" for v in numbers)
        mend = f"give the picture's own camera_info, or --set 'calibration.intrinsics=[{given}]'"
        return "intrinsics", f"focal lengths {c.focal:.2f} times as large", mend
    offset_m = reader.camera.depth_offset_m + c.farther_m
    way = "farther away" if c.farther_m > 0 else "nearer"
    mend = f"calibrate the depth camera, or --set calibration.depth_offset_m={offset_m:g}"
    return "depth_offset", f"depth {abs(c.farther_m) * 1000:.0f} mm {way}", mend


def _against_pictures(
    reader: FrameReader, frames: Sequence[Frame], is_integer: bool
) -> tuple[list[Check], str]:
    """Whether the camera's poses and depth fit what its pictures show, and a note, "" without,
    where they hardly do.
    """
    steps = scene_steps(frames)
    share = seeming_motion(steps)
    if share is None:
        return [], ""
    what = (
        f"by the poses of {reader.robot.camera_frame!r} what the pictures show moves along with "
        f"the camera, by {share:.0%} of its way"
    )
    found = [_correction(reader, is_integer, c) for c in corrections(steps, share)]
    if found:
        name, _, _ = found[0]
        other = " or ".join(dict.fromkeys(to for _, to, _ in found))
        mend = "; or ".join(dict.fromkeys(line for _, _, line in found))
        which = "a length that you know tells which: " if len(found) > 1 else ""
        return [Check(name, f"{what}, and stays where it is with {other}", which + mend)], ""
    if share <= NOT_QUITE:
        return [], ""
    if share <= CONTRADICTS:
        causes = "the hand-eye calibration, a joint's scale, the principal point (was the picture "
        causes += "cut?) or the time of pictures or joint states"
        return [], f"{what}: {causes} is not quite right"
    mend = (
        "are the pictures mirrored or turned, is the hand-eye calibration right, and have the "
        "joints above the camera the description's names, signs and units?"
    )
    return [Check("camera_poses", what, mend)], ""
