"""The undisturbed path from sightings, by Rauch-Tung-Striebel smoothing at constant velocity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgeval.geometry import Array, transform

By = Literal["registration", "depth", "colour"]
# m/s^2, process noise of the motion model; used is the one that makes the sightings most likely
ACCELERATIONS = (0.002, 0.05, 0.5)
# m, standard deviation of one sighting. Registration is precise but drifts by 1-3 mm as views
# change; a smaller value would take that drift for motion.
SIGMA: dict[By, float] = {"registration": 0.002, "depth": 0.004, "colour": 0.004}


@dataclass(frozen=True)
class Sighting:
    """Where the object was at a time: T_base_model.

    by: an accepted registration, or the tracker's alignment to depth or to colour.
    """

    t_ns: int
    T_base_model: Array
    by: By


@dataclass(frozen=True)
class Path:
    """The undisturbed path of the model's centroid, base frame.

    t_ns: (n,). position: (n, 3) m. velocity: (n, 3) m/s. sd: (n,) of the position, m. sd_velocity:
    at the end, m/s. R: (3, 3), the model's orientation, constant. sd_angle: rad. centroid: (3,) m,
    model frame. Beyond both ends the path goes on at constant velocity.
    """

    t_ns: NDArray[np.int64]
    position: Array
    velocity: Array
    sd: Array
    sd_velocity: float
    R: Array
    sd_angle: float
    centroid: Array

    def at(self, t_ns: int) -> Array:
        """T_base_model (4, 4) at a time."""
        i = int(np.clip(np.searchsorted(self.t_ns, t_ns) - 1, 0, len(self.t_ns) - 1))
        if self.t_ns[0] < t_ns < self.t_ns[-1]:
            share = (t_ns - self.t_ns[i]) / (self.t_ns[i + 1] - self.t_ns[i])
            centre = (1 - share) * self.position[i] + share * self.position[i + 1]
        else:
            i = 0 if t_ns <= self.t_ns[0] else len(self.t_ns) - 1
            centre = self.position[i] + self.velocity[i] * (t_ns - self.t_ns[i]) * 1e-9
        T = np.eye(4)
        T[:3, :3] = self.R
        T[:3, 3] = centre - self.R @ self.centroid
        return T

    def sd_at(self, t_ns: int) -> float:
        """Standard deviation of the position, m; it grows beyond the ends with the velocity's."""
        i = int(np.argmin(np.abs(self.t_ns - t_ns)))
        outside = max(0, t_ns - int(self.t_ns[-1]), int(self.t_ns[0]) - t_ns) * 1e-9
        return float(np.hypot(self.sd[i], self.sd_velocity * outside))


def smooth(sightings: list[Sighting], centroid: Array) -> Path:
    """Smooth the model's centroid over the sightings, in time order; average its orientation.

    The process noise is the one of ACCELERATIONS under which the sightings are most likely.
    """
    t_ns = np.array([s.t_ns for s in sightings], dtype=np.int64)
    t = (t_ns - t_ns[0]) * 1e-9
    positions = np.array([transform(s.T_base_model, centroid[None])[0] for s in sightings])
    sigma = np.array([SIGMA[s.by] for s in sightings])
    best = max((_rts(t, positions, sigma, a) for a in ACCELERATIONS), key=lambda r: r[0])
    _, states, covariances = best
    rotations = Rotation.from_matrix(np.array([s.T_base_model[:3, :3] for s in sightings]))
    mean = rotations.mean(weights=1 / sigma**2)
    spread = (mean.inv() * rotations).magnitude()
    return Path(
        t_ns,
        states[:, :3],
        states[:, 3:],
        np.sqrt(np.array([np.linalg.eigvalsh(P[:3, :3])[-1] for P in covariances])),
        float(np.sqrt(np.linalg.eigvalsh(covariances[-1][3:, 3:])[-1])),
        mean.as_matrix(),
        float(np.median(spread)),
        centroid,
    )


def _rts(
    t: Array, positions: Array, sigma: Array, acceleration: float
) -> tuple[float, Array, Array]:
    """Log likelihood, smoothed states (n, 6) and covariances (n, 6, 6) at constant velocity.

    t: (n,) s. positions: (n, 3) m. sigma: (n,) m. acceleration: process noise, m/s^2.
    """
    f = KalmanFilter(dim_x=6, dim_z=3)
    f.x = np.concatenate([positions[0], np.zeros(3)]).reshape(6, 1)
    f.P = np.diag([sigma[0] ** 2] * 3 + [0.25] * 3)
    f.H = np.hstack([np.eye(3), np.zeros((3, 3))])
    states, covariances = [f.x[:, 0].copy()], [f.P.copy()]
    transitions, noises = [], []
    likelihood = 0.0
    for k in range(1, len(t)):
        dt = t[k] - t[k - 1]
        F = np.eye(6)
        F[:3, 3:] = np.eye(3) * dt
        Q = Q_discrete_white_noise(
            2, dt, acceleration**2, block_size=3, order_by_dim=False
        ) + 1e-14 * np.eye(6)
        f.predict(F=F, Q=Q)
        f.update(positions[k].reshape(3, 1), R=np.eye(3) * sigma[k] ** 2)
        likelihood += float(f.log_likelihood)
        states.append(f.x[:, 0].copy())
        covariances.append(f.P.copy())
        transitions.append(F)
        noises.append(Q)
    if len(t) > 1:
        # filterpy's Fs[k + 1] leads from k to k + 1
        xs, Ps, _, _ = f.rts_smoother(
            np.array(states)[:, :, None],
            np.array(covariances),
            [transitions[0], *transitions],
            [noises[0], *noises],
        )
        return likelihood, np.asarray(xs[:, :, 0]), np.asarray(Ps)
    return likelihood, np.array(states), np.array(covariances)
