"""The paper's tracker, TransT-M, with the authors' weights, and TransT with its own.

The network's box and mask in each frame are used as masks and boxes of a log are. Without a mask of
the network's (TransT, or TransT-M's weights without that part), plane, hand and depth steps in its
box give the mask.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dgeval.config import Config
from dgeval.perception import segmentation
from dgeval.perception.boxes import visible
from dgeval.perception.trackers.model import TrackingInput
from dgeval.perception.trackers.recorded import RecordedTracker
from dgeval.perception.types import Tracked
from dgeval.recording.frame import Frame, MarkedThing

# every tracker's file is loaded to be found by its name; torch, which takes seconds, is not
if TYPE_CHECKING:
    from dgeval.networks.transt import TransT
    from dgeval.networks.transt_loop import Sighting

TARGET = "target"  # name of the only thing that the network marks


def transt_of(weights: str) -> TransT:
    """The network of a file of weights, read once. UsageError if it doesn't fit."""
    from dgeval.networks.checkpoints import version_of

    return _read(weights, version_of(Path(weights)))


@cache
def _read(weights: str, _: tuple[int, int]) -> TransT:
    from dgeval.networks.transt import load_transt

    return load_transt(Path(weights))


class TransTTracker:
    """The network says where the target is and how surely; a doubted place is a loss."""

    def __init__(self, config: Config) -> None:
        self.config = config
        assert config.tracking.weights is not None  # the configuration refuses it
        self._network = transt_of(config.tracking.weights)
        self._marked = RecordedTracker(config)
        self.reset()

    def reset(self) -> None:
        from dgeval.networks.transt_loop import TransTLoop

        c = self.config.tracking
        self._loop = TransTLoop(self._network, c.window_weight, c.update_iou, c.lost_below)
        self._marked.reset()
        self._has_started = False

    def step(self, given: TrackingInput) -> Tracked:
        """The target's box, mask and the model's pose in it, in one frame."""
        frame, score = given.frame, None
        if given.box is not None:
            self._loop.start(frame.colour, given.box)
            self._has_started = True
            things: tuple[MarkedThing, ...] = (MarkedThing(given.box, TARGET),)
        elif self._has_started:
            found = self._loop.step(frame.colour)
            score, things = found.score, self._things(frame, found)
        else:
            return Tracked("not_started")
        tracked = self._marked.step(replace(given, frame=replace(frame, marked=things)))
        return replace(tracked, confidence=score)

    def _things(self, frame: Frame, found: Sighting) -> tuple[MarkedThing, ...]:
        """What the network marks: none where it doubts, or where the target leaves the image."""
        c = self.config.tracking
        if found.score < c.lost_below or visible(found.box, frame.camera) < c.min_visible:
            return ()
        if found.probability is None:
            return (MarkedThing(found.box, TARGET),)
        window = segmentation.grow(found.box, 0.5, 10, frame.camera)
        x0, y0, x1, y1 = window
        _, free, _ = segmentation.free_pixels(frame, window, found.box, self.config)
        mask = free & (found.probability[y0:y1, x0:x1] > c.mask_above)
        v, u = np.nonzero(mask)
        if not len(v):
            return ()
        left, top, right, bottom = int(u.min()), int(v.min()), int(u.max()) + 1, int(v.max()) + 1
        box = (float(x0 + left), float(y0 + top), float(x0 + right), float(y0 + bottom))
        return (MarkedThing(box, TARGET, np.asarray(mask[top:bottom, left:right])),)


METHOD, STAND_IN, TRACKER = "transt", None, TransTTracker
