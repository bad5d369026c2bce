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
from dgeval.recording.choices import in_base
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
    brought = in_base(pose, t_ns, trial.robot)
    assert brought is not None
    np.testing.assert_allclose(brought, T_base_camera @ T, atol=1e-12)
    if topic == SEED:
        first = trial.scan.poses[topic][0]
        seed = recorded_seed([first], first.t_ns, first.t_ns, trial.robot)
        at = trial.robot.T_base_camera(first.t_ns)
        assert seed is not None
        assert at is not None
        np.testing.assert_allclose(transform(invert(at), seed[None, :3, 3])[0], T[:3, 3])
        unknown = StampedPose(first.t_ns, "planner_world", "", first.pose)
        assert recorded_seed([unknown], first.t_ns, first.t_ns, trial.robot) is None


def test_beliefs_that_are_stamped_by_the_recorder_follow_its_clock(
    messages: list[Message], tmp_path: Path
) -> None:
    """A simulator's clock begins at 10 s, the recorder's is that of the world."""
    listed, first = [], min(m[0] for m in messages)
    with_grasps = said(messages, GRASP, "base_link", T)
    for log_ns, topic, kind, value in with_grasps:
        changed = copy.deepcopy(value)
        if hasattr(changed, "header") and topic != GRASP:
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
