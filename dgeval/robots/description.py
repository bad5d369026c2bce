"""A robot from its URDF: joints for the tf tree, and the hand's shapes for the self-filter."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.errors import Place, UsageError, describe
from dgeval.geometry import IDENTITY, Array, rotation_about

if TYPE_CHECKING:
    import yourdfpy


@dataclass(frozen=True, slots=True)
class LinkShape:
    """One solid of a link.

    size, m: box half lengths; capsule and cylinder (radius, half length along z); sphere (radius,).
    hull: planes of a mesh's convex hull, rows n_x n_y n_z d with n·p + d <= 0 inside. bound, m: no
    point of the solid is further from the shape's origin.
    """

    link: str
    kind: Literal["box", "capsule", "cylinder", "sphere", "hull"]
    T_link_shape: Array
    size: tuple[float, ...] = ()
    hull: Array | None = None
    bound: float = 0.0


@dataclass(frozen=True, slots=True)
class Joint:
    """A URDF joint.

    T_parent_child = origin · motion(q · multiplier + offset), with q the position of the joint that
    it follows. Limits in rad or m.
    """

    name: str
    parent: str
    child: str
    kind: Literal["revolute", "prismatic", "fixed"]
    origin: Array
    axis: Array
    follows: str
    multiplier: float
    offset: float
    lower: float = -np.inf
    upper: float = np.inf

    def at(self, q: float) -> Array:
        """T_parent_child (4, 4) at joint position q, rad or m, of the joint it follows."""
        if self.kind == "fixed":
            return self.origin.copy()
        T = IDENTITY.copy()
        value = self.multiplier * q + self.offset
        if self.kind == "revolute":
            T[:3, :3] = rotation_about(self.axis, value)
        else:
            T[:3, 3] = self.axis * value
        return np.asarray(self.origin @ T)


@dataclass(frozen=True)
class Description:
    """Joints by child link, shapes by link, and notes on what the URDF does not give."""

    joints: dict[str, Joint]
    shapes: dict[str, list[LinkShape]]
    notes: list[str] = field(default_factory=list)

    def branches(self) -> list[str]:
        """The deepest links at which two or more chains of movable joints part, in name order.

        They are the bases of hands; a base of two arms has deeper ones below it.
        """
        children: dict[str, list[Joint]] = {}
        for joint in self.joints.values():
            children.setdefault(joint.parent, []).append(joint)

        def moves(joint: Joint) -> bool:
            return joint.kind != "fixed" or any(moves(j) for j in children.get(joint.child, []))

        parting = {link for link, listed in children.items() if sum(map(moves, listed)) >= 2}
        return sorted(link for link in parting if not parting & set(self.below(link)) - {link})

    def below(self, link: str) -> list[str]:
        """The link and all links that hang from it, in name order."""
        out = {link}
        while True:
            more = {j.child for j in self.joints.values() if j.parent in out} - out
            if not more:
                return sorted(out)
            out |= more


def _limits(joint: Any) -> tuple[float, float]:
    """Lower and upper limit, rad or m, of a joint that has a range; else
    infinity, minus and plus.
    """
    limit = joint.limit
    if (
        joint.type == "continuous"
        or limit is None
        or limit.lower is None
        or limit.upper is None
        or limit.lower >= limit.upper
    ):
        return -np.inf, np.inf
    return float(limit.lower), float(limit.upper)


def load_description(
    text: str, source: str, mesh_dirs: tuple[str, ...], radius: float
) -> Description:
    """Parse URDF text.

    Links whose meshes are missing get capsules from joint to joint of the given radius, m. source:
    where the text comes from, for messages. UsageError if the text is not a URDF or holds numbers
    that are not finite.
    """
    import yourdfpy

    try:
        robot = yourdfpy.URDF.load(
            io.BytesIO(text.encode()), build_scene_graph=False, load_meshes=False
        )
    except Exception as error:
        raise UsageError(
            f"the robot description is not a URDF ({describe(error)})", Place(source)
        ) from error
    joints: dict[str, Joint] = {}
    notes: list[str] = []
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
        mimic = joint.mimic
        joints[joint.child] = Joint(
            joint.name,
            joint.parent,
            joint.child,
            kind,
            np.eye(4) if joint.origin is None else np.asarray(joint.origin, dtype=np.float64),
            axis,
            mimic.joint if mimic else joint.name,
            (mimic.multiplier if mimic and mimic.multiplier is not None else 1.0),
            (mimic.offset if mimic and mimic.offset is not None else 0.0),
            *_limits(joint),
        )
        if not (np.isfinite(joints[joint.child].origin).all() and np.isfinite(axis).all()):
            raise UsageError(
                f"joint {joint.name} of the robot description has numbers that are none",
                Place(source),
            )
    shapes = {}
    substituted = []
    for link in robot.robot.links:
        link_shapes, missing = _shapes_of(link, mesh_dirs)
        if missing and not link_shapes:
            link_shapes = _capsules(link.name, joints, radius)
            substituted.append(link.name)
        if not all(np.isfinite(s.T_link_shape).all() and np.isfinite(s.bound) for s in link_shapes):
            raise UsageError(
                f"link {link.name} of the robot description has numbers that are none",
                Place(source),
            )
        shapes[link.name] = link_shapes
    if substituted:
        notes.append(
            "meshes not found, capsules from joint origins stand in: "
            f"{', '.join(sorted(substituted))}"
        )
    return Description(joints, shapes, notes)


def _shapes_of(link: yourdfpy.Link, mesh_dirs: tuple[str, ...]) -> tuple[list[LinkShape], bool]:
    """Shapes of a link, and whether a mesh of it is missing; the visuals where it has no
    collisions.
    """
    out: list[LinkShape] = []
    missing = False
    for element in link.collisions or link.visuals:
        T = np.eye(4) if element.origin is None else np.asarray(element.origin, dtype=np.float64)
        g = element.geometry
        if g.box is not None:
            half = tuple(float(s) / 2 for s in g.box.size)
            out.append(LinkShape(link.name, "box", T, half, bound=float(np.linalg.norm(half))))
        elif g.sphere is not None:
            out.append(
                LinkShape(
                    link.name, "sphere", T, (float(g.sphere.radius),), bound=float(g.sphere.radius)
                )
            )
        elif g.cylinder is not None:
            r, h = float(g.cylinder.radius), float(g.cylinder.length) / 2
            out.append(LinkShape(link.name, "cylinder", T, (r, h), bound=float(np.hypot(r, h))))
        elif g.mesh is not None:
            hull = _mesh_hull(g.mesh, mesh_dirs)
            if hull is None:
                missing = True
            else:
                out.append(LinkShape(link.name, "hull", T, hull=hull[0], bound=hull[1]))
    return out, missing


def _mesh_hull(mesh: Any, mesh_dirs: tuple[str, ...]) -> tuple[Array, float] | None:
    """Planes (n, 4) of a mesh's convex hull and its largest distance from the origin, m.

    None if the mesh's file is not there.
    """
    import trimesh
    from scipy.spatial import ConvexHull

    name = mesh.filename.removeprefix("file://")
    parts = Path(name.removeprefix("package://")).parts
    for folder in (*mesh_dirs, ""):
        for i in range(len(parts)):
            path = Path(folder).joinpath(*parts[i:]) if folder else Path(name)
            if path.is_file():
                loaded: Any = trimesh.load(path, force="mesh")
                vertices = np.asarray(loaded.vertices) * (
                    np.asarray(mesh.scale) if mesh.scale is not None else 1.0
                )
                return ConvexHull(vertices).equations, float(np.linalg.norm(vertices, axis=1).max())
    return None


def _capsules(link: str, joints: dict[str, Joint], radius: float) -> list[LinkShape]:
    """Capsules from the link's origin to the origin of each joint below it.

    A sphere for the last link of a chain. radius in m.
    """
    out = []
    for joint in sorted((j for j in joints.values() if j.parent == link), key=lambda j: j.name):
        end = joint.origin[:3, 3]
        length = float(np.linalg.norm(end))
        if length < 1e-6:
            continue
        T = np.eye(4)
        T[:3, :3] = Rotation.align_vectors([end / length], [[0.0, 0.0, 1.0]])[0].as_matrix()
        T[:3, 3] = end / 2
        out.append(LinkShape(link, "capsule", T, (radius, length / 2), bound=radius + length / 2))
    return out or [LinkShape(link, "sphere", np.eye(4), (radius,), bound=radius)]
