"""Looks for a lost target in the whole image, by its colours and its size."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Box, transform
from dgeval.perception import segmentation
from dgeval.perception.appearance import LEAST_SEPARABLE, LIKELY, Appearance, Colours
from dgeval.perception.types import Model
from dgeval.recording.frame import Frame

LEAST_ALIKE = 0.7  # Bhattacharyya coefficient
# of what is found, against the target's own area at its distance, and where that is not measured
SIZES, SIZES_UNMEASURED = (0.15, 2.5), (0.05, 6.0)
LEAST_MEASURED = 0.5  # share of its pixels that need depth
APART_PX = 5  # parts of the target nearer than this are one
SMOOTH_PX = 5
LEAST_PX = 25


@dataclass(frozen=True)
class Found:
    """Something that looks like the target: its box px and pixels (H, W).

    measured: its pixels have depth.
    """

    box: Box
    at: NDArray[np.bool_]
    measured: bool


def look_alikes(
    appearance: Appearance,
    frame: Frame,
    seen: Colours,
    blocked: NDArray[np.bool_],
    area_m2: float,
    z_expected: float,
) -> list[Found]:
    """Everything in a frame that has the target's colours and size, the best first.

    seen: the frame's colours. blocked (H, W): pixels of the hand. area_m2: of the target, seen from
    where it was. z_expected: m, where a thing has no depth. Nothing where colours don't tell the
    target from the rest.
    """
    if appearance.separable < LEAST_SEPARABLE:
        return []
    likely = cv2.blur(appearance.likelihood(seen), (SMOOTH_PX, SMOOTH_PX)) > LIKELY
    likely &= ~blocked
    joined = cv2.dilate(likely.astype(np.uint8), np.ones((APART_PX, APART_PX), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
    found: list[tuple[float, Found]] = []
    for k in range(1, count):
        x, y, w, h, area = (int(v) for v in stats[k])
        if area < LEAST_PX:
            continue
        here = np.s_[y : y + h, x : x + w]
        part = (labels[here] == k) & likely[here]
        pixels = int(part.sum())
        z = frame.depth[here][part]
        z = z[z > 0]
        if pixels < LEAST_PX:
            continue
        # a few readings in a thing without depth may be of what is behind it
        measured = len(z) >= max(LEAST_PX, LEAST_MEASURED * pixels)
        distances = [float(np.median(z))] if len(z) >= LEAST_PX else []
        distances += [] if measured else [z_expected]
        seen_m2 = pixels / (frame.camera.fx * frame.camera.fy)
        size = min((seen_m2 * d**2 / area_m2 for d in distances), key=lambda x: abs(np.log(x)))
        least, most = SIZES if measured else SIZES_UNMEASURED
        if not least < size < most:
            continue
        alike = appearance.alike(seen, (x, y, x + w, y + h), part)
        if alike < LEAST_ALIKE:
            continue
        at = np.zeros(frame.depth.shape, dtype=bool)
        at[here] = part
        box = segmentation.extent(part, (x, y, x + w, y + h))
        found.append((alike * min(1.0, size, 1 / size), Found(box, at, measured)))
    return [one for _, one in sorted(found, key=lambda f: -f[0])]


def put_at(
    found: Found, frame: Frame, model: Model, T_predicted: Array, min_points: int
) -> Array | None:
    """T_camera_model (4, 4), turned as predicted, with the model's near side where a thing is.

    None where the thing is not measured, or has fewer than `min_points` pixels with depth.
    """
    window = (0, 0, frame.camera.width, frame.camera.height)
    points = segmentation.points_of(frame.depth, window, found.at & (frame.depth > 0), frame.camera)
    in_camera = transform(T_predicted, model.points)
    normals = model.normals @ T_predicted[:3, :3].T
    facing = np.einsum("ij,ij->i", normals, in_camera) < 0
    if not found.measured or len(points) < min_points or not facing.any():
        return None
    T = T_predicted.copy()
    T[:3, 3] += np.median(points, axis=0) - np.median(in_camera[facing], axis=0)
    return T
