"""The tracking loop of TransT and TransT-M: from frame to frame, a box and a mask.

As the authors' trackers for VOT do it (docs/papers.md, "TransT's loop"): a search crop around the
last box, the best of its tokens with those near the last place preferred, and with TransT-M a
second template that is made anew whenever the box is predicted to fit well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Box
from dgeval.networks.images import normalised
from dgeval.networks.transt import (
    SEARCH_PX,
    STRIDE,
    TEMPLATE_PX,
    Prediction,
    Template,
    TransT,
    TransTM,
)

Image = NDArray[np.uint8]  # (h, w, 3) RGB
VOT_WINDOW, TRANST_WINDOW = 0.574, 0.49  # window weights of TransT-M and of TransT
LEAST_PX = 10.0  # side of a box


@dataclass(frozen=True)
class Sighting:
    """Where the target is: box px; score of the chosen token, 0 to 1; predicted overlap or None.

    probability (h, w) float32: that a pixel is the target's, zero outside the search crop; None of
    weights without a mask.
    """

    box: Box
    score: float
    iou: float | None
    probability: NDArray[np.float32] | None


class TransTLoop:
    """One target's track. window_weight 0 to 1: None for the default of the weights.

    update_iou: predicted overlap above which the second template is made anew, if the place itself
    has a score of lost_below at least: else it might be the background's.
    """

    def __init__(
        self,
        network: TransT,
        window_weight: float | None = None,
        update_iou: float = 0.869,
        lost_below: float = 0.0,
    ) -> None:
        self._network = network
        has_updates = isinstance(network, TransTM)
        default = VOT_WINDOW if has_updates else TRANST_WINDOW
        self._window_weight = default if window_weight is None else window_weight
        self._update_iou = update_iou if has_updates else math.inf
        self._lost_below = lost_below
        side = SEARCH_PX // STRIDE
        self._window = np.outer(np.hanning(side), np.hanning(side)).ravel()
        self._templates: tuple[Template, ...] = ()

    def start(self, image: Image, box: Box) -> None:
        """Take the target in a box px of an image as the template."""
        self._fill = image.mean(axis=(0, 1))
        self._centre = np.array([box[0] + box[2], box[1] + box[3]]) / 2
        self._size = np.array([box[2] - box[0], box[3] - box[1]], dtype=np.float64)
        template = self._template(image)
        self._templates = (template, template) if math.isfinite(self._update_iou) else (template,)

    def step(self, image: Image) -> Sighting:
        """Find the target in the next image."""
        side, centre = _side(self._size, 3.0), self._centre
        crop = _crop(image, centre, side, SEARCH_PX, self._fill)
        found = self._network(normalised(crop), self._templates)
        scores = found.logits.softmax(1)[:, 0].double().numpy()
        preferred = scores * (1 - self._window_weight) + self._window * self._window_weight
        best = int(np.argmax(preferred))
        self._put(found.boxes[best].double().numpy() * side, side, image.shape)
        iou = None if found.iou is None else float(found.iou[best])
        if iou is not None and iou > self._update_iou and scores[best] >= self._lost_below:
            self._templates = (self._templates[0], self._template(image))
        low, high = self._centre - self._size / 2, self._centre + self._size / 2
        box = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
        probability = _pasted(found, centre, side, image.shape)
        return Sighting(box, float(scores[best]), iou, probability)

    def _put(self, box: Array, side: int, shape: tuple[int, ...]) -> None:
        """Move the track to a box of the search crop (centre and size, px), kept in the image."""
        most = np.array([shape[1], shape[0]], dtype=np.float64)
        self._centre = np.clip(box[:2] + self._centre - side / 2, 0, most)
        self._size = np.clip(box[2:], LEAST_PX, most)

    def _template(self, image: Image) -> Template:
        crop = _crop(image, self._centre, _side(self._size, 1.0), TEMPLATE_PX, self._fill)
        return self._network.template(normalised(crop))


def _side(size: Array, margin: float) -> int:
    """Side px of the square crop around a box of a size px, with a margin in mean sides."""
    width, height = size + margin * size.sum() / 2
    return math.ceil(math.sqrt(width * height))


def _corner(centre: Array, side: int) -> tuple[int, int]:
    """First pixel x, y of a crop."""
    x, y = np.floor(centre - (side + 1) / 2 + 0.5).astype(int)
    return int(x), int(y)


def _crop(image: Image, centre: Array, side: int, pixels: int, fill: Array) -> Image:
    """A square of an image, side px wide, scaled to `pixels`; `fill` (3,) outside the image."""
    (x, y), (h, w) = _corner(centre, side), image.shape[:2]
    crop = np.empty((side, side, 3), np.uint8)
    crop[:] = fill.astype(np.uint8)
    x0, y0, x1, y1 = max(x, 0), max(y, 0), min(x + side, w), min(y + side, h)
    if x0 < x1 and y0 < y1:
        crop[y0 - y : y1 - y, x0 - x : x1 - x] = image[y0:y1, x0:x1]
    return crop if side == pixels else np.asarray(cv2.resize(crop, (pixels, pixels)), np.uint8)


def _pasted(
    found: Prediction, centre: Array, side: int, shape: tuple[int, ...]
) -> NDArray[np.float32] | None:
    """The crop's mask at its place in an image of a shape; None where there is none."""
    if found.mask is None:
        return None
    (x, y), (h, w) = _corner(centre, side), shape[:2]
    scaled = cv2.resize(found.mask.numpy(), (side, side))
    out = np.zeros((h, w), np.float32)
    x0, y0, x1, y1 = max(x, 0), max(y, 0), min(x + side, w), min(y + side, h)
    if x0 < x1 and y0 < y1:
        out[y0:y1, x0:x1] = scaled[y0 - y : y1 - y, x0 - x : x1 - x]
    return out
