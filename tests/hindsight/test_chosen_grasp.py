"""Catches a chosen grasp that is scored where it was believed to be good, not where it was."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.config import GraspsConfig
from dgeval.geometry import Array, transform
from dgeval.hindsight.chosen_grasp import hindsight_score
from dgeval.planning.control import Choice
from dgeval.planning.grasps import encode_cloud, networks_of, propose

CONFIG = GraspsConfig()


def standing_box() -> Array:
    """Points (n, 3) m of a box of 5 x 4 x 12 cm, model frame: its base at z = 0."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (1500, 3)) * [0.025, 0.02, 0.06]
    side = rng.integers(0, 3, len(points))
    half = np.array([0.025, 0.02, 0.06])
    points[np.arange(len(points)), side] = (
        np.sign(points[np.arange(len(points)), side]) * half[side]
    )
    return points + np.array([0.0, 0.0, 0.06])


def at(x: float) -> Array:
    T = np.eye(4)
    T[:3, 3] = (x, -0.2, 0.01)
    return T


def test_the_score_is_that_of_the_place_where_the_object_was() -> None:
    """Catches the believed place taken for the true one, and another cloud than the final one."""
    networks, points, camera = networks_of(CONFIG), standing_box(), np.eye(4)
    R = networks.R_cloud_base(camera)
    view = np.eye(4)
    view[:3, :3] = R
    cloud = encode_cloud(transform(view @ at(0.5), points), networks)
    drawn = propose(cloud, networks, 64, 1, 0, None)
    best = int(np.argmax(drawn.scores))
    choice = Choice(
        np.linalg.inv(view) @ drawn.T_cloud_palm[best], None, None, None, drawn.joints[best]
    )

    def scored(x: float, chosen: Choice = choice) -> float | None:
        path = SimpleNamespace(at=lambda t_ns: at(x + 1e-9 * t_ns))
        hindsight: Any = SimpleNamespace(path=path, points=points)
        return hindsight_score(chosen, camera, 10_000_000, hindsight, CONFIG)

    where_it_was = scored(0.49)
    assert where_it_was == pytest.approx(drawn.scores[best], abs=1e-4)
    beside = scored(0.57)
    assert beside is not None
    assert beside < where_it_was - 0.2
    assert scored(0.49, replace(choice, joints=None)) is None
