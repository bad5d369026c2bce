"""The words of a verdict. The rule that turns flags into a class joins them when the simulator can prove it."""

from __future__ import annotations

from typing import Literal

Outcome = Literal["success", "failure", "no_grasp", "incomplete", "unknown"]
OutcomeSource = Literal["label", "inferred"]
FailureClass = Literal["imprecise_pose", "collision", "timing", "unknown"]
Tracking = Literal["tracked", "lost", "not_started"]
