"""What librealsense's recorder writes in its own way: frame times as text, places of streams."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np

from dgeval.geometry import Array
from dgeval.recording.messages import pose_numbers

FRAME_TIME = re.compile(r"(?:^|;)timestamp=([0-9.]+)")  # ms, in the text of a .db3's metadata
STREAM_POSE_TYPE = "geometry_msgs/msg/Transform"
# what realsense-ros publishes of two streams, once, on …/extrinsics/depth_to_color
EXTRINSICS = frozenset(
    {"realsense2_camera_msgs/msg/Extrinsics", "realsense2_camera/msg/Extrinsics"}
)
DEPTH_TO_COLOUR = "/depth_to_color"
NO_ROTATION = 1e-3  # by which R R^T may differ from the identity
# of a .bag, the pose of a group's reference in a stream's frame
STREAM_POSE = re.compile(r"((/device_\d+)/sensor_\d+/[^/]+)/tf/(\d+)")


class StreamAt(NamedTuple):
    """The beginning of a stream's topics, and the frame of the reference that its pose is of."""

    prefix: str
    reference: str


def frame_time_ns(text: str) -> int | None:
    """The frame's own time in the metadata of an image, ns; None without."""
    found = FRAME_TIME.search(text)
    return None if found is None else round(float(found[1]) * 1e6)


def stream_of(topic: str) -> StreamAt | None:
    """The stream whose pose a topic gives; None for another topic."""
    match = STREAM_POSE.fullmatch(topic)
    if match is None:
        return None
    return StreamAt(match[1], f"{match[2].lstrip('/')}/reference_{match[3]}")


def pose_of_transform(message: Any) -> Array:
    """(7,) px py pz qx qy qz qw of a geometry_msgs/Transform. ValueError for no pose."""
    return pose_numbers(message.translation, message.rotation)


def extrinsics_of(message: Any) -> Array:
    """(4, 4), which maps points of the first stream into the second, from realsense-ros, whose
    rotation is column by column. ValueError for no rotation.
    """
    T = np.eye(4)
    T[:3, :3] = np.asarray(message.rotation, dtype=np.float64).reshape(3, 3).T
    T[:3, 3] = message.translation
    if not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=NO_ROTATION):
        raise ValueError("its rotation is none")
    return T
