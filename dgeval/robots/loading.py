"""A description from URDF text."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from collections import Counter
from typing import Any, Literal

import numpy as np

from dgeval.errors import Place, UsageError, describe
from dgeval.robots.description import Coupling, Description, Joint, resolved
from dgeval.robots.link_shapes import capsules_of, outline_of, shapes_of, without_solids
from dgeval.robots.mjcf_description import is_mjcf, load_mjcf

KNOWN_SOLIDS = ("box", "cylinder", "sphere", "mesh")  # of URDF


# by what stands in a text that is no URDF, what mends it
NO_URDF = {
    "xacro:": "it is a xacro that was not expanded: record what xacro makes of it",
    "<mujocoinclude": "it is a part of an MJCF: give the whole, as mj_saveLastXML writes it",
}


def load_description(
    text: str, source: str, mesh_dirs: tuple[str, ...], radius: float
) -> Description:
    """Parse URDF or MJCF text.

    Links whose meshes and primitives give no solid get capsules from joint to joint of the given
    radius, m. source: where the text comes from, for messages. UsageError if the text is neither or
    holds numbers that are not finite.
    """
    if is_mjcf(text):
        return load_mjcf(text, source, mesh_dirs, radius)
    notes: list[str] = []
    try:
        robot = _parsed(text, notes)
    except Exception as error:
        what = f"the robot description is not a URDF ({describe(error)})"
        hint = next((mend for mark, mend in NO_URDF.items() if mark in text), None)
        raise UsageError(what, Place(source), hint) from error
    joints: dict[str, Joint] = {}
    _check_tree(robot.robot, source)
    coupled = _coupling(robot.robot.joints, notes)
    for joint in robot.robot.joints:
        kind: Literal["revolute", "prismatic", "fixed"] = "fixed"
        if joint.type in ("revolute", "continuous"):
            kind = "revolute"
        elif joint.type == "prismatic":
            kind = "prismatic"
        elif joint.type != "fixed":
            notes.append(f"joint {joint.name} of type {joint.type} is taken as fixed")
        axis = np.asarray(joint.axis if joint.axis is not None else [1, 0, 0], dtype=np.float64)
        axis = axis / (np.linalg.norm(axis) or 1.0)
        joints[joint.child] = Joint(
            joint.name,
            joint.parent,
            joint.child,
            kind,
            np.eye(4) if joint.origin is None else np.asarray(joint.origin, dtype=np.float64),
            axis,
            *coupled[joint.name],
            *_limits(joint),
        )
        if not (np.isfinite(joints[joint.child].origin).all() and np.isfinite(axis).all()):
            raise UsageError(
                f"joint {joint.name} of the robot description has numbers that are none",
                Place(source),
            )
    shapes, outlines = {}, {}
    substituted: list[str] = []
    unusable: list[str] = []
    mass_centres = {
        link.name: np.asarray(link.inertial.origin, dtype=np.float64)[:3, 3]
        for link in robot.robot.links
        if link.inertial is not None and link.inertial.origin is not None
    }
    for link in robot.robot.links:
        link_shapes, lacking = shapes_of(link, mesh_dirs)
        unusable += [f"{what} (link {link.name})" for what in lacking]
        if lacking and not link_shapes:
            link_shapes = capsules_of(link.name, joints, mass_centres.get(link.name), radius)
            substituted.append(link.name)
        if not all(np.isfinite(s.T_link_shape).all() and np.isfinite(s.bound) for s in link_shapes):
            raise UsageError(
                f"link {link.name} of the robot description has numbers that are none",
                Place(source),
            )
        shapes[link.name] = link_shapes
        if any(shape.rough for shape in link_shapes):
            outlines[link.name] = outline_of(link, mesh_dirs)
    if unusable:
        notes.append(without_solids(unusable, substituted))
    return Description(joints, shapes, notes, mass_centres, radius, outlines)


def _parsed(text: str, notes: list[str]) -> Any:
    """The robot by yourdfpy, which refuses all for one kind of solid that it doesn't know."""
    import yourdfpy

    def load(given: bytes) -> Any:
        return yourdfpy.URDF.load(io.BytesIO(given), build_scene_graph=False, load_meshes=False)

    try:
        return load(text.encode())
    except ValueError:
        root = ET.fromstring(text.strip())
        changed = [_with_known_solids(link, notes) for link in root.iter("link")]
        if not any(changed):
            raise
        return load(ET.tostring(root))


def _with_known_solids(link: ET.Element, notes: list[str]) -> bool:
    """Whether a link's solids of unknown kinds were changed: a capsule to the cylinder around it,
    others are left out.
    """
    changed = False
    for part in [p for p in link if p.tag in ("collision", "visual")]:
        for solid in [solid for geometry in part.findall("geometry") for solid in geometry]:
            if solid.tag in KNOWN_SOLIDS:
                continue
            changed = True
            if solid.tag == "capsule":
                solid.tag = "cylinder"
                radius, length = (float(solid.get(k, "nan")) for k in ("radius", "length"))
                solid.set("length", repr(length + 2 * radius))
                _noted("capsules are taken as the cylinders around them", notes)
            else:
                link.remove(part)
                _noted(f"solids of the kind {solid.tag!r} are left out", notes)
                break
    return changed


def _noted(what: str, notes: list[str]) -> None:
    if what not in notes:
        notes.append(what)


def _check_tree(robot: Any, source: str) -> None:
    """UsageError where the joints of a URDF are no tree, with the link that shows it."""
    links = {link.name for link in robot.links}
    above = {joint.child: joint.parent for joint in robot.joints}
    wrong = ""
    for joint in robot.joints:
        for end in (joint.parent, joint.child):
            if end not in links:
                wrong = f"joint {joint.name} names the link {end}, which there is not"
    for kind, names in (("joints", robot.joints), ("links", robot.links)):
        for name, count in Counter(item.name for item in names).items():
            if count > 1:
                wrong = f"{count} {kind} are called {name}"
    for child, count in Counter(joint.child for joint in robot.joints).items():
        if count > 1:
            wrong = f"the link {child} hangs on {count} joints"
    for link in sorted(above):
        passed = {link}
        while link in above and not wrong:
            link = above[link]
            if link in passed:
                wrong = f"the link {link} hangs on itself"
            passed.add(link)
    if wrong:
        raise UsageError(f"the robot description is no tree: {wrong}", Place(source))


def _coupling(joints: list[Any], notes: list[str]) -> Coupling:
    """What each joint follows, chains resolved; a joint that follows none follows itself."""
    names = [j.name for j in joints]
    direct: Coupling = {}
    for joint in joints:
        mimic, name = joint.mimic, joint.name
        if mimic is None:
            continue
        source = _named(mimic.joint, name, names)
        if source not in names:
            notes.append(f"joint {name} follows {source}, which there is not")
        elif source != mimic.joint:
            notes.append(f"joint {name} follows {mimic.joint}, which is taken for {source}")
        factor = 1.0 if mimic.multiplier is None else float(mimic.multiplier)
        direct[name] = source, factor, 0.0 if mimic.offset is None else float(mimic.offset)
    return resolved(names, direct, notes)


def _named(source: str, follower: str, names: list[str]) -> str:
    """The joint that a coupling means: that name, else the one name that ends so on the side of the
    follower; as it is written where neither is there.
    """
    if source in names:
        return source
    ending = [n for n in names if n.endswith(source)]
    if len(ending) > 1:
        ending = [n for n in ending if n[: -len(source)] == follower[: len(n) - len(source)]]
    return ending[0] if len(ending) == 1 else source


def _limits(joint: Any) -> tuple[float, float, float]:
    """Lower and upper limit, rad or m, of a joint that has a range, and its effort, Nm or N;
    infinity, minus and plus, where none is given.
    """
    limit = joint.limit
    effort = float(limit.effort) if limit is not None and limit.effort else np.inf
    if (
        joint.type == "continuous"
        or limit is None
        or limit.lower is None
        or limit.upper is None
        or limit.lower == limit.upper
    ):
        return -np.inf, np.inf, effort
    return float(limit.lower), float(limit.upper), effort
