"""Depth pixels of the robot's own hand, from its geometry at the recorded joints.

See docs/papers.md, "Tracking".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Intrinsics, invert, transform
from dgeval.robots.description import LinkShape

Hand = list[tuple[LinkShape, Array]]  # solids of the hand with their T_camera_shape (4, 4)


def signed_distance(shape: LinkShape, points: Array) -> Array:
    """Distance (n,) m of points (n, 3) m, shape's frame, to the shape's surface; negative inside.

    Exact for box, sphere, capsule and cylinder; outside a hull a lower bound (distance to its
    planes).
    """
    if shape.kind == "sphere":
        return np.asarray(np.linalg.norm(points, axis=1) - shape.size[0])
    if shape.kind == "capsule":
        radius, half = shape.size
        axial = points[:, 2] - np.clip(points[:, 2], -half, half)
        return np.asarray(np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2 + axial**2) - radius)
    if shape.kind == "box":
        q = np.abs(points) - np.array(shape.size)
    elif shape.kind == "cylinder":
        radius, half = shape.size
        q = np.stack(
            [np.hypot(points[:, 0], points[:, 1]) - radius, np.abs(points[:, 2]) - half], axis=1
        )
    else:
        assert shape.hull is not None
        return np.asarray((points @ shape.hull[:, :3].T + shape.hull[:, 3]).max(axis=1))
    outside = np.linalg.norm(np.maximum(q, 0.0), axis=1)
    return np.asarray(outside + np.minimum(q.max(axis=1), 0.0))


def hand_pixels(
    depth: NDArray[np.float32],
    origin: tuple[int, int],
    camera: Intrinsics,
    hand: Hand,
    margin: float,
) -> NDArray[np.bool_]:
    """Mask (h, w) of the pixels of a depth window that lie within `margin` m of a hand solid.

    origin: px, the window's upper left corner (x, y) in the image.
    """
    out = np.zeros(depth.shape, dtype=bool)
    near, far = _depth_range(depth)
    for shape, T_camera_shape in hand:
        centre = T_camera_shape[:3, 3]
        reach = shape.bound + margin
        if centre[2] + reach < near or centre[2] - reach > far:
            continue
        window = _window(centre, reach, origin, depth.shape, camera)
        if window is None:
            continue
        x0, y0, x1, y1 = window
        part = depth[y0:y1, x0:x1]
        v, u = np.nonzero((part > 0) & (np.abs(part - centre[2]) < reach))
        if not len(v):
            continue
        points = camera.backproject(
            u + float(x0 + origin[0]), v + float(y0 + origin[1]), part[v, u].astype(np.float64)
        )
        hit = signed_distance(shape, transform(invert(T_camera_shape), points)) < margin
        out[v[hit] + y0, u[hit] + x0] = True
    return out


def _depth_range(depth: NDArray[np.float32]) -> tuple[float, float]:
    """Least and greatest depth m of the valid pixels; zeros if there are none."""
    valid = depth[depth > 0]
    return (float(valid.min()), float(valid.max())) if len(valid) else (0.0, 0.0)


def _window(
    centre: Array, reach: float, origin: tuple[int, int], shape: tuple[int, ...], camera: Intrinsics
) -> tuple[int, int, int, int] | None:
    """Part x0, y0, x1, y1 px of the window that a ball about the shape can cover, or None.

    The whole window if the camera lies in the ball.
    """
    z = centre[2] - reach
    if z <= 0.02:
        return 0, 0, shape[1], shape[0]
    radius = max(camera.fx, camera.fy) * reach / z
    u, v = camera.project(np.array([[centre[0], centre[1], max(centre[2], 1e-3)]]))[0] - np.array(
        origin
    )
    slack = radius * (1 + max(abs(centre[0]), abs(centre[1])) / z)
    x0, x1 = max(0, int(u - slack)), min(shape[1], int(u + slack) + 2)
    y0, y1 = max(0, int(v - slack)), min(shape[0], int(v + slack) + 2)
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None
