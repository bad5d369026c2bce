"""Catches: camera poses that are wrong by a known cause, and give a wrong speed without a word."""

from __future__ import annotations

import json

import numpy as np
import pytest
from dgeval.geometry import Array, Intrinsics, increment, matrix_from_pose
from dgeval.recording.camera_motion import moved_pairs
from dgeval.recording.camera_poses import far_from_palm, wrong_poses
from dgeval.recording.frame import Frame
from dgeval.recording.transforms import TransformTree

CAMERA = Intrinsics(160, 120, 145.0, 145.0, 79.5, 59.5)
# looks at the table z = 0 from above, tilted by 40 degrees
T_HAND_CAMERA = increment(np.array([0.03, -0.06, 0.02, np.radians(140.0), 0.0, 0.0]))
STEPS = 9
PERIOD_NS = 100_000_000


def hand_at(k: int) -> Array:
    """T_base_hand, m: over the table, sideways and down."""
    T = np.eye(4)
    T[:3, 3] = [0.3, -0.2 + 0.05 * k, 0.6 - 0.03 * k]
    return T


def depth_of_the_table(T_base_camera: Array) -> np.ndarray:
    """(H, W) m, by the closed form of a ray and a plane; with a step of 5 cm along y = 0."""
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    rays = CAMERA.backproject(u.ravel(), v.ravel(), np.ones(u.size)) @ T_base_camera[:3, :3].T
    z = -T_base_camera[2, 3] / np.where(rays[:, 2] < -1e-3, rays[:, 2], np.nan)
    y = T_base_camera[1, 3] + z * rays[:, 1]
    upper = (0.05 - T_base_camera[2, 3]) / rays[:, 2]
    z = np.where((y > 0) & (T_base_camera[1, 3] + upper * rays[:, 1] > 0), upper, z)
    return np.nan_to_num(z).reshape(v.shape).astype(np.float32)


def told(T_hand_camera: Array) -> tuple[str, str] | None:
    """What is said of frames taken with T_HAND_CAMERA whose poses have another one."""
    tree = TransformTree()
    for k in range(STEPS):
        T = hand_at(k)
        pose = np.array([*T[:3, 3], 0.0, 0.0, 0.0, 1.0])
        tree.add_moving(k * PERIOD_NS, "base", "hand", pose)
    tree.add_static("hand", "camera", T_hand_camera)
    colour = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    frames = []
    for k in range(STEPS):
        depth = depth_of_the_table(hand_at(k) @ T_HAND_CAMERA)
        pose = tree.lookup("base", "camera", k * PERIOD_NS)
        frames.append(Frame(k, k * PERIOD_NS, colour, depth, CAMERA, pose, None, None, None))
    return wrong_poses(moved_pairs(frames), tree, "base", "camera")


def test_poses_that_fit_are_not_called_wrong() -> None:
    assert told(T_HAND_CAMERA) is None


@pytest.mark.parametrize("degrees", [15.0, 40.0])
def test_a_hand_eye_calibration_that_is_turned_is_told(degrees: float) -> None:
    turned = T_HAND_CAMERA @ increment(np.array([0, 0, 0, np.radians(degrees), 0, 0]))
    assert "does not fit what it sees" in str(told(turned))


def test_a_body_frame_is_told_with_the_line_that_turns_it() -> None:
    """Fails where Gazebo's camera_link, x forward, is read as optical, or the line turns it wrong:
    the optical axis is the body's x, and right is against its y.
    """
    body = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    what, mend = told(T_HAND_CAMERA @ np.linalg.inv(body)) or ("", "")
    assert "of the camera's body" in what
    assert "--set frames.camera=camera_optical --set calibration.flange=camera" in mend
    pose = np.array(json.loads(mend[mend.index("[") : mend.index("]") + 1]))
    assert np.allclose(matrix_from_pose(pose), body, atol=1e-12)


def test_an_inverted_hand_eye_calibration_is_told() -> None:
    """The classic: T_camera_hand in place of T_hand_camera."""
    assert told(np.linalg.inv(T_HAND_CAMERA)) is not None


def test_a_camera_metres_from_its_palm_is_told() -> None:
    """A calibration in mm; a camera that does not move with the palm may stand anywhere."""
    tree = TransformTree()
    for k in range(STEPS):
        T = hand_at(k)
        tree.add_moving(k, "base", "hand", np.array([*T[:3, 3], 0.0, 0.0, 0.0, 1.0]))
    tree.add_static("hand", "near", increment(np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])))
    tree.add_static("hand", "far", increment(np.array([0.0, 87.0, 0.0, 0.0, 0.0, 0.0])))
    tree.add_static("base", "standing", increment(np.array([0.0, 3.0, 0.0, 0.0, 0.0, 0.0])))
    times = range(STEPS)
    assert far_from_palm(tree, "base", "hand", "near", times) is None
    assert far_from_palm(tree, "base", "hand", "standing", times) is None
    assert "87 m" in str(far_from_palm(tree, "base", "hand", "far", times))


def test_a_camera_far_from_a_palm_that_stands_still_is_not_on_it() -> None:
    """Fails where a camera on a tripod, two metres away, is called one in millimetres."""
    tree = TransformTree()
    for k in range(STEPS):
        tree.add_moving(k, "base", "hand", np.array([0.3, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0]))
    tree.add_static("base", "standing", increment(np.array([0.0, 3.0, 0.0, 0.0, 0.0, 0.0])))
    assert far_from_palm(tree, "base", "hand", "standing", range(STEPS)) is None
