"""Whether the hand is seen where it should be: depth of boxes before a wall, in closed form."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from dgeval.config import ClockConfig
from dgeval.geometry import Array, Intrinsics, increment, matrix_from_pose
from dgeval.recording.frame import Frame
from dgeval.recording.frame_checks import CAMERA_UNTESTED, HAND_UNTESTED, frame_checks
from dgeval.recording.frame_reader import FrameReader
from dgeval.recording.hand_seen import hand_seen
from dgeval.recording.pairing import Pair
from dgeval.recording.transforms import TransformTree
from dgeval.robots.description import Description, LinkShape
from dgeval.robots.link_shapes import primitive

CAMERA = Intrinsics(fx=300.0, fy=300.0, cx=159.5, cy=119.5, width=320, height=240)
WALL_M = 0.8
# link, half sizes and middle, m, in the camera's frame: a palm and two fingers, at several depths
HAND = (
    ("palm", (0.05, 0.02, 0.015), (0.0, 0.06, 0.36)),
    ("left", (0.01, 0.03, 0.01), (-0.04, 0.01, 0.34)),
    ("right", (0.012, 0.03, 0.01), (0.04, 0.01, 0.32)),
)


def _hand(moved: Array) -> list[tuple[LinkShape, Array]]:
    out = []
    for link, half, middle in HAND:
        T = np.eye(4)
        T[:3, 3] = np.array(middle) + moved
        out.append((primitive(link, "box", np.eye(4), half), T))
    return out


def _depth(hand: list[tuple[LinkShape, Array]], wall: float) -> np.ndarray:
    """Depth (H, W) m of boxes that stand straight before a wall: by the slabs of each."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    ray = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)])
    depth = np.full(u.shape, wall)
    for shape, T in hand:
        middle, half = T[:3, 3], np.array(shape.size)
        with np.errstate(divide="ignore"):
            near, far = (middle[:, None, None] + s * half[:, None, None] for s in (-1, 1))
            enters = np.minimum(near / ray, far / ray).max(axis=0)
            leaves = np.maximum(near / ray, far / ray).min(axis=0)
        hit = enters < leaves
        depth[hit] = np.minimum(depth[hit], enters[hit])
    return depth.astype(np.float32)


def _frames(
    put: Array, seen: Array, leave_out: str = "", nearest: float = 0.0, count: int = 8
) -> list[Frame]:
    """Frames in which the hand is put at one place and seen at another, without one of its links
    and without depth nearer than `nearest`, m.
    """
    frames = []
    for k in range(count):
        there = [(s, T) for s, T in _hand(seen) if s.link != leave_out]
        depth = _depth(there, WALL_M + 0.02 * k)
        depth[depth < nearest] = 0.0
        colour = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
        frames.append(Frame(k, k * 10**8, colour, depth, CAMERA, None, None, _hand(put)))
    return frames


def test_a_hand_in_its_place_is_not_told() -> None:
    seen = hand_seen(_frames(np.zeros(3), np.zeros(3)))
    assert seen.is_told
    assert not seen.is_off
    assert not hand_seen(_frames(np.zeros(3), np.zeros(3), count=4)).is_told


@pytest.mark.parametrize(
    "moved", [(0.015, 0, 0), (0, -0.015, 0), (0, 0, 0.015), (-0.03, 0.01, -0.02), (0, 0, -0.03)]
)
def test_a_camera_that_is_mounted_elsewhere_is_told_by_how_much(moved: tuple[float, ...]) -> None:
    off = hand_seen(_frames(np.zeros(3), np.array(moved)))
    assert off.is_told
    assert off.link == ""
    assert off.shift == pytest.approx(np.array(moved), abs=0.002)


def test_a_small_error_of_the_mount_is_not_told() -> None:
    assert not hand_seen(_frames(np.zeros(3), np.array([0.003, 0.0, 0.0]))).is_off


def test_a_hand_that_is_too_near_for_depth_is_not_told() -> None:
    shifted = np.array([0.015, 0.0, 0.0])
    seen = hand_seen(_frames(np.zeros(3), shifted, nearest=0.5))
    assert not seen.is_told  # and so nothing in the log tests where the camera is to it
    assert not seen.is_off


def test_a_finger_that_is_not_where_its_description_has_it_is_named() -> None:
    """As of the other side's hand, or with a joint's axis reversed: depth shows the wall."""
    frames = _frames(np.zeros(3), np.zeros(3), leave_out="left")
    off = hand_seen(frames)
    assert off.is_told
    assert off.link == "left"
    assert off.through > 0.7
    assert not off.shift.any()


def test_a_finger_that_is_shorter_than_described_is_named() -> None:
    frames = _frames(np.zeros(3), np.zeros(3))
    for frame in frames:
        frame.depth[:128] = WALL_M  # the fingers end 28 mm before their described tips
    off = hand_seen(frames)
    assert off.is_told
    assert off.link in ("left", "right")
    assert 0.35 < off.through < 0.65


def test_a_link_whose_visual_mesh_is_known_is_looked_for_by_it() -> None:
    """A collision box in place of a finger is rough; the mesh of what is seen is exact."""
    put, seen = np.zeros(3), np.array([0.02, 0.0, 0.0])
    frames = [
        replace(f, hand=[(replace(s, rough=True), T) for s, T in f.hand or ()])
        for f in _frames(put, seen)
    ]
    outlines = {link: [primitive(link, "box", np.eye(4), half)] for link, half, _ in HAND}
    off = hand_seen(frames, outlines)
    assert off.is_told
    assert off.shift == pytest.approx(seen, abs=0.002)


@dataclass(frozen=True)
class Reads:
    """A reader of given frames, as the checks use it."""

    given: tuple[Frame, ...]
    robot: SimpleNamespace
    camera: SimpleNamespace = field(
        default_factory=lambda: SimpleNamespace(alignment=None, depth_shrunk=1.0)
    )
    pairs: tuple[Pair, ...] = ()
    lost: object = None

    def frames(self) -> list[Frame]:
        return [f for f in self.given if f.t_ns in {p.t_ns for p in self.pairs}]


def test_a_shifted_mount_fails_and_the_printed_line_mends_it() -> None:
    """Catches a shift with the wrong sign, or in another frame than the mount's."""
    T_true = increment(np.array([0.1, -0.02, 0.05, 0.4, -0.2, 1.1]))
    moved = np.array([0.0, 0.02, -0.01])  # in the camera's frame, of the hand against its place
    T_calibrated = T_true.copy()
    T_calibrated[:3, 3] += T_true[:3, :3] @ moved
    tree = TransformTree(10**9)
    tree.add_static("flange", "camera", T_calibrated)
    robot = SimpleNamespace(
        tree=tree, camera_frame="camera", base_frame=None, description=Description({}, {})
    )
    frames = tuple(_frames(np.zeros(3), moved, count=20))
    pairs = tuple(Pair(f.t_ns, f.index, f.index) for f in frames)
    reader = cast(FrameReader, Reads(frames, robot))
    found_out = frame_checks(reader, pairs[:15], pairs[15:], False, ClockConfig())
    assert [check.name for check in found_out.failed] == ["hand_seen"]
    assert found_out.notes == []
    assert found_out.untested == [CAMERA_UNTESTED]  # that hardly moves; the hand is seen
    check = found_out.failed[0]
    assert "20 mm down, 10 mm nearer" in check.what
    assert "calibration.flange=flange" in check.mend
    found = re.search(r"T_flange_camera=\[(.*?)\]", check.mend)
    assert found is not None
    T_mended = matrix_from_pose(np.array([float(v) for v in found[1].split(",")]))
    np.testing.assert_allclose(T_mended, T_true, atol=0.002)


@pytest.mark.parametrize(
    ("description", "untested"),
    [(None, [CAMERA_UNTESTED, HAND_UNTESTED]), (Description({}, {}), [CAMERA_UNTESTED])],
)
def test_what_a_camera_in_the_room_tests(
    description: Description | None, untested: list[str]
) -> None:
    """It does not move; it shows the hand, if what the hand looks like is known."""
    robot = SimpleNamespace(
        tree=TransformTree(10**9), camera_frame="camera", base_frame=None, description=description
    )
    frames = tuple(_frames(np.zeros(3), np.zeros(3), count=20))
    pairs = tuple(Pair(f.t_ns, f.index, f.index) for f in frames)
    reader = cast(FrameReader, Reads(frames, robot))
    found = frame_checks(reader, pairs[:15], pairs[15:], False, ClockConfig())
    assert (found.failed, found.untested) == ([], untested)


@pytest.mark.parametrize("seed", range(5))
def test_a_hand_that_fills_the_picture_is_not_told(seed: int) -> None:
    """Along a plate depth agrees everywhere: what noise prefers is no finding."""
    T = np.eye(4)
    T[:3, 3] = [0.0, 0.0, 0.4]
    hand = [(primitive("palm", "box", np.eye(4), (0.4, 0.3, 0.01)), T)]
    rng = np.random.default_rng(seed)
    frames = [
        replace(f, hand=hand, depth=_depth(hand, WALL_M) + rng.normal(0, 0.006, f.depth.shape))
        for f in _frames(np.zeros(3), np.zeros(3))
    ]
    assert not hand_seen(frames).is_off


def test_what_is_before_the_hand_does_not_make_it_seen_elsewhere() -> None:
    frames = _frames(np.zeros(3), np.zeros(3))
    for frame in frames:
        frame.depth[100:200, 100:180] = 0.25
    assert not hand_seen(frames).is_off


def test_capsules_that_stand_in_for_a_mesh_say_nothing() -> None:
    """A finger's stand-in is thinner than the finger, and may lie beside it."""
    frames = [
        replace(f, hand=[(replace(s, rough=True), T) for s, T in f.hand or ()])
        for f in _frames(np.zeros(3), np.array([0.03, 0.0, 0.0]))
    ]
    assert not hand_seen(frames).is_off


def test_a_link_that_no_depth_shows_is_named() -> None:
    """Fails where a finger behind the palm, of which nothing is seen, is said to be tested."""
    frames = []
    for f in _frames(np.zeros(3), np.zeros(3)):
        hand = list(f.hand or ())
        T = hand[0][1].copy()
        T[:3, 3] *= 1.3  # along the line of sight, behind it
        frames.append(
            replace(f, hand=[*hand, (primitive("behind", "box", np.eye(4), (0.01,) * 3), T)])
        )
    found = hand_seen(frames)
    assert found.is_told
    assert found.hidden == ("behind",)
    assert hand_seen(_frames(np.zeros(3), np.zeros(3))).hidden == ()
