"""Catches a modelled cloud that sees through the object, never forgets, or takes an empty frame."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.config import Config, load_config
from dgeval.geometry import Array, Intrinsics, invert
from dgeval.simulation.perception import HELD_BELOW_M, PLANE_M, ModelledCloud
from dgeval.worlds.objects import ten_objects

CAMERA = Intrinsics(640, 480, 600.0, 600.0, 320.0, 240.0)
BOX = ten_objects()["sugar_box"]  # 0.175 m tall
PLAN: Any = SimpleNamespace(seed=0, index=0, presenter=None)
HAND_OVER: Any = SimpleNamespace(seed=0, index=0, presenter=object())


def looking_along(x: float, metres: float = 0.4, aside: float = 0.0) -> Array:
    """T_camera_object of a camera level with the object, in front of its -x or +x side."""
    T_object_camera = np.eye(4)
    T_object_camera[:3, :3] = [[0, 0, x], [-x, 0, 0], [0, -1, 0]]
    T_object_camera[:3, 3] = (-x * metres, aside, 0.0)
    return invert(T_object_camera)


def cloud(*views: Array, config: Config | None = None, plan: Any = PLAN) -> Array:
    made = ModelledCloud(BOX, CAMERA, config or load_config(), plan)
    for k, T in enumerate(views):
        points = made.step(k, T, T)
    assert points is not None
    return points


def test_only_the_side_that_faces_the_camera_is_seen() -> None:
    points = cloud(looking_along(1.0))
    assert len(points) > 300
    assert np.quantile(points[:, 0], 0.98) < 0.0  # 1 % are flying pixels
    # equation 1 takes another side once it has been seen in as many frames
    both = cloud(looking_along(1.0), *[looking_along(-1.0)] * 8)
    assert (both[:, 0] > 0.0).mean() > 0.2


def test_what_the_plane_or_a_persons_hand_hides_is_not_seen() -> None:
    foot = -BOX.rest_height()
    for plan, hidden in ((PLAN, PLANE_M), (HAND_OVER, HELD_BELOW_M)):
        low = cloud(looking_along(1.0), plan=plan)[:, 2].min() - foot
        assert hidden - 0.004 < low < hidden + 0.006


def test_a_frame_that_shows_too_little_is_not_merged() -> None:
    """Catches an empty observation that is given to the fusion."""
    made = ModelledCloud(BOX, CAMERA, load_config(), PLAN)
    assert made.step(0, looking_along(1.0, aside=1.0), np.eye(4)) is None
    first = made.step(1, looking_along(1.0), looking_along(1.0))
    assert made.step(2, looking_along(1.0, aside=1.0), np.eye(4)) is None
    again = made.step(3, looking_along(1.0), looking_along(1.0))
    assert first is not None
    assert again is not None
    assert len(again) > len(first)


def test_it_forgets_with_a_small_model_and_smears_with_a_wrong_pose() -> None:
    """Catches parts out of view that stay whole, and points that know the true pose."""
    front, back = looking_along(1.0), looking_along(-1.0)
    small = load_config("dynamic", ("fusion.max_model_points=400",))
    before = (cloud(front, config=small)[:, 0] < 0).sum()
    after = (cloud(front, *[back] * 40, config=small)[:, 0] < 0).sum()
    assert after < 0.8 * before
    made = ModelledCloud(BOX, CAMERA, load_config(), PLAN)
    true = made.step(0, front, front)
    wrong = np.eye(4)
    wrong[0, 3] = 0.006
    shifted = made.step(1, front, front @ wrong)
    assert true is not None
    assert shifted is not None
    new = shifted[len(true) :] if len(shifted) > len(true) else shifted
    assert np.median(new[:, 0]) == pytest.approx(np.median(true[:, 0]) - 0.006, abs=0.002)
