"""A frame's row of the table `frames`, made from the results of its stages.

Nothing else writes the columns of `dgeval.schema.FRAMES` and `FRAMES_ADDED`. A column without a
value is left out or None; both are a null in the table and in the digests.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dgeval.geometry import Array, pose_from_matrix

if TYPE_CHECKING:
    from dgeval.perception.pipeline import Perceived
    from dgeval.planning.control import GraspResult
    from dgeval.planning.servo import ServoCommand
    from dgeval.planning.vfas.replayed import VfasResult
    from dgeval.replay.causal import Step

POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")
POSITION = ("px", "py", "pz")
AXES = ("x", "y", "z")
BOX = ("x0", "y0", "x1", "y1")
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


def row_of(step: Step) -> dict[str, object]:
    """The columns of one frame by name."""
    frame = step.frame
    row: dict[str, object] = {"frame": frame.index, "t_ns": frame.t_ns, "execute": step.execute}
    row |= _tracking(step.perceived)
    row |= _registration_and_fusion(step.perceived)
    row |= _estimation(step.perceived)
    if frame.T_base_palm is not None:
        row |= pose_columns("hand", frame.T_base_palm)
    if step.control is not None:
        if step.control.grasps is not None:
            row |= _grasps(step.control.grasps)
        row |= _servo(step.control.command)
    if step.vfas is not None:
        row |= _vfas(step.vfas)
    return row


def pose_columns(prefix: str, T: Array) -> dict[str, float]:
    """Position m and unit quaternion of T (4, 4) as columns `prefix_px` to `prefix_qw`."""
    pose = pose_from_matrix(T)
    return {f"{prefix}_{name}": float(value) for name, value in zip(POSE, pose, strict=True)}


def _columns(prefix: str, names: Sequence[str], values: Array) -> dict[str, object]:
    return {f"{prefix}_{n}": v for n, v in zip(names, values.tolist(), strict=True)}


def _tracking(perceived: Perceived) -> dict[str, object]:
    tracked = perceived.tracked
    row: dict[str, object] = {"tracking": tracked.state}
    if tracked.box is not None:
        row |= {f"box_{n}": v for n, v in zip(BOX, tracked.box, strict=True)}
        row["mask_area"] = tracked.mask_area
    if tracked.state != "not_started":
        row |= {
            "track_confidence": tracked.confidence,
            "occluded": tracked.occluded,
            "reacquired": tracked.reacquired,
        }
    if tracked.features is not None:
        row["n_features"] = len(tracked.features.points)
    return row


def _registration_and_fusion(perceived: Perceived) -> dict[str, object]:
    fused, registration = perceived.fused, perceived.registration
    row: dict[str, object] = {
        "icp_reject_reason": fused.reject_reason,
        "predicted": not fused.accepted,
        "residual_translation": fused.residual_translation,
        "n_filtered": fused.n_filtered,
    }
    if perceived.observation is not None:
        row["n_observed"] = len(perceived.observation.points)
    if registration is not None:
        row["icp_accepted"] = registration.accepted
        row["icp_fitness"] = registration.fitness
        row["icp_gate_fitness"] = registration.gate_fitness
        row["icp_rmse"] = registration.rmse
    if fused.model is not None and fused.T_camera_model is not None:
        row["n_model"] = len(fused.model.points)
        if fused.centroid is not None:
            row |= pose_columns("model", fused.T_camera_model)
            row |= _columns("centroid", POSITION, fused.centroid)
    return row


def _estimation(perceived: Perceived) -> dict[str, object]:
    estimate = perceived.estimate
    if estimate is None:
        return {}
    row = _columns("feature", POSITION, estimate.position)
    row |= _columns("velocity", AXES, estimate.velocity)
    return row | {"velocity_sd": estimate.velocity_sd, "nis": estimate.nis}


def _grasps(result: GraspResult) -> dict[str, object]:
    row: dict[str, object] = {"n_grasps": result.n_candidates}
    choice = result.choice
    if choice is not None:
        row |= pose_columns("grasp", choice.T_base_palm)
        row["grasp_score"], row["grasp_metric"] = choice.score, choice.metric
        row["hand_score"] = choice.hand_score
    return row


def _servo(command: ServoCommand | None) -> dict[str, object]:
    if command is None:
        return {}
    row = _columns("twist", TWIST, command.twist)
    row["error_linear"], row["error_angular"] = command.error_linear, command.error_angular
    return row


def _vfas(result: VfasResult) -> dict[str, object]:
    selected = result.selected
    row: dict[str, object] = {
        **pose_columns("grasp", selected.T_base_seed),
        "n_grasps": selected.n,
        "region_factor": selected.factor,
    }
    if not np.isnan(selected.score):  # the last advance is open loop: nothing was scored
        row["grasp_score"] = selected.score
        row["grasp_quality"], row["grasp_spread"] = selected.quality, selected.spread
    if result.motion is not None:
        row |= _columns("motion", AXES, result.motion)
    return row | _servo(result.command)
