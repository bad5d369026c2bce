"""Which topic has which role: chosen by type and name unless the configuration names it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from dgeval.config import RolesConfig
from dgeval.errors import Place, UnreadableError, UsageError
from dgeval.recording.cameras import (
    COLOUR_ENCODINGS,
    DISPARITY,
    choose_camera,
    depth_topics,
    intrinsics_of,
    is_aligned,
    is_aligned_by_name,
    other_camera,
)
from dgeval.recording.containers.container import Topic
from dgeval.recording.contract import DGEVAL_PREFIX, MASK_TOPIC, TRUTH_PREFIX
from dgeval.recording.detections import DETECTION_TYPES
from dgeval.recording.images import DEPTH_ENCODINGS
from dgeval.recording.messages import (
    CAMERA_INFO,
    IMAGE_TYPES,
    JOINT_STATE,
    TF_TYPES,
    JointSample,
)
from dgeval.recording.namespaces import Series, differ, namespace_of, of_camera
from dgeval.recording.scan import ImageHead, Scan
from dgeval.recording.video import EXTRA, is_available

SAME_MATRIX = 0.02  # share; two cameras whose matrices differ by less are one; ours
SAME_JOINT = 0.02  # rad or m; two topics that differ by less give one joint's position; ours
# words in the name of a mask that is not of an object
NO_TARGET_MASK = ("valid", "self", "robot", "arm_mask", "confidence", "filter")
SAME_SHAPE = 0.01  # share; a mask whose sides have the picture's ratio within this shows all of it
MASK_ENCODINGS = ("mono8", "8UC1", "mono16", "16UC1", "32SC1")
# parts of a topic's name that say that its joint states were wanted, not measured
WANTED = ("desired", "command", "cmd", "target", "reference", "setpoint", "goal")
# parts of a name that say that poses, or a frame on /tf, are an object's: the word, and estimators
AN_OBJECT = ("object", "foundationpose", "foundation_pose", "megapose", "cosypose", "dope/")
# parts of a type's name that say that it holds pictures
PICTURES = ("image", "video", "picture", "theora", "frame")
# parts of a topic's name that rule it out as the camera or a state of the robot
NOT_A_CAMERA = (DGEVAL_PREFIX, TRUTH_PREFIX, "mask", "debug", "annotated", "detection")


@dataclass(frozen=True)
class Roles:
    """The topic of each role, or None.

    joints: every topic of joint states that counts, the first with a joint's name gives its values.
    target: masks, detections or an object's poses, which mark the target. rival: colour of another
    camera whose frame has the same name.
    depth_intrinsics: of a depth camera whose images are not aligned to colour.
    passed_over: by role, topics that could have it as well. notes: what was assumed.
    """

    colour: str | None
    depth: str | None
    intrinsics: str | None
    hand_joints: str | None
    camera_pose: str | None
    hand_pose: str | None
    passed_over: dict[str, list[str]] = field(default_factory=dict)
    joints: tuple[str, ...] = ()
    depth_intrinsics: str | None = None
    notes: tuple[str, ...] = ()
    target: tuple[str, ...] = ()
    rival: str | None = None


def find_roles(scan: Scan, config: RolesConfig) -> Roles:
    """UsageError for a configured topic that is not in the recording; it lists those that are."""
    topics = scan.opened.topics
    for role, name in config.model_dump().items():
        if name is not None and name not in topics:
            listed = "; ".join(
                f"{t.name} ({t.type}, {t.count})"
                for t in sorted(topics.values(), key=lambda t: t.name)
            )
            place = Place(str(scan.opened.path))
            raise UsageError(
                f"roles.{role} = {name!r} is not in the recording, which has: {listed}", place
            )
    passed: dict[str, list[str]] = {}

    def choose(role: str, ranked: list[str]) -> str | None:
        if len(ranked) > 1:
            passed[role] = ranked[1:]
        return ranked[0] if ranked else None

    def used(name: str) -> bool:
        return bool(scan.times[name].log_ns) and not any(part in name for part in NOT_A_CAMERA)

    heads = {name: head for name, head in scan.images.items() if used(name)}
    heads |= {n: scan.images[n] for n in (config.colour, config.depth) if n in scan.images}
    colour, depth, passed_images = choose_camera(scan, heads, config)
    passed |= passed_images
    notes = []
    rival = None
    if colour is not None and depth is not None:
        other = other_camera(scan, heads, passed, colour, depth)
        if other is not None and config.colour is None:
            same = heads[other].frame_id == heads[colour].frame_id
            rival = other if same and heads[other].frame_id else None
        if other is not None:
            notes.append(
                f"the camera is {colour} ({heads[colour].frame_id}); {other} "
                f"({heads[other].frame_id}) could be it too (roles.colour, roles.depth)"
            )
        if aligned(scan, colour, depth) and not is_aligned(heads[colour], heads[depth]):
            notes.append(
                f"{depth} is taken as aligned to colour by its name: nothing places its frame "
                f"{heads[depth].frame_id!r}"
            )
    intrinsics = config.intrinsics
    if intrinsics is None and colour is not None:
        intrinsics = intrinsics_of(scan, heads, colour)
    depth_intrinsics = None
    if depth is not None and colour is not None and not aligned(scan, colour, depth):
        depth_intrinsics = intrinsics_of(scan, heads, depth)
    joints = sorted(
        (n for n in scan.joints if used(n)),
        key=lambda n: (
            _has(n, *WANTED),
            not _has(n, "joint_states"),
            n.count("/"),
            -_count(scan, n),
            n,
        ),
    )
    # what ros2_control publishes besides says the same once more, and may lag; but a hand's
    # controller may be the only one that tells of its joints
    states = [n for n in joints if topics[n].type == JOINT_STATE]
    told = {name for n in states for s in scan.joints[n] for name in s.positions}
    joints = states + [n for n in joints if n not in states and _has_more(scan, n, told)]
    if config.hand_joints is not None:
        joints = [config.hand_joints]
    poses = [n for n in sorted(scan.poses) if used(n)]
    colour_frame = scan.images[colour].frame_id if colour in scan.images else ""
    return Roles(
        colour,
        depth,
        intrinsics,
        joints[0] if joints else None,
        config.camera_pose
        or choose("camera_pose", [n for n in poses if _of_camera(scan, n, colour_frame)]),
        config.hand_pose
        or choose(
            "hand_pose", [n for n in poses if _has(n, "palm", "hand", "gripper", "tcp", "ee_pose")]
        ),
        passed,
        tuple(joints),
        depth_intrinsics,
        tuple(notes),
        (config.target,) if config.target else _target_topics(scan, colour),
        rival,
    )


def _target_topics(scan: Scan, colour: str | None) -> tuple[str, ...]:
    """The robot's mask, else all masks of the colour picture, else detections, else poses, else
    frames on /tf.
    """
    head = scan.images.get(colour or "")
    if head is None:
        return ()

    def is_mask(name: str) -> bool:
        mask = scan.images[name]
        size = same_shape((mask.width, mask.height), (head.width, head.height))
        named = _has(name, "mask", "segmentation") and not _has(name, *NO_TARGET_MASK)
        return size and mask.encoding in MASK_ENCODINGS and named

    def theirs(names: Iterable[str]) -> list[str]:
        return sorted(n for n in names if not n.startswith((DGEVAL_PREFIX, TRUTH_PREFIX)))

    own = [n for n in scan.images if n == MASK_TOPIC and is_mask(n)]
    masks = [n for n in theirs(scan.images) if n != colour and is_mask(n)]
    poses = [n for n in theirs(scan.poses) if _has(n, *AN_OBJECT)]
    on_tf = {edge.child for heard in scan.tf.values() for edge in heard.moving}
    frames = sorted(n for n in on_tf if _has(n, *AN_OBJECT))
    kinds = (own, masks, theirs(scan.detections), poses, frames)
    return next((tuple(names) for names in kinds if names), ())


def same_shape(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Whether two pictures, width and height px, have the same ratio of their sides."""
    return abs(a[0] * b[1] - a[1] * b[0]) <= SAME_SHAPE * a[0] * b[1]


def aligned(scan: Scan, colour: str, depth: str) -> bool:
    """Whether a depth topic has the pixels of a colour topic; also where one can't be read.

    One frame and one size are not enough where each has intrinsics of its own, and they differ.
    """
    if colour not in scan.images or depth not in scan.images:
        return True
    c, d = scan.images[colour], scan.images[depth]
    if not is_aligned(c, d) and not is_aligned_by_name(scan, c, d, depth):
        return False
    own = [intrinsics_of(scan, scan.images, name) for name in (colour, depth)]
    if None in own or own[0] == own[1]:
        return True
    a, b = (scan.cameras[name].intrinsics for name in own if name is not None)
    matrix = np.array([[k.fx, k.fy, k.cx, k.cy] for k in (a, b)])
    return bool((np.abs(matrix[0] - matrix[1]) <= SAME_MATRIX * matrix[0]).all())


def _of_camera(scan: Scan, name: str, colour_frame: str) -> bool:
    """Whether a pose topic is the camera's: by the frame it moves, else by the topic's name.

    Odometry of a mobile base names the base as its child.
    """
    child = scan.poses[name][0].child if scan.poses[name] else ""
    if child:
        return child == colour_frame or _has(child, "camera", "optical")
    return _has(name, "camera", "cam_pose")


def _has_more(scan: Scan, topic: str, told: set[str]) -> bool:
    """Whether a topic of joint states gives the position of a joint that is not among some."""
    return any(name not in told for s in scan.joints[topic] for name in s.positions)


def joint_topics(
    scan: Scan, roles: Roles, namespace: str | None = None
) -> tuple[tuple[str, ...], list[str]]:
    """The topics of joint states of the camera's robot, and namespaces that contradict each other.

    namespace: of the robot, where the configuration names it.
    """
    if len({namespace_of(topic) for topic in roles.joints}) < 2:
        return roles.joints, []
    series: dict[str, dict[str, list[tuple[int, float]]]] = {}
    for topic in roles.joints:
        of_namespace = series.setdefault(namespace_of(topic), {})
        for sample in scan.joints.get(topic, []):
            for name, value in sample.positions.items():
                of_namespace.setdefault(name, []).append((sample.t_ns, value))

    def values(namespace: str, name: str) -> Series:
        rows = sorted(series[namespace][name])
        return np.array([t for t, _ in rows]), np.array([[v] for _, v in rows])

    def contradict(a: str, b: str) -> bool:
        shared = sorted(series[a].keys() & series[b].keys())
        return any(differ(values(a, n), values(b, n), SAME_JOINT) for n in shared)

    counts, mixed = of_camera(series, contradict, roles.colour, namespace)
    return tuple(t for t in roles.joints if namespace_of(t) in counts), mixed


def joint_owners(
    scan: Scan, topics: tuple[str, ...], what: Literal["positions", "efforts"] = "positions"
) -> dict[str, str]:
    """By joint, the first of the topics that gives its positions, or its efforts."""
    owner: dict[str, str] = {}
    for topic in topics:
        for sample in scan.joints.get(topic, []):
            for name in getattr(sample, what):
                owner.setdefault(name, topic)
    return owner


def merged_joints(scan: Scan, topics: tuple[str, ...]) -> list[JointSample]:
    """The samples of several topics of joint states, in time order.

    A joint that several topics give counts from the first of them.
    """
    if len(topics) == 1:
        return list(scan.joints.get(topics[0], []))
    owner = joint_owners(scan, topics)
    presses = joint_owners(scan, topics, "efforts")
    out = []
    for topic in topics:
        for s in scan.joints.get(topic, []):
            positions = {n: v for n, v in s.positions.items() if owner[n] == topic}
            efforts = {n: v for n, v in s.efforts.items() if presses[n] == topic}
            if positions or efforts:
                out.append(JointSample(s.t_ns, positions, efforts))
    return sorted(out, key=lambda s: s.t_ns)


def joint_notes(scan: Scan, topics: tuple[str, ...]) -> list[str]:
    """What is said of the topics of joint states that are used: that several are, of joints that
    are known only as they were wanted, and of efforts that are nobody's.
    """
    owner = joint_owners(scan, topics)
    given = {*owner.values(), *joint_owners(scan, topics, "efforts").values()}
    sources = [t for t in topics if t in given]
    merged = f"joint states are merged from {', '.join(sources)}"
    nameless = [
        f"the {len(scan.joints[topic])} messages of {topic} name no joint that has a position"
        for topic in topics
        if topic not in given and scan.joints.get(topic)
    ]
    return (
        [merged] * (len(sources) > 1)
        + nameless * (not sources)
        + [
            f"{', '.join(n for n in sorted(owner) if owner[n] == topic)}: as wanted ({topic}); "
            "measured positions are not recorded"
            for topic in sources
            if _has(topic, *WANTED) and topic in owner.values()
        ]
        + [
            f"efforts of {topic} are left out: {unplaced[0].unplaced_efforts} of them for "
            f"{len(unplaced[0].positions)} joints in {len(unplaced)} messages, "
            "so whose they are is not known"
            for topic in topics
            if (unplaced := [s for s in scan.joints.get(topic, []) if s.unplaced_efforts])
        ]
    )


def image_topics(scan: Scan, roles: Roles) -> tuple[str, str]:
    """The topics of colour and depth.

    UnreadableError without one: it lists what is there, and why it can't be read.
    """
    place = Place(str(scan.opened.path))
    for role in ("colour", "depth"):
        topic = getattr(roles, role)
        if topic is not None and topic not in scan.images:
            known = scan.opened.topics[topic]
            why = scan.first_undecodable.get(topic) or known.unread or f"it is a {known.type}"
            raise UnreadableError(f"roles.{role}: {topic} holds no readable images ({why})", place)
    if roles.colour is not None and roles.depth is not None:
        return roles.colour, roles.depth
    missing = " and ".join(
        role for role, topic in (("colour", roles.colour), ("depth", roles.depth)) if topic is None
    )
    topics = sorted(scan.opened.topics.values(), key=lambda t: t.name)
    listed = ", ".join(f"{t.name} ({t.stored_type or t.type})" for t in topics) or "nothing"
    of = scan.opened.topics
    damage = [d for d in scan.opened.damage if not _is_unread(of.get(d.place.topic or ""))]
    lost = f" after damage ({damage[0].what})" if damage else ""
    unread = [f"{t.name}: {t.unread}" for t in topics if t.unread]
    unread += [f"{t.name}: {t.stored_type or t.type} is not read" for t in topics if _shows(t)]
    unread += [f"{n}: {_why_unread(h)}" for n, h in scan.images.items() if h.encoding == "?"]
    if roles.depth is None:
        unread += [f"{n}: {why}" for n in sorted(scan.opened.topics) if (why := _no_depth(scan, n))]
    told = f"; not understood: {'; '.join(unread)}" if unread else ""
    usable = [n for n, h in scan.images.items() if h.encoding != "?"]
    hint = "name it with --set roles.colour=… or roles.depth=…" if len(usable) > 1 else None
    if unread and hint is None:
        hint = "record raw images, JPEG, PNG or compressedDepth (docs/recording.md)"
    if missing == "depth" and not depth_topics(scan, scan.images) and not unread:
        sure = ", ".join(sorted(DEPTH_ENCODINGS - {"mono16"}))
        hint = f"none holds depth ({sure}, or mono16 under a name with depth): record it"
    raise UnreadableError(f"no {missing} images found{lost} among: {listed}{told}", place, hint)


def _is_unread(topic: Topic | None) -> bool:
    """Whether a topic's encoding is none that is read: nothing of it is damaged."""
    return topic is not None and topic.unread is not None


def _shows(topic: Topic) -> bool:
    """Whether a topic whose type is not read is likely to hold pictures, by its type's name."""
    read = topic.type in IMAGE_TYPES or topic.type in (CAMERA_INFO, *TF_TYPES, *DETECTION_TYPES)
    return not read and not topic.unread and _has(topic.stored_type or topic.type, *PICTURES)


def _no_depth(scan: Scan, topic: str) -> str:
    """Why a topic that seems to hold depth is not read as depth; "" for others."""
    if topic.startswith((DGEVAL_PREFIX, TRUTH_PREFIX)):
        return ""
    if scan.opened.topics[topic].type == "sensor_msgs/msg/PointCloud2":
        return "a cloud, and only depth images are read"
    head = scan.images.get(topic)
    if head is not None and head.encoding in DEPTH_ENCODINGS and _has(topic, DISPARITY):
        return "disparity, in px, and not depth: record depth"
    if head is not None and head.encoding in COLOUR_ENCODINGS and _has(topic, "depth"):
        form = f"{head.format} " if head.format else ""
        return (
            f"{form}pictures of 8 bits ({head.encoding}), which can't hold depth: record "
            "…/compressedDepth, or raw"
        )
    return ""


def _why_unread(head: ImageHead) -> str:
    if head.codec is None:
        return f"{head.format!r} pictures, of which the first can't be decoded ({head.fault})"
    if not is_available():
        return f"{head.format} video, which needs {EXTRA}"
    return f"{head.format} video without a picture that can be decoded"


def _has(name: str, *parts: str) -> bool:
    return any(part in name.lower() for part in parts)


def _count(scan: Scan, name: str) -> int:
    return len(scan.times[name].log_ns)
