"""A mesh that is not convex as a few convex pieces, for contacts.

A bracket's hull fills its notch, and the hull of a palm with a step in it fills the place of what
is held there.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from dgeval.geometry import Array

CONVEX = 0.95  # share of its hull's volume that a mesh fills, from which on the hull stands for it
MOST_PIECES, MOST_CORNERS = 8, 64  # of a mesh, and of a piece
SLIVER = 1e-3  # share of a mesh's volume, of a piece that is left out: physics takes no flat one
VOXELS = 5000  # in which a mesh is taken apart; four times as many take twice as long


def convex_pieces(vertices: Array, faces: Array) -> tuple[Array, ...]:
    """Corners (k, 3) m of each piece. vertices (n, 3) m, faces (m, 3).

    One piece, the hull, of a mesh that is convex or not closed. V-HACD (Mamou 2016); the same for
    the same mesh, which is taken apart once.
    """
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    triangles = np.ascontiguousarray(faces, dtype=np.int64)
    return _pieces(points.tobytes(), triangles.tobytes())


@lru_cache(maxsize=128)
def _pieces(vertices: bytes, faces: bytes) -> tuple[Array, ...]:
    import trimesh

    points = np.frombuffer(vertices).reshape(-1, 3)
    mesh = trimesh.Trimesh(points, np.frombuffer(faces, np.int64).reshape(-1, 3), process=True)
    hull = mesh.convex_hull
    if not mesh.is_volume or mesh.volume >= CONVEX * hull.volume:
        return (np.asarray(hull.vertices),)
    parts = trimesh.decomposition.convex_decomposition(
        mesh, maxConvexHulls=MOST_PIECES, maxNumVerticesPerCH=MOST_CORNERS, resolution=VOXELS
    )
    corners = [np.asarray(part["vertices"], dtype=np.float64) for part in parts]
    solid = [c for c in corners if _volume(c) > SLIVER * mesh.volume]
    return tuple(solid) or (np.asarray(hull.vertices),)


def _volume(corners: Array) -> float:
    """Of the hull, m^3; 0 where it is flat."""
    try:
        return float(ConvexHull(corners).volume)
    except QhullError:
        return 0.0
