"""Tracks a box in colour alone, for targets without depth (too near, shiny or dark)."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.config import TrackingConfig
from dgeval.geometry import Array, Box

Grey = NDArray[np.uint8]
# settings of OpenCV's pyramidal Lucas-Kanade flow; window in px
LK: dict[str, Any] = {
    "winSize": (13, 13),
    "maxLevel": 2,
    "criteria": (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 12, 0.02),
    "minEigThreshold": 1e-4,
}


def corners(grey: Grey, mask: NDArray[np.uint8], count: int) -> NDArray[np.float32]:
    """Up to `count` corners (n, 2) px where the mask is not zero, at least 4 px apart."""
    corner_points = cv2.goodFeaturesToTrack(grey, count, 0.01, 4, mask=mask, blockSize=5)
    return (
        np.zeros((0, 2), np.float32)
        if corner_points is None
        else np.asarray(corner_points.reshape(-1, 2), dtype=np.float32)
    )


def follow(
    before: Grey, now: Grey, points: NDArray[np.float32], guess: NDArray[np.float32]
) -> tuple[Array, NDArray[np.bool_]]:
    """Lucas-Kanade flow of points (n, 2) px from `before` to `now`, checked backwards.

    Returns pixels (n, 2) and which of them are in the image and come back to within 1 px.
    guess: pixels (n, 2) to start from.
    """
    if not len(points):
        return np.zeros((0, 2)), np.zeros(0, dtype=bool)
    h, w = now.shape
    before, now = _same_size(before, now)
    there, ok, _ = cv2.calcOpticalFlowPyrLK(
        before,
        now,
        points,
        guess.astype(np.float32).copy(),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        **LK,
    )
    back, ok_back, _ = cv2.calcOpticalFlowPyrLK(
        now, before, there, points.copy(), flags=cv2.OPTFLOW_USE_INITIAL_FLOW, **LK
    )
    good = (ok.ravel() > 0) & (ok_back.ravel() > 0) & (np.linalg.norm(back - points, axis=1) < 1.0)
    good &= (there[:, 0] >= 0) & (there[:, 0] < w) & (there[:, 1] >= 0) & (there[:, 1] < h)
    return there.astype(np.float64), good


def _same_size(a: Grey, b: Grey) -> tuple[Grey, Grey]:
    """Both images with borders to the right and below, since OpenCV's flow needs equal sizes."""
    if a.shape == b.shape:
        return a, b
    h, w = max(a.shape[0], b.shape[0]), max(a.shape[1], b.shape[1])
    both = [
        cv2.copyMakeBorder(i, 0, h - i.shape[0], 0, w - i.shape[1], cv2.BORDER_REPLICATE)
        for i in (a, b)
    ]
    return np.asarray(both[0], dtype=np.uint8), np.asarray(both[1], dtype=np.uint8)


def similarity(a: Array, b: Array) -> tuple[Array, NDArray[np.bool_]] | None:
    """Robust similarity (2, 3) from points a to b (n, 2) px and its inliers (n,), or None.

    None without agreement. OpenCV's RANSAC has a fixed seed, so equal input gives equal output.
    """
    if len(a) < 3:
        return None
    M, inliers = cv2.estimateAffinePartial2D(
        a, b, method=cv2.RANSAC, ransacReprojThreshold=2.0, refineIters=10
    )
    if M is None:
        return None
    return np.asarray(M), np.asarray(inliers).ravel() > 0


class ImageTrack:
    """A box moved by the features in it: from frame to frame, then corrected by the first frame."""

    def __init__(self, grey: Grey, box: Box, config: TrackingConfig) -> None:
        self.config = config
        self.box = box
        self._first = grey
        self._first_box = box
        self._previous = grey
        self._first_points = corners(grey, self._ellipse(grey, box), config.corners)
        self._M = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # first frame -> now

    def _ellipse(self, grey: Grey, box: Box) -> NDArray[np.uint8]:
        """Mask of the box's inscribed ellipse: the corners of a box rarely show the target."""
        mask = np.zeros(grey.shape, np.uint8)
        centre = (round((box[0] + box[2]) / 2), round((box[1] + box[3]) / 2))
        axes = (max(1, round((box[2] - box[0]) / 2)), max(1, round((box[3] - box[1]) / 2)))
        cv2.ellipse(mask, centre, axes, 0, 0, 360, 255, -1)
        return mask

    def step(self, grey: Grey) -> float:
        """Move the box to this frame; return the number of features that agree (0: lost)."""
        now_points = corners(
            self._previous, self._ellipse(self._previous, self.box), self.config.corners
        )
        there, good = follow(self._previous, grey, now_points, now_points)
        motion = similarity(now_points[good].astype(np.float64), there[good])
        if motion is None or motion[1].sum() < self.config.min_corners:
            self._previous = grey
            return 0.0
        step = np.vstack([motion[0], [0, 0, 1]])
        M = (step @ np.vstack([self._M, [0, 0, 1]]))[:2]
        agree = float(motion[1].sum())
        # only the first frame's box is known: where the image still matches it, the drift since
        # then
        # is corrected
        guess = self._first_points @ M[:, :2].T.astype(np.float32) + M[:, 2].astype(np.float32)
        there, good = follow(self._first, grey, self._first_points, guess)
        good &= np.linalg.norm(there - guess, axis=1) < 6.0
        anchored = similarity(self._first_points[good].astype(np.float64), there[good])
        if anchored is not None and anchored[1].sum() >= max(
            self.config.min_corners, 0.3 * len(self._first_points)
        ):
            M = anchored[0]
        self._M = M
        self.box = carried(self._first_box, M)
        self._previous = grey
        return agree


def carried(box: Box, M: Array) -> Box:
    """A box px under a similarity M (2, 3), kept upright: its centre moves, its size scales."""
    centre = M[:, :2] @ np.array([(box[0] + box[2]) / 2, (box[1] + box[3]) / 2]) + M[:, 2]
    scale = float(np.sqrt(abs(np.linalg.det(M[:, :2]))))
    half = np.array([box[2] - box[0], box[3] - box[1]]) * scale / 2
    return (
        float(centre[0] - half[0]),
        float(centre[1] - half[1]),
        float(centre[0] + half[0]),
        float(centre[1] + half[1]),
    )
