"""Catches: pictures that contradict the camera's poses, which depth over a flat table does not.

The scene is a textured plane, whose picture from any place is a homography, by closed form.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from dgeval.geometry import Array, Intrinsics, increment, invert
from dgeval.recording.frame import Frame
from dgeval.recording.scene_corrections import corrections
from dgeval.recording.scene_motion import (
    CONTRADICTS,
    LEAST_STEPS,
    NOT_QUITE,
    Correction,
    scene_steps,
    seeming_motion,
)
from tests.recording.recorders import COLOUR, DEPTH, JOINTS, Message, opened, write

CAMERA = Intrinsics(320, 240, 290.0, 290.0, 159.5, 119.5)
PERIOD_NS = 300_000_000
STEPS = 9
CELL_M = 0.004  # of the texture
LOOKS_DOWN = increment(np.array([0.0, 0.0, 0.0, np.radians(160.0), 0.0, 0.3]))


def texture(seed: int = 4) -> np.ndarray:
    """(600, 600) of soft random blots; CELL_M a pixel."""
    noise = np.random.default_rng(seed).normal(size=(600, 600)).astype(np.float32)
    soft = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return cv2.normalize(soft, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


TEXTURE = texture()


def camera_at(k: float) -> Array:
    """T_base_camera, m: down and sideways, on a curve."""
    T = LOOKS_DOWN.copy()
    T[:3, 3] = [0.1 * np.sin(0.6 * k), 0.05 * k - 0.2, 0.75 - 0.04 * k]
    return T


def frame_of(k: int, shift: Array, angle: float = 0.0) -> Frame:
    """Of the plane z = 0, whose texture has moved by `shift`, (2,) m, and turned by `angle`, rad,
    about a point beside the camera's way.
    """
    T = camera_at(k)
    K = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1.0]])
    T_camera_base = invert(T)
    cells = np.array([[CELL_M, 0, shift[0] - 1.2], [0, CELL_M, shift[1] - 1.2], [0, 0, 1.0]])
    c, s = np.cos(angle), np.sin(angle)
    axis = np.array([0.15, 0.1])
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turn[:2, 2] = axis - turn[:2, :2] @ axis
    cells = turn @ cells
    to_camera = np.column_stack([T_camera_base[:3, 0], T_camera_base[:3, 1], T_camera_base[:3, 3]])
    size = (CAMERA.width, CAMERA.height)
    grey = cv2.warpPerspective(TEXTURE, K @ to_camera @ cells, size)
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    rays = CAMERA.backproject(u.ravel(), v.ravel(), np.ones(u.size)) @ T[:3, :3].T
    depth = (-T[2, 3] / rays[:, 2]).reshape(v.shape).astype(np.float32)
    colour = np.repeat(grey[:, :, None], 3, axis=2)
    return Frame(k, k * PERIOD_NS, colour, depth, CAMERA, T, None, None, None)


def frames(velocity: tuple[float, float] = (0.0, 0.0)) -> list[Frame]:
    seconds = PERIOD_NS * 1e-9
    return [frame_of(k, np.array(velocity) * k * seconds) for k in range(STEPS)]


def said(listed: list[Frame]) -> float:
    share = seeming_motion(scene_steps(listed))
    assert share is not None
    return share


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (0.05, 0.08)])
def test_a_still_scene_and_a_belt_agree_with_right_poses(velocity: tuple[float, float]) -> None:
    """Fails where a belt is called a wrong pose."""
    assert said(frames(velocity)) < NOT_QUITE / 2


def test_a_turntable_that_stands_for_a_while_agrees() -> None:
    """Fails where half a turn is a straight way, or the middle of two speeds is the table's."""
    angles = np.radians([0.0, 0.0, 0.0, 5.0, 35.0, 65.0, 95.0, 125.0, 155.0])
    listed = [frame_of(k, np.zeros(2), angle) for k, angle in enumerate(angles)]
    assert said(listed) < NOT_QUITE / 2


def test_a_still_table_beside_a_moving_thing_agrees() -> None:
    """Fails where some frames show the table and others the thing, whose mean nothing has."""
    table, thing = frames(), frames((0.0, 0.1))
    assert said([*table[:5], *thing[5:]]) < NOT_QUITE / 2


def test_a_thing_that_the_hand_pushes_is_no_wrong_pose() -> None:
    """Fails where the last half of an approach, which sees only what the hand pushes, counts."""
    pushed = [frame_of(k, np.array([0.02 * (k - 5) ** 2, 0.0])) for k in range(5, STEPS)]
    assert said([*frames()[:5], *pushed]) < NOT_QUITE


def test_mirrored_pictures_are_told() -> None:
    mirrored = [
        replace(
            f,
            colour=np.ascontiguousarray(f.colour[:, ::-1]),
            depth=np.ascontiguousarray(f.depth[:, ::-1]),
        )
        for f in frames()
    ]
    assert said(mirrored) > CONTRADICTS


def test_an_axis_that_runs_the_other_way_is_told() -> None:
    """As a joint's sign turned, or two joints swapped, makes of the camera's poses."""
    wrong = []
    for f in frames():
        assert f.T_base_camera is not None
        T = f.T_base_camera.copy()
        T[0, 3] = -T[0, 3]
        wrong.append(replace(f, T_base_camera=T))
    assert said(wrong) > CONTRADICTS


def pose_at(t_ns: int) -> Array:
    """T_base_camera of the camera's way at any time."""
    return camera_at(t_ns / PERIOD_NS)


def corrected(
    listed: list[Frame], poses: Callable[[int], Array | None] = pose_at
) -> list[Correction]:
    steps = scene_steps(listed)
    share = seeming_motion(steps)
    assert share is not None
    return corrections(steps, share, poses)


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (0.05, 0.08)])
@pytest.mark.parametrize("wrong", [Correction(farther_m=0.04), Correction(farther_m=-0.03),
                                   Correction(0.4), Correction(0.8), Correction(1.1),
                                   Correction(focal=1.15), Correction(focal=0.8)])  # fmt: skip
def test_wrong_depth_and_focal_lengths_are_told_with_what_they_lack(
    wrong: Correction, velocity: tuple[float, float]
) -> None:
    """Fails where a depth camera that measures 40 mm too far is wrong without a word, or where what
    would mend it is another number, or a focal length that is wrong is laid on depth.
    """
    camera = replace(CAMERA, fx=CAMERA.fx * wrong.focal, fy=CAMERA.fy * wrong.focal)
    listed = [
        replace(
            f, depth=(f.depth * wrong.factor + wrong.farther_m).astype(np.float32), camera=camera
        )
        for f in frames(velocity)
    ]
    found = corrected(listed)[0]
    assert found.factor == pytest.approx(1 / wrong.factor, rel=0.01)
    assert found.farther_m == pytest.approx(-wrong.farther_m, abs=0.0051)
    assert found.focal == pytest.approx(1 / wrong.focal, rel=0.02)


def turned(degrees: float) -> Array:
    """(4, 4) about the camera's y axis."""
    return increment(np.array([0.0, 0.0, 0.0, 0.0, np.radians(degrees), 0.0]))


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (0.05, 0.08)])
def test_a_turned_camera_is_told_and_not_laid_on_depth(velocity: tuple[float, float]) -> None:
    """Fails where a hand-eye calibration that is 4 degrees off becomes an error of depth, or is
    told without its size.
    """
    listed = []
    for f in frames(velocity):
        assert f.T_base_camera is not None
        listed.append(replace(f, T_base_camera=f.T_base_camera @ turned(-4.0)))
    found = corrected(listed, lambda t_ns: pose_at(t_ns) @ turned(-4.0))
    assert found[0].turned[1] == pytest.approx(np.radians(4.0), abs=np.radians(0.6))
    assert all(c.factor == c.focal == 1.0 and c.farther_m == c.later_s == 0.0 for c in found)


def test_a_turn_beyond_any_calibration_is_not_named() -> None:
    """Fails where a camera that was mounted otherwise is called a calibration 20 degrees off."""
    listed = []
    for f in frames():
        assert f.T_base_camera is not None
        listed.append(replace(f, T_base_camera=f.T_base_camera @ turned(20.0)))
    assert all(not any(c.turned) for c in corrected(listed))


def test_a_cut_picture_is_told_by_its_principal_point() -> None:
    """Fails where a picture cut by 80 px, with the camera_info of the whole, goes by."""
    cut = replace(CAMERA, cx=CAMERA.cx + 80.0, cy=CAMERA.cy - 24.0)
    found = corrected([replace(f, camera=cut) for f in frames()])
    assert any(c.principal == pytest.approx((-80 / 290, 24 / 290), abs=0.01) for c in found)


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (0.05, 0.08)])
@pytest.mark.parametrize("late_ms", [-90, 60])
def test_pictures_that_are_stamped_late_are_told_with_the_delay(
    late_ms: int, velocity: tuple[float, float]
) -> None:
    """Fails where stamps that are those of the transfer and not of the exposure are no finding."""
    late_ns = late_ms * 1_000_000
    listed = [
        replace(f, t_ns=f.t_ns + late_ns, T_base_camera=pose_at(f.t_ns + late_ns))
        for f in frames(velocity)
    ]
    assert corrected(listed)[0].later_s == pytest.approx(-late_ms * 1e-3, abs=0.011)


@pytest.mark.parametrize("late_ms", [-120, 90])
def test_depth_alone_that_is_late_is_told_with_the_delay(late_ms: int) -> None:
    """Fails where both clocks are blamed for depth that a driver holds back. The camera changes its
    speed: at an even one a delay of depth is one with an offset of depth.
    """

    def way(k: float) -> float:
        return k + 0.8 * float(np.sin(k))

    still = np.zeros(2)
    listed = []
    for k in range(STEPS + 3):
        then = frame_of(way(k - late_ms * 1e6 / PERIOD_NS), still)
        listed.append(replace(frame_of(way(k), still), t_ns=k * PERIOD_NS, depth=then.depth))
    found = corrected(listed, lambda t_ns: camera_at(way(t_ns / PERIOD_NS)))
    assert found[0].depth_later_s == pytest.approx(-late_ms * 1e-3, abs=0.011)
    assert found[0].later_s == 0.0


def test_right_recordings_need_no_correction() -> None:
    assert corrected(frames()) == []


def test_a_hand_that_fills_half_of_the_picture_is_left_out() -> None:
    """Fails where the texture of a glove, which moves with the camera, is taken for the scene."""
    glove = texture(9)[: CAMERA.height // 2, : CAMERA.width]
    listed = []
    for f in frames():
        colour, depth = f.colour.copy(), f.depth.copy()
        colour[CAMERA.height // 2 :] = glove[:, :, None]
        depth[CAMERA.height // 2 :] = 0.15
        listed.append(replace(f, colour=colour, depth=depth))
    assert said(listed) < NOT_QUITE / 2


def test_one_thing_that_a_hand_holds_is_no_scene() -> None:
    """Fails where a person's hand, which moves as it likes before a wall without texture, makes of
    right poses wrong ones.
    """
    listed = []
    for k in range(STEPS):
        held = frame_of(k, np.array([0.05 * (k % 3), 0.03 * (k % 2)]))
        colour = np.full_like(held.colour, 90)
        colour[90:150, 120:200] = held.colour[90:150, 120:200]
        listed.append(replace(held, colour=colour))
    assert scene_steps(listed) == []


def test_a_camera_that_stands_still_says_nothing() -> None:
    one = frames()[0]
    still = [replace(one, t_ns=k * PERIOD_NS) for k in range(STEPS)]
    assert len(scene_steps(still)) < LEAST_STEPS
    assert seeming_motion(scene_steps(still)) is None


def test_pictures_without_texture_or_depth_say_nothing() -> None:
    plain = [replace(f, colour=np.full_like(f.colour, 90)) for f in frames()]
    blind = [replace(f, depth=np.zeros_like(f.depth)) for f in frames()]
    assert seeming_motion(scene_steps(plain)) is None
    assert seeming_motion(scene_steps(blind)) is None


def _mirrored(message: Message) -> Message:
    """The same picture, its left side right."""
    value = replace(message[3])
    head = 12 if message[1] == DEPTH else 0
    data = np.asarray(value.data, np.uint8)
    pixels = cv2.imdecode(data[head:], cv2.IMREAD_UNCHANGED)[:, ::-1]
    coded = cv2.imencode(".png", np.ascontiguousarray(pixels))[1].ravel()
    value.data = np.concatenate([data[:head], coded])
    value.format = value.format if head else "bgr8; png compressed bgr8"
    return [*message[:3], value]


def test_a_recording_with_mirrored_pictures_fails_its_check(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where every speed across the picture is wrong without a word, as after a driver's
    `flip` parameter.
    """
    listed = [_mirrored(m) if m[1] in (COLOUR, DEPTH) else m for m in messages]
    trial = opened(write(tmp_path / "a.mcap", listed))
    told = [c for c in trial.checks if c.name == "camera_poses"]
    assert told, trial.checks
    assert "mirrored" in told[0].mend


def _with_depth(message: Message, change: Callable[[np.ndarray], np.ndarray]) -> Message:
    value = replace(message[3])
    data = np.asarray(value.data, np.uint8)
    mm = cv2.imdecode(data[12:], cv2.IMREAD_UNCHANGED)
    changed = np.where(mm > 0, change(mm.astype(float)), 0).astype(np.uint16)
    value.data = np.concatenate([data[:12], cv2.imencode(".png", changed)[1].ravel()])
    return [*message[:3], value]


def test_depth_that_is_40_mm_too_far_fails_its_check_with_what_mends_it(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where places and speeds are wrong by a tenth without a word."""
    wrong = [_with_depth(m, lambda mm: mm + 40) if m[1] == DEPTH else m for m in messages]
    path = write(tmp_path / "a.mcap", wrong)
    (told,) = opened(path).checks
    assert "depth 40 mm nearer" in told.what
    # over this flat table another focal length explains it as well, which is said
    assert told.name in ("depth_offset", "intrinsics")
    assert "calibration.intrinsics" in told.mend
    assert "tells which" in told.mend
    setting = re.search(r"calibration\.depth_offset_m=[-\d.]+", told.mend)
    assert setting is not None
    mended = opened(path, setting[0])
    assert mended.checks == ()
    right = opened(write(tmp_path / "b.mcap", messages))
    depth, expected = (next(iter(trial.frames())).depth for trial in (mended, right))
    off = np.abs(depth - expected)[expected > 0]
    assert np.median(off) == pytest.approx(0.0, abs=0.0051)


def test_depth_that_is_too_small_fails_its_check(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where depth in a unit that is too large by 2.5 passes for a scene that comes along."""
    wrong = [_with_depth(m, lambda mm: 0.4 * mm) if m[1] == DEPTH else m for m in messages]
    (told,) = opened(write(tmp_path / "a.mcap", wrong)).checks
    assert told.name == "depth_unit"
    assert "--set calibration.depth_scale=0.0025 " in told.mend


def _delayed(message: Message, by_ns: int) -> Message:
    """Stamped and logged later."""
    value = copy.deepcopy(message[3])
    stamp = value.header.stamp
    stamp.sec, stamp.nanosec = divmod(stamp.sec * 10**9 + stamp.nanosec + by_ns, 10**9)
    return [message[0] + by_ns, *message[1:3], value]


def test_joint_states_60_ms_late_fail_their_check_with_the_setting_that_mends_it(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a driver that stamps when it sends puts the palm 60 ms behind without a word."""
    late_ns = 60_000_000
    listed = [_delayed(m, late_ns) if m[1] == JOINTS else m for m in messages]
    path = write(tmp_path / "a.mcap", listed)
    (told,) = opened(path).checks
    assert told.name == "clocks"
    assert "taken 60 ms later" in told.what
    settings = re.findall(r"clock\.\w+\.offset_ns=\d+", told.mend)
    assert settings == ["clock.colour.offset_ns=60000000", "clock.depth.offset_ns=60000000"]
    assert opened(path, *settings).checks == ()


def test_depth_turned_left_for_right_fails_its_check(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where a flip of one of the two pictures gives exit 0 and places of another thing."""
    turned = [_with_depth(m, lambda mm: mm[:, ::-1]) if m[1] == DEPTH else m for m in messages]
    (told,) = opened(write(tmp_path / "a.mcap", turned)).checks
    assert told.name == "alignment"
    assert "left for right" in told.what
