"""Boxes in the image: of a model at a pose, how far they overlap, and what of them is in view."""

from __future__ import annotations

import numpy as np

from dgeval.geometry import Array, Box, Intrinsics, transform
from dgeval.perception.plane import Plane

BASE_HEIGHT = 0.012  # m; model points lower than this above the plane belong to the target's base


def inside(box: Box, camera: Intrinsics) -> Box:
    """The part of a box px inside the image."""
    return (
        min(max(box[0], 0.0), float(camera.width)),
        min(max(box[1], 0.0), float(camera.height)),
        min(max(box[2], 0.0), float(camera.width)),
        min(max(box[3], 0.0), float(camera.height)),
    )


def visible(box: Box, camera: Intrinsics) -> float:
    """Share of the box's area inside the image."""
    x0, y0, x1, y1 = inside(box, camera)
    area = (box[2] - box[0]) * (box[3] - box[1])
    return (x1 - x0) * (y1 - y0) / area if area > 0 else 0.0


def overlap(a: Box, b: Box) -> float:
    """Intersection over union of two boxes."""
    w = min(a[2], b[2]) - max(a[0], b[0])
    h = min(a[3], b[3]) - max(a[1], b[1])
    if w <= 0 or h <= 0:
        return 0.0
    both = w * h
    return both / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - both)


def projected_box(
    points: Array, T_camera_model: Array, camera: Intrinsics, plane: Plane | None
) -> Box | None:
    """Box px of the projected model points (n, 3) m, without the few outermost ones, or None.

    None with too few points in front of the camera. The removal of the plane also removes the
    lowest millimetres of the target, so the lowest points are also projected onto the plane.
    """
    p = transform(T_camera_model, points)
    p = p[p[:, 2] > 0.05]
    if len(p) < 10:
        return None
    pixels = camera.project(p)
    low, high = np.quantile(pixels, [0.001, 0.999], axis=0)
    if plane is not None:
        height = plane.height(p)
        base = p[(height > 0) & (height < BASE_HEIGHT)]
        base = base - plane.height(base)[:, None] * plane.n
        base = base[base[:, 2] > 0.05]
        if len(base) >= 20:
            low_base, high_base = np.quantile(camera.project(base), [0.01, 0.99], axis=0)
            low, high = np.minimum(low, low_base), np.maximum(high, high_base)
    return float(low[0]), float(low[1]), float(high[0] + 1), float(high[1] + 1)
