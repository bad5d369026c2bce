"""Catches: a transposed rotation, a quaternion in the wrong order, slerp along the longer arc.

Also a plane moved by the inverse transform.
"""

from __future__ import annotations

import numpy as np
import pytest
from dgeval import geometry as g
from dgeval.perception.plane import Plane
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

numbers = st.floats(-2, 2, allow_nan=False)


@st.composite
def poses(draw: st.DrawFn) -> np.ndarray:
    q = np.array([draw(numbers) for _ in range(4)])
    if np.linalg.norm(q) < 0.1:
        q = np.array([0.0, 0, 0, 1])
    return np.concatenate([[draw(numbers) for _ in range(3)], q / np.linalg.norm(q)])


@given(poses())
def test_pose_and_matrix_are_inverse(pose: np.ndarray) -> None:
    again = g.pose_from_matrix(g.matrix_from_pose(pose))
    assert again[6] >= 0
    same = np.allclose(again, pose, atol=1e-9) or np.allclose(again[3:], -pose[3:], atol=1e-9)
    assert same
    assert np.allclose(again[:3], pose[:3])


def test_quaternion_order_is_xyzw() -> None:
    quarter_about_z = np.array([0, 0, 0, 0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    assert np.allclose(
        g.transform(g.matrix_from_pose(quarter_about_z), np.array([[1.0, 0, 0]])), [[0, 1, 0]]
    )


@given(poses(), poses())
def test_invert_undoes(a: np.ndarray, b: np.ndarray) -> None:
    T = g.matrix_from_pose(a)
    points = np.array([b[:3], b[3:6]])
    assert np.allclose(g.transform(g.invert(T), g.transform(T, points)), points)


@given(poses(), poses(), st.floats(0, 1))
def test_interpolation_agrees_with_scipy_slerp(a: np.ndarray, b: np.ndarray, alpha: float) -> None:
    angle = (Rotation.from_quat(a[3:]).inv() * Rotation.from_quat(b[3:])).magnitude()
    if angle > 3.1:
        return  # both arcs are about equally long
    interpolated = g.interpolate_pose(a, b, alpha)
    expected = Slerp([0, 1], Rotation.from_quat([a[3:], b[3:]]))(alpha)
    assert (Rotation.from_quat(interpolated[3:]).inv() * expected).magnitude() < 1e-6
    assert np.allclose(interpolated[:3], (1 - alpha) * a[:3] + alpha * b[:3])


@given(st.lists(numbers, min_size=3, max_size=3))
def test_rotation_vector_of_increment(r: list[float]) -> None:
    v = np.array(r)
    if np.linalg.norm(v) > 3.0:
        return
    T = g.increment(np.concatenate([np.zeros(3), v]))
    assert np.allclose(T[:3, :3], Rotation.from_rotvec(v).as_matrix(), atol=1e-9)
    assert np.allclose(g.rotation_vector(T[:3, :3]), v, atol=1e-6)
    assert g.rotation_angle(T[:3, :3]) == pytest.approx(np.linalg.norm(v), abs=1e-6)


@given(st.lists(numbers, min_size=6, max_size=6))
def test_cross_agrees_with_numpy(v: list[float]) -> None:
    a, b = np.array([v[:3]]), np.array([v[3:]])
    assert np.allclose(g.cross(a, b), np.cross(a, b))


def test_project_and_backproject_are_inverse() -> None:
    camera = g.Intrinsics(640, 480, 600.0, 590.0, 320.5, 239.0)
    points = np.array([[0.1, -0.2, 0.8], [0.0, 0.0, 1.5]])
    uv = camera.project(points)
    assert np.allclose(camera.backproject(uv[:, 0], uv[:, 1], points[:, 2]), points)
    assert np.allclose(uv[1], [320.5, 239.0])


@given(poses())
def test_plane_moves_with_its_points(pose: np.ndarray) -> None:
    plane = Plane(np.array([0.0, 0.6, 0.8]), 0.5, 1.0)
    points = np.array([[0.3, 0.1, 0.2], [1, 2, 3.0]])
    T = g.matrix_from_pose(pose)
    assert np.allclose(plane.moved(T).height(g.transform(T, points)), plane.height(points))


@given(st.tuples(numbers, numbers, numbers), st.floats(-7, 7), st.sampled_from([1.0, 1e-3, 1e-9]))
def test_a_turn_about_an_axis_is_scipys_to_the_bit(
    axis: tuple[float, float, float], angle: float, scale: float
) -> None:
    """Fails where a joint's pose, and with it every digest, changes in the last bits."""
    length = float(np.linalg.norm(axis))
    unit = np.array(axis) / length if length > 0.1 else np.array([0.0, 0.0, 1.0])
    expected = Rotation.from_rotvec(unit * (angle * scale)).as_matrix()
    np.testing.assert_array_equal(g.rotation_about(unit, angle * scale), expected)


@given(poses(), st.integers(3, 9))
def test_the_best_rigid_motion_is_scipys(pose: np.ndarray, count: int) -> None:
    """Fails where a stack of point sets gets another's motion, or a reflection."""
    rng = np.random.default_rng(count)
    a = rng.normal(size=(2, count, 3))
    T = g.matrix_from_pose(pose)
    b = np.stack([g.transform(T, a[0]), a[1] * [-1.0, 1.0, 1.0]]) + 0.01 * rng.normal(size=a.shape)
    found = g.best_rigid(a, b)
    for k in range(2):
        spread_a, spread_b = a[k] - a[k].mean(axis=0), b[k] - b[k].mean(axis=0)
        expected = Rotation.align_vectors(spread_b, spread_a)[0].as_matrix()
        assert np.linalg.det(found[k, :3, :3]) == pytest.approx(1.0)
        loss = np.sum((spread_a @ found[k, :3, :3].T - spread_b) ** 2)
        assert loss <= np.sum((spread_a @ expected.T - spread_b) ** 2) + 1e-9
        assert np.allclose(g.transform(found[k], a[k].mean(axis=0)[None]), b[k].mean(axis=0))
