"""Catches a choice among candidates of another image, or a grasp chosen before that is not known
again; and candidates that are recorded though they were ruled out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from dgeval.config import SelectionConfig
from dgeval.geometry import Array, invert
from dgeval.planning.carried import Belief
from dgeval.planning.proposals import Chooser, Proposals
from dgeval.planning.recorded_candidates import RecordedProposals
from dgeval.recording.choices import CandidateSet, Numbers, RecordedChoices
from dgeval.simulation.record import _candidates
from dgeval.simulation.trial import FrameBelief


def at(x: float, y: float = 0.0, z: float = 0.0) -> Array:
    """T (4, 4) of a translation, m."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


T_BASE_OBJECT = at(0.5, 0.1)
FRAME_NS = 66_666_667
SETS = tuple(
    CandidateSet(k * FRAME_NS, np.array([at(0.01 * k), at(0.02 * k, 0.2)]), np.array([0.4, 0.6]))
    for k in range(3)
)
RECORDED = RecordedChoices(candidates=SETS, hand_scores=Numbers((0, 100), (0.25, 0.75)))


def proposed(t_ns: int, kept: tuple[Array, Array] | None = None) -> Proposals | None:
    model: Any = None
    belief = Belief(t_ns, T_BASE_OBJECT, np.zeros(3), True)
    return RecordedProposals(RECORDED).propose(t_ns, 0, model, belief, np.eye(4), kept)


def test_candidates_are_those_of_the_image_on_its_target() -> None:
    found = proposed(FRAME_NS + 5_000_000)
    assert found is not None
    np.testing.assert_allclose(T_BASE_OBJECT @ found.T_object_palm, SETS[1].T_base_palm)
    assert found.scores.tolist() == [0.4, 0.6]
    assert proposed(FRAME_NS + 20_000_000) is None  # of no image near
    assert proposed(9 * FRAME_NS) is None


@pytest.mark.parametrize(("off_m", "is_kept"), [(0.0, True), (0.003, True), (0.006, False)])
def test_the_grasp_chosen_before_is_known_again(off_m: float, is_kept: bool) -> None:
    """The last candidate is the one chosen before, or it is none."""
    before = invert(T_BASE_OBJECT) @ SETS[2].T_base_palm[-1] @ at(0.0, off_m)
    found = proposed(2 * FRAME_NS, (before, np.zeros(0)))
    assert found is not None
    assert found.kept is is_kept
    first = proposed(2 * FRAME_NS)
    assert first is not None
    assert not first.kept


def test_the_score_of_the_hand_is_the_newest_recorded_one() -> None:
    source = RecordedProposals(RECORDED)
    proposals = proposed(0)
    assert proposals is not None
    hands = [(k, t, proposals, np.eye(4), np.zeros(0)) for k, t in enumerate((50, 100))]
    # values that are logged within a millisecond belong to a state already
    assert source.hand_scores(hands) == [0.75, 0.75]
    late = RecordedProposals(replace(RECORDED, hand_scores=Numbers((0, 10**9), (0.25, 0.75))))
    assert late.hand_scores(hands) == [0.25, 0.25]


def test_what_was_ruled_out_is_not_recorded() -> None:
    """Of five candidates the best two are out of reach, and the third is chosen."""
    poses = np.array([at(0.1 * k) for k in range(5)])
    proposals = Proposals(poses, np.zeros((5, 0)), np.array([0.5, 0.9, 0.7, 0.8, 0.6]))
    chooser = Chooser(SelectionConfig(), lambda T: round(10 * T[0, 3] - 5) not in (1, 3))
    best = chooser.best(proposals, at(0.5), None, True)
    assert best is not None
    assert best[0] == 2
    assert proposals.eligible.tolist() == [0, 2, 4]
    belief = FrameBelief(0, 0, True, at(0.5), np.zeros(3), proposals)
    (_, array), (_, scores) = _candidates(belief, 7)
    assert [p.position.x for p in array.poses] == pytest.approx([0.5, 0.7, 0.9])
    assert scores.data.tolist() == [0.5, 0.7, 0.6]
    assert array.header.frame_id == "base_link"
