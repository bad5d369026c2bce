"""Catches a stand-in or a loss that a trial's notes keep quiet about, and frames miscounted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dgeval.config import load_config
from dgeval.networks import checkpoints
from dgeval.networks.transt import TransT, TransTM
from dgeval.perception.pipeline import Perceived
from dgeval.perception.trackers import transt
from dgeval.perception.types import Fused, Observation, Tracked
from dgeval.replay.notes import (
    FrameCounts,
    pipeline_notes,
    recording_notes,
    self_filter_of,
    tracker_note,
)
from dgeval.runs.target_told import FirstSeen, target_checks
from tests.replay.test_row import step_of
from tests.verdict.synthetic_trial import trial_of

COLOUR = "not as in the paper: registration.colour = True (ours)"


def test_frames_are_counted_by_what_became_of_the_target() -> None:
    """Catches a frame that is lost counted as one without depth, or counted twice."""
    points = np.zeros((3, 3))
    observation = Observation(points, points)
    counts = FrameCounts()
    for perceived in (
        Perceived(Tracked("tracked"), None, None, Fused(False, "too_few_points"), None),
        Perceived(Tracked("lost"), None, None, Fused(False, "lost"), None),
        Perceived(Tracked("lost"), None, None, Fused(False, "lost"), None),
        Perceived(Tracked("tracked"), observation, None, Fused(True), None),
    ):
        counts = counts.with_frame(step_of(perceived))
    holes = counts.holes  # of frames without any depth
    assert counts == FrameCounts(4, 2, 3, no_depth=1, no_hand=4, no_seed=4, holes=holes)
    assert holes == 4.0


def test_notes_name_stand_ins_and_what_was_left_out() -> None:
    """Catches a loss without a note, and the notes in another order than the tables of old runs."""
    trial = trial_of(description=None)
    window = replace(trial.window, n_unmatched_colour=2, n_unmatched_depth=3)
    trial = replace(trial, window=window, notes=("of the recording",))
    trial.reader.lost.times.add(1)
    config = load_config("dynamic", ("tracking.method=csrt", "grasps.source=recorded"))
    assert recording_notes(trial, FrameCounts(frames=9, no_depth=4)) == [
        "of the recording",
        "no usable depth on the target in 4 of 9 frames: followed in colour",
        "unmatched images: 2 colour, 3 depth",
        "1 frames could not be decoded",
        "self_filter: none, no robot description",
    ]
    assert pipeline_notes(trial, config, FrameCounts(frames=9, no_depth=4)) == [
        "stand-in: CSRT in place of TransT-M",
        COLOUR,
        "stand-in: the recorded grasp in place of FFHNet; hand_score as recorded",
    ]
    assert trial.notes == ("of the recording",)


def test_the_weights_that_track_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches the paper's tracker said to run with weights that lack its mask, and no name."""
    said = []
    for network in (TransTM(), TransTM(has_mask=False), TransT()):
        monkeypatch.setattr(transt, "transt_of", lambda _, network=network: network)
        monkeypatch.setattr(checkpoints, "published", lambda _: None)
        config = load_config("dynamic", ("tracking.method=transt", "tracking.weights=a/own.pth"))
        said.append(tracker_note(config))
    assert said == [
        "tracking by TransT-M, weights own.pth",
        "stand-in: weights own.pth, which lack TransT-M's parts for the mask; depth steps give the "
        "mask",
        "stand-in: weights own.pth, which lack TransT-M's parts for the mask and new templates; "
        "depth steps give the mask",
    ]


def test_a_handover_that_is_replayed_as_something_else_is_told() -> None:
    """Catches the parameters of a belt used for what someone holds, in silence."""
    trial = trial_of()
    trial = replace(trial, spec=replace(trial.spec, scenario="handover"))
    told = "pipeline dynamic, as configured, though the manifest says handover"
    for pipeline, is_told in (("dynamic", True), ("handover", False)):
        config = load_config(pipeline, ("grasps.source=none",))
        assert (told in pipeline_notes(trial, config, FrameCounts(frames=9))) == is_told


def test_a_complete_trial_has_only_the_notes_of_its_parts() -> None:
    """Catches notes of losses where nothing was lost, and of a hand that is known."""
    config = load_config("dynamic", ("grasps.source=none",))
    trial = trial_of()
    assert self_filter_of(trial, FrameCounts(frames=9)) == "geometry"
    expected = ["stand-in: model tracker in place of TransT-M", COLOUR]
    assert recording_notes(trial, FrameCounts(frames=9)) == []
    assert pipeline_notes(trial, config, FrameCounts(frames=9)) == expected


def test_a_hand_whose_joints_are_missing_is_told() -> None:
    """Catches a self-filter said to work in frames in which the fingers were not known."""
    some = recording_notes(trial_of(), FrameCounts(frames=9, no_hand=4))
    assert any("not known in 4 of 9 frames" in note for note in some)
    every = FrameCounts(frames=9, no_hand=9)
    assert self_filter_of(trial_of(), every) == "none"
    assert "self_filter: none, the hand's joint states are not recorded" in recording_notes(
        trial_of(), every
    )


@pytest.mark.parametrize(
    ("counts", "failed"),
    [
        (FrameCounts(frames=29, predicted=29, lost=0), True),
        (FrameCounts(frames=29, predicted=28, lost=28), True),
        (FrameCounts(frames=29, predicted=27, lost=27), False),
        (FrameCounts(frames=13, predicted=13), False),
    ],
)
def test_a_target_that_was_never_measured_fails_a_check(counts: FrameCounts, failed: bool) -> None:
    """Catches a track of nothing, on which every number of the trial would stand."""
    assert [c.name for c in target_checks(counts, False, None)] == (["measured"] if failed else [])


@pytest.mark.parametrize(
    ("counts", "seen", "failed"),
    [
        (FrameCounts(frames=29, predicted=2), FirstSeen(900, 4), "nothing tells which of 4"),
        (FrameCounts(frames=29, predicted=2), FirstSeen(900, 1), None),
        (FrameCounts(frames=29, predicted=2), FirstSeen(900, None), None),
        (FrameCounts(frames=29, predicted=2), FirstSeen(79, None), "79 px"),
        (FrameCounts(frames=100, predicted=96, lost=96), FirstSeen(900, None), "4 of 100 frames"),
        (FrameCounts(frames=100, predicted=96, lost=95), FirstSeen(900, None), None),
    ],
)
def test_a_target_that_may_be_the_wrong_thing_fails_a_check(
    counts: FrameCounts, seen: FirstSeen, failed: str | None
) -> None:
    """Catches the largest of several things taken, or a few frames followed, with exit 0."""
    found = target_checks(counts, False, seen)
    assert [c.name for c in found] == ([] if failed is None else ["target"])
    assert failed is None or failed in found[0].what


def test_another_box_is_no_mend_for_wrong_depth() -> None:
    counts = FrameCounts(frames=29, predicted=29)
    (check,) = target_checks(counts, False, None, "", ["stamps", "depth_unit"])
    assert check.mend == "mend depth_unit first"
    (check,) = target_checks(counts, False, None, "", ["stamps"])
    assert "--bbox" in check.mend


def test_holes_are_told_where_nothing_was_measured() -> None:
    """Catches another box asked for where depth has hardly any readings."""
    counts = FrameCounts(frames=29, predicted=29, not_started=29, holes=17.4)
    (check,) = target_checks(counts, False, None)
    assert "with usable depth in none of 29 frames; depth is missing in 60%" in check.what
    assert check.mend.startswith("record depth with fewer holes, or")
    (check,) = target_checks(replace(counts, holes=5.0), False, None)
    assert "missing" not in check.what


def test_ffhnet_is_named_with_its_weights() -> None:
    """Catches the shipped weights taken for the published ones, and a departure left out."""
    config = load_config("dynamic", ("grasps.source=ffhnet",))
    notes = pipeline_notes(trial_of(), config, FrameCounts())
    assert notes[1:-1] == [
        f"{COLOUR}, grasps.max_overlap = 0.004 (ours)",
        "no grasp was refused for the arm's reach, which is not known: its joint 'arm_1' is not "
        "recorded",
    ]
    own = "grasps by FFHNet with dgeval's own weights, closing above a score of"
    assert notes[-1] == f"{own} 0.4, the threshold of these weights"
    few = pipeline_notes(trial_of(), config, FrameCounts(frames=9, no_grasp=4))
    assert "in 4 of 9 frames" in few[-1]
    assert "the first 32" in few[-1]
    mixed = load_config("dynamic", ("grasps.source=ffhnet", "execution.c_e=0.7"))
    notes = pipeline_notes(trial_of(), mixed, FrameCounts())
    assert notes[-1] == f"{own} 0.7, though these weights' own is 0.4"
