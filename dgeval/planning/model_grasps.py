"""Grasps by FFHNet on the model cloud of every accepted frame, and the choice of one of them.

The choice is by the dynamic metric, among those that are free of overlap and in reach.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array, invert, transform
from dgeval.perception.types import Model
from dgeval.planning.grasps import (
    Candidates,
    EncodedCloud,
    Feasible,
    approach_free,
    encode_cloud,
    evaluate,
    free_of,
    networks_of,
    overlap_allowed,
    propose,
)
from dgeval.planning.reachability import Arm, arm_of
from dgeval.planning.recorded_grasps import Choice, GraspResult
from dgeval.planning.schedule import Delayed
from dgeval.planning.selection import by_metric, grasp_metric
from dgeval.recording.frame import Frame
from dgeval.recording.robot import RobotStates


@dataclass(frozen=True)
class _Drawn:
    """Candidates of one frame, with the cloud they were drawn for.

    T_base_cloud, T_cloud_model (4, 4): of that frame. support: normal (3,) and offset m of the
    plane the object stands on, in the cloud's frame; None where it is not known.
    """

    cloud: EncodedCloud
    support: tuple[Array, float] | None
    candidates: Candidates
    T_base_cloud: Array
    T_cloud_model: Array


class ModelGrasps:
    """Keeps the candidates of the newest accepted frame, and the grasp chosen last."""

    def __init__(self, robot: RobotStates, config: Config) -> None:
        self._config = config
        self._networks = networks_of(config.grasps)
        self._coming: Delayed[_Drawn] = Delayed(config.schedule.grasps_latency_s)
        # T_model_palm (4, 4) and joint angles (n,) rad of the grasp chosen last
        self._kept: tuple[Array, Array] | None = None
        self._arm: Arm | None = None
        if robot.description is not None and robot.base_frame and robot.palm_frame:
            self._arm = arm_of(robot.description, robot.base_frame, robot.palm_frame)
        self._joints = robot.joints

    def choose(
        self,
        frame: Frame,
        T_base_camera: Array | None,
        model: Model | None,
        T_camera_model: Array | None,
    ) -> GraspResult | None:
        """The best candidate by the dynamic metric that is free and in reach.

        None before there were candidates. model: None if the frame was not accepted.
        """
        at = self._coming.at(frame.t_ns)
        if model is not None and T_camera_model is not None and T_base_camera is not None:
            drawn = self._draw(frame, T_base_camera, model, T_camera_model)
            at = self._coming.step(frame.t_ns, drawn)
        if at is None:
            return None
        cloud, candidates, T_base_cloud = at[1].cloud, at[1].candidates, at[1].T_base_cloud
        palm, config = frame.T_base_palm, self._config
        poses = T_base_cloud @ candidates.T_cloud_palm
        support, most = at[1].support, config.grasps.max_overlap
        metric = (
            candidates.scores
            if palm is None
            else grasp_metric(poses, candidates.scores, palm, config.selection)
        )
        chosen = Feasible(
            lambda rows: free_of(
                cloud,
                candidates.T_cloud_palm[rows],
                candidates.joints[rows],
                support,
                overlap_allowed(rows, len(poses), candidates.kept, most),
            ),
            self._reaches(poses, frame.t_ns, at[1], palm),
        ).first(by_metric(metric, config.selection.keep_margin if candidates.kept else 0.0))
        if chosen is None:
            return GraspResult(len(poses), None)
        joints = candidates.joints[chosen]
        self._kept = invert(at[1].T_cloud_model) @ candidates.T_cloud_palm[chosen], joints
        score = float(candidates.scores[chosen])
        if palm is None:
            return GraspResult(len(poses), Choice(poses[chosen], None, score, None))
        T_cloud_palm = (invert(T_base_cloud) @ palm)[None]
        hand_score = float(evaluate(cloud, self._networks, T_cloud_palm, joints[None])[0])
        choice = Choice(poses[chosen], hand_score, score, float(metric[chosen]))
        return GraspResult(len(poses), choice)

    def _draw(
        self, frame: Frame, T_base_camera: Array, model: Model, T_camera_model: Array
    ) -> _Drawn:
        """Candidates of this frame; the grasp chosen last is one of them, moved with the model."""
        T_base_cloud = T_base_camera.copy()
        T_base_cloud[:3, :3] = self._networks.R_cloud_base(T_base_camera).T
        T_cloud_model = invert(T_base_cloud) @ T_base_camera @ T_camera_model
        z = self._config.grasps.support_z
        support = None if z is None else (T_base_cloud[2, :3], z - float(T_base_cloud[2, 3]))
        cloud = encode_cloud(transform(T_cloud_model, model.points), self._networks, support)
        kept = None if self._kept is None else (T_cloud_model @ self._kept[0], self._kept[1])
        n, seed = self._config.grasps.candidates, self._config.seed
        return _Drawn(
            cloud,
            support,
            propose(cloud, self._networks, n, seed, frame.index, kept),
            T_base_cloud,
            T_cloud_model,
        )

    def _reaches(
        self, poses: Array, t_ns: int, drawn: _Drawn, palm: Array | None
    ) -> Callable[[int], bool] | None:
        """A test of a candidate by its row: is the approach free, and does the arm reach the pose?

        The approach is tested where the palm's pose is known and `way_m` is not 0, the reach where
        the arm's joint angles are known; None where neither is tested. poses (n, 4, 4): T_base_palm
        of the candidates.
        """
        arm, config, candidates = self._arm, self._config.grasps, drawn.candidates
        hand = (
            None
            if palm is None or config.way_m == 0.0
            else (invert(drawn.T_base_cloud) @ palm)[:3, 3]
        )
        start: Array | None = None
        if arm is not None:
            gap = round(self._config.sync.max_pose_gap_s * 1e9)
            q = [self._joints.at(j.name, t_ns, gap) for j in arm.movable]
            start = None if any(v is None for v in q) else np.array(q, dtype=float)
        if hand is None and start is None:
            return None

        def reaches(row: int) -> bool:
            # the approach of the grasp chosen last is not tested again
            kept = candidates.kept and row == len(poses) - 1
            if hand is not None and not kept:
                pose, joints = candidates.T_cloud_palm[row], candidates.joints[row]
                if not approach_free(drawn.cloud, pose, joints, hand, drawn.support, config):
                    return False
            return arm is None or start is None or arm.solve(poses[row], start) is not None

        return reaches
