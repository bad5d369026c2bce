"""Points all over the surface of a link's solid, as a depth camera could see them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dgeval.geometry import Array
from dgeval.robots.description import LinkShape

if TYPE_CHECKING:
    import trimesh

POINT_M2 = 5e-6  # m^2 of the surface, for each of which there is a point
MOST_POINTS = 10_000  # of one solid
ROUND = 24  # corners around what is round


def surface_samples(shape: LinkShape) -> Array:
    """Points (n, 3) m, drawn evenly on a solid's surface, in the shape's frame; always the same."""
    import trimesh

    mesh = _mesh(shape)
    count = int(np.clip(mesh.area / POINT_M2, 1, MOST_POINTS))
    points, _ = trimesh.sample.sample_surface(mesh, count, seed=0)[:2]
    return np.asarray(points, dtype=np.float64)


def _mesh(shape: LinkShape) -> trimesh.Trimesh:
    """The solid's surface as triangles: a hull's own mesh where it keeps one."""
    import trimesh

    made: Any
    if shape.kind == "box":
        made = trimesh.creation.box(extents=2 * np.array(shape.size))
    elif shape.kind == "sphere":
        made = trimesh.creation.icosphere(subdivisions=2, radius=shape.size[0])
    elif shape.kind in ("cylinder", "capsule"):
        radius, half = shape.size
        made = trimesh.creation.cylinder(radius=radius, height=2 * half, sections=ROUND)
        if shape.kind == "capsule":
            made = trimesh.creation.capsule(height=2 * half, radius=radius)
            made.apply_translation([0.0, 0.0, -made.bounds[:, 2].mean()])
    else:
        assert shape.mesh is not None
        made = trimesh.Trimesh(*shape.mesh, process=False)
    return made
