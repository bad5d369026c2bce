"""Foxglove's messages as JSON that protobuf's own library wrote, against the same as protobuf.

Catches: times as texts, names in camelCase and left out zeros that are called damage, or read as
something else.
"""

from __future__ import annotations

import json
from typing import Any

import pytest
from dgeval.recording.encodings import foxglove, json_text
from dgeval.recording.messages import camera_model, poses_of, stamp_ns
from google.protobuf import (
    descriptor_pb2,
    descriptor_pool,
    json_format,
    message_factory,
    timestamp_pb2,
)

T_NS = 1_800_000_003_050_000_007
FIELD = descriptor_pb2.FieldDescriptorProto
TEXT, DOUBLE, BYTES, FIXED = FIELD.TYPE_STRING, FIELD.TYPE_DOUBLE, FIELD.TYPE_BYTES, 7
TIME = ".google.protobuf.Timestamp"
FIELDS: dict[str, dict[str, Any]] = {
    "Vector3": dict.fromkeys("xyz", DOUBLE),
    "Quaternion": dict.fromkeys("xyzw", DOUBLE),
    "FrameTransform": {
        "timestamp": TIME,
        "parent_frame_id": TEXT,
        "child_frame_id": TEXT,
        "translation": ".foxglove.Vector3",
        "rotation": ".foxglove.Quaternion",
    },
    "Pose": {"position": ".foxglove.Vector3", "orientation": ".foxglove.Quaternion"},
    "PoseInFrame": {"timestamp": TIME, "frame_id": TEXT, "pose": ".foxglove.Pose"},
    "RawImage": {
        "timestamp": TIME, "frame_id": TEXT, "width": FIXED, "height": FIXED, "encoding": TEXT,
        "step": FIXED, "data": BYTES,
    },
    "CameraCalibration": {
        "timestamp": TIME, "frame_id": TEXT, "width": FIXED, "height": FIXED,
        "distortion_model": TEXT, "D": [DOUBLE], "K": [DOUBLE], "R": [DOUBLE], "P": [DOUBLE],
    },
}  # fmt: skip


def _classes() -> dict[str, Any]:
    time, file = descriptor_pb2.FileDescriptorProto(), descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(time)
    file.name, file.package, file.syntax = "made.proto", "foxglove", "proto3"
    file.dependency.append("google/protobuf/timestamp.proto")
    for name, fields in FIELDS.items():
        message = file.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields.items(), 1):
            one = message.field.add(name=field, number=number, label=1)
            if isinstance(kind, list):
                one.label, (kind,) = 3, kind
            if isinstance(kind, str):
                one.type, one.type_name = 11, kind
            else:
                one.type = kind
    pool = descriptor_pool.DescriptorPool()
    pool.Add(time)
    pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))
        for name in FIELDS
    }


CLASSES = _classes()


def made(name: str, **fields: Any) -> tuple[Any, Any]:
    """The message as protobuf has it and as its JSON is read."""
    message = json_format.ParseDict(fields, CLASSES[name](), ignore_unknown_fields=False)
    message.timestamp.seconds, message.timestamp.nanos = divmod(T_NS, 10**9)
    text = json_format.MessageToJson(message).encode()
    read = foxglove.adapted(f"foxglove.{name}", json_text.decode)(text)
    return foxglove.adapted(f"foxglove.{name}", lambda _: message)(b""), read


def test_an_image() -> None:
    theirs, read = made(
        "RawImage", frameId="cam", width=2, height=1, encoding="16UC1", step=4, data="AQIDBA=="
    )
    assert read == theirs
    assert stamp_ns(read) == T_NS
    assert read.data == bytes([1, 2, 3, 4])


def test_intrinsics() -> None:
    k = [60.0, 0.0, 31.5, 0.0, 60.0, 23.5, 0.0, 0.0, 1.0]
    theirs, read = made("CameraCalibration", frameId="cam", width=64, height=48, K=k)
    assert camera_model(read) == camera_model(theirs)
    assert camera_model(read).intrinsics.cx == 31.5


def test_a_transform_whose_zeros_are_left_out() -> None:
    theirs, read = made(
        "FrameTransform",
        parentFrameId="base",
        childFrameId="cam",
        translation={"x": 0.0, "y": 0.0, "z": 0.5},
        rotation={"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    )
    (pose,), (expected,) = poses_of(read), poses_of(theirs)
    assert (pose.t_ns, pose.parent, pose.child) == (T_NS, "base", "cam")
    assert pose.pose.tolist() == expected.pose.tolist() == [0, 0, 0.5, 0, 0, 0, 1]


def test_a_pose_at_the_origin_of_its_frame() -> None:
    theirs, read = made("PoseInFrame", frameId="base", pose={"orientation": {"w": 1.0}})
    assert poses_of(read)[0].pose.tolist() == poses_of(theirs)[0].pose.tolist()


@pytest.mark.parametrize(
    ("text", "t_ns"),
    [
        ("2027-01-15T08:00:03.050000007Z", T_NS),
        ("2027-01-15T09:30:03.05+01:30", T_NS - 7),
        ("2027-01-15T08:00:03Z", T_NS - 50_000_007),
    ],
)
def test_times_as_texts(text: str, t_ns: int) -> None:
    image = {"timestamp": text, "frame_id": "cam", "format": "jpeg", "data": ""}
    decode = foxglove.adapted("foxglove.CompressedImage", json_text.decode)
    assert stamp_ns(decode(json.dumps(image).encode())) == t_ns


def test_what_is_wrong_is_named() -> None:
    decode = foxglove.adapted("foxglove.CompressedImage", json_text.decode)
    with pytest.raises(ValueError, match="it has no field 'format'"):
        decode(b'{"timestamp": {"sec": 1, "nsec": 0}, "frame_id": "cam"}')
    with pytest.raises(ValueError, match="'yesterday' is no RFC 3339 time"):
        decode(b'{"timestamp": "yesterday", "frame_id": "cam", "format": "jpeg", "data": ""}')
