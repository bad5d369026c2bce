"""VFAS-Grasp over a recording: an iteration at its period, and its columns, at the recorded states of the gripper."""

from __future__ import annotations

from typing import Any

import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array, rotation_angle
from dgeval.perception.pipeline import pose_columns
from dgeval.planning.schedule import Delayed
from dgeval.planning.vfas.loop import VfasLoop, proportional_twist
from dgeval.planning.vfas.selection import Selected
from dgeval.recording.frame import Frame

EARLY = 0.8  # of a period; a frame that comes this early still begins an iteration
TWIST = ("twist_vx", "twist_vy", "twist_vz", "twist_wx", "twist_wy", "twist_wz")


class VfasGrasps:
    """T_base_seed: another planner's proposal; None: as `VfasLoop` makes one."""

    def __init__(self, config: Config, T_base_seed: Array | None) -> None:
        self._config = config
        self._loop = VfasLoop(config, T_base_seed)
        self._coming: Delayed[Selected] = Delayed(config.schedule.grasps_latency_s)
        self._next_ns = 0

    def step(self, frame: Frame, T_base_camera: Array | None, row: dict[str, Any]) -> None:
        """One frame's columns; all null before there is a seed, or where the camera's pose isn't known."""
        config, hand = self._config.vfas, frame.T_base_palm
        if hand is not None:
            row.update(pose_columns("hand", hand))
        if T_base_camera is not None and frame.t_ns >= self._next_ns:
            self._next_ns = frame.t_ns + round(EARLY * config.period_s * 1e9)
            selected = self._loop.step(frame, T_base_camera)
            if selected is not None:
                self._coming.step(frame.t_ns, selected)
        at = self._coming.at(frame.t_ns)
        if at is None:
            return
        chosen = at[1]
        row.update(pose_columns("grasp", chosen.T_base_seed))
        if not np.isnan(chosen.score):  # the last advance is open loop
            row["grasp_score"], row["grasp_quality"], row["grasp_spread"] = (
                chosen.score,
                chosen.quality,
                chosen.spread,
            )
        row["n_grasps"], row["region_factor"] = chosen.n, chosen.factor
        row["execute"] = chosen.execute
        if self._loop.velocity is not None:
            row.update(
                zip(("motion_x", "motion_y", "motion_z"), self._loop.velocity.tolist(), strict=True)
            )
        if hand is None:
            return
        goal = chosen.T_base_goal
        row["error_linear"] = float(np.linalg.norm(goal[:3, 3] - hand[:3, 3]))
        row["error_angular"] = rotation_angle(hand[:3, :3].T @ goal[:3, :3])
        row.update(zip(TWIST, proportional_twist(hand, goal, config.gain).tolist(), strict=True))
