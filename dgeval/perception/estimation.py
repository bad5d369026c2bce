"""The target's velocity from one feature point on it, by a Kalman filter.

See docs/papers.md, "Velocity filter" and docs/papers.md, "Feature point".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter

from dgeval.config import EstimationConfig
from dgeval.geometry import Array

START_VELOCITY_VARIANCE = 0.25  # (m/s)^2 (docs/papers.md, "Velocity filter")


@dataclass(frozen=True, slots=True)
class Estimate:
    """Position (3,) m of the feature point and velocity (3,) m/s, base frame.

    velocity_sd: m/s, root of the largest eigenvalue of the velocity's covariance. nis: normalised
    innovation squared of the update, None without one. stale: null_after_s have passed without an
    accepted frame.
    """

    position: Array
    velocity: Array
    velocity_sd: float
    nis: float | None
    stale: bool


class VelocityFilter:
    """Constant-velocity Kalman filter, x = [position m, velocity m/s], with real time steps."""

    def __init__(self, config: EstimationConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        self._filter: KalmanFilter | None = None
        self._t_ns = 0
        self._accepted_ns = 0

    def _start(self, t_ns: int, position: Array) -> None:
        f = KalmanFilter(dim_x=6, dim_z=3)
        f.x = np.concatenate([position, np.zeros(3)]).reshape(6, 1)
        r2 = self.config.sigma_position**2
        f.P = np.diag([r2] * 3 + [START_VELOCITY_VARIANCE] * 3)
        f.H = np.hstack([np.eye(3), np.zeros((3, 3))])
        f.R = np.eye(3) * r2
        self._filter, self._t_ns, self._accepted_ns = f, t_ns, t_ns

    def step(self, t_ns: int, position: Array | None) -> Estimate | None:
        """Advance to t_ns; returns None before the first measurement.

        position: measured feature point (3,) m, base frame, or None. With loss_policy "zero" the
        target stands still in frames without a measurement.
        """
        if self._filter is None:
            if position is None:
                return None
            self._start(t_ns, position)
            return self._estimate(None)
        f = self._filter
        dt = max(0.0, (t_ns - self._t_ns) * 1e-9)
        self._t_ns = t_ns
        f.F = np.eye(6)
        f.F[:3, 3:] = np.eye(3) * dt
        f.Q = Q_discrete_white_noise(
            2, dt, self.config.sigma_acceleration**2, block_size=3, order_by_dim=False
        )
        if position is None and self.config.loss_policy == "zero":
            f.x[3:] = 0.0
        f.predict()
        nis = None
        if position is not None:
            f.update(position.reshape(3, 1))
            nis = float((f.y.T @ f.SI @ f.y)[0, 0])
            self._accepted_ns = t_ns
        return self._estimate(nis)

    def ahead(self, t_ns: int) -> Array:
        """Predicted motion (3,) m of the feature point from the last step to t_ns, base frame."""
        if self._filter is None or (
            self.config.loss_policy == "zero" and self._t_ns != self._accepted_ns
        ):
            return np.zeros(3)
        return np.asarray(self._filter.x[3:, 0] * max(0.0, (t_ns - self._t_ns) * 1e-9))

    def _estimate(self, nis: float | None) -> Estimate:
        assert self._filter is not None
        x, P = self._filter.x[:, 0], self._filter.P
        sd = float(np.sqrt(max(0.0, float(np.linalg.eigvalsh(P[3:, 3:])[-1]))))
        stale = self._t_ns - self._accepted_ns > self.config.null_after_s * 1e9
        return Estimate(x[:3].copy(), x[3:].copy(), sd, nis, stale)
