"""The `model` tracker: projects the model cloud at the predicted pose and aligns it to the image.

It goes beyond the paper's image tracker, as RGB-D allows. Where the target has no depth, it tracks
the box in colour and gives no pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.config import Config
from dgeval.geometry import Array, Box, Intrinsics, invert, rotation_angle, transform
from dgeval.perception import align, segmentation
from dgeval.perception.appearance import LEAST_SEPARABLE, Appearance, Colours
from dgeval.perception.boxes import inside, overlap, projected_box, visible
from dgeval.perception.keyframes import Keyframes, LastFrame
from dgeval.perception.plane import Plane
from dgeval.perception.redetection import LEAST_ALIKE, look_alikes, put_at
from dgeval.perception.self_filter import hand_pixels
from dgeval.perception.trackers.image import Grey, ImageTrack
from dgeval.perception.types import Model, Tracked, Window
from dgeval.recording.frame import Frame

GROWTH_PX = 6  # px beyond the model's silhouette in which new parts of the target are accepted
RIM_FRAMES = 15  # accepted frames at the start in which the rim is measured
RIM_SHARE = 0.05  # of the box's size; a larger difference does not come from the rim
RIM_ANGLE = 0.12  # rad; after a larger rotation other parts of the target make its outline
# a model is started if the pixels with depth cover at least these shares of the box: by the overlap
# of their extent with it, and by area
MIN_COVER, MIN_FILL = 0.5, 0.2
NEAREST_M = 0.1  # m, at which a target without depth is, at least
LEAST_SHARED = 0.2  # overlap of the box of what was found and that of the model put there
# share of its silhouette that is hidden, from which on its box is that of the rest, and from which
# on it is occluded
LEAST_HIDDEN, HALF = 0.1, 0.5
# confidence: of what colours alone found, at most; share of agreeing depth of which there is none;
# followed features, in least numbers of them, of which it is full; ours
FOUND_CONFIDENCE, LEAST_AGREE, FEATURES_SURE = 0.9, 0.4, 4
NO_DEPTH = 0.5  # share of a box without depth, from which on its target may be too near for it
LEARNT_EVERY = 3  # frames; of these one is learnt from
LEARNT_ALIKE = 0.85  # likeness, below which what is tracked is not learnt: it may be something else
LEARNT_AGREE = 0.8  # share of agreeing depth from which on a mask shows what the target looks like


@dataclass(frozen=True, slots=True)
class TrackingInput:
    """One frame, its box px if one is given, and the later stages' results of the previous frames.

    model: None until there is one. T_predicted: T_camera_model in this frame, from the estimator.
    T_previous: final T_camera_model of the previous frame; accepted: whether it is that of an
    accepted registration.
    """

    frame: Frame
    box: Box | None
    model: Model | None
    T_predicted: Array | None
    T_previous: Array | None
    accepted: bool


@dataclass(frozen=True)
class _ModelStart:
    """Box px and plane of the frame in which the model was started."""

    box: Box
    plane: Plane | None


# window px, the target's pixels in it (h, w), plane, and depth (h, w) m
_Segmented = tuple[Window, NDArray[np.bool_], Plane | None, NDArray[np.float32]]


class ModelTracker:
    """The tracker of this module. Deterministic: draws are keyed by the frame index."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        self._keyframes = Keyframes(self.config.tracking)
        self._last_frame: LastFrame | None = None
        self._image: ImageTrack | None = None
        self._lost_since: int | None = None
        self._started = False
        self._model_start: _ModelStart | None = None
        self._n_accepted = 0
        self._rim: tuple[Array, float] | None = None
        self._plane_model: Plane | None = None
        self._appearance = Appearance()
        self._area_m2 = 0.0
        self._agree = 0.0
        self._hidden = 0.0
        # the picture and box of the last frame in which the model was tracked, and what follows it
        # in colour since
        self._last_seen: tuple[Grey, Box] | None = None
        self._near: ImageTrack | None = None

    def step(self, given: TrackingInput) -> Tracked:
        """The target's box, mask, pose and features in the next frame."""
        frame = given.frame
        self._seen = Colours(frame.colour)
        grey = np.asarray(cv2.cvtColor(frame.colour, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        if given.box is not None:
            self.reset()
            self._started = True
            return self._start(frame, grey, given.box)
        if not self._started:
            return Tracked("not_started")
        if given.model is None or given.T_predicted is None:
            return self._follow_image(frame, grey)
        if given.T_previous is not None and given.accepted:
            if self._last_frame is not None:
                self._keyframes.keep(self._last_frame, given.T_previous, frame.camera)
                self._last_frame = None
            self._learn_rim(given.model, given.T_previous, frame.camera)
        was_lost = self._lost_since is not None
        tracked = self._follow_model(frame, grey, given.model, given.T_predicted)
        alike = self._looks(tracked)
        if tracked.state == "lost" or alike < LEAST_ALIKE:
            hidden = self._hidden_at(frame, given.model, given.T_predicted)
            lost = Tracked("lost", plane=tracked.plane, confidence=0.0, occluded=hidden > HALF)
            tracked = self._search(frame, grey, given.model, given.T_predicted, lost)
            if tracked.state == "lost":
                tracked = self._follow_near(frame, grey, lost)
            alike = self._looks(tracked)
        if tracked.T_camera_model is not None and tracked.box is not None:
            self._last_seen, self._near = (grey, tracked.box), None
        if tracked.state == "lost":
            self._lost_since = self._lost_since if was_lost else frame.t_ns
            return tracked
        self._lost_since = None
        self._learn(frame, tracked, alike)
        return replace(
            tracked,
            confidence=self._confidence(tracked, alike),
            occluded=tracked.mask is not None and self._hidden > HALF,
            reacquired=was_lost,
        )

    def look(self, frame: Frame, model: Model, T_camera_model: Array) -> Tracked:
        """Track the model in any frame from any pose, with what is known of the target so far.

        Lost where it does not look like the target. The tracker's own state is not changed.
        """
        kept = (self._lost_since, self._last_frame, self._plane_model, self._agree, self._hidden)
        area_m2, self._lost_since = self._area_m2, None
        self._seen = Colours(frame.colour)
        grey = np.asarray(cv2.cvtColor(frame.colour, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        tracked = self._follow_model(frame, grey, model, T_camera_model)
        if self._looks(tracked) < LEAST_ALIKE:
            tracked = Tracked("lost", plane=tracked.plane)
        self._lost_since, self._last_frame, self._plane_model, self._agree, self._hidden = kept
        self._area_m2 = area_m2
        return tracked

    # the first frame

    def _start(self, frame: Frame, grey: Grey, box: Box) -> Tracked:
        segmented = self._segment_box(frame, box)
        if segmented is None:
            self._image = ImageTrack(grey, box, self.config.tracking)
            return Tracked("tracked", inside(box, frame.camera), mask_area=0)
        return self._start_model(frame, grey, box, segmented)

    def _start_model(self, frame: Frame, grey: Grey, box: Box, segmented: _Segmented) -> Tracked:
        window, mask, plane, depth = segmented
        self._last_frame = LastFrame(grey, window, mask, depth)
        self._model_start = _ModelStart(box, plane)
        self._appearance.start(self._seen, box, window, mask, frame.camera)
        self._area_m2 = _area(mask, depth, frame.camera)
        return Tracked(
            "tracked", inside(box, frame.camera), window, mask, int(mask.sum()), plane=plane
        )

    def _segment_box(self, frame: Frame, box: Box) -> _Segmented | None:
        window = segmentation.grow(box, 0.5, 10, frame.camera)
        if segmentation.is_empty(window):
            return None
        depth, free, plane = segmentation.free_pixels(frame, window, box, self.config)
        mask = segmentation.segment_box(depth, window, free, box)
        if int(mask.sum()) < self.config.observation.min_points:
            return None
        area = (box[2] - box[0]) * (box[3] - box[1])
        filled = int((segmentation.fill(mask.astype(np.float32), 5) > 0).sum())
        if overlap(segmentation.extent(mask, window), box) < MIN_COVER or filled < MIN_FILL * area:
            return None  # a patch of depth in the box is not the object in it
        return window, mask, plane, depth

    # colour alone

    def _follow_image(self, frame: Frame, grey: Grey) -> Tracked:
        """Without a model: track the box in colour, and start a model when it has enough depth."""
        if self._image is None:
            return Tracked("lost")
        box = self._image_box(frame, grey)
        if box is None:
            return Tracked("lost", confidence=0.0)
        segmented = self._segment_box(frame, self._image.box)
        if segmented is None:
            return Tracked("tracked", box)
        followed, self._image = self._image.box, None
        return self._start_model(frame, grey, followed, segmented)

    def _image_box(self, frame: Frame, grey: Grey) -> Box | None:
        assert self._image is not None
        agree = self._image.step(grey)
        if (
            agree < self.config.tracking.min_corners
            or visible(self._image.box, frame.camera) < self._min_visible()
        ):
            return None
        return inside(self._image.box, frame.camera)

    # the model

    def _follow_model(
        self,
        frame: Frame,
        grey: Grey,
        model: Model,
        T_predicted: Array,
        searched: bool = False,
    ) -> Tracked:
        """searched: the pose is not predicted, but that of something found."""
        c = self.config.tracking
        if (
            not searched
            and self._lost_since is not None
            and frame.t_ns - self._lost_since > c.reacquire_s * 1e9
        ):
            return Tracked("lost")
        guess = self._with_rim(
            projected_box(model.points[::4], T_predicted, frame.camera, None), model, T_predicted
        )
        if guess is None or visible(guess, frame.camera) < self._min_visible():
            return Tracked("lost")
        window = segmentation.grow(guess, 0.3, 12, frame.camera)
        depth, free, plane = segmentation.free_pixels(frame, window, guess, self.config)
        if plane is None and self._plane_model is not None:
            # too little of the surface near the target has depth to fit the plane again
            plane = self._plane_model.moved(T_predicted)
            depth, free = self._crop(frame, window, plane)
        features = self._keyframes.follow(grey, window, T_predicted, frame.camera)
        free &= ~self._appearance.unlike(self._seen, window)
        T, agree, n_depth, n_features = align.align_to_image(
            depth, window, free, model, features, T_predicted, frame.camera, c
        )
        self._agree = agree
        needed = c.min_agree if self._lost_since is None else 0.5 * (1 + c.min_agree)
        by_depth = n_depth >= self.config.observation.min_points and agree >= needed
        by_colour = n_features >= 2 * c.min_corners
        if (
            self._lost_since is not None
            and self._keyframes
            and n_features < c.min_corners
            and len(features.points) >= 12
        ):
            by_depth = False  # the shape is right, but it does not look like the target
        if not by_depth and not by_colour:
            return Tracked("lost", plane=plane)
        box = self._with_rim(projected_box(model.points, T, frame.camera, plane), model, T)
        if box is None or visible(box, frame.camera) < self._min_visible():
            return Tracked("lost", plane=plane)
        points = transform(T, model.points)
        window = segmentation.grow(box, 0.15, 8, frame.camera)
        depth, free = self._crop(frame, window, plane)
        unlike = self._appearance.unlike(self._seen, window)
        mask, front = segmentation.segment_model(
            depth, window, free & ~unlike, points, frame.camera, GROWTH_PX
        )
        hidden, self._hidden = segmentation.hidden_part(front, depth, unlike)
        if self._hidden > LEAST_HIDDEN:
            box = segmentation.seen_part(box, window, (front > 0) & ~hidden)
        self._area_m2 = max(self._area_m2, _area(front > 0, front, frame.camera))
        self._last_frame = LastFrame(grey, window, mask, depth)
        if plane is not None:
            self._plane_model = plane.moved(invert(T))
        return Tracked(
            "tracked", inside(box, frame.camera), window, mask, int(mask.sum()), T, features, plane
        )

    def _crop(
        self, frame: Frame, window: Window, plane: Plane | None
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """As `_free`, with a known plane."""
        depth = frame.depth[window[1] : window[3], window[0] : window[2]]
        free = segmentation.above_plane(depth, window, frame.camera, plane, self.config.plane)
        if frame.hand is not None:
            origin = (window[0], window[1])
            free &= ~hand_pixels(
                depth, origin, frame.camera, frame.hand, self.config.self_filter.margin
            )
        return depth, free

    # what it looks like

    def _learn(self, frame: Frame, tracked: Tracked, alike: float) -> None:
        """Learn the target's colours where depth shows that it is the target, and it looks so."""
        if tracked.mask is None or tracked.window is None or tracked.box is None:
            return
        if frame.index % LEARNT_EVERY:
            return
        if self._agree >= LEARNT_AGREE and alike >= LEARNT_ALIKE:
            self._appearance.learn(
                self._seen, tracked.box, tracked.window, tracked.mask, frame.camera
            )

    def _looks(self, tracked: Tracked) -> float:
        """How alike the tracked pixels and the target are, 0 to 1; 1 where nothing tells."""
        if tracked.mask is None or tracked.window is None or not self._appearance.known:
            return 1.0
        if self._appearance.separable_near < LEAST_SEPARABLE or not tracked.mask.any():
            return 1.0
        return self._appearance.alike(self._seen, tracked.window, tracked.mask)

    def _confidence(self, tracked: Tracked, alike: float) -> float:
        """That what is tracked is the target: the least of what looks, depth and features say."""
        looks = (alike - LEAST_ALIKE) / (LEARNT_ALIKE - LEAST_ALIKE)
        if tracked.T_camera_model is None:  # found by its colours alone
            return float(np.clip(looks, 0.0, FOUND_CONFIDENCE))
        n_features = 0 if tracked.features is None else len(tracked.features.points)
        followed = n_features / (FEATURES_SURE * self.config.tracking.min_corners)
        agree = (self._agree - LEAST_AGREE) / (LEARNT_AGREE - LEAST_AGREE)
        return float(np.clip(min(looks, max(agree, followed)), 0.0, 1.0))

    def _hidden_at(self, frame: Frame, model: Model, T_camera_model: Array) -> float:
        """Share of the model's silhouette at a pose that something nearer is in front of."""
        box = projected_box(model.points[::4], T_camera_model, frame.camera, None)
        if box is None:
            return 0.0
        window = segmentation.grow(box, 0.0, 0, frame.camera)
        if segmentation.is_empty(window):
            return 0.0
        depth = frame.depth[window[1] : window[3], window[0] : window[2]]
        points = transform(T_camera_model, model.points)
        points = points[points[:, 2] > 0.05]
        front = segmentation.near_side(depth.shape, window, points, frame.camera)
        return segmentation.hidden_part(front, depth, np.zeros(depth.shape, dtype=bool))[1]

    def _search(
        self, frame: Frame, grey: Grey, model: Model, T_predicted: Array, lost: Tracked
    ) -> Tracked:
        """Look for a target that is not where it should be in the whole image."""
        blocked = np.zeros(frame.depth.shape, dtype=bool)
        if frame.hand is not None:
            margin = self.config.self_filter.margin
            blocked = hand_pixels(frame.depth, (0, 0), frame.camera, frame.hand, margin)
        z = max(float(transform(T_predicted, model.points.mean(axis=0)[None])[0, 2]), NEAREST_M)
        found = look_alikes(self._appearance, frame, self._seen, blocked, self._area_m2, z)
        if not found:
            return lost
        best = found[0]
        min_points = self.config.observation.min_points
        T = put_at(best, frame, model, T_predicted, min_points)
        if T is not None:
            tracked = self._follow_model(frame, grey, model, T, searched=True)
            if (
                tracked.box is not None
                and overlap(tracked.box, best.box) > LEAST_SHARED
                and self._looks(tracked) >= LEAST_ALIKE
            ):
                return tracked
        self._agree = 0.0
        return Tracked("tracked", best.box, plane=lost.plane)

    def _follow_near(self, frame: Frame, grey: Grey, lost: Tracked) -> Tracked:
        """A target that was tracked to where the camera has no depth: its box, in colour."""
        if self._last_seen is None:
            return lost
        if self._near is None:
            self._near = ImageTrack(*self._last_seen, self.config.tracking)
        followed = self._near.step(grey)
        box = self._near.box
        window = segmentation.grow(box, 0.0, 0, frame.camera)
        depth = frame.depth[window[1] : window[3], window[0] : window[2]]
        if (
            followed < 2 * self.config.tracking.min_corners
            or visible(box, frame.camera) < self._min_visible()
            or not depth.size
            or float((depth == 0).mean()) < NO_DEPTH
        ):
            self._last_seen = self._near = None
            return lost
        self._agree = 0.0
        return Tracked("tracked", inside(box, frame.camera), plane=lost.plane)

    # boxes

    def _learn_rim(self, model: Model, T_previous: Array, camera: Intrinsics) -> None:
        """Measure by how much the given box exceeds the box of the projected model.

        Cameras give no depth along an object's rim. The value is updated while the model grows and
        the view has hardly changed, then kept.
        """
        self._n_accepted += 1
        if self._n_accepted == 1:
            self._T_at_start = T_previous
        turn = rotation_angle(self._T_at_start[:3, :3].T @ T_previous[:3, :3])
        if self._n_accepted > RIM_FRAMES or self._model_start is None or turn > RIM_ANGLE:
            return
        box = projected_box(model.points, self._T_at_start, camera, self._model_start.plane)
        if box is None:
            return
        size = np.array([box[2] - box[0], box[3] - box[1]] * 2)
        distance = float(
            (self._T_at_start[:3, :3] @ model.points.mean(axis=0) + self._T_at_start[:3, 3])[2]
        )
        rim = np.clip(
            np.array(self._model_start.box) - np.array(box), -RIM_SHARE * size, RIM_SHARE * size
        )
        self._rim = rim, distance

    def _with_rim(self, box: Box | None, model: Model, T: Array) -> Box | None:
        if box is None or self._rim is None:
            return box
        distance = float((T[:3, :3] @ model.points.mean(axis=0) + T[:3, 3])[2])
        x0, y0, x1, y1 = (
            np.array(box) + self._rim[0] * (self._rim[1] / max(distance, 0.05))
        ).tolist()
        return x0, y0, x1, y1

    def _min_visible(self) -> float:
        return self.config.tracking.min_visible


def _area(mask: NDArray[np.bool_], depth: NDArray[np.float32], camera: Intrinsics) -> float:
    """m^2, of a mask's pixels at their depth, seen from the camera."""
    z = depth[mask].astype(np.float64)
    return float((z * z).sum() / (camera.fx * camera.fy))


METHOD, STAND_IN, TRACKER = "model", "model tracker", ModelTracker
