"""What the robot recorded of its own choice, in frames and clocks that are not dgeval's.

Catches: a grasp that is taken as of the base because nothing says where its frame is, a seed that
keeps its own frame, and beliefs that are lost, or turn off the recorder's clock, because they were
stamped when they were recorded.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dgeval.geometry import invert, pose_from_matrix, transform
from dgeval.recording.choices import in_base, logged_poses, unplaced
from dgeval.recording.messages import StampedPose
from dgeval.replay.causal import recorded_seed, seed_of
from tests.recording.recorders import TYPES, Message, names, opened, write

GRASP, SEED = "/dgeval/belief/grasp", "/dgeval/seed"
POSE = "geometry_msgs/msg/PoseStamped"


def said(messages: list[Message], topic: str, frame: str, T: np.ndarray) -> list[Message]:
    """The messages with a pose beside each camera_info from the tenth on; without grasps."""
    out = [m for m in messages if m[1] not in (GRASP, SEED)]
    infos = [m for m in messages if m[1].endswith("camera_info")][10:]
    for log_ns, _, _, info in infos:
        header = copy.deepcopy(info.header)
        header.frame_id = frame
        x, y, z, qx, qy, qz, qw = pose_from_matrix(T).tolist()
        pose = TYPES["geometry_msgs/msg/Pose"](
            position=TYPES["geometry_msgs/msg/Point"](x=x, y=y, z=z),
            orientation=TYPES["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
        )
        stamped: Any = TYPES[POSE](header=header, pose=pose)
        out.append([log_ns, topic, POSE, stamped])
    return out


T = np.eye(4)
T[:3, 3] = (0.1, 0.2, 0.3)


@pytest.mark.parametrize("topic", [GRASP, SEED])
def test_a_pose_in_a_frame_that_nothing_places_is_not_taken_as_of_the_base(
    messages: list[Message], tmp_path: Path, topic: str
) -> None:
    trial = opened(write(tmp_path / "a.mcap", said(messages, topic, "planner_world", T)))
    assert names(trial) == ["choices"]
    assert "'planner_world'" in trial.checks[0].what
    assert trial.choices.times == ()
    assert seed_of(trial) is None


@pytest.mark.parametrize("topic", [GRASP, SEED])
def test_a_pose_in_the_cameras_frame_is_brought_to_the_base(
    messages: list[Message], tmp_path: Path, topic: str
) -> None:
    plain = opened(write(tmp_path / "p.mcap", messages))
    camera = plain.robot.camera_frame
    trial = opened(write(tmp_path / "a.mcap", said(messages, topic, camera, T)))
    assert names(trial) == []
    pose, t_ns = trial.scan.poses[topic][5], trial.scan.poses[topic][5].t_ns
    T_base_camera = trial.robot.T_base_camera(t_ns)
    assert T_base_camera is not None
    brought = in_base(pose, t_ns + 300_000_000, trial.robot)
    assert brought is not None
    np.testing.assert_allclose(brought, T_base_camera @ T, atol=1e-12)
    if topic == SEED:
        first = trial.scan.poses[topic][0]
        seed = recorded_seed([(first, 0)], first.t_ns, first.t_ns, trial.robot)
        at = trial.robot.T_base_camera(first.t_ns)
        assert seed is not None
        assert at is not None
        np.testing.assert_allclose(transform(invert(at), seed[None, :3, 3])[0], T[:3, 3])
        unknown = StampedPose(first.t_ns, "planner_world", "", first.pose)
        assert recorded_seed([(unknown, 0)], first.t_ns, first.t_ns, trial.robot) is None


def test_a_grasp_holds_in_its_frame_as_it_was_at_its_stamp(
    messages: list[Message], tmp_path: Path
) -> None:
    """Catches a grasp in the moving camera's frame that is placed where the camera is when it is
    logged: 51 mm off for 300 ms; and one without a stamp that is refused.
    """
    camera = opened(write(tmp_path / "p.mcap", messages)).robot.camera_frame
    listed = [
        [m[0] + 300_000_000 * (m[1] == GRASP), *m[1:]] for m in said(messages, GRASP, camera, T)
    ]
    trial = opened(write(tmp_path / "a.mcap", listed))
    poses = trial.scan.poses[GRASP]
    assert len(trial.choices.times) > 20
    for t_ns, brought in zip(trial.choices.times, trial.choices.grasps, strict=True):
        stamp = max(p.t_ns for p in poses if p.t_ns <= t_ns - 290_000_000)
        at = trial.robot.T_base_camera(stamp)
        assert at is not None
        np.testing.assert_allclose(brought, at @ T, atol=1e-9)
    for m in listed:
        if m[1] == GRASP:
            m[0] -= 300_000_000
            m[3].header.stamp.sec = m[3].header.stamp.nanosec = 0
    unstamped = opened(write(tmp_path / "b.mcap", listed))
    assert names(unstamped) == []
    pose, log_ns = logged_poses(unstamped.scan, GRASP)[5]
    at = unstamped.robot.T_base_camera(log_ns)
    brought_now = in_base(pose, log_ns, unstamped.robot)
    assert at is not None
    assert brought_now is not None
    np.testing.assert_allclose(brought_now, at @ T, atol=1e-9)


def test_one_grasp_that_can_be_placed_is_enough_for_no_check(
    messages: list[Message], tmp_path: Path
) -> None:
    listed = said(messages, GRASP, "planner_world", T)
    next(m for m in listed if m[1] == GRASP)[3].header.frame_id = "base_link"
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert unplaced(trial.scan, trial.robot) == []
    assert len(trial.choices.times) == 1


def test_beliefs_that_are_stamped_by_the_recorder_follow_its_clock(
    messages: list[Message], tmp_path: Path
) -> None:
    """A simulator's clock begins at 10 s, the recorder's is that of the world."""
    listed, first = [], min(m[0] for m in messages)
    speed, kind = "/dgeval/belief/velocity", "geometry_msgs/msg/TwistStamped"
    with_grasps = [m for m in said(messages, GRASP, "base_link", T) if m[1] != speed]
    vector = TYPES["geometry_msgs/msg/Vector3"](x=0.1, y=0.0, z=0.0)
    twist = TYPES["geometry_msgs/msg/Twist"](linear=vector, angular=vector)
    with_grasps += [
        [m[0], speed, kind, TYPES[kind](header=copy.deepcopy(m[3].header), twist=twist)]
        for m in with_grasps
        if m[1] == GRASP
    ]
    for log_ns, topic, kind, value in with_grasps:
        changed = copy.deepcopy(value)
        if hasattr(changed, "header") and topic not in (GRASP, speed):
            stamp = changed.header.stamp
            t = stamp.sec * 10**9 + stamp.nanosec - first + 10**10
            stamp.sec, stamp.nanosec = t // 10**9, t % 10**9
        listed.append([log_ns, topic, kind, changed])
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert any("recorder's clock" in note for note in trial.notes)
    plain = opened(write(tmp_path / "p.mcap", with_grasps))
    assert len(plain.choices.times) > 20
    since = [[t - one.pairs[0].t_ns for t in one.choices.times] for one in (trial, plain)]
    np.testing.assert_allclose(since[0], since[1], atol=30_000_000)
    speeds = [[t - one.pairs[0].t_ns for t, _ in one.scan.twists[speed]] for one in (trial, plain)]
    np.testing.assert_allclose(speeds[0], speeds[1], atol=30_000_000)
