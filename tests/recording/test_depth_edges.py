"""Catches: depth that lies beside colour, mirrored or of another viewpoint, in silence.

The scene is boxes of their own colours before a wall, drawn the same into both pictures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from dgeval.geometry import Intrinsics
from dgeval.recording.depth_edges import CUT, DepthOff, depth_off
from dgeval.recording.frame import Frame

CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
FRAMES, BOXES = 8, 3


def scene(k: int) -> Frame:
    """Three boxes at places of their own, nearer than the wall, with the wall's texture."""
    rng = np.random.default_rng(k)
    noise = rng.normal(128.0, 60.0, (480, 640)).astype(np.float32)
    grey = cv2.GaussianBlur(noise, (0, 0), 6.0) + 40.0
    depth = np.full((480, 640), 1.2, np.float32)
    for _ in range(BOXES):
        left, top = rng.integers(40, 420), rng.integers(40, 300)
        width, height = rng.integers(60, 160, 2)
        box = slice(top, top + height), slice(left, left + width)
        grey[box] = rng.choice([20.0, 235.0])
        depth[box] = rng.uniform(0.5, 0.9)
    colour = np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
    return Frame(k, k, colour, depth, CAMERA, None, None, None, None)


SCENES = [scene(k) for k in range(FRAMES)]


def with_depth(change: Callable[[np.ndarray], np.ndarray]) -> list[Frame]:
    return [replace(f, depth=np.ascontiguousarray(change(f.depth))) for f in SCENES]


def test_depth_on_colour_is_no_finding() -> None:
    assert depth_off(SCENES) is None


@pytest.mark.parametrize(
    ("turned", "rows", "columns"),
    [("left for right", 1, -1), ("upside down", -1, 1), ("turned by 180°", -1, -1)],
)
def test_depth_the_other_way_round_is_told(turned: str, rows: int, columns: int) -> None:
    """Fails where a driver's flip of one of the pictures gives every point another's colour."""
    assert depth_off(with_depth(lambda z: z[::rows, ::columns])) == DepthOff(turned)


@pytest.mark.parametrize(("right", "down"), [(40, 0), (-24, 0), (20, -20), (0, 60)])
def test_depth_of_another_viewpoint_is_told_with_its_shift(right: int, down: int) -> None:
    """Fails where depth that was never registered to colour passes, or its shift is another."""
    shifted = depth_off(with_depth(lambda z: np.roll(z, (down, right), (0, 1))))
    assert shifted is not None
    assert shifted.turned == ""
    assert (shifted.right, shifted.down) == pytest.approx((right, down), abs=5.0)
    assert shifted.share == pytest.approx(np.hypot(right, down) / 640, abs=0.01)


def test_a_wall_alone_or_too_few_frames_say_nothing() -> None:
    assert depth_off(with_depth(np.ones_like)) is None
    assert depth_off(with_depth(np.zeros_like)) is None
    assert depth_off(with_depth(lambda z: z[:, ::-1])[:4]) is None


def test_steps_that_colour_does_not_show_say_nothing() -> None:
    """Fails where a shift by chance is told of a scene in one colour."""
    plain = [replace(f, colour=np.full_like(f.colour, 90)) for f in SCENES]
    other = [replace(f, colour=SCENES[k - 1].colour) for k, f in enumerate(SCENES)]
    assert depth_off(plain) is None
    assert depth_off(other) is None


def test_depth_that_was_cut_and_not_resized_is_told() -> None:
    """Fails where the middle of a depth picture, under the camera_info of all of it, counts as all
    of it made smaller; or where depth that was made smaller is called cut.
    """
    middle = with_depth(lambda z: cv2.resize(z[120:360, 160:480], (640, 480), interpolation=0))
    assert depth_off(middle, 0.5) == DepthOff(CUT)
    resized = with_depth(lambda z: cv2.resize(z[::2, ::2], (640, 480), interpolation=0))
    assert depth_off(resized, 0.5) is None
