"""Catches: an outcome of a described hand that its fingers don't show, or show otherwise."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from dgeval.geometry import Array
from dgeval.recording.messages import JointSample
from dgeval.robots.described_hand import DescribedHand, described_hand
from dgeval.robots.hand_links import HandLinks, hand_links
from dgeval.robots.loading import load_description
from dgeval.verdict.described_grip import described_grip
from dgeval.verdict.recorded_closing import closing_as, recorded_closing
from tests.robots.urdf_texts import GRIPPER, PADS, robot

OPEN, CLOSE_S, END_S = 0.04, 1.0, 4.0
SPEED = 0.1  # m/s of each jaw
PERIOD_S = 0.01


def gripper() -> DescribedHand:
    description = load_description(robot(GRIPPER, PADS), "a test", (), 0.01)
    links = hand_links(description, "hand", {"jaw"})
    assert isinstance(links, HandLinks)
    return described_hand(description, links, np.eye(4), np.full(2, OPEN))


def states(rest: float, effort: float | None) -> list[JointSample]:
    """Jaws that close at 1 s until `rest`, m, and then give an effort, N; 2 N on their way."""
    out = []
    for t in np.arange(0.0, END_S, PERIOD_S):
        q = float(np.clip(OPEN - SPEED * (t - CLOSE_S), rest, OPEN))
        given = 0.0 if t <= CLOSE_S else 2.0 if q > rest else effort or 0.0
        efforts = {} if effort is None else {"jaw": given, "other_jaw": given}
        out.append(JointSample(round(t * 1e9), {"jaw": q, "other_jaw": q}, efforts))
    return out


@pytest.mark.parametrize(
    ("rest", "effort", "holds"),
    [
        (0.0, None, False),  # as far as they go
        (0.0, 20.0, False),  # pressed against each other
        (0.015, 20.0, True),
        (0.015, 2.0, False),  # a commanded width
        (0.015, None, None),  # a width alone says nothing: it may be a command
        (OPEN, None, None),  # it never closed
    ],
)
def test_what_fingers_show(rest: float, effort: float | None, holds: bool | None) -> None:
    samples = states(rest, effort)
    end = [s for s in samples if s.t_ns > (END_S - 0.5) * 1e9]
    found = described_grip(gripper(), samples, round(CLOSE_S * 1e9), end)
    assert (None if found is None else found[0]) is holds


def test_fingers_that_pushed_something_before_the_close() -> None:
    """Fails where their effort at the close is taken for its zero, and none at the end for a grip.

    The jaws push something from 0.45 s on, most of the time to the close, and close to 5 mm, empty.
    """
    samples = [
        JointSample(s.t_ns, s.positions, dict.fromkeys(s.efforts, 2.5))
        if 0.45e9 < s.t_ns <= CLOSE_S * 1e9
        else s
        for s in states(0.005, 0.01)
    ]
    end = [s for s in samples if s.t_ns > (END_S - 0.5) * 1e9]
    found = described_grip(gripper(), samples, round(CLOSE_S * 1e9), end)
    assert found is not None
    assert not found[0]


@pytest.mark.parametrize(("at_the_end", "holds"), [(6.0, None), (1.0, False), (20.0, True)])
def test_efforts_that_tremble_on_the_way_say_no_less(at_the_end: float, holds: bool | None) -> None:
    """Fails where 6 N at the end are no grip, as the efforts before the close vary by 2 N."""
    rng = np.random.default_rng(0)
    samples = []
    for s in states(0.015, 20.0):
        noise = 2.0 if s.t_ns <= CLOSE_S * 1e9 else 0.01
        mean = 0.0 if s.t_ns <= CLOSE_S * 1e9 else 1.0 if s.positions["jaw"] > 0.015 else at_the_end
        efforts = {name: mean + noise * float(rng.normal()) for name in s.positions}
        samples.append(JointSample(s.t_ns, s.positions, efforts))
    end = [s for s in samples if s.t_ns > (END_S - 0.5) * 1e9]
    found = described_grip(gripper(), samples, round(CLOSE_S * 1e9), end)
    assert (None if found is None else found[0]) is holds


def test_jaws_that_were_pushed_shut_before_the_close() -> None:
    """Fails where opening a little, from beyond the limit to it, is a close that met something."""
    samples = []
    for t in np.arange(0.0, END_S, PERIOD_S):
        q = OPEN if t < 0.7 else -0.01 if t < CLOSE_S else 0.0
        effort = 20.0 if 0.7 <= t < CLOSE_S else 0.01
        both = {"jaw": q, "other_jaw": q}
        samples.append(JointSample(round(t * 1e9), both, dict.fromkeys(both, effort)))
    end = [s for s in samples if s.t_ns > (END_S - 0.5) * 1e9]
    found = described_grip(gripper(), samples, round(CLOSE_S * 1e9), end)
    assert found is not None
    assert not found[0]


def test_a_hand_that_has_opened_again_says_nothing() -> None:
    """Fails where a success that was put down is a failure, as nothing presses at the end."""
    samples = [
        s if s.t_ns < 3e9 else JointSample(s.t_ns, {"jaw": OPEN, "other_jaw": OPEN}, {"jaw": 0.0})
        for s in states(0.015, 20.0)
    ]
    end = [s for s in samples if s.t_ns > (END_S - 0.5) * 1e9]
    assert described_grip(gripper(), samples, round(CLOSE_S * 1e9), end) is None


def test_a_jaw_that_follows_need_not_be_recorded() -> None:
    samples = [
        JointSample(s.t_ns, {"jaw": s.positions["jaw"]}, {"jaw": s.efforts["jaw"]})
        for s in states(0.015, 20.0)
    ]
    end = [s for s in samples if s.t_ns > (END_S - 0.5) * 1e9]
    found = described_grip(gripper(), samples, round(CLOSE_S * 1e9), end)
    assert found is not None
    assert found[0]


def path(rest: float) -> Array:
    """(m, 2) m, both jaws from the close on."""
    t = np.arange(1, 300) * PERIOD_S
    return np.repeat(np.maximum(OPEN - SPEED * t, rest)[:, None], 2, axis=1)


def moved_as_recorded(
    hand: DescribedHand, before: Array, way: Array, points: Array
) -> DescribedHand:
    closing = recorded_closing(hand, before, way, points)
    return hand if closing is None else closing_as(hand, closing, "recorded")


def joints_after(hand: DescribedHand, since_s: float) -> Array:
    """(2,) m, where its drives make the jaws be: their targets are ahead of them."""
    return hand.targets(since_s - hand.lags_s[0], np.full(2, OPEN))


NOTHING = np.zeros((0, 3))
BETWEEN = np.array([[0.0, y, 0.1] for y in (-0.015, 0.0, 0.015)])  # what the jaws rest on, m


def test_a_width_that_was_commanded_is_a_limit_of_the_trial() -> None:
    """With nothing beside the jaws they stop there at any other close too."""
    hand = moved_as_recorded(gripper(), np.full(2, OPEN), path(0.015), NOTHING)
    assert hand.closing_source == "recorded"
    assert hand.targets(10.0, np.full(2, OPEN)) == pytest.approx([0.015, 0.015])
    assert joints_after(hand, 0.1) == pytest.approx([0.03, 0.03])


def test_jaws_that_something_may_have_stopped_go_on() -> None:
    """Fails where a missed close is tried with jaws that stop at the size of another object."""
    hand = moved_as_recorded(gripper(), np.full(2, OPEN), path(0.015), BETWEEN)
    assert joints_after(hand, 0.1) == pytest.approx([0.03, 0.03])
    assert joints_after(hand, 0.3) == pytest.approx([0.01, 0.01], abs=1e-3)
    assert hand.targets(10.0, np.full(2, OPEN)) == pytest.approx([0.0, 0.0])
    assert hand.centre[2] == pytest.approx(0.10, abs=1e-6)


def test_a_slow_hand_has_the_time_it_took() -> None:
    """Fails where every hand must have closed in half a second."""
    hand = moved_as_recorded(gripper(), np.full(2, OPEN), path(0.0), NOTHING)
    assert hand.close_s == pytest.approx(OPEN / SPEED, abs=0.02)
    slow = np.repeat(np.maximum(OPEN - 0.02 * np.arange(1, 300) * PERIOD_S, 0.0)[:, None], 2, 1)
    hand = moved_as_recorded(gripper(), np.full(2, OPEN), slow, NOTHING)
    assert hand.close_s == pytest.approx(2.0, abs=0.02)
    assert hand.lift_after_s == pytest.approx(2.1, abs=0.02)


def test_a_hand_that_did_not_move_closes_to_its_limits() -> None:
    still = np.full((200, 2), OPEN)
    hand = moved_as_recorded(gripper(), np.full(2, OPEN), still, NOTHING)
    assert hand.closing_source == "limits"
    assert hand.targets(1.0, np.full(2, OPEN)) == pytest.approx([0.0, 0.0])


def test_an_encoder_that_trembles_is_at_rest() -> None:
    """Fails where a hand closes for as long as its encoders tremble: the lift then comes late."""
    rng = np.random.default_rng(0)
    trembling = path(0.002) + rng.normal(0, 1e-4, (299, 2))
    hand = moved_as_recorded(gripper(), np.full(2, OPEN), trembling, NOTHING)
    assert hand.close_s == pytest.approx((OPEN - 0.002) / SPEED, abs=0.02)
    assert hand.targets(10.0, np.full(2, OPEN)) == pytest.approx([0.002, 0.002], abs=2e-4)


def test_jaws_that_snap_shut_when_the_object_slips_out() -> None:
    """Fails where another close stands at the object's width for as long, and snaps shut then."""
    slipped = path(0.015) + np.random.default_rng(0).normal(0, 5e-5, (299, 2))
    slipped[80:] = 0.0
    hand = moved_as_recorded(gripper(), np.full(2, OPEN), slipped, BETWEEN)
    assert joints_after(hand, 0.1) == pytest.approx([0.03, 0.03], abs=3e-4)
    assert joints_after(hand, 0.35) == pytest.approx([0.005, 0.005], abs=1e-3)
    assert hand.close_s == pytest.approx((OPEN - 0.015) / SPEED, abs=0.03)


def held_then_lost(rest: float) -> Array:
    """(m, 2) m: jaws that stand at 15 mm for a while, lose what they held, and come to rest."""
    lost = path(0.015) + np.random.default_rng(0).normal(0, 5e-5, (299, 2))
    lost[180:] = rest
    return lost


def test_jaws_close_to_where_they_rest_empty() -> None:
    """Fails where jaws that were sent to 5 mm close to 0 at any other time: they then sweep past
    what they would have held. The object still lies between them at the close.
    """
    opened = np.full(2, OPEN)
    closing = recorded_closing(gripper(), opened, held_then_lost(0.005), BETWEEN, np.full(2, 0.005))
    assert closing is not None
    hand = closing_as(gripper(), closing, "recorded")
    assert joints_after(hand, 0.1) == pytest.approx([0.03, 0.03], abs=3e-4)
    assert joints_after(hand, 0.3) == pytest.approx([0.01, 0.01], abs=1e-3)
    assert hand.targets(10.0, opened) == pytest.approx([0.005, 0.005])
    assert hand.close_s == pytest.approx((OPEN - 0.015) / SPEED, abs=0.03)


def test_a_joint_that_does_not_close_stays_where_a_grasp_puts_it() -> None:
    """Fails where a finger that was spread otherwise in the trial that shows the close goes there:
    the noise of its encoder says to which side it is bound.
    """
    way = path(0.005)
    way[:, 1] = OPEN
    closing = recorded_closing(
        gripper(), np.full(2, OPEN), way, BETWEEN, np.array([0.005, OPEN - 1e-5])
    )
    assert closing is not None
    hand = closing_as(gripper(), closing, "estimates")
    assert hand.targets(10.0, np.array([OPEN, 0.02])) == pytest.approx([0.005, 0.02], abs=1e-4)


def test_jaws_that_have_opened_again_do_not_rest_empty() -> None:
    """Fails where a hand that waits for its next try is said to close to where it stands then."""
    opened = np.full(2, OPEN)
    closing = recorded_closing(gripper(), opened, path(0.015), BETWEEN, np.full(2, 0.035))
    assert closing is not None
    hand = closing_as(gripper(), closing, "recorded")
    assert hand.targets(10.0, opened) == pytest.approx([0.0, 0.0])


def test_free_jaws_move_in_physics_as_recorded() -> None:
    """Fails where drives that follow late make the twin's fingers late: by 6 mm here."""
    hand = moved_as_recorded(gripper(), np.full(2, OPEN), path(0.015), NOTHING)
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    hand.add(spec, spec.worldbody.add_body(name="base"))
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = OPEN
    for k, recorded in enumerate(path(0.015)[:40]):
        data.ctrl[:] = hand.targets(k * PERIOD_S, np.full(2, OPEN))
        mujoco.mj_step(model, data, round(PERIOD_S / model.opt.timestep))
        assert data.qpos == pytest.approx(recorded, abs=2.5e-3)


BESIDE_ONE = np.array([[0.0, 0.015, 0.1]])  # beside one jaw, 30 mm from the other


def test_a_finger_that_ends_with_the_free_ones_was_not_stopped() -> None:
    """Fails where fingers of an empty close go on, as something they did not touch was near."""
    hand = moved_as_recorded(gripper(), np.full(2, OPEN), path(0.015), BESIDE_ONE)
    at = np.full(2, 0.015)
    assert hand.targets(10.0, np.full(2, OPEN)) == pytest.approx(at)
    near = int(np.argmin(np.linalg.norm(gripper().geometry.tips_at(at) - BESIDE_ONE, axis=1)))
    earlier = path(0.0)
    earlier[:, near] = path(0.015)[:, 0]
    hand = moved_as_recorded(gripper(), np.full(2, OPEN), earlier, BESIDE_ONE)
    assert hand.targets(10.0, np.full(2, OPEN)) == pytest.approx([0.0, 0.0])
