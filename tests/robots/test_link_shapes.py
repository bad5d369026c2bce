"""Catches: a stand-in taken for what is seen of a link; points beside the surface; a mesh that is
too large to be prepared.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from dgeval.robots import link_shapes
from dgeval.robots.description import Description
from dgeval.robots.link_shapes import primitive
from dgeval.robots.link_surface import surface_samples
from dgeval.robots.loading import load_description

BOX = '<geometry><box size="0.04 0.06 0.1"/></geometry>'
MESH = '<geometry><mesh filename="package://mine/cone.stl" scale="2 2 2"/></geometry>'


def loaded(tmp_path: Path, collision: str, visual: str) -> Description:
    """A robot of one link with these elements; cone.stl is 0.02 m high before its scale."""
    trimesh.creation.cone(radius=0.01, height=0.02).export(tmp_path / "cone.stl")
    elements = f"<collision>{collision}</collision>" if collision else ""
    elements += f'<visual><origin xyz="0 0 0.1"/>{visual}</visual>' if visual else ""
    text = f'<robot name="r"><link name="tool">{elements}</link></robot>'
    return load_description(text, "a test", (str(tmp_path),), 0.01)


def test_a_box_in_place_of_a_mesh_is_rough_and_the_mesh_is_what_is_seen(tmp_path: Path) -> None:
    description = loaded(tmp_path, BOX, MESH)
    assert [(s.kind, s.rough) for s in description.shapes["tool"]] == [("box", True)]
    [outline] = description.outlines["tool"]
    assert outline.corners is not None
    assert np.ptp(outline.corners, axis=0)[2] == pytest.approx(0.04)
    assert outline.T_link_shape[2, 3] == pytest.approx(0.1)


def test_a_link_that_looks_as_it_collides_is_exact(tmp_path: Path) -> None:
    for collision, visual in ((BOX, BOX), (BOX, ""), (MESH, MESH), ("", MESH), ("", BOX)):
        description = loaded(tmp_path, collision, visual)
        assert [s.rough for s in description.shapes["tool"]] == [False]
        assert description.outlines == {}


def test_capsules_and_boxes_whose_mesh_is_not_there_are_rough(tmp_path: Path) -> None:
    gone = MESH.replace("cone", "gone")
    for collision, visual in ((gone, ""), ("", gone), (BOX, gone)):
        description = loaded(tmp_path, collision, visual)
        assert {s.rough for s in description.shapes["tool"]} == {True}
        assert not description.outlines.get("tool")


def test_a_mesh_with_too_many_faces_is_named_and_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_shapes, "MOST_FACES", 20)
    [note] = loaded(tmp_path, "", MESH).notes
    assert "cone.stl has" in note
    assert "reduce it to 20 at most (link tool)" in note


def test_points_lie_all_over_the_surface() -> None:
    box = primitive("tool", "box", np.eye(4), (0.02, 0.03, 0.05))
    points = surface_samples(box)
    sides = np.abs(points) / box.size
    np.testing.assert_allclose(sides.max(axis=1), 1.0)
    area = np.array([0.03 * 0.05, 0.02 * 0.05, 0.02 * 0.03])
    shares = np.bincount(sides.argmax(axis=1)) / len(points)
    assert shares == pytest.approx(area / area.sum(), abs=0.03)
    np.testing.assert_array_equal(points, surface_samples(box))
    capsule = primitive("tool", "capsule", np.eye(4), (0.01, 0.04))
    middle = surface_samples(capsule)
    middle[:, 2] -= np.clip(middle[:, 2], -0.04, 0.04)
    assert np.linalg.norm(middle, axis=1) == pytest.approx(0.01, abs=2e-4)


def test_a_solid_that_urdf_does_not_have_costs_no_description(tmp_path: Path) -> None:
    """Fails where a simulator's capsule, or a kind that nobody knows, refuses the whole robot."""
    capsule = '<geometry><capsule radius="0.01" length="0.08"/></geometry>'
    found = loaded(tmp_path, capsule, "")
    (shape,) = found.shapes["tool"]
    assert shape.kind == "cylinder"
    assert shape.size == pytest.approx((0.01, 0.05))  # radius, half of the length
    assert any("capsules" in note for note in found.notes)
    torus = '<geometry><torus radius="1"/></geometry>'
    text = f'<robot name="r"><link name="tool"><collision>{torus}</collision>'
    text += f"<collision>{BOX}</collision></link></robot>"
    found = load_description(text, "a test", (), 0.01)
    assert [s.kind for s in found.shapes["tool"]] == ["box"]
    assert any("'torus'" in note for note in found.notes)
