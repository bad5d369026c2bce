"""Colour, depth and intrinsics that belong to one camera.

They are chosen together: depth in the colour camera's frame and size needs nothing; depth of its
own camera is brought into colour with both intrinsics and the transform between them
(`alignment`). Names only decide between candidates that fit equally well.
"""

from __future__ import annotations

from itertools import product
from os.path import commonpath
from pathlib import PurePosixPath
from xml.etree import ElementTree

import numpy as np

from dgeval.config import RolesConfig
from dgeval.geometry import Array
from dgeval.recording.images import DEPTH_ENCODINGS
from dgeval.recording.scan import ImageHead, Scan

DISPARITY = "disparity"  # in the names of topics whose numbers are px, and larger the nearer
# in the names of topics whose 16-bit numbers say how good depth is, or how bright
OF_DEPTH = ("confidence", "amplitude", "variance")
COLOUR_ENCODINGS = frozenset({"rgb8", "bgr8", "rgba8", "bgra8", "8UC3", "8UC4", "mono8", "8UC1"})
GREY = frozenset({"mono8", "8UC1"})
STILL = 1e-4  # m and parts of a quaternion, by which a transform that moves changes at least; ours
MOVED = 0.01  # rad, m and parts of a quaternion, by which what goes somewhere moves at least; ours
STEREO = ("infra", "left", "right")
ALIGNED = ("aligned", "registered", "to_color", "to_colour", "to_rgb")
ALIGNED_TO_COLOUR = ("registered", "to_color", "to_colour", "to_rgb")


def _has(name: str, *parts: str) -> bool:
    return any(part in name.lower() for part in parts)


def colour_topics(scan: Scan, heads: dict[str, ImageHead]) -> list[str]:
    """Topics that may be colour, the likeliest by name first."""
    return sorted(
        (
            n
            for n, h in heads.items()
            if h.encoding in COLOUR_ENCODINGS and "depth" not in n.lower()
        ),
        key=lambda n: (
            not _has(n, "color", "colour", "rgb"),
            _has(n, *STEREO),
            -len(scan.times[n].log_ns),
            n,
        ),
    )


def depth_topics(scan: Scan, heads: dict[str, ImageHead]) -> list[str]:
    """Topics that may be depth, the likeliest by name first.

    16-bit grey is also how infrared pictures are stored: it is depth only under that name.
    """
    return sorted(
        (
            n
            for n, h in heads.items()
            if h.encoding in DEPTH_ENCODINGS
            and (h.encoding != "mono16" or _has(n, "depth"))
            and not _has(n, DISPARITY, *OF_DEPTH)
        ),
        key=lambda n: (
            not _has(n, *ALIGNED),
            not _has(n, "depth"),
            -len(scan.times[n].log_ns),
            n,
        ),
    )


def is_aligned(colour: ImageHead, depth: ImageHead) -> bool:
    """Whether depth has the colour camera's pixels: its frame, as far as both say one, and size."""
    one_frame = not colour.frame_id or not depth.frame_id or colour.frame_id == depth.frame_id
    return one_frame and (colour.width, colour.height) == (depth.width, depth.height)


def is_aligned_by_name(scan: Scan, colour: ImageHead, depth: ImageHead, topic: str) -> bool:
    """Whether a depth topic's name says that it is aligned, and its frame, which nothing places,
    says nothing: some drivers give aligned depth a frame of its own that they never publish.
    """
    same_size = (colour.width, colour.height) == (depth.width, depth.height)
    if not same_size or not _has(topic, *ALIGNED_TO_COLOUR):
        return False
    placed = _parents(scan, None)
    return depth.frame_id not in placed.keys() | {parent for parent, _ in placed.values()}


def choose_camera(
    scan: Scan, heads: dict[str, ImageHead], config: RolesConfig
) -> tuple[str | None, str | None, dict[str, list[str]]]:
    """Topics of colour and depth, and by role the others that could have it."""
    colours = [config.colour] if config.colour else colour_topics(scan, heads)
    depths = [config.depth] if config.depth else depth_topics(scan, heads)

    def rank(pair: tuple[str, str]) -> tuple[bool, tuple[int, ...], bool, bool, int, int]:
        c, d = heads.get(pair[0]), heads.get(pair[1])
        aligned = c is not None and d is not None and is_aligned(c, d)
        alignable = (
            intrinsics_of(scan, heads, pair[0]) is not None
            and intrinsics_of(scan, heads, pair[1]) is not None
        )
        stereo = c is not None and (c.encoding in GREY or _has(pair[0], *STEREO))
        return (
            not (aligned or alignable),
            carried[c.frame_id] if c is not None else (),
            stereo,
            not aligned,
            colours.index(pair[0]),
            depths.index(pair[1]),
        )

    trees = (_parents(scan, _ways(scan)), _parents(scan, None))
    carried = {f: tuple(-moving_edges(tree, f) for tree in trees) for f in sorted(_frames(heads))}
    pairs = list(product(colours, depths))
    colour, depth = min(pairs, key=rank) if pairs else (None, None)
    colour = colour or (colours[0] if colours else None)
    depth = depth or (depths[0] if depths else None)
    passed: dict[str, list[str]] = {}
    for role, chosen, listed in (("colour", colour, colours), ("depth", depth, depths)):
        others = [n for n in listed if n != chosen]
        if others:
            passed[role] = others
    return colour, depth, passed


def _ways(scan: Scan) -> dict[str, float]:
    """How far each recorded joint moves, rad or m: an arm or a head that stands still carries the
    camera of no grasp.
    """
    least: dict[str, float] = {}
    most: dict[str, float] = {}
    for samples in scan.joints.values():
        for sample in samples:
            for name, value in sample.positions.items():
                least[name] = min(least.get(name, value), value)
                most[name] = max(most.get(name, value), value)
    return {name: most[name] - least[name] for name in least}


def _parents(scan: Scan, ways: dict[str, float] | None) -> dict[str, tuple[str, bool]]:
    """By frame, its parent and whether it moves against it: by joints and by transforms.

    ways: how far each joint moves, where that counts and not that it can.
    """
    parents: dict[str, tuple[str, bool]] = {}
    for text in scan.descriptions.values():
        for link, (parent, joint) in _joints(text).items():
            far = ways is None or ways.get(joint, 0.0) > MOVED
            parents[link] = (parent, bool(joint) and far)
    for heard in scan.tf.values():
        for edge in heard.static:
            parents[edge.child] = (edge.parent, False)
        first: dict[str, Array] = {}
        for edge in heard.moving:
            pose = first.setdefault(edge.child, edge.pose)
            moves = parents.get(edge.child, ("", False))[1]
            least = STILL if ways is None else MOVED
            moves = moves or bool((np.abs(edge.pose - pose) > least).any())
            parents[edge.child] = (edge.parent, moves)
    return parents


def moving_edges(parents: dict[str, tuple[str, bool]], frame: str) -> int:
    """How many joints and moving transforms are above a frame: the wrist's camera has most."""
    count, seen = 0, {frame}
    while frame in parents:
        frame, moves = parents[frame]
        if frame in seen:
            break
        seen.add(frame)
        count += moves
    return count


def _joints(text: str) -> dict[str, tuple[str, str]]:
    """By link of a robot description, its parent and the joint between them; "" for a fixed one."""
    out = {}
    try:
        for joint in ElementTree.fromstring(text).iter("joint"):
            parent, child = joint.find("parent"), joint.find("child")
            if parent is not None and child is not None:
                name = "" if joint.get("type") == "fixed" else joint.get("name", "?")
                out[child.get("link", "")] = (parent.get("link", ""), name)
    except ElementTree.ParseError:
        pass  # the description is read later, and its error told
    return out


def other_camera(
    scan: Scan, heads: dict[str, ImageHead], passed: dict[str, list[str]], colour: str, depth: str
) -> str | None:
    """The colour topic of another whole camera than the chosen one; else None.

    By its frame, or by intrinsics of its own and a namespace that has both pictures.
    """
    here = {heads[n].frame_id for n in (colour, depth) if n in heads}
    own = intrinsics_of(scan, heads, colour)
    for c in passed.get("colour", []):
        for d in passed.get("depth", []):
            if c not in heads or d not in heads:
                continue
            beside = len(commonpath([c, d])) > 1 and commonpath([c, d]) != commonpath([c, colour])
            another = beside and intrinsics_of(scan, heads, c) not in (None, own)
            if heads[c].frame_id in here and not another:
                continue
            if is_aligned(heads[c], heads[d]) and intrinsics_of(scan, heads, c) is not None:
                return c
    return None


def intrinsics_of(scan: Scan, heads: dict[str, ImageHead], image: str) -> str | None:
    """The CameraInfo topic of an image topic; None where none is of its camera.

    By frame and size where both are known; else the one whose name shares most with the image's.
    """
    head = heads.get(image)
    if head is None:
        return None
    beside = PurePosixPath(image).parent  # the driver's namespace, or that of one of its streams
    fitting = []
    for name, model in scan.cameras.items():
        one_frame = not model.frame_id or not head.frame_id or model.frame_id == head.frame_id
        shared = len(commonpath([name, image]))
        near = shared >= len(str(beside.parent)) > 1 or shared >= len(str(beside)) > 1
        if not one_frame and not (near and model.frame_id not in _frames(heads)):
            continue
        same_size = model.full_size == (head.width, head.height) or (
            model.intrinsics.width,
            model.intrinsics.height,
        ) == (head.width, head.height)
        fitting.append((not one_frame, not same_size, -shared, name))
    return min(fitting)[3] if fitting else None


def _frames(heads: dict[str, ImageHead]) -> set[str]:
    """The frames of all images: an intrinsics message of one of them is of that camera."""
    return {h.frame_id for h in heads.values()}
