"""Which topic has which role: chosen by type and name unless the configuration names it."""

from __future__ import annotations

from dataclasses import dataclass, field
from os.path import commonpath

from dgeval.config import RolesConfig
from dgeval.errors import Place, UnreadableError, UsageError
from dgeval.recording.contract import DGEVAL_PREFIX, TRUTH_PREFIX
from dgeval.recording.images import DEPTH_ENCODINGS
from dgeval.recording.scan import Scan

COLOUR_ENCODINGS = frozenset({"rgb8", "bgr8", "rgba8", "bgra8", "8UC3", "mono8", "8UC1"})
# parts of a topic's name that rule it out as the camera or a state of the robot
NOT_A_CAMERA = (DGEVAL_PREFIX, TRUTH_PREFIX, "mask", "debug", "annotated", "detection")


@dataclass(frozen=True)
class Roles:
    """The topic of each role, or None. passed_over: by role, topics that could have it as well."""

    colour: str | None
    depth: str | None
    intrinsics: str | None
    hand_joints: str | None
    camera_pose: str | None
    hand_pose: str | None
    passed_over: dict[str, list[str]] = field(default_factory=dict)


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
    colour = config.colour or choose(
        "colour",
        sorted(
            (
                n
                for n, h in heads.items()
                if h.encoding in COLOUR_ENCODINGS and "depth" not in n.lower()
            ),
            key=lambda n: (
                not _has(n, "color", "colour", "rgb"),
                _has(n, "infra", "left", "right"),
                -_count(scan, n),
                n,
            ),
        ),
    )
    depth = config.depth or choose(
        "depth",
        sorted(
            (n for n, h in heads.items() if h.encoding in DEPTH_ENCODINGS),
            key=lambda n: (
                not _has(n, "aligned", "registered"),
                not _has(n, "depth"),
                -_count(scan, n),
                n,
            ),
        ),
    )
    intrinsics = config.intrinsics
    if intrinsics is None and colour is not None:
        near = sorted(scan.cameras, key=lambda n: (-len(commonpath([n, colour])), n))
        intrinsics = near[0] if near else None
    joints = config.hand_joints or choose(
        "hand_joints",
        sorted(
            (n for n in scan.joints if used(n)),
            key=lambda n: (not _has(n, "joint_states"), -_count(scan, n), n),
        ),
    )
    poses = [n for n in sorted(scan.poses) if used(n)]
    return Roles(
        colour,
        depth,
        intrinsics,
        joints,
        config.camera_pose
        or choose("camera_pose", [n for n in poses if _has(n, "camera", "cam_pose", "odom")]),
        config.hand_pose
        or choose(
            "hand_pose", [n for n in poses if _has(n, "palm", "hand", "gripper", "tcp", "ee_pose")]
        ),
        passed,
    )


def image_topics(scan: Scan, roles: Roles) -> tuple[str, str]:
    """The topics of colour and depth. UnreadableError without one; it lists what is there."""
    if roles.colour is not None and roles.depth is not None:
        return roles.colour, roles.depth
    missing = " and ".join(
        role for role, topic in (("colour", roles.colour), ("depth", roles.depth)) if topic is None
    )
    topics = sorted(scan.opened.topics.values(), key=lambda t: t.name)
    listed = ", ".join(f"{t.name} ({t.type})" for t in topics) or "nothing"
    damage = scan.opened.damage
    lost = f" after damage ({damage[0].what})" if damage else ""
    raise UnreadableError(
        f"no {missing} images found{lost} among: {listed}",
        Place(str(scan.opened.path)),
        "name it with --set roles.colour=… or roles.depth=…",
    )


def _has(name: str, *parts: str) -> bool:
    return any(part in name.lower() for part in parts)


def _count(scan: Scan, name: str) -> int:
    return len(scan.times[name].log_ns)
