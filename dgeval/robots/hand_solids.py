"""The solids of a described hand: points on them, and as MuJoCo's geoms."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from dgeval.geometry import Array, transform
from dgeval.robots.convex_pieces import MOST_CORNERS, convex_pieces
from dgeval.robots.description import LinkShape

if TYPE_CHECKING:
    import mujoco

AROUND = 12  # points around a cylinder's or capsule's ends


def surface_points(shape: LinkShape, in_link: bool = True) -> Array:
    """Points (n, 3) m on a solid's ends and corners, in the link's frame or in the shape's own."""
    if shape.kind == "hull":
        assert shape.corners is not None
        points = shape.corners
    elif shape.kind == "box":
        points = np.array(list(product((-1.0, 1.0), repeat=3))) * np.array(shape.size)
    elif shape.kind == "sphere":
        points = np.vstack([np.eye(3), -np.eye(3)]) * shape.size[0]
    else:
        radius, half = shape.size
        angles = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
        ring = np.stack([radius * np.cos(angles), radius * np.sin(angles)], axis=1)
        ends = [np.column_stack([ring, np.full(AROUND, z)]) for z in (-half, half)]
        if shape.kind == "capsule":
            ends.append(np.array([[0.0, 0.0, -half - radius], [0.0, 0.0, half + radius]]))
        points = np.vstack(ends)
    return transform(shape.T_link_shape, points) if in_link else points


def _solids(shapes: list[LinkShape]) -> Iterator[tuple[LinkShape, Array | None]]:
    """Each solid, and the corners (n, 3) m of a convex one that is no primitive."""
    for shape in shapes:
        if shape.mesh is None:
            yield shape, None
        else:
            for corners in convex_pieces(*shape.mesh):
                yield shape, corners


def add_solids(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    shapes: list[LinkShape],
    T_body_link: Array,
    name: str,
) -> None:
    """Put a link's solids on a body, named "<name>_<k>"; contacts as those of the known hands."""
    import mujoco

    from dgeval.robots.mjcf import place

    kinds = {
        "box": mujoco.mjtGeom.mjGEOM_BOX,
        "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
        "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
        "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
        "hull": mujoco.mjtGeom.mjGEOM_MESH,
    }
    for k, (shape, corners) in enumerate(_solids(shapes)):
        label = f"{name}_{k}"
        geom = body.add_geom(type=kinds[shape.kind], name=label)
        if corners is not None:
            mesh = spec.add_mesh(name=label)
            mesh.uservert = corners.ravel()
            mesh.maxhullvert = MOST_CORNERS
            geom.meshname = label
        else:
            geom.size = [*shape.size, *[0.0] * (3 - len(shape.size))]
        place(geom, T_body_link @ shape.T_link_shape)
        geom.contype, geom.conaffinity, geom.condim, geom.priority = 2, 1, 4, 1
        geom.friction = [0.9, 0.005, 0.0001]  # sliding, torsional m, rolling m
        geom.solref, geom.solimp = [0.006, 1], [0.9, 0.97, 0.001, 0.5, 2]
        geom.rgba = [0.34, 0.35, 0.38, 1]
