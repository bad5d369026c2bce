"""What the target looks like against its surroundings: how likely a colour is the target's.

Histograms of colour, of the target and of what is around it. The target's keeps half of its weight
for the first mask, so that what is learnt later can't take its place.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Box, Intrinsics
from dgeval.perception import segmentation
from dgeval.perception.segmentation import Mask
from dgeval.perception.types import Window

Image = NDArray[np.uint8]  # RGB, (h, w, 3)
LIGHT, TINT = 8, 32  # bins of lightness, and of each of the two axes of colour
LEAST_PIXELS = 30  # of a mask that is learnt from
RECENT = 0.25  # share of a new frame in what was seen last
FIRST = 0.5  # share of the first mask in the target's histogram
UNSEEN = 2e-5  # share of each histogram that any colour has, so that unseen ones are undecided
LIKELY, UNLIKE = 0.5, 0.2  # likelihood, above which a colour is its own, and below which it isn't
PATCH = 0.2  # share of the window's shorter side; smaller patches of another colour are its print
LEAST_SEPARABLE = 0.6  # colours that tell the target less from its surroundings are not used
BESIDE_PX = 4  # px beside the target's box that are neither it nor its surroundings


class Colours:
    """The bins of an image's colours; what was asked for once is not worked out again."""

    def __init__(self, image: Image) -> None:
        self._image = image
        self._window: Window = (0, 0, 0, 0)
        self._bins = np.zeros((0, 0), np.uint16)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        return self._image.shape[0], self._image.shape[1]

    def of(self, window: Window) -> NDArray[np.uint16]:
        """(h, w) of a window of the image."""
        x0, y0, x1, y1 = window
        a, b, c, d = self._window
        if not (a <= x0 and b <= y0 and x1 <= c and y1 <= d):
            self._window, self._bins = window, colours(self._image[y0:y1, x0:x1])
            a, b = x0, y0
        return self._bins[y0 - b : y1 - b, x0 - a : x1 - a]

    def all(self) -> NDArray[np.uint16]:
        """(H, W) of the whole image."""
        height, width = self.shape
        return self.of((0, 0, width, height))


class Appearance:
    """The colours of the target, of what is beside it now, and of the first image around it.

    separable: what share of the target's pixels look rather like it than like the first image
    around it, less the share of that image which does too. separable_near: beside what is near.
    """

    def __init__(self) -> None:
        self._first: Array | None = None
        self.separable = self.separable_near = 0.0

    @property
    def known(self) -> bool:
        """Whether a target has been learnt."""
        return self._first is not None

    def start(
        self, seen: Colours, box: Box, window: Window, mask: Mask, camera: Intrinsics
    ) -> None:
        """Learn a new target: its mask in a window of the image, and its box px.

        A mask that is too small, or that leaves nothing around it, teaches nothing.
        """
        target = np.zeros(seen.shape, dtype=bool)
        target[window[1] : window[3], window[0] : window[2]] = mask
        around = np.ones(target.shape, dtype=bool)
        x0, y0, x1, y1 = segmentation.grow(box, 0.0, BESIDE_PX, camera)
        around[y0:y1, x0:x1] = False
        near = np.zeros(target.shape, dtype=bool)
        x0, y0, x1, y1 = segmentation.grow(box, 1.0, BESIDE_PX, camera)
        near[y0:y1, x0:x1] = around[y0:y1, x0:x1]
        if min(int(part.sum()) for part in (target, near, around)) < LEAST_PIXELS:
            return
        bins = seen.all()
        self._first = self._recent = histogram(bins[target])
        self._near, self._around = histogram(bins[near]), histogram(bins[around])
        self._weigh()

    def learn(
        self, seen: Colours, box: Box, window: Window, mask: Mask, camera: Intrinsics
    ) -> None:
        """Learn how the target and what is near it look now, as `start`."""
        if self._first is None:
            return
        x0, y0, x1, y1 = segmentation.grow(box, 1.0, BESIDE_PX, camera)
        near = np.ones((y1 - y0, x1 - x0), dtype=bool)
        a, b, c, d = segmentation.grow(box, 0.0, BESIDE_PX, camera)
        near[b - y0 : d - y0, a - x0 : c - x0] = False
        if min(int(mask.sum()), int(near.sum())) < LEAST_PIXELS:
            return
        other = seen.of((x0, y0, x1, y1))[near]
        own = seen.of(window)[mask]
        self._recent = (1 - RECENT) * self._recent + RECENT * histogram(own)
        self._near = (1 - RECENT) * self._near + RECENT * histogram(other)
        self._weigh()

    def _weigh(self) -> None:
        assert self._first is not None
        self._target = FIRST * self._first + (1 - FIRST) * self._recent
        around = 0.5 * (self._around + self._near)
        self._table, self.separable = _against(self._target, around)
        self._table_near, self.separable_near = _against(self._target, self._near)

    def likelihood(self, seen: Colours) -> NDArray[np.float32]:
        """(H, W) how likely each pixel is the target's, 0 to 1, anywhere."""
        return np.asarray(self._table[seen.all()])

    def unlike(self, seen: Colours, window: Window) -> Mask:
        """Pixels of a window near the target that do not have its colours but those beside it.

        None of them where its colours don't tell it from what is beside it.
        """
        x0, y0, x1, y1 = window
        if self.separable_near < LEAST_SEPARABLE:
            return np.zeros((y1 - y0, x1 - x0), dtype=bool)
        likely = self._table_near[seen.of(window)]
        unlike = (cv2.blur(likely, (3, 3)) < UNLIKE).astype(np.uint8)
        size = max(3, round(PATCH * min(x1 - x0, y1 - y0)) | 1)
        square = np.ones((size, size), np.uint8)
        return np.asarray(cv2.morphologyEx(unlike, cv2.MORPH_OPEN, square) > 0)

    def alike(self, seen: Colours, window: Window, at: Mask) -> float:
        """Bhattacharyya coefficient of the colours of a mask (h, w) and of the target, 0 to 1."""
        return float(np.sqrt(histogram(seen.of(window)[at]) * self._target).sum())


def colours(image: Image) -> NDArray[np.uint16]:
    """The bin (h, w) of each pixel's colour, in CIELAB."""
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB).astype(np.uint16)
    return np.asarray(((lab[..., 0] >> 5) << 10) | ((lab[..., 1] >> 3) << 5) | (lab[..., 2] >> 3))


def histogram(bins: NDArray[np.uint16]) -> Array:
    """Shares (LIGHT * TINT * TINT,) of the pixels, smoothed over neighbouring colours; sum 1."""
    counts = np.bincount(bins.ravel(), minlength=LIGHT * TINT * TINT).astype(np.float64)
    padded = np.pad(counts.reshape(LIGHT, TINT, TINT), ((1, 1), (0, 0), (0, 0)))
    cube = 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
    planes = np.ascontiguousarray(cube.transpose(1, 2, 0))
    smooth = cv2.GaussianBlur(planes, (5, 5), 0.8).transpose(2, 0, 1)
    return np.asarray(smooth.ravel() / max(smooth.sum(), 1e-12))


def _against(target: Array, others: Array) -> tuple[NDArray[np.float32], float]:
    """How likely each colour is the target's, and how well that tells it from the others."""
    table = ((target + UNSEEN) / (target + others + 2 * UNSEEN)).astype(np.float32)
    likely = table > LIKELY
    return table, float(target[likely].sum() - others[likely].sum())
