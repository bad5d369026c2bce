"""The picture of a decisive moment: where the object would have been and where it was seen.

Catches: the two outlines or their colours swapped, a camera pose taken the wrong way round, a
sighting of another moment drawn, and a crash where the object lies behind the camera.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from dgeval.geometry import Array, Intrinsics
from dgeval.hindsight.smoothing import Sighting
from dgeval.verdict.picture import decisive_picture

SECOND = 1_000_000_000
RED, YELLOW = (60, 60, 230), (40, 200, 255)  # BGR
CAMERA = Intrinsics(200, 100, 100.0, 100.0, 100.0, 50.0)
SQUARE = np.array([[x, y, 0.0] for x in (-0.1, 0.1) for y in (-0.1, 0.1)])


def at(x: float, z: float) -> Array:
    T = np.eye(4)
    T[:3, 3] = [x, 0.0, z]
    return T


def pixels(image: Any, colour: tuple[int, int, int]) -> tuple[int, int, int, int] | None:
    """Least and greatest column and row of a colour within the upper part of an image; None without
    any.
    """
    rows, columns = np.nonzero((image[:85] == colour).all(axis=2))
    return (columns.min(), columns.max(), rows.min(), rows.max()) if len(rows) else None


def drawn(free: Array, seen: Array, apart_ns: int = 0, T_base_camera: Array | None = None) -> Any:
    hindsight: Any = SimpleNamespace(
        path=SimpleNamespace(
            at=lambda t_ns: free if t_ns == 5 * SECOND else np.full((4, 4), np.nan)
        ),
        points=SQUARE,
        sightings=[
            Sighting(0, at(0.0, 0.5), "depth"),
            Sighting(5 * SECOND - apart_ns, seen, "depth"),
        ],
    )
    image = np.zeros((100, 200, 3), dtype=np.uint8)
    T = np.eye(4) if T_base_camera is None else T_base_camera
    out = decisive_picture(image, 5 * SECOND, T, CAMERA, hindsight, "title")
    assert not image.any(), "the frame itself is kept as it was"
    assert out[90:].any(), "the title is written below"
    return out


def test_the_path_is_red_and_the_sighting_yellow() -> None:
    """At 1 m, 100 px of focal length: 10 px to each side of the middle, the sighting 40 px to the
    right. Lines of 2 px.
    """
    picture = drawn(at(0.0, 1.0), at(0.4, 1.0))
    for found, middle in ((pixels(picture, RED), 100), (pixels(picture, YELLOW), 140)):
        assert found is not None
        np.testing.assert_allclose(found, [middle - 10, middle + 10, 40, 60], atol=2)


def test_the_camera_moves_the_picture() -> None:
    """Catches the pose of the camera used without its inverse: moved to the right, it sees the
    object on its left.
    """
    found = pixels(drawn(at(0.0, 1.0), at(0.4, 1.0), T_base_camera=at(0.3, 0.0)), RED)
    assert found is not None
    np.testing.assert_allclose(found, [60, 80, 40, 60], atol=2)


def test_a_sighting_of_another_moment_is_not_drawn() -> None:
    """Catches a sighting up to 0.1 s away left out, and an older one shown."""
    assert pixels(drawn(at(0.0, 1.0), at(0.4, 1.0), 99_000_000), YELLOW) is not None
    assert pixels(drawn(at(0.0, 1.0), at(0.4, 1.0), 100_000_000), YELLOW) is None


def test_nothing_is_drawn_of_what_is_behind_the_camera() -> None:
    """Catches points with negative depth that are mirrored into the picture."""
    picture = drawn(at(0.0, -1.0), at(0.4, 0.02))
    assert pixels(picture, RED) is None
    assert pixels(picture, YELLOW) is None
