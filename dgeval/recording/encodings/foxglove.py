"""Foxglove's message types, given the fields of the ROS 2 types that mean the same.

They come as protobuf, as JSON, or as ROS messages of the package foxglove_msgs. Field names are
those of the public schemas; bytes in JSON are base64. JSON may also be protobuf's own: names in
camelCase, times as RFC 3339 texts, and no fields that are 0 or empty.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from datetime import datetime
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
# "2027-01-15T08:00:00.123456789Z": to the second, its fraction, the zone
RFC_3339 = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?(Z|[+-]\d\d:\d\d)")


def ros_type(name: str) -> str:
    """The ROS 2 type that a Foxglove type stands for; other names as they are."""
    for package in PACKAGES:
        if name.startswith(package):
            return STANDS_FOR.get(name[len(package) :], name)
    return name


def adapted(name: str, decode: Callable[[bytes], Any]) -> Callable[[bytes], Any]:
    """A decoder of a Foxglove type, made to give the fields of the ROS 2 type; of other types the
    decoder itself.
    """
    kind = next((name[len(p) :] for p in PACKAGES if name.startswith(p)), "")
    adapt = ADAPTERS.get(kind)
    if adapt is None:
        return decode

    def decoded(data: bytes) -> Any:
        message = _in_snake_case(decode(data))
        try:
            return adapt(message)
        except AttributeError as error:
            raise ValueError(f"it has no field {error.name!r}") from error

    return decoded


def _in_snake_case(value: Any) -> Any:
    """An object of JSON with its fields named as in the schemas: `frameId` is `frame_id`."""
    if isinstance(value, list) and value and isinstance(value[0], SimpleNamespace):
        return [_in_snake_case(item) for item in value]
    if not isinstance(value, SimpleNamespace):
        return value
    return SimpleNamespace(
        **{
            re.sub(r"(?<=[a-z0-9])[A-Z]", lambda m: f"_{m[0].lower()}", name): _in_snake_case(field)
            for name, field in vars(value).items()
        }
    )


def _stamp(time: Any) -> SimpleNamespace:
    """From protobuf (seconds, nanos), JSON (sec, nsec, or an RFC 3339 text) or ROS (sec, nanosec).

    0 without one, as of an image whose recorder's time counts. ValueError for a text of another
    form.
    """
    if time is None:
        return SimpleNamespace(sec=0, nanosec=0)
    if isinstance(time, str):
        parts = RFC_3339.fullmatch(time)
        if parts is None:
            raise ValueError(f"the time {time[:40]!r} is no RFC 3339 time")
        second = datetime.fromisoformat(parts[1] + parts[3].replace("Z", "+00:00"))
        fraction = (parts[2] or "").ljust(9, "0")
        return SimpleNamespace(sec=int(second.timestamp()), nanosec=int(fraction))
    sec = getattr(time, "seconds", None)
    sec = time.sec if sec is None else sec
    for name in ("nanos", "nsec", "nanosec"):
        nanosec = getattr(time, name, None)
        if nanosec is not None:
            return SimpleNamespace(sec=int(sec), nanosec=int(nanosec))
    return SimpleNamespace(sec=int(sec), nanosec=0)


def _header(message: Any, frame: str = "frame_id") -> SimpleNamespace:
    return SimpleNamespace(
        stamp=_stamp(getattr(message, "timestamp", None)), frame_id=getattr(message, frame, "")
    )


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
        distortion_model=getattr(m, "distortion_model", ""),
        **matrices,
    )


def _numbers(message: Any, names: str) -> SimpleNamespace:
    """Components of a vector or quaternion; one that is left out is 0, and so are all of None."""
    return SimpleNamespace(**{name: float(getattr(message, name, 0.0)) for name in names})


def _transform(m: Any) -> SimpleNamespace:
    return SimpleNamespace(
        header=_header(m, "parent_frame_id"),
        child_frame_id=m.child_frame_id,
        transform=SimpleNamespace(
            translation=_numbers(getattr(m, "translation", None), "xyz"),
            rotation=_numbers(m.rotation, "xyzw"),
        ),
    )


def _transforms(m: Any) -> SimpleNamespace:
    return SimpleNamespace(transforms=[_transform(t) for t in m.transforms])


def _pose_in_frame(m: Any) -> SimpleNamespace:
    pose = SimpleNamespace(
        position=_numbers(getattr(m.pose, "position", None), "xyz"),
        orientation=_numbers(m.pose.orientation, "xyzw"),
    )
    return SimpleNamespace(header=_header(m), pose=pose)


def _joint_states(m: Any) -> SimpleNamespace:
    joints = list(m.joints)
    nan = float("nan")

    def values(name: str) -> list[float]:
        given = [getattr(j, name, None) for j in joints]
        return [nan if v is None else float(v) for v in given]

    return SimpleNamespace(
        header=SimpleNamespace(stamp=_stamp(getattr(m, "timestamp", None)), frame_id=""),
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
