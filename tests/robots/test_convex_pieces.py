"""Catches: a bracket whose notch is filled, so that a hand touches what it does not reach."""

from __future__ import annotations

import numpy as np
import trimesh
from dgeval.geometry import Array
from dgeval.robots.convex_pieces import MOST_CORNERS, MOST_PIECES, _pieces, convex_pieces
from scipy.spatial import ConvexHull

L = np.array([[0, 0], [0.06, 0], [0.06, 0.01], [0.01, 0.01], [0.01, 0.06], [0, 0.06]])
HEIGHT = 0.02


def bracket() -> trimesh.Trimesh:
    """Two plates of 60 x 10 mm at a right angle."""
    lower = trimesh.creation.box(bounds=[[0, 0, 0], [0.06, 0.01, HEIGHT]])
    upper = trimesh.creation.box(bounds=[[0, 0.01, 0], [0.01, 0.06, HEIGHT]])
    whole = trimesh.util.concatenate([lower, upper])
    # one closed surface: the face between the plates is in neither
    corners = np.array([[x, y, z] for z in (0, HEIGHT) for x, y in L])
    flat = [[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 5, 4]]
    sides = [[k, (k + 1) % 6, k + 6] for k in range(6)]
    sides += [[(k + 1) % 6, (k + 1) % 6 + 6, k + 6] for k in range(6)]
    faces = flat + [[a + 6, c + 6, b + 6] for a, b, c in flat] + sides
    out = trimesh.Trimesh(corners, faces)
    assert out.is_volume
    assert abs(out.volume - whole.volume) < 1e-12
    return out


def inside(pieces: tuple[Array, ...], point: Array, slack: float) -> bool:
    planes = [ConvexHull(p).equations for p in pieces]
    return any((e[:, :3] @ point + e[:, 3] <= slack).all() for e in planes)


def test_a_brackets_notch_stays_free() -> None:
    mesh = bracket()
    pieces = convex_pieces(mesh.vertices, mesh.faces)
    assert 2 <= len(pieces) <= MOST_PIECES
    assert all(len(p) <= MOST_CORNERS for p in pieces)
    for corner in mesh.vertices:
        assert inside(pieces, corner, 0.002)
    for x in (0.02, 0.03):  # the hull would fill the notch to 35 mm
        assert not inside(pieces, np.array([x, x, HEIGHT / 2]), 0.0)
        assert inside((mesh.vertices,), np.array([x, x, HEIGHT / 2]), 0.0)


def test_pieces_are_the_same_each_time() -> None:
    mesh = bracket()
    first = convex_pieces(mesh.vertices, mesh.faces)
    _pieces.cache_clear()
    again = convex_pieces(mesh.vertices, mesh.faces)
    assert [p.tobytes() for p in first] == [p.tobytes() for p in again]


def test_a_convex_mesh_and_an_open_one_are_one_piece() -> None:
    """Fails where a sheet without a volume is cut into what it does not fill."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.02)
    assert len(convex_pieces(ball.vertices, ball.faces)) == 1
    mesh = bracket()
    assert len(convex_pieces(mesh.vertices, mesh.faces[:-4])) == 1
