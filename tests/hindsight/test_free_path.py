"""Catches: a push that bends the path before it, an early one, a push without a hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.geometry import Array
from dgeval.hindsight import free_path as module
from dgeval.hindsight.free_path import free_path
from dgeval.hindsight.smoothing import Sighting
from dgeval.perception.types import Model

MODEL = Model(np.zeros((10, 3)), np.tile([0.0, 0.0, 1.0], (10, 1)))
ROBOT: Any = SimpleNamespace()
BELT = np.array([0.0, 0.08, 0.0])


def seen(
    pushed_s: float, speed: float, until_s: float = 2.0, noise: float = 0.001
) -> list[Sighting]:
    """Sightings at 30 Hz of a thing on a belt that from a time on is pushed to the side."""
    rng = np.random.default_rng(1)
    out = []
    for t in np.arange(0.0, 2.0, 1 / 30):
        T = np.eye(4)
        T[:3, 3] = BELT * t + rng.normal(0, 0.001, 3)
        T[0, 3] += speed * max(0.0, t - pushed_s)
        out.append(Sighting(round(t * 1e9), T, "registration"))
    return out


def with_hand(monkeypatch: pytest.MonkeyPatch, from_s: float) -> None:
    """A hand that is at the object from a time on."""

    def distance(_: Any, t_ns: int, __: Array) -> tuple[float, str]:
        return (0.002 if t_ns * 1e-9 >= from_s else 0.2), "finger"

    monkeypatch.setattr(module, "hand_distance", distance)


@pytest.mark.parametrize(("pushed_s", "speed"), [(1.0, 0.03), (1.0, 0.2), (0.35, 0.2)])
def test_a_push_does_not_bend_the_path_before_it(
    monkeypatch: pytest.MonkeyPatch, pushed_s: float, speed: float
) -> None:
    """A slow push is seen late, and an early one within the first half second."""
    with_hand(monkeypatch, pushed_s)
    end_ns = 2_000_000_000
    path, pushed_ns = free_path(ROBOT, seen(pushed_s, speed), MODEL, np.zeros(3), end_ns)
    assert pushed_ns is not None
    assert pushed_s < pushed_ns * 1e-9 < pushed_s + 0.5
    assert path.t_ns[-1] * 1e-9 < pushed_s
    # within what the path says of itself, at the end
    off = path.at(end_ns)[:3, 3] - BELT * 2.0
    assert np.linalg.norm(off) < 3 * path.sd_at(end_ns)
    assert abs(off[0]) < 0.03


def test_what_moves_by_itself_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    with_hand(monkeypatch, 9.0)
    path, pushed_ns = free_path(ROBOT, seen(1.0, 0.2), MODEL, np.zeros(3), 2_000_000_000)
    assert pushed_ns is None
    assert path.velocity[-1] == pytest.approx([0.2, 0.08, 0.0], abs=0.03)


def test_a_hand_that_only_holds_still_beside_it_leaves_the_path(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Catches sightings left out because a hand is near, though nothing was pushed."""
    with_hand(monkeypatch, 0.5)
    path, pushed_ns = free_path(ROBOT, seen(9.0, 0.0), MODEL, np.zeros(3), 2_000_000_000)
    assert pushed_ns is None
    assert len(path.t_ns) == 60
