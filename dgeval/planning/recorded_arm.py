"""The log's own arm: whether it can bring its palm to a pose from where it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgeval.geometry import Array
from dgeval.planning.reachability import Arm, arm_of
from dgeval.recording.robot import RobotStates


def recorded_arm(robot: RobotStates) -> Arm | str:
    """The arm that brings the palm to a grasp; in words why its reach can't be asked."""
    description, base, palm = robot.description, robot.base_frame, robot.palm_frame
    if description is None or base is None or palm is None:
        return "no robot description" if description is None else "no pose of the palm in a base"
    arm = arm_of(description, base, palm)
    if isinstance(arm, str):
        return arm
    missing = [joint.name for joint in arm.movable if joint.name not in robot.joints.times]
    if missing:
        return f"its joint {missing[0]!r} is not recorded"
    first_ns = robot.joints.first_ns(arm.movable[0])
    if arm.base != base and robot.tree.lookup(arm.base, base, first_ns) is None:
        return f"nothing says where its base {arm.base!r} is in {base!r}"
    return arm


@dataclass(frozen=True)
class ArmAt:
    """The arm at a time: T_arm_base (4, 4), of its own base, and its joint positions q (n,)."""

    arm: Arm
    T_arm_base: Array
    q: Array

    def solve(self, T_base_palm: Array) -> Array | None:
        """Joint positions (n,) that bring the palm to a pose (4, 4), or None."""
        return self.arm.solve(self.T_arm_base @ T_base_palm, self.q)

    def room(self, T_base_palm: Array) -> float | None:
        """How far the arm is from its limits with the palm at a pose (4, 4); None out of reach."""
        q = self.solve(T_base_palm)
        return None if q is None else self.arm.room(q)


class RecordedArm:
    """The arm through a trial. max_gap_s: joints farther apart in time are not interpolated."""

    def __init__(self, robot: RobotStates, max_gap_s: float) -> None:
        self._robot, self._arm = robot, recorded_arm(robot)
        self._gap_ns = round(max_gap_s * 1e9)

    def at(self, t_ns: int) -> ArmAt | None:
        """The arm at a time, ns; None where its reach can't be asked."""
        arm, base = self._arm, self._robot.base_frame
        if isinstance(arm, str) or base is None:
            return None
        T_arm_base = np.eye(4)
        if arm.base != base:
            found = self._robot.tree.lookup(arm.base, base, t_ns)
            if found is None:
                return None
            T_arm_base = found
        joints = self._robot.joints
        q = [joints.at(joint.name, t_ns, self._gap_ns) for joint in arm.movable]
        if any(value is None for value in q):
            return None
        return ArmAt(arm, T_arm_base, np.array(q, dtype=float))

    def reaches(self, t_ns: int, T_base_palm: Array) -> bool:
        """Whether it reaches a pose (4, 4) from where it is then; True where that is not known."""
        arm = self.at(t_ns)
        return arm is None or arm.solve(T_base_palm) is not None
