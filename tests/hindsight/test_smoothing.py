"""Catches: a smoother that is not that of Rauch, Tung and Striebel, in any of its outputs."""

from __future__ import annotations

import numpy as np
import pytest
from dgeval.hindsight.smoothing import ACCELERATIONS, SD_VELOCITY, _rts
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter
from scipy.linalg import block_diag


def by_filterpy(
    t: np.ndarray, positions: np.ndarray, sigma: np.ndarray, acceleration: float
) -> tuple[float, np.ndarray, np.ndarray]:
    """The same from filterpy, in six dimensions: likelihood, states and covariances.

    States are x, vx, y, vy, z, vz.
    """
    f = KalmanFilter(dim_x=6, dim_z=3)
    f.x[::2, 0] = positions[0]
    f.P = block_diag(*[np.diag([sigma[0] ** 2, SD_VELOCITY**2])] * 3)
    f.H = np.eye(6)[::2]
    states, covariances, transitions, noises = [f.x.copy()], [f.P.copy()], [f.F], [f.Q]
    likelihood = 0.0
    for k in range(1, len(t)):
        dt = t[k] - t[k - 1]
        F = block_diag(*[np.array([[1.0, dt], [0.0, 1.0]])] * 3)
        Q = Q_discrete_white_noise(2, dt, acceleration**2, block_size=3) + 1e-14 * np.eye(6)
        f.predict(F=F, Q=Q)
        f.update(positions[k], R=np.eye(3) * sigma[k] ** 2)
        likelihood += f.log_likelihood
        states.append(f.x.copy())
        covariances.append(f.P.copy())
        transitions.append(F)
        noises.append(Q)
    x, P, _, _ = f.rts_smoother(np.array(states), np.array(covariances), transitions, noises)
    return likelihood, x[:, :, 0], P


@pytest.mark.parametrize("acceleration", ACCELERATIONS)
def test_smoother_is_filterpys(acceleration: float) -> None:
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.uniform(0.01, 0.4, 60))
    positions = np.outer(t, [0.0, 0.08, 0.01]) + rng.normal(0, 0.002, (60, 3))
    sigma = rng.choice([0.002, 0.004], 60)
    likelihood, x, P = _rts(t, positions, sigma, acceleration)
    wanted, states, covariances = by_filterpy(t, positions, sigma, acceleration)
    assert likelihood == pytest.approx(wanted, rel=1e-10)
    np.testing.assert_allclose(x[:, 0], states[:, ::2], atol=1e-12)
    np.testing.assert_allclose(x[:, 1], states[:, 1::2], atol=1e-12)
    for axis in (0, 2, 4):
        np.testing.assert_allclose(P, covariances[:, axis : axis + 2, axis : axis + 2], atol=1e-13)


def test_one_sighting_is_where_it_was_seen() -> None:
    _, x, P = _rts(np.zeros(1), np.array([[0.1, 0.2, 0.3]]), np.array([0.002]), 0.05)
    np.testing.assert_array_equal(x[0], [[0.1, 0.2, 0.3], [0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(P[0], np.diag([0.002**2, SD_VELOCITY**2]))
