"""Catches: tf composed in the wrong order, poses extrapolated, gaps bridged, joints misread."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from dgeval.errors import UsageError
from dgeval.geometry import matrix_from_pose
from dgeval.recording.containers.opening import open_container
from dgeval.recording.messages import JointSample, event_of
from dgeval.recording.robot import JointTrack
from dgeval.recording.scan import scan
from dgeval.recording.transforms import Track, TransformTree
from dgeval.robots.loading import load_description
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "datasets"))
from make_demo import CAMERA_FRAME, T_HAND_CAMERA, hand_pose, joints, urdf


def pose(x: float, yaw: float = 0.0) -> np.ndarray:
    return np.concatenate([[x, 0, 0], Rotation.from_rotvec([0, 0, yaw]).as_quat()])


def test_lookup_composes_from_root_to_leaf() -> None:
    """Fails where transforms are multiplied in the wrong order."""
    tree = TransformTree()
    tree.add_static("base", "arm", matrix_from_pose(pose(1.0, np.pi / 2)))
    tree.add_moving(0, "arm", "camera", pose(2.0))
    T = tree.lookup("base", "camera", 0)
    assert T is not None
    assert np.allclose(T[:3, 3], [1, 2, 0])
    back = tree.lookup("camera", "base", 0)
    assert back is not None
    assert np.allclose(back @ T, np.eye(4))


def test_siblings_meet_at_their_common_frame() -> None:
    """Fails where a lookup only goes up to the root, or connects separate trees."""
    tree = TransformTree()
    tree.add_static("base", "left", matrix_from_pose(pose(1.0)))
    tree.add_static("base", "right", matrix_from_pose(pose(-2.0)))
    T = tree.lookup("left", "right", 0)
    assert T is not None
    assert np.allclose(T[:3, 3], [-3, 0, 0])
    assert tree.lookup("left", "elsewhere", 0) is None


def test_nothing_is_extrapolated_and_long_gaps_stay_open() -> None:
    """Fails where a pose is made up outside the samples or across a long gap."""
    track = Track()
    for t, x in ((0, 0.0), (100_000, 1.0), (900_000_000, 5.0)):
        track.add(t, pose(x))
    middle = track.sample(50_000, 500_000_000)
    assert middle is not None
    assert middle[0] == pytest.approx(0.5)
    assert track.sample(-2_000, 10**9) is None
    assert track.sample(900_002_000, 10**9) is None
    assert track.sample(400_000_000, 500_000_000) is None
    assert track.sample(900_000_000, 1) is not None


def test_a_cycle_in_tf_ends() -> None:
    """Fails where frames that are each other's parents never end a lookup."""
    tree = TransformTree()
    tree.add_static("a", "b", np.eye(4))
    tree.add_static("b", "a", np.eye(4))
    assert tree.root("a") in ("a", "b")
    assert tree.lookup("c", "a", 0) is None


def test_each_transform_has_its_own_parent() -> None:
    """Fails where a frame's first parent is taken for its later poses."""
    tree = TransformTree()
    tree.add_static("world", "base", matrix_from_pose(pose(10.0)))
    tree.add_static("world", "other", matrix_from_pose(pose(-5.0)))
    for t_ns, parent, x in ((0, "base", 1.0), (10_000, "base", 2.0), (20_000, "other", 9.0)):
        tree.add_moving(t_ns, parent, "camera", pose(x))
    tree.add_moving(30_000, "other", "camera", pose(8.0))
    places = [tree.lookup("world", "camera", t) for t in (0, 10_000, 20_000, 25_000, 30_000)]
    assert [round(float(T[0, 3]), 6) for T in places if T is not None] == [11, 12, 4, 3.5, 3]
    assert tree.reparented() == {"camera": ["base", "other"]}
    between = tree.lookup("world", "camera", 15_000)  # as tf2: the earlier one
    assert between is not None
    assert between[0, 3] == 12


@given(st.permutations(list(range(8))))
def test_order_of_arrival_does_not_matter(order: list[int]) -> None:
    """Fails where late messages are lost or put in the wrong place."""
    track = Track()
    for i in order:
        track.add(i * 10, pose(float(i)))
    assert track.times == [i * 10 for i in range(8)]
    assert [p[0] for p in track.poses] == [float(i) for i in range(8)]


def test_same_tf_from_bag_and_db3(real_data: Path) -> None:
    """Fails where the same log in two containers gives different transforms."""
    scans = [scan(open_container(real_data / name)) for name in ("tf_example.bag", "tf_example")]
    a, b = (
        sorted((e.t_ns, e.parent, e.child, tuple(e.pose)) for e in s.tf[""].moving) for s in scans
    )
    assert len(a) > 500
    assert a == b


def test_description_forward_kinematics_against_pinocchio() -> None:
    """Fails where a link differs from an independent library at any of nine postures."""
    pin = pytest.importorskip("pinocchio")
    description = load_description(urdf(), "demo", (), 0.01)
    model = pin.buildModelFromXML(urdf())
    data = model.createData()
    for t in np.linspace(0, 4.5, 9):
        q = joints(float(t))
        vector = np.zeros(model.nq)
        for name, value in q.items():
            vector[model.joints[model.getJointId(name)].idx_q] = value
        pin.framesForwardKinematics(model, data, vector)
        for child, joint in description.joints.items():
            T, node = np.eye(4), child
            while node in description.joints:
                joint = description.joints[node]
                T = joint.at(q.get(joint.follows, 0.0)) @ T
                node = joint.parent
            want = data.oMf[model.getFrameId(child)].homogeneous
            assert np.allclose(T, want, atol=1e-9), child
    assert np.allclose(
        hand_pose(joints(1.0)) @ T_HAND_CAMERA, _camera(description, joints(1.0)), atol=1e-9
    )


def _camera(description: object, q: dict[str, float]) -> np.ndarray:
    T, node = np.eye(4), CAMERA_FRAME
    while node in description.joints:  # type: ignore[attr-defined]
        joint = description.joints[node]  # type: ignore[attr-defined]
        T = joint.at(q.get(joint.follows, 0.0)) @ T
        node = joint.parent
    return T


def test_mimic_joints_follow() -> None:
    """Fails where multiplier or offset of a mimic joint is not applied."""
    text = """<robot name="m"><link name="a"/><link name="b"/><link name="c"/>
      <joint name="j1" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
      <joint name="j2" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/>
        <mimic joint="j1" multiplier="2" offset="0.1"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    joint = load_description(text, "m", (), 0.01).joints["c"]
    assert joint.follows == "j1"
    assert np.allclose(joint.at(0.2)[:3, :3], Rotation.from_rotvec([0, 0, 0.5]).as_matrix())


def test_missing_meshes_become_capsules_with_a_note() -> None:
    """Fails where a link without its mesh has no shape, or nobody learns of it."""
    text = """<robot name="m"><link name="a">
      <visual><geometry><mesh filename="package://x/a.stl"/></geometry></visual></link>
      <link name="b"/>
      <joint name="j" type="fixed"><parent link="a"/><child link="b"/>
        <origin xyz="0 0.3 0.4"/></joint></robot>"""
    description = load_description(text, "m", (), 0.02)
    capsule = description.shapes["a"][0]
    assert (capsule.kind, capsule.size) == ("capsule", (0.02, pytest.approx(0.25)))
    tip = capsule.T_link_shape @ np.array([0, 0, 0.25, 1])
    assert np.allclose(tip[:3], [0, 0.3, 0.4])
    assert "capsules" in description.notes[0]


def test_a_description_that_is_none_is_a_usage_error() -> None:
    """Fails where a wrong file ends in an internal error."""
    with pytest.raises(UsageError, match="not a URDF"):
        load_description("<html>", "somewhere", (), 0.01)


def test_joint_track_survives_reordered_names_and_missing_values() -> None:
    """Fails where joints are read by place instead of by name."""
    samples = [
        JointSample(0, {"a": 0.0, "b": 1.0}),
        JointSample(10, {"b": 2.0, "a": 1.0}),
        JointSample(20, {"a": 2.0}),
    ]
    track = JointTrack.of(samples, 0)
    assert track.at("a", 15, 100) == pytest.approx(1.5)
    assert track.at("b", 5, 100) == pytest.approx(1.5)
    assert track.at("b", 15, 100) is None
    assert track.at("c", 5, 100) is None


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"event": 3}', '{"event": "close", "t_ns": "now"}']
)
def test_malformed_events_are_refused(text: str) -> None:
    """Fails where an event without a kind or with a wrong time is used."""
    with pytest.raises(ValueError, match=r"."):
        event_of(text, 0)
