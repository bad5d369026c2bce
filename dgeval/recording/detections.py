"""What a robot's detector saw, from the messages of vision_msgs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dgeval.geometry import Array, Box, matrix_from_pose
from dgeval.recording.messages import pose_numbers, stamp_ns


@dataclass(frozen=True, slots=True)
class Detection:
    """One thing that a detector saw. box: px of the picture as recorded; of a 3-D detection it is
    None, and T_frame_box (4, 4) and size (3,) m are known. name: the same in every message, or "".
    score: of its likeliest hypothesis, 0 to 1; None without one.
    """

    t_ns: int
    frame: str
    box: Box | None
    T_frame_box: Array | None = None
    size: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = ""
    score: float | None = None


DETECTION_TYPES = frozenset(
    f"vision_msgs/msg/{name}"
    for name in ("Detection2DArray", "Detection2D", "Detection3DArray", "Detection3D")
)


def detections_of(message: Any) -> list[Detection]:
    """From vision_msgs Detection2D, Detection3D and their arrays, of any of its versions.

    ValueError for a box whose numbers are none.
    """
    listed = message.detections if hasattr(message, "detections") else [message]
    stamp = stamp_ns(message)
    frame = message.header.frame_id.lstrip("/")
    out = []
    for one in listed:
        t_ns = stamp_ns(one) or stamp
        here = one.header.frame_id.lstrip("/") or frame
        name, score = str(getattr(one, "id", "")), _score(one)
        if hasattr(one.bbox, "size"):
            size = tuple(float(getattr(one.bbox.size, axis)) for axis in "xyz")
            centre = one.bbox.center
            pose = matrix_from_pose(pose_numbers(centre.position, centre.orientation))
            out.append(Detection(t_ns, here, None, pose, size, name, score))  # type: ignore[arg-type]
            continue
        centre = one.bbox.center
        at = getattr(centre, "position", centre)
        numbers = np.array([at.x, at.y, one.bbox.size_x, one.bbox.size_y, centre.theta], float)
        if not np.isfinite(numbers).all():
            raise ValueError(f"not a box: {numbers.tolist()}")
        x, y, w, h, theta = numbers.tolist()
        c, s = abs(np.cos(theta)), abs(np.sin(theta))
        half = float(w * c + h * s) / 2, float(w * s + h * c) / 2
        box = (x - half[0], y - half[1], x + half[0], y + half[1])
        out.append(Detection(t_ns, here, box, name=name, score=score))
    return out


def _score(one: Any) -> float | None:
    """The highest score of a detection's hypotheses, in either version of their message; None
    where none lies in 0 to 1, or all are 0, as of a detector that doesn't fill it.
    """
    listed = [getattr(r, "hypothesis", r).score for r in getattr(one, "results", ())]
    known = [float(v) for v in listed if 0 < v <= 1]
    return max(known, default=None)
