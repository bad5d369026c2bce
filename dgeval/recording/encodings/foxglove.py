"""Foxglove's message types, given the fields of the ROS 2 types that mean the same.

They come as protobuf, as JSON, or as ROS messages of the package foxglove_msgs. Field names are
those of the public schemas; bytes in JSON are base64.
"""

from __future__ import annotations

import base64
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

# Foxglove's type, without its package: the ROS 2 type that means the same
STANDS_FOR = {
    "CompressedImage": "sensor_msgs/msg/CompressedImage",
    "CompressedVideo": "foxglove_msgs/msg/CompressedVideo",
    "RawImage": "sensor_msgs/msg/Image",
    "CameraCalibration": "sensor_msgs/msg/CameraInfo",
    "FrameTransform": "tf2_msgs/msg/TFMessage",
    "FrameTransforms": "tf2_msgs/msg/TFMessage",
    "PoseInFrame": "geometry_msgs/msg/PoseStamped",
    "JointStates": "sensor_msgs/msg/JointState",
}
PACKAGES = ("foxglove.", "foxglove_msgs/msg/")


def ros_type(name: str) -> str:
    """The ROS 2 type that a Foxglove type stands for; other names as they are."""
    for package in PACKAGES:
        if name.startswith(package):
            return STANDS_FOR.get(name[len(package) :], name)
    return name


def adapted(name: str, decode: Callable[[bytes], Any]) -> Callable[[bytes], Any]:
    """A decoder of a Foxglove type, made to give the fields of the ROS 2 type."""
    adapt = ADAPTERS[next(name[len(p) :] for p in PACKAGES if name.startswith(p))]
    return lambda data: adapt(decode(data))


def _stamp(time: Any) -> SimpleNamespace:
    """From protobuf (seconds, nanos), JSON (sec, nsec) or ROS (sec, nanosec)."""
    sec = getattr(time, "seconds", None)
    sec = time.sec if sec is None else sec
    for name in ("nanos", "nsec", "nanosec"):
        nanosec = getattr(time, name, None)
        if nanosec is not None:
            return SimpleNamespace(sec=int(sec), nanosec=int(nanosec))
    return SimpleNamespace(sec=int(sec), nanosec=0)


def _header(message: Any, frame: str = "frame_id") -> SimpleNamespace:
    return SimpleNamespace(stamp=_stamp(message.timestamp), frame_id=getattr(message, frame))


def _bytes(data: Any) -> bytes:
    return base64.b64decode(data, validate=True) if isinstance(data, str) else bytes(data)


def _compressed_image(m: Any) -> SimpleNamespace:
    return SimpleNamespace(header=_header(m), format=m.format, data=_bytes(m.data))


def _raw_image(m: Any) -> SimpleNamespace:
    size = {k: int(getattr(m, k)) for k in ("width", "height", "step")}
    return SimpleNamespace(
        header=_header(m), encoding=m.encoding, is_bigendian=0, data=_bytes(m.data), **size
    )


def _camera_calibration(m: Any) -> SimpleNamespace:
    matrices = {k.lower(): list(getattr(m, k, getattr(m, k.lower(), ()))) for k in "DKRP"}
    return SimpleNamespace(
        header=_header(m),
        width=int(m.width),
        height=int(m.height),
        distortion_model=m.distortion_model,
        **matrices,
    )


def _transform(m: Any) -> SimpleNamespace:
    return SimpleNamespace(
        header=_header(m, "parent_frame_id"),
        child_frame_id=m.child_frame_id,
        transform=SimpleNamespace(translation=m.translation, rotation=m.rotation),
    )


def _transforms(m: Any) -> SimpleNamespace:
    return SimpleNamespace(transforms=[_transform(t) for t in m.transforms])


def _pose_in_frame(m: Any) -> SimpleNamespace:
    return SimpleNamespace(header=_header(m), pose=m.pose)


def _joint_states(m: Any) -> SimpleNamespace:
    joints = list(m.joints)
    nan = float("nan")

    def values(name: str) -> list[float]:
        given = [getattr(j, name, None) for j in joints]
        return [nan if v is None else float(v) for v in given]

    return SimpleNamespace(
        header=SimpleNamespace(stamp=_stamp(m.timestamp), frame_id=""),
        name=[j.name for j in joints],
        position=values("position"),
        velocity=values("velocity"),
        effort=values("effort"),
    )


ADAPTERS: dict[str, Callable[[Any], SimpleNamespace]] = {
    "CompressedImage": _compressed_image,
    "CompressedVideo": _compressed_image,
    "RawImage": _raw_image,
    "CameraCalibration": _camera_calibration,
    "FrameTransform": lambda m: SimpleNamespace(transforms=[_transform(m)]),
    "FrameTransforms": _transforms,
    "PoseInFrame": _pose_in_frame,
    "JointStates": _joint_states,
}
