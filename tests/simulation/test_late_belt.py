"""Catches a belt that runs before its start, an object that topples or lags as it starts, and a
robot's world whose belt differs from the one without a robot.
"""

from __future__ import annotations

import numpy as np
import pytest
from dgeval.robots.hand import hand_named
from dgeval.simulation.setting import RAMP_S, LateBelt, Setting
from dgeval.simulation.world import World, home, matrix_of, twin_path
from dgeval.worlds.closing import CONTROL_S
from dgeval.worlds.objects import ten_objects

OBJECTS = ten_objects()
LATE = Setting(belt=LateBelt(0.22, 0.5))


def at(path: np.ndarray, t: float) -> np.ndarray:
    return path[round(t / CONTROL_S)]


@pytest.mark.parametrize("name", ["mustard_bottle", "sugar_box", "foam_brick"])
def test_the_object_stands_and_then_goes_with_the_belt(name: str) -> None:
    path = twin_path(OBJECTS[name], 0.22, 0.5, -0.3, 0.4, 2.5, LATE)
    start = path[0, :2]
    assert np.abs(at(path, 0.48)[:2] - start).max() < 0.002
    assert at(path, 2.0)[8] == pytest.approx(0.22, abs=0.01)  # m/s along y
    went = at(path, 2.5)[1] - start[1]
    assert went == pytest.approx(0.22 * (2.0 - RAMP_S / 2), abs=0.01)
    assert matrix_of(path[-1, :7])[2, 2] > 0.995


def test_the_robots_belt_starts_at_the_same_time_again_after_a_restore() -> None:
    """Catches a belt that goes on at the speed of the moment that was restored from."""
    world = World(OBJECTS["foam_brick"], 0.22, setting=LATE, gripper=hand_named("dlr_hit_hand"))
    world.start(home(world, -0.3), world.gripper.open, 0.5, -0.3, 0.4, 0.22)
    first = world.save()
    alone = twin_path(OBJECTS["foam_brick"], 0.22, 0.5, -0.3, 0.4, 1.5, LATE)
    for _ in range(2):
        for _ in range(round(1.5 / CONTROL_S)):
            world.move_hand(np.zeros(6), world.gripper.open)
        assert world.T_base_object()[:3, 3] == pytest.approx(alone[-1, :3], abs=0.001)
        world.restore(first)
