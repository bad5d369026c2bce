"""What the log itself marks as the target: the robot's masks, its detections, or an object's pose.

Each becomes boxes in the colour picture of a time. Which of several is the target is not told here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Box, matrix_from_pose, transform
from dgeval.recording.camera import Camera
from dgeval.recording.containers.container import Opened
from dgeval.recording.detections import Detection
from dgeval.recording.frame import MarkedThing
from dgeval.recording.images import decode_image
from dgeval.recording.messages import StampedPose, stamp_ns
from dgeval.recording.pairing import Pair
from dgeval.recording.robot import RobotStates
from dgeval.recording.roles import same_shape
from dgeval.recording.scan import NOT_USABLE, Scan

RECORDED = "recorded"  # the `tracking.method` that takes what the log marks
# a mark so near to an image's stamp is of that image: ns, and share of the time between images
SAME_IMAGE_NS, SAME_IMAGE_SHARE = 20_000_000, 0.4
AHEAD_NS = 100_000_000  # ns; no mark is logged by so much before the picture that it is of; ours
SOFT = 0.5  # share of a mask's pixels with nearly its largest value; then it has soft edges; ours
LEAST_PX = 10.0  # px; a smaller box holds nothing that can be followed; ours
UNDECODABLE = "can't be decoded"
MOST_MARKS = 200  # messages with a mark that are looked at; ours
MOST_LABELS = 20  # values of a mask; more is no mask; ours
MOST_OF_PICTURE = 0.5  # share that a target covers at most in a mask; ours
# of a box's numbers at most where they are shares; times the picture's size, and share of the
# boxes that may reach beyond it; ours
IN_SHARES, BEYOND, MOST_BEYOND = 1.01, 1.05, 0.1
ABOUT_M = 0.04  # m around an object's pose; no object is asked for its size; ours


@dataclass(frozen=True, slots=True)
class Mark:
    """What a topic marks in the colour picture of a time, ns."""

    topic: str
    t_ns: int
    things: tuple[MarkedThing, ...]

    @property
    def boxes(self) -> tuple[Box, ...]:
        """Of the things, x0 y0 x1 y1 px, in the picture as frames hold it."""
        return tuple(thing.box for thing in self.things)

    @property
    def is_point(self) -> bool:
        """Whether a box is around a point on the object, and says nothing of its size."""
        return any(thing.is_point for thing in self.things)


def marks_of(
    scan: Scan,
    topics: tuple[str, ...],
    pairs: tuple[Pair, ...],
    camera: Camera,
    robot: RobotStates,
    most: int | None = MOST_MARKS,
    unused: Counter[str] | None = None,
) -> list[Mark]:
    """The marks of topics in a trial's pictures, in time order; one for all in one picture.

    most: of each topic that are looked at; None for all. unused: counts, by the reason in words,
    what is not used.
    """
    unused = Counter() if unused is None else unused
    stamps = np.array([p.t_ns for p in pairs], dtype=np.int64)
    near_ns = near_enough(pairs)
    out: dict[int, Mark] = {}
    for topic in topics:
        if unusable(scan, topic, camera):
            continue
        seen: dict[int, int] = {}  # by the picture's time the mark's own
        for mark in _marks_of_topic(scan, topic, camera, robot, unused):
            at = int(stamps[np.argmin(np.abs(stamps - mark.t_ns))])
            things = tuple(
                replace(thing, box=box)
                for thing in mark.things
                if (box := _inside(thing.box, camera)) is not None
            )
            if abs(at - mark.t_ns) > near_ns:
                unused[f"{topic}: farther than {near_ns * 1e-6:.0f} ms from a picture's stamp"] += 1
                continue
            if not things:
                unused[f"{topic}: outside the picture, or smaller than {LEAST_PX:.0f} px"] += 1
                continue
            if seen.setdefault(at, mark.t_ns) != mark.t_ns:
                unused[f"{topic}: of a picture that another message marks"] += 1
                continue
            before = out.get(at)
            names = topic if before is None else before.topic
            if topic not in names.split(", "):
                names = f"{names}, {topic}"
            others = () if before is None else before.things
            out[at] = Mark(names, at, (*others, *things))
            if most is not None and len(seen) >= most:
                break
    return [out[t] for t in sorted(out)]


def unusable(scan: Scan, topic: str, camera: Camera) -> str:
    """Why nothing that a topic marks is used: stamps ahead of the recorder's time, or pictures of
    another size; "" where that is not so.
    """
    k = camera.intrinsics
    if (ahead := _ahead(scan, topic)) > AHEAD_NS:
        return (
            f"the stamps of {topic} are {ahead * 1e-9:.1f} s ahead of when the recorder had it: "
            "which pictures it marks is not known, and it is not used"
        )
    mask = scan.images.get(topic)
    if mask is not None and not same_shape((mask.width, mask.height), (k.width, k.height)):
        return (
            f"the masks of {topic} are {mask.width}x{mask.height} for pictures of "
            f"{k.width}x{k.height}: of another shape, and not used"
        )
    listed = [d.box for d in scan.detections.get(topic, ()) if d.box is not None]
    if not listed:
        return ""
    boxes = np.array(listed)
    if boxes.max() <= IN_SHARES:
        return f"the boxes of {topic} are in shares of the picture, not in px, and are not used"
    reach = (boxes[:, 2] > BEYOND * k.width) | (boxes[:, 3] > BEYOND * k.height)
    if reach.mean() <= MOST_BEYOND:
        return ""
    right, down = boxes[:, 2].max(), boxes[:, 3].max()
    return (
        f"the boxes of {topic} reach to {right:.0f}, {down:.0f} px in pictures of "
        f"{k.width}x{k.height}: of another size, and not used"
    )


def near_enough(pairs: tuple[Pair, ...]) -> int:
    """How near, ns, a mark must be to a picture's stamp: less than half of the time between two."""
    steps = np.diff(np.array([p.t_ns for p in pairs], dtype=np.int64))
    if not len(steps):
        return SAME_IMAGE_NS
    return min(SAME_IMAGE_NS, int(SAME_IMAGE_SHARE * float(np.median(steps))))


def _ahead(scan: Scan, topic: str) -> float:
    """By how much, ns, a topic's stamps are ahead of the recorder's time, against the pictures'."""

    def early(name: str) -> float | None:
        times = scan.times.get(name)
        if times is None or not times.log_ns or len(times.header_ns) != len(times.log_ns):
            return None
        stamps, log = times.arrays()
        return float(np.median(stamps - log))

    own = early(topic)
    others = [e for name in scan.cameras if (e := early(name)) is not None]
    others += [e for name in scan.images if name != topic and (e := early(name)) is not None]
    return 0.0 if own is None or not others else own - float(np.median(others))


def _marks_of_topic(
    scan: Scan, topic: str, camera: Camera, robot: RobotStates, unused: Counter[str]
) -> Iterator[Mark] | list[Mark]:
    if topic in scan.images:
        return _of_masks(scan.opened, topic, camera, unused)
    if topic in scan.detections:
        return _of_detections(scan.detections[topic], topic, camera, robot, unused)
    poses = scan.poses.get(topic) or frame_on_tf(scan, topic)
    return _of_poses(poses, topic, camera, robot, unused)


def frame_on_tf(scan: Scan, frame: str) -> list[StampedPose]:
    """The samples of a frame on /tf, as estimators of an object's pose publish it; with the stamps
    as they are, those of the pictures.
    """
    return [edge for heard in scan.tf.values() for edge in heard.moving if edge.child == frame]


def _of_masks(opened: Opened, topic: str, camera: Camera, unused: Counter[str]) -> Iterator[Mark]:
    """One thing for each value, or colour, of a mask that is not 0 and covers less than half of the
    picture; one for all where JPEG or soft edges blur the values.

    A mask of another size with the picture's shape is scaled.
    """
    size = (camera.intrinsics.width, camera.intrinsics.height)
    for message in opened.messages(frozenset({topic})):
        try:
            decoded = opened.decode(message)
            mask = decode_image(decoded).array
            t_ns = stamp_ns(decoded)
        except NOT_USABLE:
            unused[f"{topic}: {UNDECODABLE}"] += 1
            continue
        mask = _labels(mask, "jp" in str(getattr(decoded, "format", "")).lower())
        values = np.unique(mask[mask > 0])
        if not len(values):
            unused[f"{topic}: empty"] += 1
            continue
        if len(values) > MOST_LABELS:
            unused[f"{topic}: more than {MOST_LABELS} values"] += 1
            continue
        things = []
        for value in values:
            at = (mask == value).astype(np.uint8)
            if at.shape != size[::-1]:
                at = np.asarray(cv2.resize(at, size, interpolation=cv2.INTER_NEAREST), np.uint8)
            if camera.lens is not None:
                at = camera.lens.mask(at)
            if 0 < at.mean() < MOST_OF_PICTURE:
                things.append(_masked(at > 0, f"{topic}#{value}"))
        if things:
            yield Mark(topic, t_ns, tuple(things))
        else:
            unused[f"{topic}: more than {MOST_OF_PICTURE:.0%} of the picture"] += 1


def _labels(mask: NDArray[Any], is_lossy: bool) -> NDArray[Any]:
    """(h, w) numbers of a mask's things, 0 where there is none."""
    if mask.ndim == 3:
        if (mask == mask[:, :, :1]).all():
            mask = mask[:, :, 0]
        else:
            channels = mask.astype(np.int64)
            mask = (channels[:, :, 0] << 32) | (channels[:, :, 1] << 16) | channels[:, :, 2]
    most = int(mask.max())
    marked = mask[mask > 0]
    soft = len(np.unique(marked)) > MOST_LABELS and float((marked > 0.9 * most).mean()) > SOFT
    return np.where(mask > most / 2, most, 0) if is_lossy or soft else mask


def _masked(at: NDArray[np.bool_], name: str) -> MarkedThing:
    rows, cols = np.flatnonzero(at.any(axis=1)), np.flatnonzero(at.any(axis=0))
    x0, x1, y0, y1 = int(cols[0]), int(cols[-1]) + 1, int(rows[0]), int(rows[-1]) + 1
    box = (float(x0), float(y0), float(x1), float(y1))
    return MarkedThing(box, name, at[y0:y1, x0:x1].copy())


def _of_detections(
    detections: list[Detection],
    topic: str,
    camera: Camera,
    robot: RobotStates,
    unused: Counter[str],
) -> list[Mark]:
    """By the time of their image; those in a picture of another camera are left out."""
    by_time: dict[int, list[MarkedThing]] = {}
    for d in detections:
        box, T_camera_object = d.box, None
        if box is not None:
            if d.frame not in ("", robot.camera_frame):
                unused[f"{topic}: of {d.frame}, while the camera is {robot.camera_frame}"] += 1
                continue
            box = box if camera.lens is None else camera.lens.box(box)
        elif d.T_frame_box is not None:
            T = _T_camera_frame(d.frame, d.t_ns, robot)
            if T is None:
                unused[f"{topic}: in a frame that the tree doesn't have, {d.frame}"] += 1
                continue
            T_camera_object = T @ d.T_frame_box
            box = _seen(transform(T, _corners(d)), camera)
        if box is not None:
            name = f"{topic}#{d.name}" if d.name else ""
            thing = MarkedThing(box, name, T_camera_object=T_camera_object, score=d.score)
            by_time.setdefault(d.t_ns, []).append(thing)
    return [Mark(topic, t, tuple(by_time[t])) for t in sorted(by_time)]


def _of_poses(
    poses: list[StampedPose],
    topic: str,
    camera: Camera,
    robot: RobotStates,
    unused: Counter[str],
) -> list[Mark]:
    out = []
    around = ABOUT_M * np.array(list(product((-1, 1), repeat=3)), dtype=float)
    for pose in poses:
        T = _T_camera_frame(pose.parent, pose.t_ns, robot)
        if T is None:
            unused[f"{topic}: in a frame that the tree doesn't have, {pose.parent}"] += 1
            continue
        T_camera_object = T @ matrix_from_pose(pose.pose)
        box = _seen(around + T_camera_object[:3, 3], camera)
        if box is not None:
            thing = MarkedThing(box, topic, T_camera_object=T_camera_object, is_point=True)
            out.append(Mark(topic, pose.t_ns, (thing,)))
    return out


def _corners(detection: Detection) -> Array:
    """(8, 3) m, of a 3-D box in its frame."""
    assert detection.T_frame_box is not None
    half = np.array(detection.size) / 2
    return transform(detection.T_frame_box, half * np.array(list(product((-1, 1), repeat=3))))


def _T_camera_frame(frame: str, t_ns: int, robot: RobotStates) -> Array | None:
    """(4, 4) at a time, ns; None where the frame is not known."""
    T = robot.tree.lookup(robot.camera_frame, frame or robot.camera_frame, t_ns)
    if T is None and frame in ("", robot.camera_frame):
        return np.eye(4)
    return None if T is None else np.asarray(T)


def _seen(points: Array, camera: Camera) -> Box | None:
    """The box px around points (n, 3) m, camera frame, in the picture; None behind the camera."""
    x, y, z = points.T
    if (z <= 0.01).any():
        return None
    k = camera.intrinsics
    u, v = k.fx * x / z + k.cx, k.fy * y / z + k.cy
    return float(u.min()), float(v.min()), float(u.max()), float(v.max())


def _inside(box: Box, camera: Camera) -> Box | None:
    """The part of a box that lies in the picture; None where that is too small."""
    k = camera.intrinsics
    x0, y0 = max(0.0, box[0]), max(0.0, box[1])
    x1, y1 = min(float(k.width), box[2]), min(float(k.height), box[3])
    return (x0, y0, x1, y1) if min(x1 - x0, y1 - y0) >= LEAST_PX else None
