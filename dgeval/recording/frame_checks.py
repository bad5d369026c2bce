"""Consistency checks by what a few frames of a trial show: depth's unit, the camera's poses.

Those of camera and scene: a camera that moves by a known way past things that stand still, or that
move evenly, sees them move by that way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dgeval.config import ClockConfig
from dgeval.geometry import Array, pose_from_matrix
from dgeval.recording.camera_motion import moved_pairs
from dgeval.recording.camera_poses import wrong_poses
from dgeval.recording.check import Check, Findings
from dgeval.recording.closing_motion import finger_ends
from dgeval.recording.depth_edges import CUT, DepthOff, depth_off
from dgeval.recording.depth_unit import bytes_swapped, cut_at, inverse_fits, is_inverse, wrong_unit
from dgeval.recording.frame import Frame
from dgeval.recording.frame_reader import FrameReader, LostFrames
from dgeval.recording.hand_seen import HandSeen, hand_seen
from dgeval.recording.pairing import Pair
from dgeval.recording.robot import states_period_s
from dgeval.recording.scene_corrections import corrections, poses_then
from dgeval.recording.scene_motion import (
    CONTRADICTS,
    NOT_QUITE,
    Correction,
    SceneStep,
    scene_steps,
    seeming_motion,
)

SAMPLED, SAMPLED_LATER = 12, 6  # frames of a trial that are looked at, before and after a lift
UNITS_M = (1.0, 1e-2, 1e-3, 1e-4, 2.5e-4)  # m per unit of depth, of cameras in use
MUST_TELL_BESIDE = 0.034  # of the width, by which depth beside colour fails; less is a note; ours
MUST_TELL_S = 0.04  # s, from which on a delay fails the check; less is a note; ours
MUST_TELL_M = 0.012  # m, by which the hand is seen off, and fails; less is a note; ours
HARDLY_A_MOUNT_M = 0.03  # m; farther off is seldom an error of calibration alone; ours
NAMED_M = 0.002  # m; less along one axis is not named
HAND_UNTESTED = (
    "where the camera is to the hand, and how its fingers stand (no depth shows enough of the hand)"
)
CAMERA_UNTESTED = (
    "which way the camera looks, its clock and intrinsics, depth's scale (the camera hardly moves, "
    "or past hardly any texture)"
)
# share of the period of the robot's states, below which a delay may come from bridging them; ours
BRIDGED = 0.5
NEAR_UNIT = 0.15  # in the logarithm; a measured unit so near to one of them is that one


def frame_checks(
    reader: FrameReader,
    approach: tuple[Pair, ...],
    later: tuple[Pair, ...],
    is_integer: bool,
    clock: ClockConfig,
) -> Findings:
    """What a few frames of a trial show.

    approach, later: pairs before and after the hand lifts what it holds, which then moves with the
    camera; a few of each are looked at. is_integer: whether depth is recorded in whole numbers.
    clock: as it is set.
    """
    chosen = [*_few(approach, SAMPLED), *_few(later, SAMPLED_LATER)]
    lost = LostFrames([])
    seen = list(replace(reader, pairs=tuple(chosen), lost=lost).frames())
    ends_ns = approach[-1].t_ns
    frames = [frame for frame in seen if frame.t_ns <= ends_ns]
    if not frames:
        mend = "see encodings and sizes in `dgeval inspect`"
        return Findings([Check("frames", damage.what, mend) for damage in lost.damage])
    beside = depth_off(frames, reader.camera.depth_shrunk)
    what, mend = ("", "") if beside is None else _beside(beside)
    if beside is not None and (beside.turned or beside.share >= MUST_TELL_BESIDE):
        return Findings([Check("alignment", what, mend)])
    found = _of_camera(reader, frames, is_integer, clock)
    notes = [what and f"{what}: {mend}", *found.notes, _cut(frames)]
    notes = [text for text in notes if text]
    if found.failed:
        return Findings(found.failed, notes)
    description = reader.robot.description
    hand = HandSeen(False) if description is None else hand_seen(seen, description.outlines)
    failed = []
    if hand.hidden and (ends := sorted(set(finger_ends(reader.robot)) & set(hand.hidden))):
        notes.append(
            f"depth shows the hand, but not {', '.join(ends)}: how these fingers stand is as their "
            "joint states say, and nothing tests it"
        )
    if hand.is_off:
        check = _hand_check(hand, reader, seen[0].t_ns)
        if hand.link or np.linalg.norm(hand.shift) >= MUST_TELL_M:
            failed.append(check)
        else:
            notes.append(f"{check.what}; {check.mend}")
    untested = [*found.untested, *([] if hand.is_told else [HAND_UNTESTED])]
    return Findings(failed, notes, untested)


def _cut(frames: list[Frame]) -> str:
    """A note on depth that ends at one value; "" where it doesn't."""
    found = cut_at(frames)
    if found is None:
        return ""
    return (
        f"{found[1]:.0%} of the depth readings are exactly {found[0]:.3f} m, and none is farther: "
        "if depth is cut there, all that is farther is taken for nearer than it is; "
        "record it uncut, or with 0 in its place"
    )


def stamps_fit(reader: FrameReader, pairs: tuple[Pair, ...], later_s: float) -> bool:
    """Whether what the pictures show fits the camera's poses as stamped, and not `later_s` later.

    False too where it can't be told: no texture, a camera that moves evenly, or no poses then.
    """
    chosen = replace(reader, pairs=tuple(_few(pairs, SAMPLED)), lost=LostFrames([]))
    steps = scene_steps(list(chosen.frames()))
    share = seeming_motion(steps)
    if share is None or share > NOT_QUITE:
        return False
    then = poses_then(steps, reader.robot.T_base_camera, later_s)
    moved = [replace(step, T_base_a=T_a, T_base_b=T_b) for step, T_a, T_b in then]
    shifted = seeming_motion(moved)
    return shifted is not None and shifted > CONTRADICTS


def _few(pairs: tuple[Pair, ...], count: int) -> list[Pair]:
    """At most so many of them, evenly."""
    if not pairs:
        return []
    return [pairs[k] for k in np.unique(np.linspace(0, len(pairs) - 1, count).astype(int))]


def _hand_check(off: HandSeen, reader: FrameReader, t_ns: int) -> Check:
    """That the hand is seen elsewhere, or a link of it is not seen, and what mends it."""
    if off.link:
        what = f"depth shows what lies behind {off.link!r} where {off.through:.0%} of it should "
        what += "be seen, and the rest of the hand in its place"
        mend = "is it another hand's description (calibration.description), has a joint another "
        return Check(
            "hand_seen",
            what,
            mend + "sign, zero or unit in the log, or does the driver fill holes in depth?",
        )
    words = (("right", "left"), ("down", "up"), ("farther away", "nearer"))
    told = [
        f"{abs(m) * 1000:.0f} mm {plus if m > 0 else minus}"
        for m, (plus, minus) in zip(off.shift, words, strict=True)
        if abs(m) >= NAMED_M
    ]
    what = f"depth shows the hand {', '.join(told)} in the picture from where the camera's pose, "
    what += "the joints and the description put it"
    mend = "calibrate anew where the camera is on the robot (hand-eye), or in the room"
    mend += _shifted_mount(off.shift, reader, t_ns)
    if np.linalg.norm(off.shift) >= HARDLY_A_MOUNT_M:
        mend += "; or is it another hand's description (calibration.description)?"
    return Check("hand_seen", what, mend)


def _shifted_mount(shift: Array, reader: FrameReader, t_ns: int) -> str:
    """The setting that puts the camera where the hand is seen in its place, shift (3,) m by its
    axes; "" where depth's own frame would have to be moved too.
    """
    tree, camera = reader.robot.tree, reader.robot.camera_frame
    above = tree.parent(camera, t_ns)
    T = None if above is None else tree.lookup(above, camera, t_ns)
    if T is None or reader.camera.alignment is not None:
        return ""
    T_shifted = T.copy()
    T_shifted[:3, 3] -= T[:3, :3] @ shift
    numbers = ",".join(f"{v:.5g}" for v in pose_from_matrix(T_shifted))
    line = f"--set calibration.flange={above} --set 'calibration.T_flange_camera=[{numbers}]'"
    return f"; until then, for what is as far away as the hand: {line}"


def _beside(off: DepthOff) -> tuple[str, str]:
    """What is said of depth that does not lie on colour, and what mends it."""
    if off.turned == CUT:
        what = (
            "depth is smaller than its camera_info says, and its steps lie on colour's edges only "
        )
        return f"{what}{CUT}", "record the camera_info of the pictures that were cut out"
    if off.turned:
        what = f"steps of depth lie on colour's edges only where depth is turned, {off.turned}"
        return what, "record both pictures the same way round (a driver's flip or rotation?)"
    sides = (
        (abs(off.right), "right" if off.right > 0 else "left"),
        (abs(off.down), "below" if off.down > 0 else "above"),
    )
    where = " and ".join(f"{px:.0f} px {side}" for px, side in sides if px >= 1)
    mend = "is it registered to colour? Record the aligned depth, or depth's own frame and "
    mend += "camera_info; or are its stamps late (clock.depth.offset_ns)?"
    return f"steps of depth lie {where} of colour's edges", mend


def _of_camera(
    reader: FrameReader, frames: Sequence[Frame], is_integer: bool, clock: ClockConfig
) -> Findings:
    """What depth and camera show of each other."""
    by_depth = _against_depth(reader, frames, is_integer)
    if any(check.name == "depth_unit" for check in by_depth):
        return Findings(by_depth)
    steps = scene_steps(frames)
    share = seeming_motion(steps)
    if share is None:
        return Findings(by_depth, [], [CAMERA_UNTESTED])
    by_pictures, note = _against_pictures(reader, steps, share, is_integer, clock)
    # wrong depth contradicts the poses too, and is the better answer where it explains everything;
    # but depth alone can't tell a turntable from wrong poses, and texture can
    explained = by_depth and not any(check.name != "camera_poses" for check in by_pictures)
    if share > NOT_QUITE and explained:
        return Findings(by_depth)
    return Findings(by_pictures, [note] if note else [])


def _against_depth(reader: FrameReader, frames: Sequence[Frame], is_integer: bool) -> list[Check]:
    """Whether depth can be metres, and the camera's poses those of its optical frame, by depth."""
    pairs_moved = moved_pairs(frames)
    found = wrong_unit(frames, pairs_moved)
    robot = reader.robot
    wrong = None
    if robot.base_frame is not None and found is None:
        wrong = wrong_poses(pairs_moved, robot.tree, robot.base_frame, robot.camera_frame)
    by_motion = (found is not None or wrong is not None) and inverse_fits(frames)
    if by_motion or is_inverse(frames):
        by = "the camera's motion fits" if by_motion else "flat things are flat"
        what = f"{by} only where depth's readings are 1/m (inverse depth, disparity)"
        return [Check("depth_unit", what, "record depth in metres; no setting turns it over")]
    if found is not None:
        swapped_m = bytes_swapped(frames, reader.camera.depth_scale) if is_integer else None
        if swapped_m is not None:
            what = f"{found[0]}; with its bytes swapped it is {swapped_m:.2f} m, and smooth"
            mend = "is_bigendian or the bytes are wrong in the driver; no setting turns them"
            return [Check("depth_unit", what, mend)]
        return [_unit_check(reader, is_integer, *found)]
    return [] if wrong is None else [Check("camera_poses", *wrong)]


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
    return f"--set calibration.depth_scale={proposed:.2g} (m per unit; probably that)"


@dataclass(frozen=True)
class _Told:
    """The check's name, what would fit, and the setting that makes it so."""

    name: str
    fits: str
    mend: str


def _told(reader: FrameReader, is_integer: bool, clock: ClockConfig, c: Correction) -> _Told:
    if c.factor != 1.0:
        mend = _unit_mend(reader, is_integer, c.factor)
        return _Told("depth_unit", f"depth {c.factor:.2f} times as large", mend)
    if c.focal != 1.0:
        return _intrinsics(reader, f"focal lengths {c.focal:.2f} times as large", c)
    if any(c.principal):
        k = reader.camera.intrinsics
        right, down = c.principal[0] * k.fx, c.principal[1] * k.fy
        where = f"{abs(right):.0f} px farther {'right' if right > 0 else 'left'}"
        where += f" and {abs(down):.0f} px {'down' if down > 0 else 'up'}"
        return _intrinsics(reader, f"the principal point {where} (was the picture cut?)", c)
    if any(c.turned):
        degrees = np.degrees(np.linalg.norm(c.turned))
        mend = "calibrate it anew (hand-eye; calibration.T_flange_camera)"
        return _Told("camera_poses", f"the camera turned by {degrees:.1f}° in its mount", mend)
    if c.later_s != 0.0:
        ns = round(c.later_s * 1e9)
        mend = f"--set clock.colour.offset_ns={ns + clock.colour.offset_ns} --set "
        mend += f"clock.depth.offset_ns={ns + clock.depth.offset_ns}, or the robot's clock by as "
        way = "later" if ns > 0 else "earlier"
        fits = f"pictures taken {abs(ns) * 1e-6:.0f} ms {way} than they are stamped"
        return _Told("clocks", fits, mend + "much the other way")
    if c.depth_later_s != 0.0:
        ns = round(c.depth_later_s * 1e9)
        way = "later" if ns > 0 else "earlier"
        fits = f"depth taken {abs(ns) * 1e-6:.0f} ms {way} than it is stamped, colour as it is"
        mend = f"--set clock.depth.offset_ns={ns + clock.depth.offset_ns}"
        return _Told("clocks", fits, mend)
    offset_m = reader.camera.depth_offset_m + c.farther_m
    way = "farther away" if c.farther_m > 0 else "nearer"
    mend = f"calibrate the depth camera, or --set calibration.depth_offset_m={offset_m:g}"
    return _Told("depth_offset", f"depth {abs(c.farther_m) * 1000:.0f} mm {way}", mend)


def _intrinsics(reader: FrameReader, fits: str, c: Correction) -> _Told:
    k = reader.camera.intrinsics
    centre = (k.cx + c.principal[0] * k.fx, k.cy + c.principal[1] * k.fy)
    given = ", ".join(f"{v:.6g}" for v in (k.fx * c.focal, k.fy * c.focal, *centre))
    mend = f"give the picture's own camera_info, or --set 'calibration.intrinsics=[{given}]'"
    return _Told("intrinsics", fits, mend)


def _must_be_told(c: Correction, share: float) -> bool:
    """Whether what is wrong makes numbers wrong, and not only less exact. share: as it is seen.

    A turn and a middle have numbers enough to fit, by chance, what a person's hand holds: what they
    explain fails where nothing that is right shows as much.
    """
    if c.later_s != 0.0 or c.depth_later_s != 0.0:
        return max(abs(c.later_s), abs(c.depth_later_s)) >= MUST_TELL_S - 1e-9
    return share > CONTRADICTS or not (any(c.turned) or any(c.principal))


def _against_pictures(
    reader: FrameReader,
    steps: Sequence[SceneStep],
    share: float,
    is_integer: bool,
    clock: ClockConfig,
) -> tuple[list[Check], str]:
    """Whether the camera's poses and depth fit what its pictures show, and a note, "" without,
    where they hardly do. share: `seeming_motion` of the steps.
    """
    what = (
        f"by the poses of {reader.robot.camera_frame!r} what the pictures show moves along with "
        f"the camera, by {share:.1%} of its way"
    )
    fitting = corrections(steps, share, reader.robot.T_base_camera)
    period_s = states_period_s(reader.robot)
    if any(0.0 < abs(c.later_s) < BRIDGED * period_s for c in fitting):
        mend = "record the joint states, or /tf, at 50 Hz or more; no setting brings them back"
        states = f"the robot's states come every {period_s:.2f} s and are bridged in between"
        return [Check("poses", f"{what}; {states}", mend)], ""
    if fitting:
        found = [_told(reader, is_integer, clock, c) for c in fitting]
        other = ", or ".join(dict.fromkeys(told.fits for told in found))
        mend = "; or ".join(dict.fromkeys(told.mend for told in found))
        which = "what you know of the camera tells which: " if len(found) > 1 else ""
        check = Check(
            found[0].name, f"{what}, and would stay where it is with {other}", which + mend
        )
        if any(_must_be_told(c, share) for c in fitting):
            return [check], ""
        return [], f"{check.what}; {check.mend}"
    if share <= NOT_QUITE:
        return [], ""
    if share <= CONTRADICTS:
        causes = "the hand-eye calibration, a joint's scale, the intrinsics (was the picture "
        causes += "cut?), or the time of colour against depth"
        return [], f"{what}: one of these is not quite right: {causes}"
    mend = (
        "are the pictures mirrored or turned, is the hand-eye calibration right, and have the "
        "joints above the camera the description's names, signs and units?"
    )
    return [Check("camera_poses", what, mend)], ""
