"""A box tracker from colour alone (OpenCV's CSRT) with depth-aware segmentation of its box."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from dgeval.config import Config
from dgeval.perception import segmentation
from dgeval.perception.boxes import inside, visible
from dgeval.perception.trackers.model import TrackingInput
from dgeval.perception.types import Tracked


class CsrtTracker:
    """CSRT gives the box; plane, hand and depth steps in it give the mask. It has no pose."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        self._tracker: Any = None
        self._box: tuple[float, float, float, float] | None = None

    def step(self, given: TrackingInput) -> Tracked:
        """The target's box and mask in one frame."""
        frame = given.frame
        colour = np.ascontiguousarray(frame.colour[:, :, ::-1])
        if given.box is not None:
            self._box = given.box
            x0, y0, x1, y1 = (round(v) for v in given.box)
            self._tracker = cv2.TrackerCSRT.create()
            self._tracker.init(colour, (x0, y0, x1 - x0, y1 - y0))
        elif self._tracker is None:
            return Tracked("not_started")
        else:
            success, (x, y, w, h) = self._tracker.update(colour)
            self._box = (float(x), float(y), float(x + w), float(y + h)) if success else None
        if self._box is None:
            return Tracked("lost")
        if visible(self._box, frame.camera) < self.config.tracking.min_visible:
            return Tracked("lost")
        window = segmentation.grow(self._box, 0.5, 10, frame.camera)
        depth, free, plane = segmentation.free_pixels(frame, window, self._box, self.config)
        mask = segmentation.segment_box(depth, window, free, self._box)
        box = inside(self._box, frame.camera)
        return Tracked("tracked", box, window, mask, int(mask.sum()), plane=plane)


METHOD, STAND_IN, TRACKER = "csrt", "CSRT", CsrtTracker
