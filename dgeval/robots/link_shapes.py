"""The solids of a description's links: primitives, hulls of meshes, capsules without either."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.geometry import Array
from dgeval.robots.description import Joint, LinkShape

if TYPE_CHECKING:
    import yourdfpy

LEAST_M = 1e-6  # m; nearer than that two places are one


def shapes_of(link: yourdfpy.Link, mesh_dirs: tuple[str, ...]) -> tuple[list[LinkShape], bool]:
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
                planes, bound, corners = hull
                out.append(LinkShape(link.name, "hull", T, (), planes, bound, corners))
    return out, missing


def _mesh_hull(mesh: Any, mesh_dirs: tuple[str, ...]) -> tuple[Array, float, Array] | None:
    """Planes (n, 4) of a mesh's convex hull, its largest distance from the origin, m, and corners.

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
                hull = ConvexHull(vertices)
                bound = float(np.linalg.norm(vertices, axis=1).max())
                return hull.equations, bound, vertices[hull.vertices]
    return None


def capsules_of(
    link: str, joints: dict[str, Joint], mass_centre: Array | None, radius: float
) -> list[LinkShape]:
    """Capsules from the link's origin to the origin of each joint below it.

    A link without one reaches to twice its centre of mass, else as far as the link above it; else
    it is a sphere. radius in m.
    """
    below = sorted((j for j in joints.values() if j.parent == link), key=lambda j: j.name)
    ends = [j.origin[:3, 3] for j in below if np.linalg.norm(j.origin[:3, 3]) >= LEAST_M]
    if not ends and mass_centre is not None and np.linalg.norm(mass_centre) >= LEAST_M:
        ends = [2 * mass_centre]
    elif not ends and link in joints and np.linalg.norm(joints[link].origin[:3, 3]) >= LEAST_M:
        # straight on from the link above, whatever way this one's axes are turned
        origin = joints[link].origin
        ends = [origin[:3, :3].T @ origin[:3, 3]]
    out = []
    for end in ends:
        length = float(np.linalg.norm(end))
        T = np.eye(4)
        T[:3, :3] = Rotation.align_vectors([end / length], [[0.0, 0.0, 1.0]])[0].as_matrix()
        T[:3, 3] = end / 2
        out.append(LinkShape(link, "capsule", T, (radius, length / 2), bound=radius + length / 2))
    return out or [LinkShape(link, "sphere", np.eye(4), (radius,), bound=radius)]
