"""Writes the demo's messages as other people's recorders would, and reads them back."""

from __future__ import annotations

import copy
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from dgeval.config import Config, load_config
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import Trial, open_trial
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE, ROS1 = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)
VISION_MSGS = {
    "Point2D": "float64 x\nfloat64 y",
    "Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
    "BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose",
    "Detection2D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox2D bbox\nstring id",
    "Detection3D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox3D bbox\nstring id",
    "Detection2DArray": "std_msgs/Header header\nvision_msgs/Detection2D[] detections",
    "Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}


for _name, _text in VISION_MSGS.items():
    STORE.register(get_types_from_msg(_text, f"vision_msgs/msg/{_name}"))
TYPES = STORE.types
COLOUR = "/camera/color/image_raw/compressed"
DEPTH = "/camera/aligned_depth_to_color/image_raw/compressedDepth"
INFO, JOINTS, EVENTS = "/camera/color/camera_info", "/joint_states", "/dgeval/events"
Message = list[Any]  # log time ns, topic, type, message


def write(
    path: Path, listed: list[Message], schema: Callable[[str], tuple[str, bytes]] | None = None
) -> Path:
    """An MCAP as rosbag2 writes it; schema gives a type's (encoding, text)."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for log_ns, topic, kind, value in sorted(listed, key=lambda m: m[0]):
            if kind not in schemas:
                text = STORE.generate_msgdef(kind, ros_version=2)[0].encode()
                encoding, data = schema(kind) if schema else ("ros2msg", text)
                schemas[kind] = writer.register_schema(kind, encoding, data)
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "cdr", schemas[kind])
            data = bytes(STORE.serialize_cdr(value, kind))
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.finish()
    return path


def opened(path: Path, *settings: str) -> Trial:
    config = load_config("dynamic", settings) if settings else Config()
    return open_trial(find_trials([path])[0], config)


def names(trial: Trial) -> list[str]:
    """Of the checks that fail."""
    return [check.name for check in trial.checks]


def contents(trial: Trial, every: int = 8) -> list[tuple[Any, ...]]:
    """Stamp, sums of the pixels and camera pose of some frames."""
    return [
        (
            f.t_ns,
            int(f.colour.sum()),
            float(f.depth.sum()),
            None if f.T_base_camera is None else np.round(f.T_base_camera, 6).tolist(),
        )
        for f in trial.frames()
        if f.index % every == 0
    ]


def depth_codes(message: Any) -> np.ndarray:
    data = np.asarray(message.data, np.uint8)[12:]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED))


def header(like: Any, frame: str | None = None) -> Any:
    out = copy.deepcopy(like.header)
    out.frame_id = frame or out.frame_id
    return out


def image(like: Any, pixels: np.ndarray, encoding: str, frame: str | None = None) -> Any:
    pixels = np.ascontiguousarray(pixels)
    return TYPES["sensor_msgs/msg/Image"](
        header=header(like, frame),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=pixels.strides[0],
        data=pixels.view(np.uint8).reshape(-1),
    )


def rvl_words(codes: np.ndarray) -> bytes:
    """Wilson's run-length code, written out plainly."""
    nibbles: list[int] = []

    def put(value: int) -> None:
        while True:
            low, value = value & 7, value >> 3
            nibbles.append(low | (8 if value else 0))
            if not value:
                return

    pixels, i, previous = codes.ravel().tolist(), 0, 0
    while i < len(pixels):
        for zeros in (True, False):
            first = i
            while i < len(pixels) and (pixels[i] == 0) == zeros:
                i += 1
            put(i - first)
        for value in pixels[first:i]:
            difference = value - previous
            put((difference << 1) ^ (difference >> 31))
            previous = value
    nibbles += [0] * (-len(nibbles) % 8)
    words = [sum(n << (28 - 4 * k) for k, n in enumerate(nibbles[j : j + 8]))
             for j in range(0, len(nibbles), 8)]  # fmt: skip
    return struct.pack(f"<{len(words)}I", *words)


def of(name: str, **fields: Any) -> Any:
    return TYPES[f"vision_msgs/msg/{name}"](**fields)


def flat(header: Any, *boxes: tuple[float, float, float, float]) -> Any:
    """A Detection2DArray; x0 y0 x1 y1 px."""
    listed = []
    for x0, y0, x1, y1 in boxes:
        at = of("Pose2D", position=of("Point2D", x=(x0 + x1) / 2, y=(y0 + y1) / 2), theta=0.0)
        box = of("BoundingBox2D", center=at, size_x=x1 - x0, size_y=y1 - y0)
        listed.append(of("Detection2D", header=header, results=[], bbox=box, id=""))
    return of("Detection2DArray", header=header, detections=listed)
