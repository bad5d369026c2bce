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
from dgeval import api
from dgeval.geometry import invert, pose_from_matrix, transform
from dgeval.recording.choices import in_base, logged_poses, unplaced
from dgeval.recording.contract import CANDIDATE_SCORES_TOPIC, CANDIDATES_TOPIC
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


def offered(messages: list[Message], frame: str, places: list[np.ndarray]) -> list[Message]:
    """The messages with candidates at places (4, 4) beside each camera_info, the last one best.

    Every second message of scores has one too few.
    """
    out = [m for m in messages if m[1] not in (GRASP, SEED)]
    infos = [m for m in messages if m[1].endswith("camera_info")]
    for k, (log_ns, _, _, info) in enumerate(infos):
        header = copy.deepcopy(info.header)
        header.frame_id = frame
        poses = []
        for place in places:
            x, y, z, qx, qy, qz, qw = pose_from_matrix(place).tolist()
            poses.append(
                TYPES["geometry_msgs/msg/Pose"](
                    position=TYPES["geometry_msgs/msg/Point"](x=x, y=y, z=z),
                    orientation=TYPES["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
                )
            )
        array: Any = TYPES["geometry_msgs/msg/PoseArray"](header=header, poses=poses)
        layout = TYPES["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        scores = np.linspace(0.5, 0.502, len(places))[k % 2 :]
        numbers: Any = TYPES["std_msgs/msg/Float64MultiArray"](layout=layout, data=scores)
        out.append([log_ns, CANDIDATES_TOPIC, "geometry_msgs/msg/PoseArray", array])
        out.append(
            [log_ns + 1000, CANDIDATE_SCORES_TOPIC, "std_msgs/msg/Float64MultiArray", numbers]
        )
    return out


def test_a_robots_own_candidates_are_what_is_chosen_from(
    messages: list[Message], tmp_path: Path
) -> None:
    """Catches candidates left in the camera's frame, scores of another set, and a choice by FFHNet
    or by the score alone where the robot's candidates are there.
    """
    plain = opened(write(tmp_path / "p.mcap", messages))
    camera, t_ns = plain.robot.camera_frame, plain.pairs[20].t_ns
    T_base_camera, T_base_palm = plain.robot.T_base_camera(t_ns), plain.robot.T_base_palm(t_ns)
    assert T_base_camera is not None
    assert T_base_palm is not None
    near = invert(T_base_camera) @ T_base_palm  # where the hand is, which the arm reaches
    far = near.copy()
    far[0, 3] += 0.05  # 0.005 of the metric, where the scores differ by 0.002
    trial = opened(write(tmp_path / "a.mcap", offered(messages, camera, [near, far])))
    assert names(trial) == []
    sets = trial.choices.candidates
    frames = [pair.t_ns for pair in trial.pairs]
    assert [one.t_ns for one in sets] == frames[::2]
    at = trial.robot.T_base_camera(sets[3].t_ns)
    assert at is not None
    np.testing.assert_allclose(sets[3].T_base_palm, at @ np.array([near, far]), atol=1e-12)
    np.testing.assert_allclose(sets[3].scores, [0.5, 0.502])
    steps = [s for s in api.replay_trial(trial) if s.control is not None and s.accepted]
    chosen = [s for s in steps if s.frame.t_ns in frames[::2] and s.control.grasps is not None]
    in_reach = [s for s in chosen if s.control.grasps.choice is not None]  # type: ignore[union-attr]
    assert len(in_reach) > 3
    for step in in_reach:
        choice = step.control.grasps.choice  # type: ignore[union-attr]
        assert choice is not None
        assert step.T_base_camera is not None
        np.testing.assert_allclose(choice.T_base_palm, step.T_base_camera @ near, atol=1e-9)
        assert (choice.score, choice.joints) == (0.5, None)


def test_one_bad_candidate_costs_no_other(messages: list[Message], tmp_path: Path) -> None:
    """Catches a set, and a recording, that are lost for one pose of NaN or a quaternion of zero;
    and sets without scores that are dropped without a word.
    """
    listed = offered(messages, "base_link", [T, T, T])
    for message in listed:
        if message[1] == CANDIDATES_TOPIC:
            message[3].poses[0].position.x = float("nan")
            message[3].poses[1].orientation.w = 0.0
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert names(trial) == []
    assert not trial.opened.damage
    assert {len(one.scores) for one in trial.choices.candidates} == {1}
    np.testing.assert_allclose(trial.choices.candidates[0].T_base_palm[0], T, atol=1e-12)
    unscored = [m for m in listed if m[1] != CANDIDATE_SCORES_TOPIC]
    trial = opened(write(tmp_path / "b.mcap", unscored))
    assert names(trial) == ["choices"]
    assert "as many scores" in trial.checks[0].what


def test_candidates_follow_the_recorders_clock(messages: list[Message], tmp_path: Path) -> None:
    """Catches candidates that are lost where the recorder's clock is not that of the stamps."""
    listed = offered(messages, "base_link", [T, T])
    there = opened(write(tmp_path / "a.mcap", listed)).choices.candidates
    later = 5_000_000_000_000
    listed = [[log_ns + later, *rest] for log_ns, *rest in listed]
    for message in listed:
        if message[1] == CANDIDATES_TOPIC:  # stamped by the recorder, as the others aren't
            message[3].header.stamp.sec += later // 1_000_000_000
    apart = opened(write(tmp_path / "b.mcap", listed)).choices.candidates
    assert len(apart) == len(there) > 20
    assert abs(apart[5].t_ns - there[5].t_ns) < 20_000_000


def test_candidates_that_nothing_places_are_told(messages: list[Message], tmp_path: Path) -> None:
    listed = offered(messages, "planner_world", [T, T])
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert names(trial) == ["choices"]
    assert CANDIDATES_TOPIC in trial.checks[0].what
    assert trial.choices.candidates == ()


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
