"""The picture of a decisive moment: the object where it would have been and where it was seen."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Intrinsics, invert, transform
from dgeval.hindsight.second_pass import Hindsight

FREE, SEEN = (60, 60, 230), (40, 200, 255)  # BGR: on its free path, and as sighted


def decisive_picture(
    image: NDArray[np.uint8],
    t_ns: int,
    T_base_camera: Array,
    camera: Intrinsics,
    hindsight: Hindsight,
    title: str,
) -> NDArray[np.uint8]:
    """BGR image (H, W, 3) with two outlines: on the free path (red), where it was seen (yellow)."""
    out = image.copy()
    T_camera_base = invert(T_base_camera)
    _outline(
        out, transform(T_camera_base @ hindsight.path.at(t_ns), hindsight.points), camera, FREE
    )
    near = min(hindsight.sightings, key=lambda s: abs(s.t_ns - t_ns))
    if abs(near.t_ns - t_ns) < 100_000_000:
        _outline(out, transform(T_camera_base @ near.T_base_model, hindsight.points), camera, SEEN)
    scale = max(0.4, out.shape[1] / 1100)
    # a dark bar and not an outline: in OpenCV 5 thicker letters are wider, and would stand twice
    (width, height), below = cv2.getTextSize(title, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
    foot = out.shape[0] - 8
    corner = (0, foot - height - 6), (width + 12, out.shape[0])
    cv2.rectangle(out, *corner, (0, 0, 0), cv2.FILLED)
    cv2.putText(
        out,
        title,
        (6, foot - below // 2),
        cv2.FONT_HERSHEY_SIMPLEX,
        scale,
        (255, 255, 255),
        1,
        cv2.LINE_AA,
    )
    return out


def _outline(
    image: NDArray[np.uint8], points: Array, camera: Intrinsics, colour: tuple[int, int, int]
) -> None:
    points = points[points[:, 2] > 0.03]
    if len(points) < 3:
        return
    hull = cv2.convexHull(np.clip(camera.project(points), -4000, 4000).astype(np.float32))
    cv2.polylines(image, [np.rint(hull).astype(np.int32)], True, colour, 2, cv2.LINE_AA)
