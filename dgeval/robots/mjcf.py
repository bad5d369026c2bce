"""Poses in MuJoCo specs and URDF origins."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.geometry import Array


def pose(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> Array:
    """T_parent_child (4, 4) of a URDF origin: xyz m, rpy rad about fixed axes."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    T[:3, 3] = xyz
    return T


def quat_wxyz(R: Array) -> Array:
    """Quaternion (4,) in MuJoCo's order w x y z from a rotation matrix (3, 3)."""
    return np.asarray(Rotation.from_matrix(R).as_quat(scalar_first=True))


def place(item: object, T: Array) -> None:
    """Set a body's, geom's, camera's or site's pose in its parent."""
    item.pos = T[:3, 3]  # type: ignore[attr-defined]
    item.quat = quat_wxyz(T[:3, :3])  # type: ignore[attr-defined]
