"""Catches: a lift that is not in the log, one that is cut, a way that ends elsewhere."""

from __future__ import annotations

import numpy as np
from dgeval.geometry import Array
from dgeval.verdict.recorded_lift import recorded_lift
from scipy.spatial.transform import Rotation


def way(rise_m: float, lift_s: float = 0.8, until_s: float = 3.0, turn: float = 0.0) -> Array:
    """Poses (n, 4, 4) of a hand that follows at 0.1 m/s, waits 0.5 s, rises, turning, and waits."""
    t = np.arange(0.0, until_s, 0.01)
    T = np.tile(np.eye(4), (len(t), 1, 1))
    share = np.clip((t - 0.5) / lift_s, 0, 1)
    smooth = share * share * (3 - 2 * share)
    T[:, :3, 3] = np.stack([0.5 + 0 * t, 0.1 * np.minimum(t, 0.9), 0.3 + rise_m * smooth], axis=1)
    T[:, :3, :3] = Rotation.from_rotvec(np.outer(turn * smooth, [0.0, 0.0, 1.0])).as_matrix()
    return T


def test_the_motion_is_the_recorded_one_and_ends_with_the_lift() -> None:
    poses = way(0.15, turn=0.6)
    finish = recorded_lift(poses)
    assert finish is not None
    n = len(finish.twists)
    assert 1.1 < n * 0.01 < 1.35  # at 1.3 s it has risen as far as it does
    travelled = finish.twists.sum(axis=0) * 0.01
    np.testing.assert_allclose(travelled[:3], poses[n, :3, 3] - poses[0, :3, 3], atol=0.002)
    np.testing.assert_allclose(travelled[3:], [0, 0, 0.6], atol=0.03)
    assert abs(finish.needed_m - 0.075) < 0.003
    assert abs(finish.rises[finish.given_up] - 0.06) < 0.005
    np.testing.assert_allclose(finish.twists[:40, 1], 0.1, atol=1e-9)  # it follows


def test_what_is_no_whole_lift_is_none() -> None:
    assert recorded_lift(way(0.04)) is None  # a hand that trembles, or settles
    assert recorded_lift(way(0.15, until_s=0.9)) is None  # the log ends on the way up
    assert recorded_lift(way(0.15, until_s=1.3)) is None  # and before it is known to be over
    assert recorded_lift(way(-0.15)) is None
    assert recorded_lift(way(0.15)[:1]) is None
