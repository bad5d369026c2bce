"""The undisturbed path from sightings, by Rauch-Tung-Striebel smoothing at constant velocity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgeval.geometry import Array, transform

By = Literal["registration", "depth", "colour"]
# m/s^2, process noise of the motion model; used is the one that makes the sightings most likely
ACCELERATIONS = (0.002, 0.05, 0.5)
# m, standard deviation of one sighting. Registration is precise but drifts by 1-3 mm as views
# change; a smaller value would take that drift for motion.
SIGMA: dict[By, float] = {"registration": 0.002, "depth": 0.004, "colour": 0.004}

SD_VELOCITY = 0.5  # m/s, of the velocity before the first sighting


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
        states[:, 0],
        states[:, 1],
        np.sqrt(covariances[:, 0, 0]),
        float(np.sqrt(covariances[-1, 1, 1])),
        mean.as_matrix(),
        float(np.median(spread)),
        centroid,
    )


@njit(cache=True)
def _rts(
    t: Array, positions: Array, sigma: Array, acceleration: float
) -> tuple[float, Array, Array]:
    """Log likelihood, smoothed states (n, 2, 3) and covariances (n, 2, 2) at constant velocity.

    t: (n,) s. positions: (n, 3) m. sigma: (n,) m. acceleration: process noise, m/s^2. A state is
    position and velocity. Noise is equal along all axes, so that one covariance serves all three;
    the update is Joseph's.
    """
    n = len(t)
    x, P = np.zeros((n, 2, 3)), np.zeros((n, 2, 2))
    ahead, F, Q = np.zeros((n, 2, 2)), np.eye(2), np.zeros((2, 2))
    x[0, 0] = positions[0]
    P[0, 0, 0], P[0, 1, 1] = sigma[0] ** 2, SD_VELOCITY**2
    likelihood = 0.0
    for k in range(1, n):
        dt = t[k] - t[k - 1]
        F[0, 1] = dt
        Q[0, 0] = dt**4 / 4 * acceleration**2 + 1e-14
        Q[0, 1] = Q[1, 0] = dt**3 / 2 * acceleration**2
        Q[1, 1] = dt**2 * acceleration**2 + 1e-14
        ahead[k] = F @ P[k - 1] @ F.T + Q
        predicted = F @ x[k - 1]
        off = positions[k] - predicted[0]
        noise = sigma[k] ** 2
        S = ahead[k, 0, 0] + noise
        gain = ahead[k, :, 0] / S
        x[k] = predicted
        x[k, 0] += gain[0] * off
        x[k, 1] += gain[1] * off
        kept = np.eye(2)
        kept[0, 0] -= gain[0]
        kept[1, 0] -= gain[1]
        P[k] = kept @ ahead[k] @ kept.T + np.outer(gain, gain) * noise
        likelihood -= 0.5 * (float((off**2).sum()) / S + 3 * np.log(2 * np.pi * S))
    for k in range(n - 2, -1, -1):
        F[0, 1] = t[k + 1] - t[k]
        back = P[k] @ F.T @ np.linalg.inv(ahead[k + 1])
        x[k] += back @ (x[k + 1] - F @ x[k])
        P[k] += back @ (P[k + 1] - ahead[k + 1]) @ back.T
    return likelihood, x, P
