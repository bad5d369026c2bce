"""Rigid transforms, pinhole projection, planes. `T_a_b` maps points from frame b into frame a.

Transforms are (4, 4) float64, lengths in m. A pose as seven numbers is px py pz qx qy qz qw in m,
with a unit quaternion of qw >= 0, so that equal rotations have equal numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]  # x0, y0, x1, y1 px
IDENTITY: Array = np.eye(4)  # to copy, which takes a fifth of the time of making it
IDENTITY.flags.writeable = False


def matrix_from_pose(pose: Array) -> Array:
    """(7,) px py pz qx qy qz qw -> T (4, 4).

    The quaternion is normalised; a zero quaternion is a ValueError.
    """
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(pose[3:7]).as_matrix()
    T[:3, 3] = pose[:3]
    return T


def pose_from_matrix(T: Array) -> Array:
    """T (4, 4) -> (7,) px py pz qx qy qz qw with qw >= 0."""
    q = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
    return np.concatenate([T[:3, 3], q])


def invert(T: Array) -> Array:
    """Inverse of a rigid transform, T_b_a from T_a_b."""
    R = T[:3, :3]
    out = IDENTITY.copy()
    out[:3, :3] = R.T
    out[:3, 3] = -R.T @ T[:3, 3]
    return out


def transform(T_a_b: Array, points_b: Array) -> Array:
    """Points (n, 3) in frame b -> (n, 3) in frame a."""
    return points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def increment(xi: Array) -> Array:
    """Small motion (6,) [translation m, rotation vector rad] -> (4, 4); the rotation is exact."""
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(xi[3:])[
        0
    ]  # a hundredth of the time of scipy's Rotation, and called in inner loops
    T[:3, 3] = xi[:3]
    return T


def rotation_about(axis: Array, angle: float) -> Array:
    """(3, 3), a turn about a unit axis (3,) by an angle, rad.

    The same steps as in SciPy's `Rotation.from_rotvec`, which needs ten times as long for one.
    """
    rx, ry, rz = float(axis[0]) * angle, float(axis[1]) * angle, float(axis[2]) * angle
    turn = math.sqrt(rx * rx + ry * ry + rz * rz)
    if turn <= 1e-3:
        scale = 0.5 - turn * turn / 48 + turn * turn * turn * turn / 3840
    else:
        scale = math.sin(turn / 2) / turn
    x, y, z, w = scale * rx, scale * ry, scale * rz, math.cos(turn / 2)
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    xy, zw, xz, yw, yz, xw = x * y, z * w, x * z, y * w, y * z, x * w
    return np.array(
        [
            [xx - yy - zz + ww, 2 * (xy - zw), 2 * (xz + yw)],
            [2 * (xy + zw), -xx + yy - zz + ww, 2 * (yz - xw)],
            [2 * (xz - yw), 2 * (yz + xw), -xx - yy + zz + ww],
        ]
    )


def rotation_vector(R: Array) -> Array:
    """Rotation matrix (3, 3) -> rotation vector (3,), rad."""
    sine = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    if R[0, 0] + R[1, 1] + R[2, 2] > 2.9 and sine @ sine < 1e-8:
        return (
            sine  # OpenCV calls angles below 1e-5 zero; up to 1e-4 the sine is the angle to 2e-13
        )
    return np.asarray(cv2.Rodrigues(R)[0][:, 0])


def cross(a: Array, b: Array) -> Array:
    """Row-wise cross product (..., 3).

    numpy's own takes several times as long on arrays of a few thousand rows.
    """
    out = np.empty(np.broadcast_shapes(a.shape, b.shape), np.result_type(a, b))
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


def rotation_angle(R: Array) -> float:
    """Geodesic angle of a rotation matrix (3, 3), rad, in [0, pi]."""
    return float(np.linalg.norm(rotation_vector(R)))


def pose_distance(T: Array, other: Array) -> tuple[float, float]:
    """Distance, m, and turn, rad, between two poses (4, 4)."""
    metres = float(np.linalg.norm(T[:3, 3] - other[:3, 3]))
    return metres, rotation_angle(T[:3, :3].T @ other[:3, :3])


def orthonormalise(T: Array) -> Array:
    """Nearest rigid transform (SVD), so that products of many transforms stay rigid."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    out = T.copy()
    out[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return out


def best_rigid(a: Array, b: Array) -> Array:
    """T (..., 4, 4) that maps points a (..., n, 3) onto the points b best, as Kabsch 1976."""
    middle_a, middle_b = a.mean(axis=-2), b.mean(axis=-2)
    spread = np.swapaxes(a - middle_a[..., None, :], -1, -2) @ (b - middle_b[..., None, :])
    U, _, Vt = np.linalg.svd(spread)
    V, Ut = np.swapaxes(Vt, -1, -2), np.swapaxes(U, -1, -2)
    proper = np.ones(middle_a.shape)
    proper[..., 2] = np.sign(np.linalg.det(V @ Ut))
    out = np.broadcast_to(IDENTITY, (*middle_a.shape[:-1], 4, 4)).copy()
    R = (V * proper[..., None, :]) @ Ut
    out[..., :3, :3] = R
    out[..., :3, 3] = middle_b - (R @ middle_a[..., None])[..., 0]
    return out


def interpolate_pose(a: Array, b: Array, alpha: float) -> Array:
    """Interpolate two (7,) poses: linear in position, slerp along the shorter arc in rotation.

    alpha: 0 gives a, 1 gives b.
    """
    qa = a[3:7] / np.linalg.norm(a[3:7])
    qb = b[3:7] / np.linalg.norm(b[3:7])
    dot = float(qa @ qb)
    if dot < 0:
        qb, dot = -qb, -dot
    if dot > 1 - 1e-10:
        q = qa + alpha * (qb - qa)
    else:
        theta = np.arccos(min(dot, 1.0))
        q = (np.sin((1 - alpha) * theta) * qa + np.sin(alpha * theta) * qb) / np.sin(theta)
    return np.concatenate([(1 - alpha) * a[:3] + alpha * b[:3], q / np.linalg.norm(q)])


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """Pinhole camera: focal lengths and principal point in px, pixel centres at integers."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def project(self, points: Array) -> Array:
        """Camera points (n, 3) m, z > 0 -> pixels (n, 2) u, v."""
        z = points[:, 2]
        out = np.empty((len(points), 2))
        out[:, 0] = self.fx * points[:, 0] / z + self.cx
        out[:, 1] = self.fy * points[:, 1] / z + self.cy
        return out

    def backproject(self, u: NDArray[Any], v: NDArray[Any], z: Array) -> Array:
        """Pixels and depths (n,) m -> camera points (n, 3) m."""
        return np.stack([(u - self.cx) / self.fx * z, (v - self.cy) / self.fy * z, z], axis=-1)


def depth_sigma(z: NDArray[Any] | float) -> Array:
    """Standard deviation of an RGB-D camera's depth at range z, m.

    Nguyen, Izadi, Lovell, 3DIMPVT 2012, axial noise of the first Kinect: 1.2 mm + 1.9 mm/m^2
    (z - 0.4 m)^2. The noise of active stereo cameras is of the same size from 0.3 to 1.5 m, so one
    model serves for both.
    """
    return np.asarray(0.0012 + 0.0019 * (np.asarray(z) - 0.4) ** 2)
