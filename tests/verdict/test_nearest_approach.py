"""How near a hand that never closed came to the object, against distances made of numbers.

Catches: a hand that is far called near by its palm, a blind object taken for one that is known, a
hand without solids said to be near, or said to be far where its fingers may reach.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.hindsight import moments
from dgeval.hindsight.moments import nearest_approach
from dgeval.hindsight.smoothing import Sighting, smooth

S = 1_000_000_000
POINTS = np.zeros((20, 3))


def path(last_s: float = 4.0) -> Any:
    """An object that stands at the origin, seen from 0 to last_s."""
    times = np.arange(0.0, last_s, 0.05)
    seen = [Sighting(round(t * S), np.eye(4), "registration") for t in times]
    return smooth(seen, np.zeros(3))


def robot(monkeypatch: pytest.MonkeyPatch, palm_m: float, solids_m: float | None) -> Any:
    """Its palm comes from 1 m to palm_m within 4 s, its solids to solids_m."""

    def away(t_ns: int) -> float:
        return 1.0 - (1.0 - palm_m) * min(1.0, t_ns / (4 * S))

    def T_base_palm(t_ns: int) -> np.ndarray:
        T = np.eye(4)
        T[0, 3] = away(t_ns)
        return T

    def distance(_: object, t_ns: int, points: np.ndarray) -> tuple[float, str] | None:
        return None if solids_m is None else (away(t_ns) - palm_m + solids_m, "tip")

    monkeypatch.setattr(moments, "hand_distance", distance)
    return SimpleNamespace(T_base_palm=T_base_palm)


def test_the_solids_count_and_not_the_palm(monkeypatch: pytest.MonkeyPatch) -> None:
    made = robot(monkeypatch, 0.15, 0.05)
    assert nearest_approach(made, 0, 4 * S, path(), POINTS) == pytest.approx(0.05, abs=0.02)
    made = robot(monkeypatch, 0.20, 0.12)
    assert nearest_approach(made, 0, 4 * S, path(), POINTS) == pytest.approx(0.12, abs=0.02)


def test_a_hand_without_solids(monkeypatch: pytest.MonkeyPatch) -> None:
    """No finger is longer than 0.25 m: a palm at 0.5 m is far, one at 0.2 m may be near."""
    assert nearest_approach(robot(monkeypatch, 0.5, None), 0, 4 * S, path(), POINTS) == (
        pytest.approx(0.25, abs=0.02)
    )
    assert nearest_approach(robot(monkeypatch, 0.2, None), 0, 4 * S, path(), POINTS) is None


def test_an_object_that_was_not_seen_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails where a hand is said to come near, or not, to a place that nobody knows by then."""
    blind = path(0.2)
    assert blind.sd_at(4 * S) > 0.04, "the case is none"
    assert nearest_approach(robot(monkeypatch, 0.15, 0.1), 0, 4 * S, blind, POINTS) is None


def test_no_palm_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    made = SimpleNamespace(T_base_palm=lambda _: None)
    assert nearest_approach(made, 0, 4 * S, path(), POINTS) is None
