"""One pass over a recording: counts, stamps, poses, joints, intrinsics, events and latched data.

Of images only the stamps are read, and the first of each topic is decoded. A few numbers are kept
per message and no image, so memory does not grow with the size of images.
"""

from __future__ import annotations

import contextlib
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgeval.errors import Damage, Place, UndecodableError, UsageError
from dgeval.geometry import Array, invert, matrix_from_pose, pose_from_matrix
from dgeval.recording.clocks import RecorderClock, recorder_clock
from dgeval.recording.containers.container import Opened, RawMessage
from dgeval.recording.contract import (
    ACCEPTED_TOPIC,
    CANDIDATE_SCORES_TOPIC,
    CANDIDATES_TOPIC,
    DEPTH_UNIT,
    EVENT_KINDS,
    EVENTS_TOPIC,
    EXECUTE_TOPIC,
    GRASP_SCORE_TOPIC,
    IMAGE_METADATA,
    OWN_PREFIXES,
    ROBOT_DESCRIPTION,
    SCORE_TOPIC,
)
from dgeval.recording.detections import DETECTION_TYPES, Detection, detections_of
from dgeval.recording.events import heard_once
from dgeval.recording.grippers import GOALS, goals_of, is_gripper_topic, number_of
from dgeval.recording.images import decode_image
from dgeval.recording.librealsense import (
    EXTRINSICS,
    STREAM_POSE_TYPE,
    StreamAt,
    extrinsics_of,
    frame_time_ns,
    pose_of_transform,
    stream_of,
)
from dgeval.recording.messages import (
    CAMERA_INFO,
    IMAGE_TYPES,
    JOINT_TYPES,
    POSE_TYPES,
    TF_TYPES,
    CameraModel,
    Event,
    JointSample,
    StampedPose,
    StampedPoses,
    camera_model,
    event_of,
    event_text,
    header_stamp_ns,
    joints_of,
    poses_of,
    read_event,
    stamp_ns,
    stamped_poses_of,
)
from dgeval.recording.namespaces import namespace_of
from dgeval.recording.video import EXTRA, VideoDecoder, codec_of, is_available

MOST_OF_AN_EVENT = 2000  # bytes; an event camera's topics are called so too
NUMBERS = frozenset({GRASP_SCORE_TOPIC, SCORE_TOPIC, EXECUTE_TOPIC, ACCEPTED_TOPIC})
# what a message that does not hold what its type says leads to
NOT_USABLE = (
    UndecodableError,
    ValueError,
    AttributeError,
    TypeError,
    LookupError,
    OverflowError,
    struct.error,
)
STAMPED = (
    IMAGE_TYPES
    | POSE_TYPES
    | TF_TYPES
    | DETECTION_TYPES
    | {
        CAMERA_INFO,
        *JOINT_TYPES,
        "geometry_msgs/msg/TwistStamped",
    }
)
# bytes of an image's message that may hold its stamp, in any encoding; every so many bytes after
# them tell one picture from the next
BEHIND_STAMP, DIGESTED = 64, 31
URDF_TAGS = ("<robot", "<link", "<joint", "<parent ", "<child ")
MOST_INTRINSICS = 50  # different ones of a topic, that are kept


@dataclass
class TopicTimes:
    """Log and header stamps of a topic, ns; header stamps only where the type has a header.

    digests: of images, of every DIGESTED-th byte behind the stamp.
    """

    log_ns: list[int] = field(default_factory=list)
    header_ns: list[int] = field(default_factory=list)
    digests: list[int] = field(default_factory=list)

    def arrays(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Header stamps and log times; log times stand in where there is no header."""
        log = np.array(self.log_ns, dtype=np.int64)
        header = (
            np.array(self.header_ns, dtype=np.int64)
            if len(self.header_ns) == len(self.log_ns)
            else log
        )
        return header, log


@dataclass(frozen=True, slots=True)
class ImageHead:
    """The first image of a topic; encoding "?" where it can't be decoded. Size px.

    codec: of a video. fault: why it can't be decoded.
    """

    encoding: str
    width: int
    height: int
    frame_id: str
    format: str
    codec: str | None = None
    fault: str = ""


@dataclass
class Transforms:
    """The transforms of one namespace, in the order of the file.

    is_static: by frame, whether the first transform heard of it was a static one.
    """

    moving: list[StampedPose] = field(default_factory=list)
    static: list[StampedPose] = field(default_factory=list)
    is_static: dict[str, bool] = field(default_factory=dict)


@dataclass
class Scan:
    """What one pass keeps of a recording, most of it by topic; transforms by namespace.

    depth_units: m per unit, by the topic of librealsense's option. extrinsics: (4, 4) by the topic
    of realsense-ros, from one stream into the other that its name says. words: by another topic of
    texts, how many of them an event could be, and how many there are. not_events: entries of the
    events' topic that are not understood. description_changes: topics of several descriptions.
    recorder_clock: where the recorder's clock is not that of the stamps; events and numbers
    without a stamp are moved by it. numbers: by topic, each with its log time, ns;
    candidate_scores (n,) likewise.
    """

    opened: Opened
    times: dict[str, TopicTimes] = field(default_factory=lambda: defaultdict(TopicTimes))
    images: dict[str, ImageHead] = field(default_factory=dict)
    cameras: dict[str, CameraModel] = field(default_factory=dict)
    camera_changes: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    tf: dict[str, Transforms] = field(default_factory=lambda: defaultdict(Transforms))
    poses: dict[str, list[StampedPose]] = field(default_factory=lambda: defaultdict(list))
    twists: dict[str, list[tuple[int, Array]]] = field(default_factory=lambda: defaultdict(list))
    joints: dict[str, list[JointSample]] = field(default_factory=lambda: defaultdict(list))
    grippers: dict[str, list[tuple[int, float]]] = field(default_factory=lambda: defaultdict(list))
    detections: dict[str, list[Detection]] = field(default_factory=lambda: defaultdict(list))
    numbers: dict[str, list[tuple[int, float]]] = field(default_factory=dict)
    candidates: list[StampedPoses] = field(default_factory=list)
    candidate_scores: list[tuple[int, Array]] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    not_events: list[str] = field(default_factory=list)
    recorder_clock: RecorderClock | None = None
    descriptions: dict[str, str] = field(default_factory=dict)
    description_changes: set[str] = field(default_factory=set)
    depth_units: dict[str, float] = field(default_factory=dict)
    extrinsics: dict[str, Array] = field(default_factory=dict)
    words: dict[str, list[int]] = field(default_factory=lambda: defaultdict(lambda: [0, 0]))
    undecodable: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    first_undecodable: dict[str, str] = field(default_factory=dict)

    def describe(self, topic: str, text: Any) -> None:
        """Keep a robot's description, the last one of its topic."""
        if not isinstance(text, str):
            return
        if self.descriptions.get(topic, text) != text:
            self.description_changes.add(topic)
        self.descriptions[topic] = text


@dataclass
class _Counted:
    """Intrinsics, and in how many messages they are."""

    model: CameraModel
    count: int = 0


def _of_most(counted: Iterable[_Counted]) -> tuple[CameraModel, int]:
    """The intrinsics that most messages have, of equally many the first; and how many have others.

    A driver that starts in another mode publishes that one's first.
    """
    by_model: dict[CameraModel, int] = {}
    for one in counted:
        by_model[one.model] = by_model.get(one.model, 0) + one.count
    most = max(by_model, key=lambda model: by_model[model])
    return most, sum(by_model.values()) - by_model[most]


def scan(opened: Opened, events_topic: str | None = None) -> Scan:
    """Read the whole recording once. Faults of the file are added to `opened.damage`."""
    out = Scan(opened)
    wanted_events = events_topic or EVENTS_TOPIC
    intrinsics: dict[str, dict[bytes, _Counted]] = defaultdict(dict)
    videos: dict[str, VideoDecoder] = {}
    frame_times: dict[str, dict[int, int]] = defaultdict(dict)
    goals: dict[str, set[bytes]] = defaultdict(set)
    streams: dict[StreamAt, Array] = {}
    for message in opened.messages():
        topic = opened.topics[message.topic]
        times = out.times[message.topic]
        times.log_ns.append(message.log_ns)
        try:
            if topic.type in IMAGE_TYPES:
                times.digests.append(zlib.crc32(message.data[BEHIND_STAMP::DIGESTED]))
                times.header_ns.append(_stamp(message, topic.encoding, opened))
                known = out.images.get(message.topic)
                # a broken first image does not hide the topic
                if known is None or known.encoding == "?":
                    out.images[message.topic] = _head(message, opened, videos)
            elif topic.type in TF_TYPES:
                latched = message.topic.endswith("static")
                edges = poses_of(opened.decode(message))
                heard = out.tf[namespace_of(message.topic)]
                for edge in edges:
                    heard.is_static.setdefault(edge.child, latched)
                (heard.static if latched else heard.moving).extend(edges)
                times.header_ns.append(edges[0].t_ns if edges else message.log_ns)
            elif topic.type in POSE_TYPES:
                pose = poses_of(opened.decode(message))[0]
                times.header_ns.append(pose.t_ns)
                out.poses[message.topic].append(pose)
            elif topic.type == "geometry_msgs/msg/TwistStamped":
                twist = opened.decode(message)
                times.header_ns.append(stamp_ns(twist))
                v, w = twist.twist.linear, twist.twist.angular
                values = np.array([v.x, v.y, v.z, w.x, w.y, w.z], dtype=np.float64)
                if np.isfinite(values).all():
                    out.twists[message.topic].append((times.header_ns[-1], values))
            elif topic.type == CAMERA_INFO:
                times.header_ns.append(_stamp(message, topic.encoding, opened))
                matrix = message.data[20:]  # after the stamp; equal bytes are not decoded again
                known_models = intrinsics[message.topic]
                if matrix not in known_models and len(known_models) < MOST_INTRINSICS:
                    known_models[matrix] = _Counted(camera_model(opened.decode(message)))
                if matrix in known_models:
                    known_models[matrix].count += 1
            elif topic.type in JOINT_TYPES:
                sample = joints_of(opened.decode(message))
                times.header_ns.append(sample.t_ns)
                out.joints[message.topic].append(sample)
            elif topic.type in DETECTION_TYPES:
                decoded = opened.decode(message)
                times.header_ns.append(stamp_ns(decoded))
                out.detections[message.topic].extend(detections_of(decoded))
            elif message.topic.endswith(DEPTH_UNIT):
                out.depth_units[message.topic] = round(float(opened.decode(message).data), 9)
            elif topic.type == "std_msgs/msg/String" and message.topic.endswith(IMAGE_METADATA):
                t_ns = frame_time_ns(opened.decode(message).data)
                if t_ns is not None:
                    stream = message.topic.removesuffix("metadata")
                    frame_times[stream][message.log_ns] = t_ns
            elif topic.type in EXTRINSICS:
                out.extrinsics[message.topic] = extrinsics_of(opened.decode(message))
            elif topic.type == STREAM_POSE_TYPE and (stream_at := stream_of(message.topic)):
                streams[stream_at] = pose_of_transform(opened.decode(message))
            elif message.topic == wanted_events:
                decoded = opened.decode(message)
                try:
                    out.events.append(read_event(decoded, message.log_ns))
                except ValueError:
                    out.not_events.append(event_text(decoded))  # without a text it is damage
            elif message.topic.endswith(ROBOT_DESCRIPTION[1:]):
                out.describe(message.topic, getattr(opened.decode(message), "data", None))
            elif topic.type == "std_msgs/msg/String":
                said = opened.decode(message)
                if _is_urdf(getattr(said, "data", "")):
                    out.describe(message.topic, said.data)
                else:
                    _count_words(out.words[message.topic], said)
            elif is_gripper_topic(message.topic, topic.type):
                gripper = opened.decode(message)
                if topic.type == GOALS:
                    taken = out.grippers[message.topic]
                    # each goal is a command of its own, whatever it says
                    for t_ns in goals_of(gripper, goals[message.topic]):
                        taken.append((t_ns or message.log_ns, float(len(taken) % 2)))
                    continue
                number = number_of(gripper)
                header = getattr(gripper, "header", None)
                if number is not None:
                    at = message.log_ns if header is None else stamp_ns(gripper)
                    out.grippers[message.topic].append((at or message.log_ns, number))
            elif message.topic == CANDIDATES_TOPIC:
                out.candidates.append(stamped_poses_of(opened.decode(message), message.log_ns))
            elif message.topic == CANDIDATE_SCORES_TOPIC:
                scores = np.array(opened.decode(message).data, dtype=np.float64).ravel()
                out.candidate_scores.append((message.log_ns, scores))
            elif message.topic in NUMBERS:
                value = float(opened.decode(message).data)
                if np.isfinite(value):
                    out.numbers.setdefault(message.topic, []).append((message.log_ns, value))
            elif "event" in message.topic.lower() and len(message.data) < MOST_OF_AN_EVENT:
                with contextlib.suppress(*NOT_USABLE):  # nobody asked for it
                    _count_words(out.words[message.topic], opened.decode(message))
        except NOT_USABLE as error:
            if topic.type in STAMPED and len(times.header_ns) < len(times.log_ns):
                times.header_ns.append(0)  # so that the stamps of the others stay theirs
            out.undecodable[message.topic] += 1
            out.first_undecodable.setdefault(message.topic, str(error))
    for name, models in intrinsics.items():
        if models:
            out.cameras[name], out.camera_changes[name] = _of_most(models.values())
    _use_frame_times(out, frame_times)
    _place_streams(out, streams)
    _onto_the_stamps_clock(out)
    out.events = heard_once(out.events)
    if units := sorted({event.unit for event in out.events if event.unit}):
        opened.notes.append(
            f"t_ns of events is in {' and '.join(units)}, by when they were logged, and taken so"
        )
    for name in sorted(out.undecodable):
        what = (
            f"{out.undecodable[name]} messages can't be used, "
            f"the first: {out.first_undecodable[name]}"
        )
        if opened.topics[name].type in DETECTION_TYPES:
            opened.notes.append(f"{name}: {what}; a target is found without it")
            continue
        opened.damage.append(Damage(what, Place(str(opened.path), name)))
    return out


def _is_urdf(text: Any) -> bool:
    """Whether a text, on a topic of any name, describes a robot's links; a semantic description
    has no parents of joints.
    """
    return (
        isinstance(text, str)
        and text.lstrip().startswith("<")
        and all(tag in text for tag in URDF_TAGS)
    )


def _count_words(counted: list[int], message: Any) -> None:
    """Count a message, and whether it would be understood as an event."""
    counted[1] += 1
    with contextlib.suppress(ValueError):
        counted[0] += event_of(event_text(message), 0).kind in EVENT_KINDS


def add_to_stamps(found: Scan, offsets: Mapping[str, int]) -> None:
    """Move the stamps of topics of joint states or poses, by ns. UsageError for another one."""
    for topic, offset_ns in offsets.items():
        if topic not in found.joints and topic not in found.poses:
            raise UsageError(
                f"clock.topics names {topic!r}, which holds no joint states or poses",
                Place(str(found.opened.path)),
            )
        times = found.times[topic]
        times.header_ns = [t_ns + offset_ns for t_ns in times.header_ns]
        if topic in found.joints:
            samples = found.joints[topic]
            found.joints[topic] = [replace(s, t_ns=s.t_ns + offset_ns) for s in samples]
        if topic in found.poses:
            poses = found.poses[topic]
            found.poses[topic] = [replace(p, t_ns=p.t_ns + offset_ns) for p in poses]


def _use_frame_times(found: Scan, frame_times: dict[str, dict[int, int]]) -> None:
    """The frames' own times, ns, for stamps that say when an image arrived at the recorder.

    frame_times: by the beginning of the topics' names and by log time. Only where every image of a
    topic has one.
    """
    for stream, by_log in frame_times.items():
        for name in found.images:
            times = found.times[name]
            if name.startswith(stream) and all(t in by_log for t in times.log_ns):
                times.header_ns = [by_log[t] for t in times.log_ns]


def _place_streams(found: Scan, streams: dict[StreamAt, Array]) -> None:
    """Frames of the streams of a librealsense .bag, which calls all those of a group by the group's
    number, and where they are.

    streams: by stream, its reference's pose in it, px py pz qx qy qz qw.
    """
    heard = found.tf[namespace_of("/tf_static")] if streams else Transforms()
    for at, pose in sorted(streams.items()):
        image, info = f"{at.prefix}/image/data", f"{at.prefix}/info/camera_info"
        head = found.images.get(image)
        if head is None or (head.frame_id and not head.frame_id.isdigit()):
            continue
        frame = at.prefix.lstrip("/")
        found.images[image] = replace(head, frame_id=frame)
        if info in found.cameras:
            found.cameras[info] = replace(found.cameras[info], frame_id=frame)
        inverse = pose_from_matrix(invert(matrix_from_pose(pose)))
        heard.static.append(StampedPose(0, at.reference, frame, inverse))
        heard.is_static[frame] = True


def _onto_the_stamps_clock(found: Scan) -> None:
    """Bring what has only a log time onto the clock of the stamps, where the two are apart.

    What the robot says of its own beliefs tells no clock: its stamps may be of either.
    """
    stamped = {
        name: times.arrays()
        for name, times in found.times.items()
        if found.opened.topics[name].type in STAMPED
        and not name.endswith("static")
        and not name.startswith(OWN_PREFIXES)
    }
    stamped = {name: (header, log) for name, (header, log) in stamped.items() if header.any()}
    found.recorder_clock = clock = recorder_clock(stamped)
    for topic, samples in found.joints.items():
        log_ns = found.times[topic].log_ns
        if len(samples) > 1 and len(samples) == len(log_ns) and not any(s.t_ns for s in samples):
            # never stamped: the recorder's time is all there is
            found.joints[topic] = [
                replace(s, t_ns=t if clock is None else clock.stamp_ns(t))
                for s, t in zip(samples, log_ns, strict=True)
            ]
    if clock is None:
        return
    found.events = [
        replace(e, t_ns=clock.stamp_ns(e.t_ns)) if e.is_log_time else e for e in found.events
    ]
    for topic in [n for n in found.times if n.startswith(OWN_PREFIXES)]:
        header, log = found.times[topic].arrays()
        by_recorder = len(header) == len(log) > 0 and header.any()
        if by_recorder and abs(np.median(log - header)) < 0.5e9 * abs(clock.apart_s):
            found.times[topic].header_ns = [clock.stamp_ns(t_ns) for t_ns in header.tolist()]
            if topic in found.poses:
                poses = found.poses[topic]
                found.poses[topic] = [replace(p, t_ns=clock.stamp_ns(p.t_ns)) for p in poses]
            if topic in found.twists:
                twists = found.twists[topic]
                found.twists[topic] = [(clock.stamp_ns(t_ns), twist) for t_ns, twist in twists]
    found.candidates = [_on_clock(one, clock) for one in found.candidates]
    found.candidate_scores = [(clock.stamp_ns(t_ns), v) for t_ns, v in found.candidate_scores]
    found.numbers = {
        topic: [(clock.stamp_ns(t_ns), value) for t_ns, value in listed]
        for topic, listed in found.numbers.items()
    }


def _on_clock(one: StampedPoses, clock: RecorderClock) -> StampedPoses:
    """A set with its times on the stamps' clock; its own stamp may be of either."""
    by_recorder = one.t_ns and abs(one.log_ns - one.t_ns) < 0.5e9 * abs(clock.apart_s)
    t_ns = clock.stamp_ns(one.t_ns) if by_recorder else one.t_ns
    return replace(one, t_ns=t_ns, log_ns=clock.stamp_ns(one.log_ns))


def _stamp(message: RawMessage, encoding: str, opened: Opened) -> int:
    if encoding in ("cdr", "ros1"):
        return header_stamp_ns(message.data, encoding)
    stamp = opened.decode(message).header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _head(message: RawMessage, opened: Opened, videos: dict[str, VideoDecoder]) -> ImageHead:
    """videos: by topic, the decoder that waits for the first picture."""
    decoded = opened.decode(message)
    frame = decoded.header.frame_id.lstrip("/")
    stated = getattr(decoded, "format", "") or getattr(decoded, "encoding", "")
    codec = codec_of(decoded)
    try:
        if codec is None:
            pixels = decode_image(decoded)
            array, encoding = pixels.array, pixels.encoding
        else:
            array, encoding = _first_picture(message.topic, codec, decoded, videos), "rgb8"
    except ValueError as error:
        return ImageHead("?", 0, 0, frame, stated, codec, str(error))
    height, width = array.shape[:2]
    return ImageHead(encoding, width, height, frame, stated, codec)


def _first_picture(
    topic: str, codec: str, decoded: Any, videos: dict[str, VideoDecoder]
) -> NDArray[np.uint8]:
    """ValueError where there is none yet, or the extra is not installed."""
    if not is_available():
        raise ValueError(f"{codec} video needs {EXTRA}")
    if topic not in videos:
        videos[topic] = VideoDecoder(codec)
    for _, picture in videos[topic].feed(bytes(memoryview(decoded.data))):
        return picture
    raise ValueError("no picture yet")
