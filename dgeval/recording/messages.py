"""Values from decoded messages of either ROS version: stamps, poses, intrinsics, joints, events."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dgeval.geometry import Array, Intrinsics
from dgeval.recording.contract import (
    EVENT_KEY,
    EVENT_KINDS,
    LABEL_EVENT,
    LABEL_KEY,
    LABEL_KEYS,
    TIME_KEY,
    label_of,
)

VIDEO_TYPES = frozenset(
    {"foxglove_msgs/msg/CompressedVideo", "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"}
)
LOG_LINES = ("message", "msg", "text")  # a log's words: in Foxglove's line, in ROS's, in others
IMAGE_TYPES = VIDEO_TYPES | {"sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"}
# the second is the older name of the same fields
TF_TYPES = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
JOINT_STATE = "sensor_msgs/msg/JointState"
# what ros2_control publishes besides: of all its interfaces, and of a trajectory's controller
JOINT_TYPES = frozenset(
    {
        JOINT_STATE,
        "control_msgs/msg/DynamicJointState",
        "control_msgs/msg/JointTrajectoryControllerState",
    }
)
POSE_TYPES = frozenset(
    {
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "nav_msgs/msg/Odometry",
    }
)


def stamp_ns(message: Any) -> int:
    """A decoded message's header stamp, ns."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def header_stamp_ns(data: bytes, encoding: str) -> int:
    """Stamp of a message that begins with a Header, ns, without decoding the rest.

    struct.error for too few bytes.
    """
    if encoding == "ros1":
        sec, nanosec = struct.unpack_from("<II", data, 4)
    else:
        order = "<" if struct.unpack_from("B", data, 1)[0] & 1 else ">"
        sec, nanosec = struct.unpack_from(f"{order}iI", data, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)


@dataclass(frozen=True, slots=True)
class StampedPose:
    """T_parent_child at a time, px py pz qx qy qz qw; child is "" where the message names none."""

    t_ns: int
    parent: str
    child: str
    pose: Array


def pose_numbers(position: Any, orientation: Any) -> Array:
    """(7,) px py pz qx qy qz qw, normalised.

    ValueError for NaN, or a quaternion whose norm is not within 0.1 of 1.
    """
    pose = np.array(
        [
            position.x,
            position.y,
            position.z,
            orientation.x,
            orientation.y,
            orientation.z,
            orientation.w,
        ],
        dtype=np.float64,
    )
    sound = bool(np.isfinite(pose).all() and np.abs(pose[3:]).max() < 2.0)
    norm = float(np.linalg.norm(pose[3:])) if sound else 0.0
    if not 0.9 < norm < 1.1:
        raise ValueError(f"not a pose: {pose.tolist()}")
    pose[3:] /= norm
    return pose


def poses_of(message: Any) -> list[StampedPose]:
    """The poses in a TFMessage, PoseStamped, PoseWithCovarianceStamped or Odometry."""
    if hasattr(message, "transforms"):
        return [
            StampedPose(
                stamp_ns(t),
                t.header.frame_id.lstrip("/"),
                t.child_frame_id.lstrip("/"),
                pose_numbers(t.transform.translation, t.transform.rotation),
            )
            for t in message.transforms
        ]
    pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
    child = getattr(message, "child_frame_id", "").lstrip("/")
    parent = message.header.frame_id.lstrip("/")
    return [
        StampedPose(stamp_ns(message), parent, child, pose_numbers(pose.position, pose.orientation))
    ]


@dataclass(frozen=True, slots=True)
class StampedPoses:
    """Several poses (n, 7) px py pz qx qy qz qw in the frame `parent`, at one time, ns.

    log_ns: when they were recorded.
    """

    t_ns: int
    log_ns: int
    parent: str
    poses: Array


def stamped_poses_of(message: Any, log_ns: int) -> StampedPoses:
    """The poses of a PoseArray; NaN for one that is none."""
    listed = []
    for pose in message.poses:
        try:
            listed.append(pose_numbers(pose.position, pose.orientation))
        except ValueError:
            listed.append(np.full(7, np.nan))
    parent = message.header.frame_id.lstrip("/")
    return StampedPoses(stamp_ns(message), log_ns, parent, np.reshape(listed, (-1, 7)))


@dataclass(frozen=True, slots=True)
class CameraModel:
    """Intrinsics with the frame they belong to and the lens's distortion.

    intrinsics: of the picture as published, binned and cropped; size px. rectified: of the
    rectified picture (P), which has no distortion; None where P is not given. full_size: of the
    sensor's picture, px. lens_model: what the coefficients of `distortion` mean.
    """

    intrinsics: Intrinsics
    frame_id: str
    distortion: tuple[float, ...]
    rectified: Intrinsics | None = None
    full_size: tuple[int, int] = (0, 0)
    lens_model: str = ""


def camera_model(message: Any) -> CameraModel:
    """From sensor_msgs/CameraInfo. ValueError for a matrix that can't be a camera's."""
    k = np.asarray(message.k if hasattr(message, "k") else message.K, dtype=np.float64).reshape(
        3, 3
    )
    d = np.asarray(message.d if hasattr(message, "d") else message.D, dtype=np.float64).ravel()
    fx, fy = float(k[0, 0]), float(k[1, 1])
    if not k.any():
        raise ValueError("the camera matrix is all zero: the camera is not calibrated")
    if not (np.isfinite(k).all() and fx > 0 and fy > 0):
        raise ValueError(f"camera matrix {k.tolist()} is not a camera's")
    if k[2].tolist() != [0.0, 0.0, k[2, 2]] or k[2, 2] <= 0:
        raise ValueError(f"camera matrix {k.tolist()} has no last row 0 0 1: is it transposed?")
    p = np.asarray(getattr(message, "p", getattr(message, "P", ())), dtype=np.float64).ravel()
    rectified = None
    if len(p) == 12 and np.isfinite(p).all() and p[0] > 0 and p[5] > 0:
        rectified = _published(message, p.reshape(3, 4)[:, :3])
    return CameraModel(
        _published(message, k),
        message.header.frame_id.lstrip("/"),
        tuple(d.tolist()),
        rectified,
        (int(message.width), int(message.height)),
        str(getattr(message, "distortion_model", "")),
    )


def _published(message: Any, matrix: Array) -> Intrinsics:
    """Intrinsics of the picture that is published: the region of interest, then binned.

    The matrix (3, 3) is of the full picture, as sensor_msgs/CameraInfo says. A binned pixel covers
    several, and its middle is theirs.
    """
    width, height = int(message.width), int(message.height)
    x0 = y0 = 0
    roi = getattr(message, "roi", None)
    if roi is not None and roi.width and roi.height:
        x0, y0, width, height = (
            int(v) for v in (roi.x_offset, roi.y_offset, roi.width, roi.height)
        )
    bx = max(1, int(getattr(message, "binning_x", 0)))
    by = max(1, int(getattr(message, "binning_y", 0)))
    fx, fy, cx, cy = (float(matrix[a]) for a in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Intrinsics(
        width // bx,
        height // by,
        fx / bx,
        fy / by,
        (cx - x0 + 0.5) / bx - 0.5,
        (cy - y0 + 0.5) / by - 0.5,
    )


def cloud_points(message: Any) -> Array:
    """Finite points (n, 3) of a sensor_msgs/PointCloud2.

    ValueError without floating point x, y, z, or with too few bytes.
    """
    kinds = {7: "f4", 8: "f8"}
    fields = {f.name: f for f in message.fields}
    if any(n not in fields or fields[n].datatype not in kinds for n in "xyz"):
        raise ValueError("a cloud without floating point x, y, z")
    order = ">" if message.is_bigendian else "<"
    at = {n: (order + kinds[fields[n].datatype], int(fields[n].offset)) for n in "xyz"}
    layout = {
        "names": list(at),
        "formats": [a[0] for a in at.values()],
        "offsets": [a[1] for a in at.values()],
    }
    kind = np.dtype({**layout, "itemsize": int(message.point_step)})  # type: ignore[call-overload]
    data, count = (
        np.asarray(message.data, dtype=np.uint8).tobytes(),
        int(message.width) * int(message.height),
    )
    if len(data) < count * kind.itemsize:
        raise ValueError(f"a cloud of {count} points with {len(data)} bytes")
    rows = np.frombuffer(data, kind, count)
    points = np.column_stack([rows[n].astype(np.float64) for n in "xyz"])
    return points[np.isfinite(points).all(axis=1)]


@dataclass(frozen=True, slots=True)
class JointSample:
    """One JointState: positions, rad or m, and efforts, Nm or N, by joint name.

    Values of 1e6 and more, infinite ones and NaN are left out. unplaced_efforts: of a message with
    another number of efforts than of joints; whose they are isn't known.
    """

    t_ns: int
    positions: dict[str, float]
    efforts: dict[str, float] = field(default_factory=dict)
    unplaced_efforts: int = 0


def joints_of(message: Any) -> JointSample:
    """From a message of JOINT_TYPES; joints without a value are left out, as are efforts whose
    number is not that of the joints.

    ValueError where the number of positions is not that of the joints: which is whose isn't known.
    """
    unplaced = 0
    if hasattr(message, "interface_values"):
        given = zip(message.joint_names, message.interface_values, strict=True)
        by_joint = {n: dict(zip(i.interface_names, i.values, strict=True)) for n, i in given}
        positions, efforts = (
            [(n, v[kind]) for n, v in by_joint.items() if kind in v]
            for kind in ("position", "effort")
        )
    else:
        if hasattr(message, "joint_names"):
            point = message.feedback if hasattr(message, "feedback") else message.actual
            names, at, forces = message.joint_names, point.positions, point.effort
        else:
            names, at, forces = message.name, message.position, message.effort
        if len(names) and len(at) not in (0, len(names)):
            raise ValueError(f"{len(at)} positions for {len(names)} joint names")
        unplaced = len(forces) if len(forces) != len(names) else 0
        positions = list(zip(names, at, strict=False))
        efforts = [] if unplaced else list(zip(names, forces, strict=False))
    return JointSample(
        stamp_ns(message),
        {n: float(v) for n, v in positions if abs(v) < 1e6},
        {n: float(v) for n, v in efforts if abs(v) < 1e6},
        unplaced,
    )


NEAR_LOG_NS = 3_600_000_000_000  # ns, between an event's time and when it was logged; ours


@dataclass(frozen=True, slots=True)
class Event:
    """An entry of /dgeval/events: time, ns, kind, and the other fields as written.

    is_log_time: the message has no time of its own, and was logged then. unit: of its own time,
    where that was not in ns.
    """

    t_ns: int
    kind: str
    fields: dict[str, Any]
    is_log_time: bool = False
    unit: str = ""


def event_text(message: Any) -> str:
    """The text of an event: a String's, that of a line of a log, or an object's fields as JSON.

    ValueError where a message is none of these.
    """
    data = getattr(message, "data", None)
    if isinstance(data, str):
        return data
    fields = _fields(message)
    if any(key in fields for key in (EVENT_KEY, *LABEL_KEYS)):
        return json.dumps(fields, default=_fields)
    for key in LOG_LINES:
        if isinstance(fields.get(key), str):
            return str(fields[key])
    raise ValueError(
        f"an event's message has no text, but {', '.join(sorted(fields)) or 'nothing'}"
    )


def read_event(message: Any, log_ns: int) -> Event:
    """An event of a decoded message: at its own stamp where it bears one, and says no time itself.

    ValueError where it is none.
    """
    event = event_of(event_text(message), log_ns)
    at_ns = _own_stamp_ns(message) if event.is_log_time else 0
    return replace(event, t_ns=at_ns, is_log_time=False) if at_ns else event


def _own_stamp_ns(message: Any) -> int:
    """The stamp of a structure or of a line of a log, ns; 0 without one."""
    stamp = getattr(getattr(message, "header", message), "stamp", None)
    stamp = getattr(message, "timestamp", None) if stamp is None else stamp
    for sec, nanosec in (("sec", "nanosec"), ("sec", "nsec"), ("seconds", "nanos")):
        if hasattr(stamp, sec) and hasattr(stamp, nanosec):
            return int(getattr(stamp, sec)) * 1_000_000_000 + int(getattr(stamp, nanosec))
    return 0


def _fields(message: Any) -> dict[str, Any]:
    """The fields of a decoded message, by name; texts that are empty, as by default, are none."""
    described = getattr(message, "DESCRIPTOR", None)  # protobuf's
    if described is not None:
        named = {field.name: getattr(message, field.name) for field in described.fields}
    else:
        named = {k: v for k, v in getattr(message, "__dict__", {}).items() if not k.startswith("_")}
    return {k: v for k, v in named.items() if not (isinstance(v, str) and not v)}


def event_of(text: str, log_ns: int) -> Event:
    """From JSON {"event": kind, …}, or the kind alone; its own "t_ns" goes before the log time.

    A label alone is a label, also as JSON without a kind. ValueError for anything else.
    """
    word = text.strip().strip('"').lower()
    if word in EVENT_KINDS:
        return Event(log_ns, word, {}, True)
    if label_of(word) is not None:
        return Event(log_ns, LABEL_EVENT, {LABEL_KEY: word}, True)
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"not an event: {text[:80]!r}") from error
    if isinstance(value, dict) and EVENT_KEY not in value and any(k in value for k in LABEL_KEYS):
        value = {EVENT_KEY: LABEL_EVENT, **value}
    if not isinstance(value, dict) or not isinstance(value.get(EVENT_KEY), str):
        raise ValueError(f"not an event: {text[:80]!r}")
    t_ns = value.get(TIME_KEY, log_ns)
    if isinstance(t_ns, str) and t_ns.strip().isdecimal():  # as JSON writes integers of 64 bits
        t_ns = int(t_ns)
    if not isinstance(t_ns, int) or isinstance(t_ns, bool):
        raise ValueError(f"t_ns of an event is not a whole number: {text[:80]!r}")
    t_ns, unit = _in_ns(t_ns, log_ns)
    kind = value[EVENT_KEY].strip().lower()
    fields = {k: v for k, v in value.items() if k not in (EVENT_KEY, TIME_KEY)}
    if not any(key in fields for key in LABEL_KEYS):  # a state machine's result, one level down
        inner = [v for v in fields.values() if isinstance(v, dict)]
        fields |= {key: v[key] for v in inner for key in LABEL_KEYS if key in v}
    if kind not in EVENT_KINDS and label_of(kind) is not None:
        kind, fields = LABEL_EVENT, {LABEL_KEY: kind, **fields}
    elif kind not in EVENT_KINDS:
        kind = value[EVENT_KEY]
    return Event(t_ns, kind, fields, TIME_KEY not in value, unit)


def _in_ns(t: int, log_ns: int) -> tuple[int, str]:
    """A time, ns, and the unit that it was in; "" where that is ns, or cannot be told.

    A time far from when it was logged is in the unit that puts it within an hour of it.
    """
    if abs(t - log_ns) > NEAR_LOG_NS:
        for unit, factor in (("us", 1_000), ("ms", 1_000_000), ("s", 1_000_000_000)):
            if abs(t * factor - log_ns) <= NEAR_LOG_NS:
                return t * factor, unit
    return t, ""
