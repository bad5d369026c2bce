"""Poses of camera, palm and hand links over time.

They come from tf, from pose topics, and from joint states with a robot description, all in one
transform tree.
"""

from __future__ import annotations

import itertools
import re
from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from dgeval.config import Config, HandConfig
from dgeval.errors import Place, UsageError
from dgeval.geometry import Array, matrix_from_pose
from dgeval.recording.contract import ROBOT_DESCRIPTION
from dgeval.recording.joint_names import as_described, as_published
from dgeval.recording.messages import JointSample
from dgeval.recording.namespaces import Series, differ, holds, home_of, namespace_of, of_camera
from dgeval.recording.palm import palm_of
from dgeval.recording.roles import Roles, joint_notes, joint_topics, merged_joints
from dgeval.recording.scan import Scan, Transforms
from dgeval.recording.transforms import Track, TransformTree
from dgeval.recording.two_sources import contradictions, unplaced_by_tf
from dgeval.robots.described_hand import CLOSE_S, described_hand
from dgeval.robots.description import Description, Joint, LinkShape
from dgeval.robots.hand import Hand
from dgeval.robots.hand_links import hand_links
from dgeval.robots.loading import load_description
from dgeval.robots.recognition import known_hand

# names of the robot's base in common descriptions, in order of preference
BASE_NAMES = ("base_link", "base", "robot_base", "panda_link0", "iiwa_link_0", "base_footprint")
# words in the names of frames that may be on a thing that moves; ours
TAGS = ("tag", "apriltag", "marker", "aruco", "charuco", "object")
ODOMETRY = "odom"  # where the body of a robot is the top of its tree
SAME_POSE = 0.005  # m and parts of a quaternion; transforms that differ by less are one; ours
ONE_OF_THEM = "the last counts; record one of them"

EARLY = 0.8  # share of the least time between two control periods that jitter may leave; ours
MOVES = 1e-6  # m, and of a quaternion, by which a recorded transform moves
NAMELESS = "camera"  # the frame of images that name none, nor does their camera_info


@dataclass
class JointTrack:
    """Joint positions over time by name, linear between samples at most max_gap_ns apart."""

    times: dict[str, list[int]] = field(default_factory=dict)
    values: dict[str, list[float]] = field(default_factory=dict)

    @staticmethod
    def of(samples: list[JointSample], offset_ns: int) -> JointTrack:
        """Samples in time order, the clock offset added; a repeated stamp is dropped."""
        out = JointTrack()
        for sample in sorted(samples, key=lambda s: s.t_ns):
            for name, value in sample.positions.items():
                times = out.times.setdefault(name, [])
                t_ns = sample.t_ns + offset_ns
                if times and t_ns <= times[-1]:
                    continue
                times.append(t_ns)
                out.values.setdefault(name, []).append(value)
        return out

    def at(self, name: str, t_ns: int, max_gap_ns: int) -> float | None:
        """Position of a joint at a time; None outside its samples or in a gap."""
        times = self.times.get(name)
        if not times:
            return None
        i = bisect_left(times, t_ns)
        if i < len(times) and times[i] == t_ns:
            return self.values[name][i]
        if i == 0 or i == len(times) or times[i] - times[i - 1] > max_gap_ns:
            return None
        share = (t_ns - times[i - 1]) / (times[i] - times[i - 1])
        before, after = self.values[name][i - 1], self.values[name][i]
        if abs(after - before) > np.pi:  # the joint turns on over the end of its range
            after -= float(np.copysign(2 * np.pi, after - before))
        return (1 - share) * before + share * after

    def first_ns(self, joint: Joint) -> int:
        """The time from which on the position of a joint is known; 0 where it never is."""
        return next(iter(self.times.get(joint.name) or self.times.get(joint.follows) or ()), 0)

    def position(self, joint: Joint, t_ns: int, max_gap_ns: int) -> float | None:
        """Position of a joint as recorded, else by the one that it follows; None without either."""
        if joint.name in self.times or joint.follows == joint.name:
            return self.at(joint.name, t_ns, max_gap_ns)
        q = self.at(joint.follows, t_ns, max_gap_ns)
        return None if q is None else joint.multiplier * q + joint.offset


@dataclass(frozen=True)
class RobotStates:
    """Poses of camera, palm and hand links over one recording; None where one is not known.

    hand_links: links of the hand that have a shape. joints: of the whole robot, samples: as
    recorded. notes: what was assumed. conflict: robots that use the same names and are not told
    apart, "" without. hands: palms of several hands of which nothing tells the one that grasps.
    changed: static transforms and descriptions that are given twice, differently, each with what
    mends it. hand_given: what a user says of the hand.
    """

    tree: TransformTree
    camera_frame: str
    base_frame: str | None
    palm_frame: str | None
    description: Description | None
    hand_links: tuple[str, ...]
    joints: JointTrack
    notes: tuple[str, ...]
    conflict: str = ""
    hands: tuple[str, ...] = ()
    changed: tuple[tuple[str, str], ...] = ()
    samples: tuple[JointSample, ...] = ()
    hand_given: HandConfig = field(default_factory=HandConfig)

    @cached_property
    def hand_found(self) -> Hand | str:
        """The hand: one that dgeval knows, else what the description says of it; or in words why
        there is none.
        """
        if self.description is None:
            return "no robot description: the hand's geometry is not known"
        return known_hand(self.description)[0] or self.hand_by_description

    @cached_property
    def hand_by_description(self) -> Hand | str:
        """The hand as its description alone has it; or in words why there is none."""
        description, frame, track = self.description, self.palm_frame, self.joints
        if description is None or frame is None:
            return "no frame of a palm is found (frames.palm), so the hand is not known"
        given = self.hand_given
        palm = given.root or frame
        if palm not in description.joints and palm not in description.shapes:
            if given.root is not None:
                return f"hand.root = {palm!r} is not in the description"
            branches = description.branches()
            if len(branches) != 1:
                return f"the palm's frame {palm!r} is not in the description (frames.palm)"
            palm = branches[0]
        links = hand_links(description, palm, track.times)
        if isinstance(links, str):
            return links
        joints = links.joints(description)
        others = sorted(set(given.closed) - {joint.name for joint in joints})
        if others:
            named = ", ".join(joint.name for joint in joints)
            return f"hand.closed names {others[0]!r}; the hand's joints are {named}"
        first_ns = max((track.first_ns(joint) for joint in joints), default=0)
        start = [track.position(joint, first_ns, self.tree.max_gap_ns) for joint in joints]
        T = self.tree.lookup(links.base, frame, first_ns)
        if T is None or any(q is None for q in start):
            return f"where the palm's frame {frame!r} is on {links.base!r} is not recorded"
        at = np.array(start, dtype=np.float64)
        close_s = CLOSE_S if given.close_s is None else given.close_s
        centre = None if given.centre is None else np.array(given.centre)
        approach = None if given.approach is None else np.array(given.approach)
        return described_hand(description, links, T, at, given.closed, close_s, centre, approach)

    @property
    def hand(self) -> Hand | None:
        """The hand; None where there is none."""
        return None if isinstance(self.hand_found, str) else self.hand_found

    def T_base_camera(self, t_ns: int) -> Array | None:
        if self.base_frame is None:
            return None
        return self.tree.lookup(self.base_frame, self.camera_frame, t_ns)

    def T_base_palm(self, t_ns: int) -> Array | None:
        if self.base_frame is None or self.palm_frame is None:
            return None
        return self.tree.lookup(self.base_frame, self.palm_frame, t_ns)

    def palm_stamps(self, least_s: float) -> list[int]:
        """Times, ns, of the recorded states that move the palm in the base frame, in order.

        Those of the joint or frame between them that moves and is recorded most often, about
        least_s apart or more: a state may be early by a fifth of it.
        """
        if self.palm_frame is None or self.base_frame is None:
            return []
        chain = self.tree.ancestors(self.palm_frame)
        below = itertools.takewhile(lambda frame: frame != self.base_frame, chain)
        out: list[int] = []
        for t_ns in max(_stamps_of_moving(self, below), key=len, default=[]):
            if not out or t_ns - out[-1] >= EARLY * least_s * 1e9:
                out.append(t_ns)
        return out

    def hand_shapes(self, t_ns: int) -> list[tuple[LinkShape, Array]] | None:
        """The hand's solids with T_camera_shape; None where a link's pose is not known then."""
        if self.description is None or not self.hand_links:
            return None
        out: list[tuple[LinkShape, Array]] = []
        for link in self.hand_links:
            T = self.tree.lookup(self.camera_frame, link, t_ns)
            if T is None:
                return None
            out.extend(
                (shape, T @ shape.T_link_shape) for shape in self.description.shapes.get(link, [])
            )
        return out


def _changes(track: Track) -> bool:
    """Whether a recorded pose is not the same throughout."""
    return float(np.ptp(track.poses, axis=0).max()) > MOVES


def _stamps_of_moving(robot: RobotStates, frames: Iterable[str]) -> list[list[int]]:
    """Times, ns, of the recorded states of each of some frames that moves against its parent."""
    tree, joints = robot.tree, robot.description.joints if robot.description else {}
    listed: list[list[int]] = []
    for frame in frames:
        if frame in tree.moving:
            if _changes(tree.moving[frame][1]):  # a mount may be on /tf too
                listed.append(tree.moving[frame][1].times)
        elif frame in tree.computed and frame in joints:
            listed.append(robot.joints.times.get(joints[frame].follows, []))
    return listed


def states_period_s(robot: RobotStates) -> float:
    """s between the states of what moves the camera, of the slowest; 0 where nothing does."""
    listed = _stamps_of_moving(robot, robot.tree.ancestors(robot.camera_frame))
    return max((float(np.median(np.diff(t))) * 1e-9 for t in listed if len(t) > 1), default=0.0)


def robot_states(scan: Scan, roles: Roles, config: Config) -> RobotStates:
    """Put tf, pose topics and joint states into one tree; find camera, base and palm in it.

    UsageError where the configuration names a frame that is not there.
    """
    max_gap_ns = round(config.sync.max_pose_gap_s * 1e9)
    tree = TransformTree(max_gap_ns)
    notes: list[str] = []
    offset = config.clock.camera_pose.offset_ns
    head = scan.images.get(roles.colour) if roles.colour else None
    model = scan.cameras.get(roles.intrinsics) if roles.intrinsics else None
    named = (head.frame_id if head else "") or (model.frame_id if model else "")
    camera = config.frames.camera or named or NAMELESS
    counts, mixed = of_camera(
        scan.tf,
        lambda a, b: _contradict(scan.tf[a], scan.tf[b]),
        roles.colour,
        config.frames.namespace,
        lambda ns: camera in scan.tf[ns].is_static,
    )
    for namespace in counts:
        _add_transforms(tree, scan.tf[namespace], offset, notes)
    notes.extend(
        f"the transforms in {namespace or '/'} are another robot's and are not used"
        for namespace in sorted(scan.tf.keys() - set(counts) - set(mixed))
    )
    changed = [(what, ONE_OF_THEM) for ns in counts for what in _given_twice(scan.tf[ns])]
    used, joints_mixed = joint_topics(scan, roles, config.frames.namespace)
    samples = merged_joints(scan, used)
    joints = JointTrack.of(samples, config.clock.hand_joints.offset_ns)
    notes.extend(joint_notes(scan, used))
    for topic in used:
        header, _ = scan.times[topic].arrays()
        if len(header) and not header.any():
            notes.append(f"the states of {topic} bear no stamps: the recorder's times are used")
    left = [topic for topic in roles.joints if topic not in used]
    if left and not joints_mixed:
        notes.append(f"{', '.join(left)} are another robot's joint states and are not used")
    description = _description(scan, roles, joints, config, notes)
    _keep_what_is_said_once(tree, description, notes)
    if description is not None:
        description, prefixed = as_published(description, tree.frames() | {camera})
        if prefixed:
            notes.append(prefixed)
        samples, renamed = as_described(samples, description)
        if renamed:
            joints = JointTrack.of(samples, config.clock.hand_joints.offset_ns)
            notes.append(renamed)
        notes.extend(description.notes)
        known_one, other = known_hand(description)
        if other:
            notes.append(other)
        given = [f"hand.{key}" for key in sorted(config.hand.model_dump(exclude_defaults=True))]
        if known_one is not None and given:
            notes.append(
                f"{', '.join(given)}: for hands that dgeval knows by their description alone; this "
                f"one is {known_one.name}, whose own count"
            )
        described = TransformTree(max_gap_ns)
        _add_joints(described, description, joints, max_gap_ns)
        times = sorted({t for listed in joints.times.values() for t in listed})
        for frame, parent in unplaced_by_tf(tree, described, times).items():
            tree.drop(frame)
            notes.append(
                f"{frame!r} hangs on {parent!r} by /tf and on {described.parent(frame)!r} by the "
                f"description: nothing ties {parent!r} to the robot, so the description counts"
            )
        mounts, elsewhere = contradictions(tree, described, description, times)
        notes.extend(mounts)
        changed += [(what, "publish the frame once") for what in elsewhere]
        _add_joints(tree, description, joints, max_gap_ns)
    _add_odometry(tree, scan, roles, offset)
    if config.calibration.T_flange_camera is not None:
        if config.calibration.flange is None:
            raise UsageError(
                "calibration.T_flange_camera needs calibration.flange, the link it refers to"
            )
        tree.drop_moving(camera)
        tree.add_static(
            config.calibration.flange,
            camera,
            matrix_from_pose(np.array(config.calibration.T_flange_camera)),
        )
    if tree.parent(camera) is None and roles.camera_pose:
        for pose in scan.poses[roles.camera_pose]:
            tree.add_moving(pose.t_ns + offset, pose.parent or "base", camera, pose.pose)
    if offset and not (roles.camera_pose or any(scan.tf[ns].moving for ns in counts)):
        notes.append(
            "clock.camera_pose.offset_ns moves nothing here: the camera's pose comes from the "
            "joints (clock.hand_joints.offset_ns)"
        )
    palm, hands = palm_of(scan, roles, config, tree, camera, description, notes)
    base = config.frames.base
    if base is None and tree.parent(camera) is not None:
        base = _base_above(tree, camera)
        if base is None:
            top = tree.root(camera)
            robot = "no robot" if not (tree.moving or tree.computed) else "none to the robot"
            notes.append(
                f"only static frames from {top!r} to the camera are recorded, and {robot}: no "
                "camera pose; record the transform between them (the hand-eye calibration, "
                "calibration.flange and calibration.T_flange_camera), or set frames.base if that "
                "frame stands still"
                + (
                    f"; {roles.hand_pose} is recorded: if it is the pose of {top!r}, publish it on "
                    "/tf"
                    if roles.hand_pose
                    else ""
                )
            )
    if base is not None and tree.root(base) != tree.root(camera):
        raise UsageError(
            f"frames.base = {base!r} is not connected to the camera frame {camera!r} in tf"
        )
    if base is None and roles.colour is not None:
        known = tree.frames()
        if known and camera not in known and camera != NAMELESS:
            notes.append(
                f"the images' frame {camera!r} is in neither /tf nor a description (frames.camera)"
            )
        notes.append("no camera pose recorded: the base frame is the camera frame")
    if base is None:
        palm = palm if config.frames.palm is not None else None
    words = re.split(r"[^a-z]+", "" if config.frames.base else (base or "").lower())
    if any(word in TAGS for word in words):
        notes.append(
            f"the base frame is {base!r}, the top of the tree: if that is on a thing that moves, "
            "speeds are against it; another: frames.base"
        )
    for child, parents in tree.reparented().items():
        notes.append(
            f"the frame {child!r} is given in {', '.join(map(repr, parents))}; each transform "
            "counts with its own, as tf2 reads them"
        )
    above = tree.ancestors(base) if base is not None else []
    if any(frame in tree.moving and _changes(tree.moving[frame][1]) for frame in above):
        notes.append(
            f"the base frame {base!r} moves in {above[-1]!r}: speeds are against {base!r}; for the "
            f"other: frames.base={above[-1]}"
        )
    if base is not None and palm is None and not hands:
        notes.append("no frame of a palm is found: the hand's pose is not known; set frames.palm")
    links: list[str] = []
    if description is not None and palm is not None and palm in description.shapes:
        links = description.below(_hand_root(description, palm))
        links = [link for link in links if description.shapes.get(link)]
    conflict = ""
    if mixed or joints_mixed:
        names = ", ".join(ns or "/" for ns in dict.fromkeys([*mixed, *joints_mixed]))
        conflict = f"{names} use the same names, and {roles.colour} is in none of them"
    return RobotStates(
        tree,
        camera,
        base,
        palm,
        description,
        tuple(links),
        joints,
        tuple(notes),
        conflict,
        hands,
        (*changed, *_two_descriptions(scan)),
        tuple(samples),
        config.hand,
    )


def _add_odometry(tree: TransformTree, scan: Scan, roles: Roles, offset_ns: int) -> None:
    """Put the robot's topmost frame where odometry has it, as far as that moves it and no other
    transform does: many bases that drive publish no transform of it.
    """
    for topic in sorted(scan.poses.keys() - {roles.camera_pose, roles.hand_pose}):
        poses = scan.poses[topic]
        child = poses[0].child if poses else ""
        if child not in tree.frames() or tree.parent(child) is not None:
            continue
        if float(np.ptp([pose.pose for pose in poses], axis=0).max()) <= SAME_POSE:
            continue
        for pose in poses:
            tree.add_moving(pose.t_ns + offset_ns, pose.parent or ODOMETRY, child, pose.pose)


def _base_above(tree: TransformTree, camera: str) -> str | None:
    """The robot's base for a camera: by its name above the camera, else beside it in the same tree,
    else the topmost frame; None where nothing moves between the camera and any of them.
    """

    def moves(frame: str) -> bool:
        passed = {*tree.ancestors(camera)} ^ {*tree.ancestors(frame)}
        return any(f in tree.moving or f in tree.computed for f in passed)

    chain = tree.ancestors(camera)
    named = [name for name in BASE_NAMES if name in chain]
    # a tree that hangs on the moving body or on the hand, as tf2 allows it
    beside = [n for n in (*BASE_NAMES, ODOMETRY) if n not in chain and n in tree.frames()]
    beside = [n for n in beside if tree.root(n) == chain[-1] and moves(n)]
    if named:
        return named[0]
    if moves(chain[-1]):
        return beside[0] if beside else chain[-1]
    return beside[0] if beside else None


def _contradict(a: Transforms, b: Transforms) -> bool:
    """Whether two sets of transforms give a frame two poses."""
    shared = sorted(a.is_static.keys() & b.is_static.keys())

    def series(heard: Transforms, child: str) -> Series:
        edges = heard.static if heard.is_static[child] else heard.moving
        # a static transform holds at every time
        rows = {0 if heard.is_static[child] else e.t_ns: e.pose for e in edges if e.child == child}
        return np.array(sorted(rows)), np.array([rows[t] for t in sorted(rows)])

    return any(
        a.is_static[child] != b.is_static[child]
        or differ(series(a, child), series(b, child), SAME_POSE)
        for child in shared
    )


def _two_descriptions(scan: Scan) -> list[tuple[str, str]]:
    mend = "the last counts; if that is wrong: --set calibration.description=FILE.urdf"
    return [(f"{t} has two descriptions", mend) for t in sorted(scan.description_changes)]


def _given_twice(heard: Transforms) -> list[str]:
    """The static transforms that are given again with another place or parent."""
    first: dict[str, tuple[str, Array]] = {}
    out: dict[str, str] = {}
    for edge in heard.static:
        parent, pose = first.setdefault(edge.child, (edge.parent, edge.pose))
        if parent != edge.parent:
            out[edge.child] = (
                f"the static frame {edge.child!r} hangs on {parent!r} and on {edge.parent!r}"
            )
            continue
        apart = float(np.linalg.norm(edge.pose[:3] - pose[:3]))
        turned = min(np.abs(edge.pose[3:] - pose[3:]).max(), np.abs(edge.pose[3:] + pose[3:]).max())
        if apart > SAME_POSE or turned > SAME_POSE:
            out[edge.child] = (
                f"the static frame {edge.child!r} is given twice, {apart * 1000:.0f} mm apart"
            )
    return [out[child] for child in sorted(out)]


def _add_transforms(
    tree: TransformTree, heard: Transforms, offset_ns: int, notes: list[str]
) -> None:
    """As in tf2, the first transform heard of a frame decides whether the frame is static."""
    for edge in heard.static:
        if heard.is_static.get(edge.child, True):
            tree.add_static(edge.parent, edge.child, matrix_from_pose(edge.pose))
    for edge in heard.moving:
        if not heard.is_static.get(edge.child, False):
            tree.add_moving(edge.t_ns + offset_ns, edge.parent, edge.child, edge.pose)
    for child in sorted({e.child for e in heard.moving} & {e.child for e in heard.static}):
        kind = "static" if heard.is_static[child] else "moving"
        notes.append(
            f"the frame {child!r} is on /tf and on /tf_static; it was heard {kind} first, and tf2 "
            "keeps it so"
        )


def _keep_what_is_said_once(
    tree: TransformTree, description: Description | None, notes: list[str]
) -> None:
    """Make what /tf has only once fixed, as Foxglove's player does and tf2 does not: the whole
    recording asks for it. Of a joint that moves the states tell more; a thing may have moved on.
    """
    joints = description.joints if description is not None else {}
    kept = []
    for child, (parent, track) in sorted(tree.moving.items()):
        if len(track.times) > 1 or any(word in child.lower() for word in TAGS):
            continue
        moves = child in joints and joints[child].kind != "fixed"
        if not moves:
            kept.append(child)
            tree.drop_moving(child)
            tree.add_static(parent, child, matrix_from_pose(track.poses[0]))
    if kept:
        notes.append(f"/tf has {', '.join(map(repr, kept))} only once: taken as fixed")


def _description(
    scan: Scan, roles: Roles, joints: JointTrack, config: Config, notes: list[str]
) -> Description | None:
    topic = _description_topic(scan, roles, joints, config, notes)
    text = scan.descriptions.get(topic or "")
    source = f"{topic or ROBOT_DESCRIPTION} of {scan.opened.path}"
    if config.calibration.description is not None:
        source = config.calibration.description
        try:
            text = Path(source).read_text(encoding="utf-8")
        except OSError as error:
            raise UsageError(
                f"the robot description can't be read ({error.strerror})", Place(source)
            ) from error
    if text is None:
        return None
    return load_description(
        text, source, config.calibration.mesh_dirs, config.self_filter.radius_default
    )


def _description_topic(
    scan: Scan, roles: Roles, joints: JointTrack, config: Config, notes: list[str]
) -> str | None:
    """Of several descriptions that of the camera's namespace, else one that has the images' frame,
    else the one with the most joints that are recorded; said in the notes.
    """
    if len(scan.descriptions) <= 1:
        return next(iter(scan.descriptions), None)
    home = home_of(roles.colour, config.frames.namespace)

    head = scan.images.get(roles.colour) if roles.colour else None
    camera = config.frames.camera or (head.frame_id if head is not None else "")

    def rank(topic: str) -> tuple[bool, bool, bool, int, int, str]:
        by_name = topic.endswith(ROBOT_DESCRIPTION[1:])
        namespace = namespace_of(topic)
        has_camera = bool(camera) and f'"{camera}"' in scan.descriptions[topic]
        recorded = sum(f'"{name}"' in scan.descriptions[topic] for name in joints.times)
        is_home = bool(namespace) and holds(namespace, home)
        return not by_name, not is_home, not has_camera, -recorded, -len(namespace), topic

    best = min(scan.descriptions, key=rank)
    others = ", ".join(sorted(scan.descriptions.keys() - {best}))
    notes.append(f"the robot description is {best}; there is {others} too (frames.namespace)")
    return best


def _add_joints(
    tree: TransformTree, description: Description, track: JointTrack, max_gap_ns: int
) -> None:
    for child, joint in description.joints.items():
        if joint.kind == "fixed":
            if child not in tree.static:
                tree.add_static(joint.parent, child, joint.origin)
            continue

        def edge(t_ns: int, joint: Joint = joint) -> Array | None:
            q = track.position(joint, t_ns, max_gap_ns)
            return None if q is None else joint.moved(q)

        tree.add_computed(joint.parent, child, edge)


def _hand_root(description: Description, palm: str) -> str:
    """The link that the fingers are mounted on.

    The palm itself, or the link that carries a palm frame without children of its own.
    """
    link = palm
    while len(description.below(link)) == 1 and link in description.joints:
        link = description.joints[link].parent
    return link
