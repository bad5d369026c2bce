"""Catches a column that nothing fills, and a value under the wrong column of a frame's row.

The steps are made by hand; no image is looked at.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from dgeval.config import load_config
from dgeval.geometry import Intrinsics
from dgeval.perception.estimation import Estimate
from dgeval.perception.pipeline import Perceived
from dgeval.perception.types import Features, Fused, Model, Observation, Registration, Tracked
from dgeval.planning.control import Choice, Control, GraspResult
from dgeval.planning.servo import ServoCommand
from dgeval.planning.vfas.replayed import VfasResult
from dgeval.planning.vfas.selection import Selected
from dgeval.recording.frame import Frame
from dgeval.recording.manifest import TrialSpec
from dgeval.replay.causal import Step
from dgeval.replay.fidelity import BOUNDS, Fidelity
from dgeval.replay.notes import FrameCounts
from dgeval.replay.row import pose_columns, row_of
from dgeval.runs.trial_job import trial_row
from dgeval.schema import FRAMES, FRAMES_ADDED, TRIALS, StageDigests
from dgeval.verdict.estimates import Estimates
from dgeval.verdict.judge import Judgement, VerdictRow
from tests.verdict.synthetic_trial import trial_of

POINTS = np.arange(12.0).reshape(4, 3)
NAMES = {c.name for c in (*FRAMES, *FRAMES_ADDED)}


def pose(x: float, y: float, z: float, about_z: float = 0.0) -> np.ndarray:
    """T (4, 4): turned by an angle about z, rad, at x y z."""
    T = np.eye(4)
    T[:2, :2] = [[np.cos(about_z), -np.sin(about_z)], [np.sin(about_z), np.cos(about_z)]]
    T[:3, 3] = (x, y, z)
    return T


def frame_of(T_base_palm: np.ndarray | None) -> Frame:
    """Frame 7 at 1000 ns; one pixel without depth."""
    colour, depth = np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1), np.float32)
    camera = Intrinsics(1, 1, 1.0, 1.0, 0.0, 0.0)
    return Frame(7, 1000, colour, depth, camera, np.eye(4), T_base_palm)


def step_of(
    perceived: Perceived,
    control: Control | None = None,
    vfas: VfasResult | None = None,
    T_base_palm: np.ndarray | None = None,
) -> Step:
    return Step(frame_of(T_base_palm), np.eye(4), {}, perceived, control, (), vfas)


PALM = pose(0.1, 0.2, 0.3, np.pi)
# a registration that is not accepted, so that its reason has a value too
PERCEIVED = Perceived(
    Tracked(
        "tracked",
        (1, 2, 3, 4),
        mask_area=5,
        features=Features(POINTS, POINTS[:, :2]),
        confidence=0.25,
        reacquired=True,
    ),
    Observation(POINTS[:3], POINTS[:3]),
    Registration(np.eye(4), 0.8, 0.6, 0.004, "fitness"),
    Fused(False, "fitness", 3, 0.002, Model(POINTS, POINTS), pose(1, 2, 3), np.array([4, 5, 6.0])),
    Estimate(np.array([7, 8, 9.0]), np.array([0.1, 0.2, 0.3]), 0.01, 2.5, False),
)
COMMAND = ServoCommand(0.05, 0.4, np.array([1, 2, 3, 4, 5, 6.0]))
DYNAMIC = step_of(
    PERCEIVED,
    Control(1000, GraspResult(12, Choice(pose(0.5, 0.6, 0.7), 0.91, 0.92, 0.93)), True, COMMAND),
    T_base_palm=PALM,
)
SELECTED = Selected(pose(0.8, 0.9, 1), np.eye(4), 1.5, 0.7, 0.05, 2.0, 30, True, False)
VFAS = step_of(
    PERCEIVED, vfas=VfasResult(SELECTED, np.array([0.4, 0.5, 0.6]), COMMAND), T_base_palm=PALM
)


def filled(row: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in row.items() if v is not None}


def test_every_frame_column_is_filled_by_one_pipeline_or_the_other() -> None:
    """Catches a column of the schema that no stage's result reaches, and a key without a column."""
    assert set(filled(row_of(DYNAMIC))) | set(filled(row_of(VFAS))) == NAMES
    for step in (DYNAMIC, VFAS):
        StageDigests().add(row_of(step))


def test_every_trial_column_is_filled() -> None:
    """Catches a column of the trial table that is always null."""
    verdict: Any = dict.fromkeys((f.name for f in fields(VerdictRow)), "x")
    judgement = Judgement(VerdictRow(**verdict), 3, "palm", closes=((2, 1.0),))
    trial = trial_of()
    spec = TrialSpec(
        "a", trial.spec.recording, 1, 2, object="mug", scenario="s", speed=0.1, cause="timing"
    )
    trial = replace(trial, spec=spec)
    given = Estimates({}, "x")
    counts, config = FrameCounts(), load_config("dynamic", ())
    seen = tuple(Fidelity(stage, 12, (0.0,) * len(BOUNDS[stage]), True) for stage in BOUNDS)
    row, _, _ = trial_row(
        trial, config, counts, 2, 3, judgement, estimates=given, fidelity=seen, chosen_score=0.5
    )
    row |= {f"digest_{stage}": value for stage, value in StageDigests().hexdigests().items()}
    names = {c.name for c in TRIALS}
    assert set(filled(row)) == names
    assert "an operator says timing, the verdict x" in row["notes"], "two words for one cause"


def test_values_of_a_step_stand_under_their_own_columns() -> None:
    """Catches box corners, scores, errors or axes that change places."""
    expected = {
        "frame": 7, "t_ns": 1000, "tracking": "tracked", "mask_area": 5, "n_features": 4,
        "track_confidence": 0.25, "occluded": False, "reacquired": True,
        "box_x0": 1, "box_y0": 2, "box_x1": 3, "box_y1": 4,
        "n_observed": 3, "n_filtered": 3, "n_model": 4, "predicted": True,
        "icp_accepted": False, "icp_fitness": 0.8, "icp_gate_fitness": 0.6, "icp_rmse": 0.004,
        "icp_reject_reason": "fitness", "residual_translation": 0.002,
        "centroid_px": 4, "centroid_py": 5, "centroid_pz": 6,
        "feature_px": 7, "feature_py": 8, "feature_pz": 9,
        "velocity_x": 0.1, "velocity_y": 0.2, "velocity_z": 0.3, "velocity_sd": 0.01, "nis": 2.5,
        "grasp_score": 0.92, "grasp_metric": 0.93, "hand_score": 0.91, "n_grasps": 12,
        "error_linear": 0.05, "error_angular": 0.4, "execute": True,
        "twist_vx": 1, "twist_vy": 2, "twist_vz": 3, "twist_wx": 4, "twist_wy": 5, "twist_wz": 6,
    }  # fmt: skip
    poses = {
        **pose_columns("model", pose(1, 2, 3)),
        **pose_columns("grasp", pose(0.5, 0.6, 0.7)),
        **pose_columns("hand", PALM),
    }
    assert filled(row_of(DYNAMIC)) == expected | poses


def test_values_of_vfas_stand_under_their_own_columns() -> None:
    """Catches the goal in place of the seed, and the spread in place of the quality."""
    row = row_of(VFAS)
    expected = {
        **pose_columns("grasp", pose(0.8, 0.9, 1)), "grasp_score": 1.5, "grasp_quality": 0.7,
        "grasp_spread": 0.05, "region_factor": 2.0, "n_grasps": 30, "execute": False,
        "motion_x": 0.4, "motion_y": 0.5, "motion_z": 0.6, "error_linear": 0.05, "twist_wz": 6,
    }  # fmt: skip
    assert {k: row[k] for k in expected} == expected


def test_an_open_loop_advance_has_no_score() -> None:
    """Catches NaN in a table in which nothing to say is null."""
    nan = float("nan")
    selected = Selected(np.eye(4), np.eye(4), nan, nan, nan, 1.0, 0, True, True)
    row = row_of(step_of(PERCEIVED, vfas=VfasResult(selected, None, None)))
    assert not {"grasp_score", "grasp_quality", "grasp_spread", "motion_x"} & filled(row).keys()
    assert row["execute"] is True


def test_candidates_are_counted_where_none_of_them_was_chosen() -> None:
    """Catches a frame whose candidates were all refused told as one without candidates."""
    row = filled(row_of(step_of(PERCEIVED, Control(1000, GraspResult(12, None), None, None))))
    assert row["n_grasps"] == 12
    assert not [name for name in row if name.startswith("grasp_")]


def test_a_frame_before_the_start_has_its_time_and_state_alone() -> None:
    """Catches a reason, or a pose of nothing, before there is a target."""
    perceived = Perceived(Tracked("not_started"), None, None, Fused(False), None)
    expected = {"frame": 7, "t_ns": 1000, "tracking": "not_started", "predicted": True}
    assert filled(row_of(step_of(perceived))) == expected


def test_a_stale_pose_is_neither_in_the_row_nor_in_the_step() -> None:
    """Catches the model's pose carried on and shown after `null_after_s`; its size stays known."""
    fused = Fused(False, "lost", None, None, Model(POINTS, POINTS), np.eye(4), None)
    step = step_of(Perceived(Tracked("lost"), None, None, fused, None))
    assert "model_px" not in step.row
    assert step.row["n_model"] == 4
    assert step.T_camera_model is None


def test_a_pose_is_position_and_quaternion_with_w_last() -> None:
    """Catches w first. Half a turn about z is x y z w = 0 0 1 0."""
    columns = pose_columns("hand", PALM)
    assert list(columns) == [f"hand_{n}" for n in ("px", "py", "pz", "qx", "qy", "qz", "qw")]
    assert np.abs(list(columns.values())) == pytest.approx([0.1, 0.2, 0.3, 0, 0, 1, 0], abs=1e-12)
