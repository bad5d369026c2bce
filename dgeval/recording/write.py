"""Writes recordings: MCAP with checksums, ROS 1 bags, ROS 2 folders.

The same messages give the same bytes in every run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Rosbag1
from rosbags.rosbag2 import Writer as Rosbag2
from rosbags.typesys import Stores, get_typestore

from dgeval.geometry import pose_from_matrix

STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE_ROS1 = get_typestore(Stores.ROS1_NOETIC)
TYPES = STORE.types


def message(kind: str, /, **fields: Any) -> Any:
    """A message of a ROS 2 type by its short name, e.g. message("sensor_msgs/Image", …)."""
    return TYPES[kind.replace("/", "/msg/", 1)](**fields)


def header(t_ns: int, frame_id: str) -> Any:
    """std_msgs/Header."""
    return message(
        "std_msgs/Header",
        stamp=message("builtin_interfaces/Time", sec=t_ns // 10**9, nanosec=t_ns % 10**9),
        frame_id=frame_id,
    )


def pose_message(pose: Any) -> Any:
    """geometry_msgs/Pose from px py pz qx qy qz qw."""
    p, q = [float(v) for v in pose[:3]], [float(v) for v in pose[3:]]
    return message(
        "geometry_msgs/Pose",
        position=message("geometry_msgs/Point", x=p[0], y=p[1], z=p[2]),
        orientation=message("geometry_msgs/Quaternion", x=q[0], y=q[1], z=q[2], w=q[3]),
    )


def transform_message(t_ns: int, parent: str, child: str, pose: Any) -> Any:
    """geometry_msgs/TransformStamped from px py pz qx qy qz qw."""
    p, q = [float(v) for v in pose[:3]], [float(v) for v in pose[3:]]
    return message(
        "geometry_msgs/TransformStamped",
        header=header(t_ns, parent),
        child_frame_id=child,
        transform=message(
            "geometry_msgs/Transform",
            translation=message("geometry_msgs/Vector3", x=p[0], y=p[1], z=p[2]),
            rotation=message("geometry_msgs/Quaternion", x=q[0], y=q[1], z=q[2], w=q[3]),
        ),
    )


def jpeg_message(t_ns: int, frame_id: str, rgb: Any, quality: int = 85) -> Any:
    """(H, W, 3) uint8 RGB as image_transport's compressed JPEG."""
    return jpeg_file_message(
        t_ns,
        frame_id,
        cv2.imencode(".jpg", rgb[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1],
    )


def jpeg_file_message(t_ns: int, frame_id: str, file: Any) -> Any:
    """An encoded JPEG, bytes or uint8 array."""
    data = np.frombuffer(file, np.uint8)
    return message(
        "sensor_msgs/CompressedImage",
        header=header(t_ns, frame_id),
        format="rgb8; jpeg compressed bgr8",
        data=data,
    )


def compressed_depth_message(t_ns: int, frame_id: str, millimetres: Any, level: int = 9) -> Any:
    """uint16 mm as image_transport's compressedDepth with PNG; level 9 is smallest and slowest."""
    png = cv2.imencode(".png", millimetres, [cv2.IMWRITE_PNG_COMPRESSION, level])[1]
    data = np.concatenate([np.zeros(12, np.uint8), png.ravel()])
    return message(
        "sensor_msgs/CompressedImage",
        header=header(t_ns, frame_id),
        format="16UC1; compressedDepth png",
        data=data,
    )


def camera_info_message(t_ns: int, frame_id: str, camera: Any) -> Any:
    """sensor_msgs/CameraInfo of `Intrinsics`, without distortion."""
    k = np.array([camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1], dtype=np.float64)
    p = np.array(
        [camera.fx, 0, camera.cx, 0, 0, camera.fy, camera.cy, 0, 0, 0, 1, 0], dtype=np.float64
    )
    roi = message(
        "sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    return message(
        "sensor_msgs/CameraInfo",
        header=header(t_ns, frame_id),
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=k,
        r=np.eye(3).ravel(),
        p=p,
        binning_x=0,
        binning_y=0,
        roi=roi,
    )


def pose_stamped(t_ns: int, frame_id: str, T: Any) -> Any:
    """geometry_msgs/PoseStamped from T (4, 4)."""
    return message(
        "geometry_msgs/PoseStamped",
        header=header(t_ns, frame_id),
        pose=pose_message(pose_from_matrix(T)),
    )


def pose_array(t_ns: int, frame_id: str, T: Any) -> Any:
    """geometry_msgs/PoseArray from T (n, 4, 4)."""
    return message(
        "geometry_msgs/PoseArray",
        header=header(t_ns, frame_id),
        poses=[pose_message(pose_from_matrix(one)) for one in T],
    )


def numbers(values: Any) -> Any:
    """std_msgs/Float64MultiArray from values (n,)."""
    layout = message("std_msgs/MultiArrayLayout", dim=[], data_offset=0)
    return message(
        "std_msgs/Float64MultiArray", layout=layout, data=np.asarray(values, dtype=np.float64)
    )


def twist_stamped(t_ns: int, frame_id: str, twist: Any) -> Any:
    """geometry_msgs/TwistStamped from (6,) linear m/s, angular rad/s."""
    x, y, z, a, b, c = (float(v) for v in twist)
    both = (
        message("geometry_msgs/Vector3", x=x, y=y, z=z),
        message("geometry_msgs/Vector3", x=a, y=b, z=c),
    )
    twist = message("geometry_msgs/Twist", linear=both[0], angular=both[1])
    return message("geometry_msgs/TwistStamped", header=header(t_ns, frame_id), twist=twist)


def joint_state(
    t_ns: int, names: Sequence[str], position: Any, velocity: Any = (), effort: Any = ()
) -> Any:
    """sensor_msgs/JointState: rad or m, rad/s or m/s, Nm or N by joint name."""
    values = [np.asarray(v, dtype=np.float64) for v in (position, velocity, effort)]
    return message(
        "sensor_msgs/JointState",
        header=header(t_ns, ""),
        name=list(names),
        position=values[0],
        velocity=values[1],
        effort=values[2],
    )


def text(value: str) -> Any:
    """std_msgs/String."""
    return message("std_msgs/String", data=value)


def png_message(t_ns: int, frame_id: str, image: Any) -> Any:
    """A one-channel image as sensor_msgs/CompressedImage."""
    data = cv2.imencode(".png", image)[1].ravel()
    return message(
        "sensor_msgs/CompressedImage",
        header=header(t_ns, frame_id),
        format="mono8; png compressed",
        data=data,
    )


def cloud_message(t_ns: int, frame_id: str, points: Any) -> Any:
    """sensor_msgs/PointCloud2 of points (n, 3), float32 x y z."""
    fields = [
        message("sensor_msgs/PointField", name=n, offset=4 * i, datatype=7, count=1)
        for i, n in enumerate("xyz")
    ]
    data = np.ascontiguousarray(points, dtype="<f4").view(np.uint8).ravel()
    return message(
        "sensor_msgs/PointCloud2",
        header=header(t_ns, frame_id),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=12,
        row_step=12 * len(points),
        data=data,
        is_dense=True,
    )


class McapWriter:
    """An MCAP file of the ROS 2 profile, chunks with CRC. Messages must come in log-time order."""

    def __init__(
        self,
        path: Path,
        compression: CompressionType = CompressionType.ZSTD,
        chunk_size: int = 512 * 1024,
    ) -> None:
        self._stream = path.open("wb")
        self._writer = Writer(
            self._stream, chunk_size=chunk_size, compression=compression, enable_crcs=True
        )
        self._writer.start(profile="ros2", library="dgeval")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def write(self, topic: str, log_ns: int, value: Any) -> None:
        name: str = value.__msgtype__
        if name not in self._schemas:
            text = STORE.generate_msgdef(name, ros_version=2)[0]
            self._schemas[name] = self._writer.register_schema(name, "ros2msg", text.encode())
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[name])
        data = bytes(STORE.serialize_cdr(value, name))
        self._writer.add_message(self._channels[topic], log_ns, data, log_ns)

    def __enter__(self) -> McapWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.close()


class BagWriter:
    """ROS 1 bag of the same messages."""

    def __init__(self, path: Path) -> None:
        self._writer = Rosbag1(path)
        self._writer.open()
        self._connections: dict[str, Any] = {}

    def write(self, topic: str, log_ns: int, value: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, value.__msgtype__, typestore=STORE_ROS1
            )
        data = STORE_ROS1.serialize_ros1(_as_ros1(value), value.__msgtype__)
        self._writer.write(self._connections[topic], log_ns, bytes(data))

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.close()


class Db3Writer:
    """ROS 2 folder with SQLite storage."""

    def __init__(self, path: Path) -> None:
        self._writer = Rosbag2(path, version=8)
        self._writer.open()
        self._connections: dict[str, Any] = {}

    def write(self, topic: str, log_ns: int, value: Any) -> None:
        name: str = value.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, name, typestore=STORE)
        self._writer.write(
            self._connections[topic], log_ns, bytes(STORE.serialize_cdr(value, name))
        )

    def __enter__(self) -> Db3Writer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.close()


def open_writer(path: Path) -> McapWriter | BagWriter | Db3Writer:
    """The writer for a path: .mcap or .bag by its suffix, else a ROS 2 folder."""
    if path.suffix == ".bag":
        return BagWriter(path)
    return McapWriter(path) if path.suffix == ".mcap" else Db3Writer(path)


def _as_ros1(value: Any) -> Any:
    """The ROS 1 message of a ROS 2 one: names differ in case, headers have a sequence number, 0."""
    kind = getattr(value, "__msgtype__", None)
    if kind is None:
        return [_as_ros1(v) for v in value] if isinstance(value, list) else value
    if kind == "builtin_interfaces/msg/Time":
        return STORE_ROS1.types[kind](sec=value.sec, nanosec=value.nanosec)
    given = {
        f.name.lower(): getattr(value, f.name) for f in fields(value) if not f.name.startswith("__")
    }
    target: Any = STORE_ROS1.types[kind]
    names = [f.name for f in fields(target) if not f.name.startswith("__")]
    return target(**{n: _as_ros1(given[n.lower()]) if n.lower() in given else 0 for n in names})
