"""The `recorded` tracker: masks, boxes or poses of the target from the log, of any other tracker.

So that a team's own tracker is evaluated without porting it. Where the log marks nothing, the
target is lost.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array, Box, invert, transform
from dgeval.perception import align, segmentation
from dgeval.perception.boxes import inside, overlap, projected_box, visible
from dgeval.perception.keyframes import Keyframes, LastFrame
from dgeval.perception.redetection import Found, put_at
from dgeval.perception.trackers.image import Grey
from dgeval.perception.trackers.model import GROWTH_PX, TrackingInput
from dgeval.perception.types import Model, Tracked
from dgeval.recording.frame import Frame, MarkedThing
from dgeval.recording.recorded_target import RECORDED

SAME_PLACE = 0.5  # overlap with the last box, from which on a thing is in its place; ours
MOVED = 0.5  # overlap with the box, below which the model is put there before it is aligned; ours


class RecordedTracker:
    """Which of the marked things is the target: by its name in the log, else by where it was.

    In a box, plane, hand and depth steps give the mask. In a mask the model is aligned to depth and
    to image features, for registration to start from, and of the mask that part is used which lies
    in its silhouette or comes into view beside it. A pose is taken as it is from where the model
    was started, and the model's silhouette there gives the mask.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        self._box: Box | None = None
        self._name = ""
        self._T_object_model: Array | None = None
        self._was_lost = False
        self._keyframes = Keyframes(self.config.tracking)
        self._last_frame: LastFrame | None = None

    def step(self, given: TrackingInput) -> Tracked:
        """The target's box, mask and pose in one frame, as the log has them."""
        if given.box is not None:
            self.reset()
            self._box = given.box
        if self._box is None:
            return Tracked("not_started")
        if self._last_frame is not None and given.T_previous is not None and given.accepted:
            self._keyframes.keep(self._last_frame, given.T_previous, given.frame.camera)
        self._last_frame = None
        thing = self._chosen(given.frame.marked)
        tracked = Tracked("lost") if thing is None else self._tracked(given, thing)
        if thing is None or tracked.box is None:
            self._was_lost = True
            return Tracked("lost", plane=tracked.plane)
        self._name, self._box = thing.name, tracked.box
        reacquired, self._was_lost = self._was_lost, False
        return replace(tracked, reacquired=reacquired, confidence=thing.score)

    def _chosen(self, things: tuple[MarkedThing, ...]) -> MarkedThing | None:
        """The thing of the target's name, of several the one where the target was last.

        Without a name the thing at that place. A name that is suddenly elsewhere, while another
        thing is in the target's place, is none.
        """
        assert self._box is not None
        shares = [_shared(thing, self._box) for thing in things]
        named = [k for k, thing in enumerate(things) if self._name and thing.name == self._name]
        best = int(np.argmax(shares)) if shares else 0
        if named:
            own = max(named, key=lambda k: shares[k])
            # a number of the message's entries is no name: what was in this place is there still
            is_elsewhere = not self._was_lost and shares[own] <= 0 and shares[best] > SAME_PLACE
            return things[best if is_elsewhere else own]
        if self._name or not shares or shares[best] <= 0:
            return None
        return things[best]

    def _tracked(self, given: TrackingInput, thing: MarkedThing) -> Tracked:
        frame = given.frame
        if thing.T_camera_object is not None:
            if given.model is not None and self._T_object_model is not None:
                T = thing.T_camera_object @ self._T_object_model
                return self._posed(frame, given.model, T)
            # the model's frame is the camera's in the frame in which it is started
            self._T_object_model = invert(thing.T_camera_object)
            assert self._box is not None
            return self._segmented(frame, self._box if thing.is_point else thing.box, None)
        tracked = self._segmented(frame, thing.box, thing)
        if given.model is None or given.T_predicted is None or tracked.window is None:
            return self._remembered(frame, tracked)
        return self._aligned(frame, tracked, given.model, given.T_predicted)

    def _remembered(self, frame: Frame, tracked: Tracked, grey: Grey | None = None) -> Tracked:
        """The same, kept until the frame's final pose is known, as features are then kept of it."""
        if tracked.window is None or tracked.mask is None:
            return tracked
        x0, y0, x1, y1 = tracked.window
        depth = frame.depth[y0:y1, x0:x1]
        grey = _grey(frame) if grey is None else grey
        self._last_frame = LastFrame(grey, tracked.window, tracked.mask, depth)
        return tracked

    def _aligned(self, frame: Frame, tracked: Tracked, model: Model, T_predicted: Array) -> Tracked:
        """With the pose of the model in the mask; without one where they don't agree."""
        assert tracked.window is not None
        assert tracked.mask is not None
        assert tracked.box is not None
        x0, y0, x1, y1 = tracked.window
        T, grey, c = T_predicted, _grey(frame), self.config.tracking
        expected = projected_box(model.points[::4], T, frame.camera, None)
        if expected is None or overlap(expected, tracked.box) < MOVED:
            marked = np.zeros(frame.depth.shape, dtype=bool)
            marked[y0:y1, x0:x1] = tracked.mask
            found = Found(tracked.box, marked, True)
            put = put_at(found, frame, model, T, self.config.observation.min_points)
            T = T if put is None else put
        features = self._keyframes.follow(grey, tracked.window, T, frame.camera)
        depth = frame.depth[y0:y1, x0:x1]
        T, agree, n_depth, n_features = align.align_to_image(
            depth, tracked.window, tracked.mask, model, features, T, frame.camera, c
        )
        by_depth = n_depth >= self.config.observation.min_points and agree >= c.min_agree
        if by_depth or n_features >= 2 * c.min_corners:
            # a side that comes into view at once would be refused, and the model never grow
            points = transform(T, model.points)
            mask, _ = segmentation.segment_model(
                depth, tracked.window, tracked.mask, points, frame.camera, GROWTH_PX
            )
            tracked = replace(
                tracked, mask=mask, mask_area=int(mask.sum()), T_camera_model=T, features=features
            )
        return self._remembered(frame, tracked, grey)

    def _segmented(self, frame: Frame, box: Box, thing: MarkedThing | None) -> Tracked:
        """The mask of a box px, or a thing's own."""
        window = segmentation.grow(box, 0.5, 10, frame.camera)
        if segmentation.is_empty(window):
            return Tracked("lost")
        depth, free, plane = segmentation.free_pixels(frame, window, box, self.config)
        if thing is None or thing.pixels is None:
            mask = segmentation.segment_box(depth, window, free, box)
        else:
            mask = np.zeros(depth.shape, dtype=bool)
            x0, y0 = round(thing.box[0]) - window[0], round(thing.box[1]) - window[1]
            height, width = thing.pixels.shape
            mask[y0 : y0 + height, x0 : x0 + width] = thing.pixels
            mask &= depth > 0
        return Tracked("tracked", box, window, mask, int(mask.sum()), plane=plane)

    def _posed(self, frame: Frame, model: Model, T_camera_model: Array) -> Tracked:
        """The mask of the model's silhouette at a pose; lost where the camera doesn't see it."""
        box = projected_box(model.points, T_camera_model, frame.camera, None)
        if box is None or visible(box, frame.camera) < self.config.tracking.min_visible:
            return Tracked("lost")
        window = segmentation.grow(box, 0.3, 12, frame.camera)
        depth, free, plane = segmentation.free_pixels(frame, window, box, self.config)
        points = transform(T_camera_model, model.points)
        mask, _ = segmentation.segment_model(
            depth, window, free, points[points[:, 2] > 0.05], frame.camera, GROWTH_PX
        )
        area, seen = int(mask.sum()), inside(box, frame.camera)
        return Tracked(
            "tracked", seen, window, mask, area, T_camera_model, plane=plane, pose_stands=True
        )


def _grey(frame: Frame) -> Grey:
    return np.asarray(cv2.cvtColor(frame.colour, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def _shared(thing: MarkedThing, box: Box) -> float:
    """How far a thing and a box px are one: their overlap; of a point 1 where it is in the box."""
    if not thing.is_point:
        return overlap(thing.box, box)
    u, v = (thing.box[0] + thing.box[2]) / 2, (thing.box[1] + thing.box[3]) / 2
    return float(box[0] <= u < box[2] and box[1] <= v < box[3])


METHOD, STAND_IN, TRACKER = RECORDED, "what the log marks", RecordedTracker
