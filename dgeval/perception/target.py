"""Finds the target without a box: of what stands on the dominant plane, the nearest to the palm."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.config import Config
from dgeval.determinism import generator
from dgeval.geometry import Array, Box, invert, transform
from dgeval.perception import segmentation
from dgeval.perception.plane import fit_plane
from dgeval.perception.self_filter import hand_pixels
from dgeval.recording.frame import Frame

MAX_HEIGHT = 0.4  # m above the plane; higher pixels are not part of an object
MIN_PIXELS = 150  # smallest component that can be the target


def find_target(
    frame: Frame, T_base_camera: Array | None, palm_at_close: Array | None, config: Config
) -> Box | None:
    """Box of the component above the dominant plane nearest to palm_at_close.

    palm_at_close (3,) m, base frame. Without it, or without the camera's pose: the largest
    component, and one that the image's border cuts only if there is no other. None if there is no
    component.
    """
    palm = None
    if palm_at_close is not None and T_base_camera is not None:
        palm = transform(invert(T_base_camera), palm_at_close[None])[0]
    window = (0, 0, frame.camera.width, frame.camera.height)
    best: tuple[tuple[float, ...], Box] | None = None
    for box, at in _components(frame, config):
        if palm is None:
            x0, y0, x1, y1 = box
            cut = x0 <= 0 or y0 <= 0 or x1 >= frame.camera.width or y1 >= frame.camera.height
            rank: tuple[float, ...] = (float(cut), -float(at.sum()))
        else:
            centre = segmentation.points_of(frame.depth, window, at, frame.camera).mean(axis=0)
            rank = (float(np.linalg.norm(centre - palm)),)
        if best is None or rank < best[0]:
            best = (rank, box)
    return best[1] if best else None


def nearest_thing(
    frame: Frame, T_base_camera: Array, place: Array, config: Config
) -> tuple[float, Box] | None:
    """Of what stands on the dominant plane the thing nearest to a place (3,) m, base frame.

    How far its middle is, m, and its box; None if there is none.
    """
    here = transform(invert(T_base_camera), place[None])[0]
    window = (0, 0, frame.camera.width, frame.camera.height)
    found = []
    for box, at in _components(frame, config):
        points = segmentation.points_of(frame.depth, window, at, frame.camera)
        found.append((float(np.linalg.norm(points.mean(axis=0) - here)), box))
    return min(found, default=None)


def candidates(frame: Frame, config: Config) -> list[Box]:
    """Boxes of all components above the dominant plane, the largest first."""
    found = [(-int(at.sum()), box) for box, at in _components(frame, config)]
    return [box for _, box in sorted(found)]


def _components(frame: Frame, config: Config) -> list[tuple[Box, NDArray[np.bool_]]]:
    """Boxes, px, and masks (H, W) of what stands on the dominant plane and is not the hand."""
    window = (0, 0, frame.camera.width, frame.camera.height)
    hand = np.zeros(frame.depth.shape, dtype=bool)
    if frame.hand is not None:
        hand = hand_pixels(frame.depth, (0, 0), frame.camera, frame.hand, config.self_filter.margin)
    v, u = np.nonzero((frame.depth > 0) & ~hand)
    step = max(1, len(v) // 2000)
    v, u = v[::step], u[::step]
    points = frame.camera.backproject(
        u.astype(float), v.astype(float), frame.depth[v, u].astype(np.float64)
    )
    plane = fit_plane(points, generator(config.seed, "target", frame.index), config.plane)
    if plane is None:
        return []
    free = segmentation.above_plane(frame.depth, window, frame.camera, plane, config.plane) & ~hand
    free &= segmentation.height_map(frame.depth, window, frame.camera, plane) < MAX_HEIGHT
    free = cv2.morphologyEx(free.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    count, labels = segmentation.components(frame.depth, free)
    out = []
    for label in range(1, count):
        at = (labels == label) & free
        if int(at.sum()) < MIN_PIXELS:
            continue
        rows, cols = np.nonzero(at)
        box = (float(cols.min()), float(rows.min()), float(cols.max() + 1), float(rows.max() + 1))
        out.append((box, at))
    return out
