"""Views of the target that are kept: its image features with their places on the model."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.config import TrackingConfig
from dgeval.geometry import Array, Intrinsics, invert, rotation_angle, transform
from dgeval.perception import segmentation
from dgeval.perception.trackers.image import Grey, corners, follow
from dgeval.perception.types import Features, Window

MAX_KEYFRAMES = 12  # keyframes that are kept


@dataclass(frozen=True)
class _Keyframe:
    """Features of one frame with their model points.

    crop: part of the image, origin: its upper left corner px. pixels (n, 2) px in the crop, points
    (n, 3) m and their mean `centre`, model frame. distance: m, depth of the centre.
    """

    crop: Grey
    origin: tuple[int, int]
    pixels: NDArray[np.float32]
    points: Array
    T_camera_model: Array
    centre: Array
    distance: float


@dataclass(frozen=True)
class LastFrame:
    """The data of a frame that a keyframe needs, kept until the frame's final pose is known."""

    grey: Grey
    window: Window
    mask: NDArray[np.bool_]
    depth: NDArray[np.float32]


class Keyframes:
    """The views of the target that features are followed from."""

    def __init__(self, config: TrackingConfig) -> None:
        self.config = config
        self._keyframes: list[_Keyframe] = []

    def __len__(self) -> int:
        return len(self._keyframes)

    def keep(self, last_frame: LastFrame, T_previous: Array, camera: Intrinsics) -> None:
        """Make the previous frame a keyframe if none has a similar direction and distance.

        T_previous: its final T_camera_model (4, 4).
        """
        nearest = self._nearest(T_previous)
        c = self.config
        if nearest is not None:
            turn = rotation_angle(nearest.T_camera_model[:3, :3].T @ T_previous[:3, :3])
            distance = float((T_previous[:3, :3] @ nearest.centre + T_previous[:3, 3])[2])
            scale = max(distance / nearest.distance, nearest.distance / distance)
            if turn < c.keyframe_angle and scale < c.keyframe_scale:
                return
        x0, y0, x1, y1 = last_frame.window
        crop = np.ascontiguousarray(last_frame.grey[y0:y1, x0:x1])
        inner = cv2.erode(
            segmentation.fill(last_frame.mask.astype(np.float32)), np.ones((5, 5), np.uint8)
        )
        pixels = corners(crop, (inner > 0).astype(np.uint8) * 255, c.corners)
        smooth = segmentation.smoothed(last_frame.depth, last_frame.mask)
        if len(pixels):
            at = np.rint(pixels).astype(int)
            z = smooth[
                np.clip(at[:, 1], 0, smooth.shape[0] - 1), np.clip(at[:, 0], 0, smooth.shape[1] - 1)
            ]
            pixels, z = pixels[z > 0], z[z > 0]
        else:
            z = np.zeros(0)
        if len(pixels) < c.min_corners:
            return
        in_camera = camera.backproject(
            pixels[:, 0] + float(x0), pixels[:, 1] + float(y0), z.astype(np.float64)
        )
        points = transform(invert(T_previous), in_camera)
        centre = points.mean(axis=0)
        distance = float((T_previous[:3, :3] @ centre + T_previous[:3, 3])[2])
        self._keyframes.append(
            _Keyframe(crop, (x0, y0), pixels, points, T_previous, centre, distance)
        )
        if len(self._keyframes) > MAX_KEYFRAMES:
            del self._keyframes[1]  # the first one has the least drift and stays

    def _nearest(self, T: Array) -> _Keyframe | None:
        """The keyframe whose view of the target is nearest in direction and distance."""
        if not self._keyframes:
            return None

        def dissimilarity(k: _Keyframe) -> float:
            turn = rotation_angle(k.T_camera_model[:3, :3].T @ T[:3, :3])
            distance = float((T[:3, :3] @ k.centre + T[:3, 3])[2])
            return turn / 0.2 + abs(float(np.log(max(distance, 1e-3) / k.distance))) / 0.2

        return min(self._keyframes, key=dissimilarity)

    def follow(self, grey: Grey, window: Window, T: Array, camera: Intrinsics) -> Features:
        """The features of the nearest view in a window of an image, from T_camera_model (4, 4)."""
        key = self._nearest(T)
        if key is None:
            return Features(np.zeros((0, 3)), np.zeros((0, 2)))
        x0, y0, x1, y1 = window
        crop = np.ascontiguousarray(grey[y0:y1, x0:x1])
        guess = camera.project(transform(T, key.points)) - np.array([x0, y0])
        there, good = follow(key.crop, crop, key.pixels, guess.astype(np.float32))
        return Features(key.points[good], there[good] + np.array([x0, y0]))
