"""What the log itself marks as the target: the robot's masks, its detections, or an object's pose.

Each becomes boxes in the colour picture of a time. Which of several is the target is not told here.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array, Box, matrix_from_pose, transform
from dgeval.recording.camera import Camera
from dgeval.recording.containers.container import Opened
from dgeval.recording.detections import Detection
from dgeval.recording.images import decode_image
from dgeval.recording.messages import stamp_ns
from dgeval.recording.pairing import Pair
from dgeval.recording.robot import RobotStates
from dgeval.recording.scan import NOT_USABLE, Scan

SAME_IMAGE_NS = 20_000_000  # ns; a mark so near to an image's stamp is of that image; ours
LEAST_PX = 10.0  # px; a smaller box holds nothing that can be followed; ours
MOST_MARKS = 200  # messages with a mark that are looked at; ours
MOST_LABELS = 20  # values of a mask; more is no mask; ours
MOST_OF_PICTURE = 0.5  # share that a target covers at most in a mask; ours
# of a box's numbers at most where they are shares; times the picture's size, and share of the
# boxes that may reach beyond it; ours
IN_SHARES, BEYOND, MOST_BEYOND = 1.01, 1.05, 0.1
ABOUT_M = 0.04  # m around an object's pose; no object is asked for its size; ours


@dataclass(frozen=True, slots=True)
class Mark:
    """What a topic marks in the colour picture of a time, ns: boxes, in the picture as frames hold
    it. is_point: the box is around a point on the object, and says nothing of its size.
    """

    topic: str
    t_ns: int
    boxes: tuple[Box, ...]
    is_point: bool = False


def marks_of(
    scan: Scan,
    topics: tuple[str, ...],
    pairs: tuple[Pair, ...],
    camera: Camera,
    robot: RobotStates,
) -> list[Mark]:
    """The marks of topics in a trial's pictures, in time order; one for all in one picture."""
    stamps = np.array([p.t_ns for p in pairs], dtype=np.int64)
    out: dict[int, Mark] = {}
    for topic in topics:
        if of_another_size(scan, topic, camera):
            continue
        seen: set[int] = set()
        for mark in _marks_of_topic(scan, topic, camera, robot):
            at = int(stamps[np.argmin(np.abs(stamps - mark.t_ns))])
            boxes = tuple(b for box in mark.boxes if (b := _inside(box, camera)) is not None)
            if abs(at - mark.t_ns) > SAME_IMAGE_NS or not boxes or at in seen:
                continue
            seen.add(at)
            before = out.get(at)
            names = topic if before is None else f"{before.topic}, {topic}"
            others = () if before is None else before.boxes
            is_point = mark.is_point or (before is not None and before.is_point)
            out[at] = Mark(names, at, (*others, *boxes), is_point)
            if len(seen) >= MOST_MARKS:
                break
    return [out[t] for t in sorted(out)]


def of_another_size(scan: Scan, topic: str, camera: Camera) -> str:
    """What is wrong with a topic of boxes in a picture of another size; "" where nothing is."""
    listed = [d.box for d in scan.detections.get(topic, ()) if d.box is not None]
    if not listed:
        return ""
    boxes = np.array(listed)
    k = camera.intrinsics
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


def _marks_of_topic(scan: Scan, topic: str, camera: Camera, robot: RobotStates) -> list[Mark]:
    if topic in scan.images:
        return _of_masks(scan.opened, topic, camera)
    if topic in scan.detections:
        return _of_detections(scan.detections[topic], topic, camera, robot)
    return _of_poses(scan, topic, camera, robot)


def _of_masks(opened: Opened, topic: str, camera: Camera) -> list[Mark]:
    """One box for each value of a mask that is not 0 and covers less than half of the picture."""
    out: list[Mark] = []
    for message in opened.messages(frozenset({topic})):
        try:
            decoded = opened.decode(message)
            mask = decode_image(decoded).array
            t_ns = stamp_ns(decoded)
        except NOT_USABLE:
            continue  # told by the scan
        mask = mask if mask.ndim == 2 else mask[:, :, 0]
        values = np.unique(mask[mask > 0])
        if not 0 < len(values) <= MOST_LABELS:
            continue
        labels = [at for v in values if (at := mask == v).mean() < MOST_OF_PICTURE]
        if labels:
            out.append(Mark(topic, t_ns, tuple(_box_of(at, camera) for at in labels)))
        if len(out) >= MOST_MARKS:
            break
    return out


def _box_of(at: NDArray[np.bool_], camera: Camera) -> Box:
    rows, cols = np.nonzero(at)
    box = (float(cols.min()), float(rows.min()), float(cols.max() + 1), float(rows.max() + 1))
    return box if camera.lens is None else camera.lens.box(box)


def _of_detections(
    detections: list[Detection], topic: str, camera: Camera, robot: RobotStates
) -> list[Mark]:
    """By the time of their image; those in a picture of another camera are left out."""
    by_time: dict[int, list[Box]] = {}
    for d in detections:
        box = d.box
        if box is not None:
            if d.frame not in ("", robot.camera_frame):
                continue
            box = box if camera.lens is None else camera.lens.box(box)
        elif d.T_frame_box is not None:
            box = _seen(_corners(d), d.frame, d.t_ns, camera, robot)
        if box is not None:
            by_time.setdefault(d.t_ns, []).append(box)
    return [Mark(topic, t, tuple(by_time[t])) for t in sorted(by_time)]


def _of_poses(scan: Scan, topic: str, camera: Camera, robot: RobotStates) -> list[Mark]:
    out = []
    around = ABOUT_M * np.array(list(product((-1, 1), repeat=3)), dtype=float)
    for pose in scan.poses.get(topic, []):
        place = matrix_from_pose(pose.pose)[:3, 3]
        box = _seen(around + place, pose.parent, pose.t_ns, camera, robot)
        if box is not None:
            out.append(Mark(topic, pose.t_ns, (box,), True))
    return out


def _corners(detection: Detection) -> Array:
    """(8, 3) m, of a 3-D box in its frame."""
    assert detection.T_frame_box is not None
    half = np.array(detection.size) / 2
    return transform(detection.T_frame_box, half * np.array(list(product((-1, 1), repeat=3))))


def _seen(points: Array, frame: str, t_ns: int, camera: Camera, robot: RobotStates) -> Box | None:
    """The box around points (n, 3) m of a frame, in the picture; None behind the camera or where
    the frame is not known.
    """
    T = robot.tree.lookup(robot.camera_frame, frame or robot.camera_frame, t_ns)
    if T is None and frame in ("", robot.camera_frame):
        T = np.eye(4)
    if T is None:
        return None
    x, y, z = transform(T, points).T
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
