"""Catches: a target box around the table, the hand or another object, or where there is none.

`find_target` runs on depth images drawn by hand: boxes on a plane that fills the image, no noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from dgeval.config import Config
from dgeval.geometry import Array, Intrinsics, transform
from dgeval.perception.target import find_target
from dgeval.recording.frame import Frame
from dgeval.robots.description import LinkShape
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)
Rectangle = tuple[int, int, int, int]  # px, x0 y0 x1 y1; the last column and row are not part of it
T_BASE_CAMERA = np.eye(4)  # looks down from 1.2 m
T_BASE_CAMERA[:3, :3] = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
T_BASE_CAMERA[:3, 3] = [0.4, 0.1, 1.2]


def image(
    boxes: Sequence[tuple[Rectangle, float]], plane: float = 1.0, tilt: float = 0.0
) -> NDArray[np.float32]:
    """Depth (h, w) m of a plane across the image and of flat tops of boxes at their own depths.

    tilt: m per pixel downwards.
    """
    depth = np.full((CAMERA.height, CAMERA.width), plane, np.float32)
    depth += (
        np.float32(tilt)
        * (np.arange(CAMERA.height, dtype=np.float32) - np.float32(CAMERA.cy))[:, None]
    )
    for (x0, y0, x1, y1), z in boxes:
        depth[y0:y1, x0:x1] = z
    return depth


def target(
    depth: NDArray[np.float32],
    *,
    palm: Array | None = None,
    base: Array | None = T_BASE_CAMERA,
    hand: Any = None,
) -> tuple[float, float, float, float] | None:
    """Result of `find_target`. palm (3,) m, base frame; hand: its solids in the camera frame."""
    colour = np.zeros((*depth.shape, 3), np.uint8)
    return find_target(Frame(0, 0, colour, depth, CAMERA, base, None, hand), base, palm, Config())


def above(rectangle: Rectangle, z: float, T_base_camera: Array = T_BASE_CAMERA) -> Array:
    """The point (3,) m, base frame, in the middle of a rectangle px at depth z m."""
    x0, y0, x1, y1 = rectangle
    u, v = np.array([(x0 + x1 - 1) / 2]), np.array([(y0 + y1 - 1) / 2])
    return transform(T_base_camera, CAMERA.backproject(u, v, np.array([z])))[0]


SMALL, LARGE = (100, 30, 120, 50), (30, 60, 70, 100)


@pytest.mark.parametrize("tilt", [0.0, 0.002])
def test_a_box_on_a_plane(tilt: float) -> None:
    """Catches corners off by a pixel, x and y swapped, and a box around the plane."""
    assert target(image([((40, 50, 70, 90), 0.8)], tilt=tilt)) == (40.0, 50.0, 70.0, 90.0)


def test_of_two_the_one_nearest_to_where_the_palm_closed() -> None:
    """Catches the larger box chosen in spite of the palm, and the palm left in the base frame."""
    depth = image([(SMALL, 0.9), (LARGE, 0.85)])
    assert target(depth, palm=above(SMALL, 0.8)) == SMALL
    assert target(depth, palm=above(LARGE, 0.8)) == LARGE
    # nearer in the image, farther in space: the palm is low beside the small one
    low, high = (60, 30, 80, 50), (90, 30, 110, 50)
    depth = image([(low, 0.95), (high, 0.65)])
    assert target(depth, palm=above((72, 30, 92, 50), 0.65)) == high
    assert target(depth, palm=above((78, 30, 98, 50), 0.95)) == low


def test_the_palm_is_used_with_the_cameras_pose_of_that_time() -> None:
    """Catches the inverse of the camera's pose."""
    depth = image([(SMALL, 0.9), (LARGE, 0.9)])
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", [130, -35, 70], degrees=True).as_matrix()
    T[:3, 3] = [0.3, -0.5, 0.9]
    for box in (SMALL, LARGE):
        assert target(depth, palm=above(box, 0.9, T), base=T) == box


def test_without_a_palm_the_largest() -> None:
    """Catches the first box chosen, or the nearest to the camera."""
    depth = image([(SMALL, 0.8), (LARGE, 0.9)])
    assert target(depth) == LARGE
    assert target(depth, palm=above(SMALL, 0.8), base=None) == LARGE  # camera's pose not known


@pytest.mark.parametrize(
    "cut", [(0, 40, 60, 100), (110, 40, 160, 100), (40, 0, 110, 40), (40, 80, 110, 120)]
)
def test_what_the_border_cuts_comes_last(cut: Rectangle) -> None:
    """Catches a shelf's edge or a person's arm chosen, larger than the object, at each border."""
    middle = (80, 50, 100, 70)
    assert target(image([(cut, 0.8), (middle, 0.85)])) == middle
    assert target(image([(cut, 0.8)])) == cut


def test_too_small_is_nothing() -> None:
    """Catches a limit other than 150 pixels."""
    assert target(image([((50, 50, 65, 60), 0.9)])) == (50, 50, 65, 60)
    assert target(image([((50, 50, 64, 60), 0.9)])) is None


def test_too_high_is_nothing() -> None:
    """Catches an arm above the table chosen: pixels more than 0.4 m above the plane don't count."""
    assert target(image([(LARGE, 0.61)])) == LARGE
    assert target(image([(LARGE, 0.59)])) is None


def test_what_lies_in_the_noise_of_the_plane_is_nothing() -> None:
    """Catches a sheet of paper chosen: lower than three standard deviations of depth, 5.6 mm at 1
    m.
    """
    assert target(image([(LARGE, 0.993)])) == LARGE
    assert target(image([(LARGE, 0.996)])) is None


def test_the_hand_is_no_target() -> None:
    """Catches the robot's hand chosen, which is larger and nearer to the palm than the object."""
    T = np.eye(4)
    T[:3, 3] = CAMERA.backproject(np.array([49.5]), np.array([79.5]), np.array([0.85]))[0]
    solid = LinkShape("palm_link", "box", np.eye(4), (0.13, 0.13, 0.02), bound=0.2)
    depth = image([(SMALL, 0.9), (LARGE, 0.85)])
    assert target(depth, palm=above(LARGE, 0.85), hand=[(solid, T)]) == SMALL
    assert target(image([(LARGE, 0.85)]), hand=[(solid, T)]) is None


def test_depth_steps_part_objects_that_touch_in_the_image() -> None:
    """Catches one box around two objects of which one hides the base of the other."""
    left, right = (40, 50, 70, 90), (70, 50, 90, 90)
    depth = image([(left, 0.8), (right, 0.9)])
    box = target(depth, palm=above(right, 0.9))
    assert box is not None
    np.testing.assert_allclose(box, right, atol=2)  # the step's own pixels belong to neither
    box = target(depth, palm=above(left, 0.8))
    assert box is not None
    np.testing.assert_allclose(box, left, atol=2)


def test_pixels_without_depth_are_not_near_the_camera() -> None:
    """Catches a depth of 0 taken for a high object."""
    depth = image([(SMALL, 0.9)])
    depth[60:100, 30:70] = 0.0
    assert target(depth) == SMALL


def test_nothing_to_find() -> None:
    """Catches a box where there is no depth, no plane, or an empty plane."""
    assert target(np.zeros((120, 160), np.float32)) is None
    assert target(image([])) is None
    rng = np.random.default_rng(0)
    assert target(rng.uniform(0.3, 3.0, (120, 160)).astype(np.float32)) is None
