"""VFAS-Grasp on a recording: one iteration per period, at the recorded gripper poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dgeval.config import Config
from dgeval.geometry import Array, invert, rotation_angle, transform
from dgeval.perception.types import Observation
from dgeval.planning.recorded_arm import RecordedArm
from dgeval.planning.schedule import Delayed
from dgeval.planning.servo import ServoCommand
from dgeval.planning.vfas.contacts import Reach
from dgeval.planning.vfas.gripper import Gripper, trained_gripper
from dgeval.planning.vfas.loop import VfasLoop, proportional_twist
from dgeval.planning.vfas.selection import Selected
from dgeval.recording.frame import Frame

EARLY = 0.2  # share of a period by which a frame may be early for an iteration that is due; ours


@dataclass(frozen=True)
class VfasResult:
    """The newest usable iteration at a frame, and the command to its goal.

    motion (3,): motion field near the seed in the newest iteration, m/s, base frame; None without
    one. command: None without the palm's pose.
    """

    selected: Selected
    motion: Array | None
    command: ServoCommand | None


class VfasGrasps:
    """The planner over the frames of a trial, with its latency.

    T_base_seed (4, 4): another planner's proposal; None: `VfasLoop` makes one. gripper: of the log;
    default: the trained one. Poses that go in and come out are of the palm's frame, the planner's
    own are of the gripper's grasp frame. arm: the log's; its limits rank Contact-GraspNet's seeds.
    """

    def __init__(
        self,
        config: Config,
        T_base_seed: Array | None,
        gripper: Gripper | None = None,
        arm: RecordedArm | None = None,
    ) -> None:
        self._config = config
        gripper = gripper or trained_gripper()
        self._T_palm_grasp, self._T_grasp_palm = gripper.T_palm_grasp, invert(gripper.T_palm_grasp)
        seed = None if T_base_seed is None else T_base_seed @ self._T_palm_grasp
        self._arm = arm
        self._loop = VfasLoop(config, seed, gripper, self._reach)
        self._coming: Delayed[Selected] = Delayed(config.schedule.grasps_latency_s)
        self._due_ns: int | None = None

    def step(
        self, frame: Frame, T_base_camera: Array | None, seen: Observation | None = None
    ) -> VfasResult | None:
        """The newest usable iteration at a frame; None before there is one.

        T_base_camera (4, 4): None where it is not known, then the frame begins no iteration. seen:
        the target in the frame, where a seed of Contact-GraspNet lies.
        """
        config, hand = self._config.vfas, frame.T_base_palm
        if T_base_camera is not None and self._is_due(frame.t_ns):
            grasp = None if hand is None else hand @ self._T_palm_grasp
            target = None if seen is None else transform(T_base_camera, seen.points)
            frame_of_grasp = replace(frame, T_base_palm=grasp)
            selected = self._loop.step(frame_of_grasp, T_base_camera, target=target)
            if selected is not None:
                self._coming.step(frame.t_ns, self._of_palm(selected))
        at = self._coming.at(frame.t_ns)
        if at is None:
            return None
        command = None
        if hand is not None:
            goal = at[1].T_base_goal
            command = ServoCommand(
                float(np.linalg.norm(goal[:3, 3] - hand[:3, 3])),
                rotation_angle(hand[:3, :3].T @ goal[:3, :3]),
                proportional_twist(hand, goal, config.gain),
            )
        return VfasResult(at[1], self._loop.velocity, command)

    def _reach(self, t_ns: int) -> Reach | None:
        """The arm's room at poses of the grasp frame; None where the arm is not known then."""
        at = None if self._arm is None else self._arm.at(t_ns)
        return None if at is None else lambda T: at.room(T @ self._T_grasp_palm)

    def _is_due(self, t_ns: int) -> bool:
        """Whether a frame begins an iteration: one per period in the mean at any camera's rate.

        What a frame comes late is not lost: the next iteration is due as if it had not been.
        """
        period_ns = round(self._config.vfas.period_s * 1e9)
        if self._due_ns is None:
            self._due_ns = t_ns
        if t_ns < self._due_ns - EARLY * period_ns:
            return False
        self._due_ns += period_ns * max(1, (t_ns - self._due_ns) // period_ns + 1)
        return True

    def _of_palm(self, selected: Selected) -> Selected:
        """The same with poses of the palm's frame."""
        return replace(
            selected,
            T_base_seed=selected.T_base_seed @ self._T_grasp_palm,
            T_base_goal=selected.T_base_goal @ self._T_grasp_palm,
        )
