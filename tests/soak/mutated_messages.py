"""Messages with changed bytes, by encoding: a typed error, or the rest unharmed.

A small recording in memory is written in each encoding; of one message bytes are flipped, cut or
doubled. Reading must end with dgeval's own error, or give every frame that the message has no part
in exactly as before.

    python -m tests.soak.mutated_messages               # 1000 of each encoding
    python -m tests.soak.mutated_messages --count 50    # fewer

Exit code: 0 if all are well, 1 with the seeds of those that are not.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from dgeval.config import Config
from dgeval.errors import Damage, DgevalError
from dgeval.recording.camera import camera_of
from dgeval.recording.containers.container import Opened, RawMessage, Topic
from dgeval.recording.encodings import decoders, foxglove
from dgeval.recording.frame_reader import FrameReader, LostFrames
from dgeval.recording.manifest import TrialSpec
from dgeval.recording.pairing import pair_images, window_of
from dgeval.recording.robot import robot_states
from dgeval.recording.roles import find_roles, image_topics
from dgeval.recording.scan import scan
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from tests.recording.recorders import STORE, TYPES, flat, rvl_words
from tests.recording.test_cdr2 import encoded

W, H, N = 64, 48, 6
START, STEP = 1_700_000_000_000_000_000, 50_000_000
COLOUR, DEPTH, INFO, JOINTS = (
    "/cam/color/image",
    "/cam/depth/image",
    "/cam/color/camera_info",
    "/joint_states",
)
TF, EVENTS = "/tf", "/dgeval/events"
DETECTIONS, GOALS = "/detections", "/gripper/_action/status"
Listed = list[tuple[str, int, str, Any]]  # topic, time ns, type, message


def header(t: int, frame: str) -> Any:
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=t // 10**9, nanosec=t % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def picture(t: int, encoding: str, data: np.ndarray, step: int) -> Any:
    return TYPES["sensor_msgs/msg/Image"](
        header=header(t, "cam"), height=H, width=W, encoding=encoding, is_bigendian=0, step=step,
        data=np.ascontiguousarray(data).view(np.uint8).ravel(),
    )  # fmt: skip


def recording(colour: str = "rgb8", depth: str = "16UC1") -> Listed:
    """Six frames with intrinsics, joints, transforms and events."""
    rng = np.random.default_rng(0)
    out: Listed = []
    sizes = {"rgb8": 3, "uyvy": 2, "nv24": 3, "bayer_rggb8": 1, "rgb16": 6}
    for k in range(N):
        t = START + k * STEP
        step = W if colour in ("nv24", "bayer_rggb8") else W * sizes[colour]
        pixels = rng.integers(0, 255, H * W * sizes[colour], np.uint8)
        out.append((COLOUR, t, "sensor_msgs/msg/Image", picture(t, colour, pixels, step)))
        codes = rng.integers(400, 900, (H, W)).astype(np.uint16)
        if depth == "rvl":
            words = (
                b"\0" * 12 + W.to_bytes(4, "little") + H.to_bytes(4, "little") + rvl_words(codes)
            )
            value = TYPES["sensor_msgs/msg/CompressedImage"](
                header=header(t, "cam"), format="16UC1; compressedDepth rvl",
                data=np.frombuffer(words, np.uint8),
            )  # fmt: skip
            out.append((DEPTH, t, "sensor_msgs/msg/CompressedImage", value))
        else:
            out.append((DEPTH, t, "sensor_msgs/msg/Image", picture(t, "16UC1", codes, 2 * W)))
        roi = TYPES["sensor_msgs/msg/RegionOfInterest"](
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        info = TYPES["sensor_msgs/msg/CameraInfo"](
            header=header(t, "cam"), height=H, width=W, distortion_model="plumb_bob",
            d=np.zeros(5), k=np.array([60.0, 0, 31.5, 0, 60, 23.5, 0, 0, 1]), r=np.eye(3).ravel(),
            p=np.zeros(12), binning_x=0, binning_y=0, roi=roi,
        )  # fmt: skip
        out.append((INFO, t, "sensor_msgs/msg/CameraInfo", info))
        joints = TYPES["sensor_msgs/msg/JointState"](
            header=header(t, ""), name=["a", "b"], position=np.array([0.1 * k, 0.2]),
            velocity=np.zeros(2), effort=np.zeros(2),
        )  # fmt: skip
        out.append((JOINTS, t, "sensor_msgs/msg/JointState", joints))
        transform = TYPES["geometry_msgs/msg/TransformStamped"](
            header=header(t, "base"), child_frame_id="cam",
            transform=TYPES["geometry_msgs/msg/Transform"](
                translation=TYPES["geometry_msgs/msg/Vector3"](x=0.1 * k, y=0.0, z=1.0),
                rotation=TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            ),
        )  # fmt: skip
        tf = TYPES["tf2_msgs/msg/TFMessage"](transforms=[transform])
        out.append((TF, t, "tf2_msgs/msg/TFMessage", tf))
        detected = flat(header(t, "cam"), (10.0, 8.0, 30.0, 28.0))
        out.append((DETECTIONS, t, "vision_msgs/msg/Detection2DArray", detected))
        goal = TYPES["action_msgs/msg/GoalInfo"](
            goal_id=TYPES["unique_identifier_msgs/msg/UUID"](uuid=np.full(16, k, np.uint8)),
            stamp=TYPES["builtin_interfaces/msg/Time"](sec=t // 10**9, nanosec=t % 10**9),
        )
        state = TYPES["action_msgs/msg/GoalStatus"](goal_info=goal, status=2)
        states = TYPES["action_msgs/msg/GoalStatusArray"](status_list=[state])
        out.append((GOALS, t, "action_msgs/msg/GoalStatusArray", states))
    text = TYPES["std_msgs/msg/String"](data='{"event": "close"}')
    out.append((EVENTS, START + STEP, "std_msgs/msg/String", text))
    return out


def as_video(listed: Listed, gop: int) -> Listed:
    """With colour as H.264, of which every gop-th picture stands alone."""
    from tests.recording.test_video import encoded as video

    pictures = [
        np.tile(np.linspace(20 * k, 80 + 20 * k, W)[None, :, None], (H, 1, 3)).astype(np.uint8)
        for k in range(N)
    ]
    packets = iter(video(pictures, gop))
    out: Listed = []
    for topic, t, kind, value in listed:
        if topic == COLOUR:
            kind = "sensor_msgs/msg/CompressedImage"
            data = np.frombuffer(next(packets), np.uint8)
            value = TYPES[kind](header=header(t, "cam"), format="h264", data=data)
        out.append((topic, t, kind, value))
    return out


def as_json(kind: str, value: Any) -> bytes:
    def plain(v: Any) -> Any:
        if isinstance(v, np.ndarray):
            return v.tolist()
        if isinstance(v, list):
            return [plain(x) for x in v]
        if hasattr(v, "__dataclass_fields__"):
            return {n: plain(getattr(v, n)) for n in v.__dataclass_fields__ if n != "__msgtype__"}
        return v

    return json.dumps(plain(value)).encode()


def raw_image_type() -> tuple[Any, bytes]:
    """foxglove.RawImage as a class, and its schema."""
    file = descriptor_pb2.FileDescriptorProto(
        name="foxglove/RawImage.proto", package="foxglove", syntax="proto3",
        dependency=["google/protobuf/timestamp.proto"],
    )  # fmt: skip
    message = file.message_type.add(name="RawImage")
    kinds = {"timestamp": 11, "frame_id": 9, "width": 7, "height": 7, "encoding": 9, "step": 7}
    for number, (name, kind) in enumerate({**kinds, "data": 12}.items(), 1):
        one = message.field.add(name=name, number=number, label=1, type=kind)
        if kind == 11:
            one.type_name = ".google.protobuf.Timestamp"
    time = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(time)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(time)
    pool.Add(file)
    schema = descriptor_pb2.FileDescriptorSet(file=[time, file]).SerializeToString()
    found = pool.FindMessageTypeByName("foxglove.RawImage")
    return message_factory.GetMessageClass(found), schema


def as_protobuf(kind: str, value: Any) -> tuple[str, bytes, bytes] | None:
    """Type, schema and bytes of an image; None for other messages."""
    if kind != "sensor_msgs/msg/Image":
        return None
    made, schema = raw_image_type()
    message = made(
        frame_id="cam", width=W, height=H, encoding=value.encoding, step=value.step,
        data=bytes(value.data),
    )  # fmt: skip
    message.timestamp.seconds = value.header.stamp.sec
    message.timestamp.nanos = value.header.stamp.nanosec
    return "foxglove.RawImage", schema, message.SerializeToString()


@dataclass
class InMemory:
    """A container of messages in memory."""

    topics: dict[str, Topic]
    stored: list[RawMessage]
    kind: str = "memory"
    checksums: str = "none"
    path: Path = Path("memory.mcap")
    notes: list[str] = field(default_factory=list)
    damage: list[Damage] = field(default_factory=list)

    def messages(self, topics: frozenset[str]) -> Iterator[RawMessage]:
        return (m for m in self.stored if m.topic in topics)


def container(listed: Listed, how: str) -> InMemory:
    """The messages in an encoding: cdr, cdr2, json or protobuf (images; the rest cdr)."""
    topics: dict[str, Topic] = {}
    stored = []
    for topic, t, kind, value in sorted(listed, key=lambda m: m[1]):
        name, encoding, schema = kind, "cdr", b""
        key = ("cdr", "")
        if how == "cdr2":
            data = encoded(kind, value)
        elif how == "json":
            key, encoding, data = ("json", "jsonschema"), "json", as_json(kind, value)
        elif how == "protobuf" and (made := as_protobuf(kind, value)) is not None:
            name, schema, data = made
            key, encoding = ("protobuf", "protobuf"), "protobuf"
        else:
            data = bytes(STORE.serialize_cdr(value, kind))
        if key == ("cdr", "") and kind.startswith("vision_msgs"):
            key, schema = ("cdr", "ros2msg"), STORE.generate_msgdef(kind, ros_version=2)[0].encode()
        if topic not in topics:
            decode = foxglove.adapted(name, decoders()[key](name, schema))
            topics[topic] = Topic(topic, foxglove.ros_type(name), encoding, None, decode)
        stored.append(RawMessage(topic, t, data))
    return InMemory(topics, stored)


def frames_of(made: InMemory) -> dict[int, str]:
    """A digest of each frame, by its stamp. DgevalError where there are none."""
    opened = Opened(made, made.path)
    config = Config()
    scanned = scan(opened)
    roles = find_roles(scanned, config.roles)
    colour, depth = image_topics(scanned, roles)
    robot = robot_states(scanned, roles, config)
    spec = TrialSpec("m", made.path)
    window = window_of(pair_images(scanned, colour, depth, config), spec, opened.damage)
    camera = camera_of(
        scanned, colour, depth, roles, robot.tree, window.pairs[0].t_ns, config.calibration
    )
    codec = scanned.images[colour].codec
    reader = FrameReader(opened, colour, depth, window.pairs, camera, robot, LostFrames([]), codec)
    out = {}
    for frame in reader.frames():
        digest = hashlib.sha256(frame.colour.tobytes() + frame.depth.tobytes())
        out[frame.t_ns] = digest.hexdigest()
    return out


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    if not data:
        return data
    kind = rng.integers(5)
    at = int(rng.integers(min(len(data), 400)))
    if kind == 0:
        return data[:at]
    if kind == 1:
        return data[:at] + bytes([data[at] ^ int(1 << rng.integers(8))]) + data[at + 1 :]
    if kind == 2:
        return data[:at] + rng.bytes(8) + data[at + 8 :]
    if kind == 3:
        return data[:at] + data[at : at + 16] + data[at:]
    return data[:at] + b"\xff\xff\xff\x7f" + data[at + 4 :]


CASES: dict[str, Callable[[], InMemory]] = {
    "cdr": lambda: container(recording(), "cdr"),
    "cdr2": lambda: container(recording(), "cdr2"),
    "json": lambda: container(recording(), "json"),
    "protobuf": lambda: container(recording(), "protobuf"),
    "rvl": lambda: container(recording(depth="rvl"), "cdr"),
    "h264": lambda: container(as_video(recording(), 1), "cdr"),
    "h264, later pictures need earlier ones": lambda: container(as_video(recording(), 30), "cdr"),
    **{
        name: (lambda name=name: container(recording(name), "cdr"))
        for name in ("uyvy", "nv24", "bayer_rggb8", "rgb16")
    },
}


def fault(made: InMemory, whole: dict[int, str], seed: int, needed: bool = False) -> str | None:
    """What is wrong after one mutation; None where all is well. needed: by later pictures."""
    rng = np.random.default_rng(seed)
    k = int(rng.integers(len(made.stored)))
    hit = made.stored[k]
    stored = list(made.stored)
    stored[k] = RawMessage(hit.topic, hit.log_ns, mutated(hit.data, rng))
    try:
        got = frames_of(InMemory(made.topics, stored))
    except DgevalError:
        return None
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    if hit.topic not in (COLOUR, DEPTH):
        if hit.topic == INFO or got == whole:
            return None
        return "a message that is no image changed frames"
    last_ns = max(whole)
    # of a picture that others need, the later ones may change
    until = hit.log_ns if needed and hit.topic == COLOUR else last_ns
    lost = {t for t in whole if t != hit.log_ns and t <= until and t in got and got[t] != whole[t]}
    return f"frames at {sorted(lost)} changed" if lost else None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1000, help="of each encoding")
    count = parser.parse_args().count
    wrong = 0
    for name, make in CASES.items():
        made = make()
        whole = frames_of(made)
        needed = "later" in name
        found = [
            (seed, what) for seed in range(count) if (what := fault(made, whole, seed, needed))
        ]
        wrong += len(found)
        print(f"{name}: {count} mutations, {len(found)} wrong {found[:3]}", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
