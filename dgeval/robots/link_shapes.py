"""The solids of a description's links: primitives, hulls of meshes, capsules without either."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.geometry import Array
from dgeval.robots.description import Joint, Kind, LinkShape, crank_beside

if TYPE_CHECKING:
    import yourdfpy

LEAST_M = 1e-6  # m; nearer than that two places are one
# what trimesh's readers raise of files that are not what their names say
UNREADABLE = (
    AssertionError, AttributeError, ImportError, LookupError, OSError, SyntaxError, TypeError,
    ValueError, struct.error,
)  # fmt: skip
MOST_NAMED = 3  # shapes in a note
MOST_FACES = 200_000  # of a mesh that is taken: more take a minute a link, and add nothing; ours
MOST_M = 5.0  # m; a mesh that reaches farther is in mm or cm


class UnusableMeshError(Exception):
    """A mesh that gives no solid: its file's name and why."""


def shapes_of(link: yourdfpy.Link, mesh_dirs: tuple[str, ...]) -> tuple[list[LinkShape], list[str]]:
    """Shapes of a link, and what gives none, each with the reason; the visuals where it has no
    collisions.
    """
    out: list[LinkShape] = []
    unusable: list[str] = []
    rough = bool(link.collisions) and any(v.geometry.mesh is not None for v in link.visuals)
    for element in link.collisions or link.visuals:
        T = _origin(element)
        g = element.geometry
        solid: tuple[Kind, tuple[float, ...]] | None = None
        if g.box is not None:
            solid = "box", tuple(float(s) / 2 for s in g.box.size)
        elif g.sphere is not None:
            solid = "sphere", (float(g.sphere.radius),)
        elif g.cylinder is not None:
            solid = "cylinder", (float(g.cylinder.radius), float(g.cylinder.length) / 2)
        elif g.mesh is not None:
            try:
                out.append(mesh_hull(link.name, T, g.mesh, mesh_dirs))
            except UnusableMeshError as error:
                unusable.append(str(error))
        if solid is not None:
            kind, size = solid
            if min(size) <= 0:
                unusable.append(f"a {kind} of size {min(size):g}")
                continue
            out.append(primitive(link.name, kind, T, size, rough))
    return out, unusable


def _origin(element: yourdfpy.Collision | yourdfpy.Visual) -> Array:
    """T_link_element (4, 4) of a URDF's element."""
    return np.eye(4) if element.origin is None else np.asarray(element.origin, dtype=np.float64)


def outline_of(link: yourdfpy.Link, mesh_dirs: tuple[str, ...]) -> list[LinkShape]:
    """What is seen of a link whose solids are simpler: its visual meshes, where all are there."""
    out: list[LinkShape] = []
    for element in link.visuals:
        T = _origin(element)
        if element.geometry.mesh is None:
            continue
        try:
            out.append(mesh_hull(link.name, T, element.geometry.mesh, mesh_dirs))
        except UnusableMeshError:
            return []
    return out


def primitive(
    link: str, kind: Kind, T_link_shape: Array, size: tuple[float, ...], rough: bool = False
) -> LinkShape:
    """A box, sphere, cylinder or capsule of the sizes that `LinkShape` takes."""
    if kind == "cylinder":
        bound = float(np.hypot(size[0], size[1]))
    else:
        bound = float(np.linalg.norm(size)) if kind == "box" else sum(size)
    return LinkShape(link, kind, T_link_shape, size, bound=bound, rough=rough)


def mesh_hull(link: str, T_link_shape: Array, mesh: Any, mesh_dirs: tuple[str, ...]) -> LinkShape:
    """A mesh's convex hull, which keeps the mesh.

    UnusableMeshError where its file is not there, can't be read, is too large, or spans no volume.
    """
    import trimesh

    path = _mesh_file(mesh.filename, mesh_dirs)
    if path is None:
        raise UnusableMeshError(f"{Path(mesh.filename).name} is not found")
    try:
        loaded: Any = trimesh.load(path, force="mesh")
        vertices = np.asarray(loaded.vertices, dtype=np.float64)
        faces = np.asarray(loaded.faces)
    except UNREADABLE as error:
        raise UnusableMeshError(f"{path.name} can't be read ({error})") from None
    if len(faces) > MOST_FACES:
        raise UnusableMeshError(
            f"{path.name} has {len(faces)} faces: reduce it to {MOST_FACES} at most"
        )
    if mesh.scale is not None:
        vertices = vertices * np.asarray(mesh.scale)
    return hull_of(link, T_link_shape, vertices, faces, path.name)


def hull_of(
    link: str, T_link_shape: Array, vertices: Array, faces: Array | None, name: str
) -> LinkShape:
    """The convex hull of vertices (n, 3) m with faces (k, 3); None: those of the hull.

    UnusableMeshError where they span no volume, with the mesh's name.
    """
    from scipy.spatial import ConvexHull, QhullError

    if not len(vertices):
        raise UnusableMeshError(f"{name} holds no mesh")
    if not np.isfinite(vertices).all():
        raise UnusableMeshError(f"{name} has numbers that are none")
    bound = float(np.linalg.norm(vertices, axis=1).max())
    if bound > MOST_M:
        raise UnusableMeshError(f"{name} reaches {bound:.3g} m: is its unit the metre?")
    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError):
        raise UnusableMeshError(f"{name} spans no volume") from None
    corners = vertices[hull.vertices]
    triangles: Any = hull.simplices if faces is None else faces
    mesh = (vertices, triangles)
    return LinkShape(link, "hull", T_link_shape, (), hull.equations, bound, corners, mesh)


def _mesh_file(filename: str, mesh_dirs: tuple[str, ...]) -> Path | None:
    """The first file of that name, or of the end of its path, in the folders; else by its path."""
    name = filename.removeprefix("file://")
    parts = Path(name.removeprefix("package://")).parts
    for folder in mesh_dirs:
        for i in range(len(parts)):
            if (path := Path(folder).joinpath(*parts[i:])).is_file():
                return path
    return Path(name) if Path(name).is_file() else None


def without_solids(unusable: list[str], substituted: list[str]) -> str:
    """The note on shapes that give no solid, and on the links for which capsules stand in."""
    named = ", ".join(unusable[:MOST_NAMED])
    named += f" and {len(unusable) - MOST_NAMED} more" if len(unusable) > MOST_NAMED else ""
    stand_in = ", ".join(sorted(substituted)) or "none"
    return (
        f"{len(unusable)} shapes give no solid: {named}; capsules from joint origins stand in "
        f"for: {stand_in}; give calibration.mesh_dirs"
    )


def capsules_of(
    link: str, joints: dict[str, Joint], mass_centre: Array | None, radius: float
) -> list[LinkShape]:
    """Capsules from the link's origin to the origin of each joint below it.

    A bar of a linkage is as long as the crank beside it. Another link without a joint below
    reaches to twice its centre of mass, else as far as the link above it; else it is a sphere, as a
    knuckle is, on which another joint turns at the same place. radius in m.
    """
    below = sorted((j for j in joints.values() if j.parent == link), key=lambda j: j.name)
    ends = [j.origin[:3, 3] for j in below if np.linalg.norm(j.origin[:3, 3]) >= LEAST_M]
    is_knuckle = not ends and any(joint.kind != "fixed" for joint in below)
    beside = crank_beside(joints, link)
    if beside is not None:
        ends = [beside]
    elif ends or is_knuckle:
        pass
    elif mass_centre is not None and np.linalg.norm(mass_centre) >= LEAST_M:
        ends = [2 * mass_centre]
    elif link in joints and np.linalg.norm(joints[link].origin[:3, 3]) >= LEAST_M:
        # straight on from the link above, whatever way this one's axes are turned
        origin = joints[link].origin
        ends = [origin[:3, :3].T @ origin[:3, 3]]
    out = []
    for end in ends:
        length = float(np.linalg.norm(end))
        T = np.eye(4)
        T[:3, :3] = Rotation.align_vectors([end / length], [[0.0, 0.0, 1.0]])[0].as_matrix()
        T[:3, 3] = end / 2
        out.append(primitive(link, "capsule", T, (radius, length / 2), rough=True))
    return out or [primitive(link, "sphere", np.eye(4), (radius,), rough=True)]
