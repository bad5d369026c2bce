"""Catches: what other trials show of a hand, lost, mixed up, or used where the trial shows it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dgeval.errors import UsageError
from dgeval.recording.messages import JointSample
from dgeval.robots.described_hand import DescribedHand
from dgeval.runs.estimates import estimates_of, read_estimates, shown_as_json
from dgeval.verdict.described_grip import described_grip
from dgeval.verdict.draws import draws_of
from dgeval.verdict.estimates import Estimates, HandShown, hand_shown
from dgeval.verdict.evidence import Scene, scene_of
from dgeval.verdict.log import HandEstimate, TrialLog, log_of
from dgeval.verdict.outcome import Ended, outcome_of
from dgeval.verdict.recorded_closing import Closing, closing_as, slowed
from dgeval.verdict.recorded_force import recorded_force
from tests.verdict.synthetic_trial import RECORDED, hindsight_of, joint_samples, trial_of, urdf_of
from tests.verdict.test_described_grip import CLOSE_S, END_S, OPEN, gripper, states
from tests.verdict.test_described_verdict import renamed

WAY = np.linspace(OPEN, 0.01, 30)[1:]


def closing(periods: int = 29, stopped: bool = False) -> Closing:
    """Of both jaws, to 10 mm."""
    way = np.repeat(np.linspace(OPEN, 0.01, periods + 1)[1:, None], 2, axis=1)
    return Closing(np.full(2, OPEN), way, np.full(2, -0.001 if stopped else 0.0))


def shown(made: Closing | None, rest: float | None = None) -> dict[str, Any]:
    geometry = gripper().geometry
    empty = None if rest is None else np.full(2, rest)
    return shown_as_json(
        HandShown(geometry.key, "a jaw", geometry.names, geometry.spans, made, empty)
    )


def read(tmp_path: Path, trials: list[tuple[str, dict[str, Any]]]) -> Estimates:
    text = estimates_of(trials)
    assert text is not None
    (tmp_path / "estimates.json").write_text(text)
    return read_estimates(tmp_path)


def test_the_closing_that_nothing_stopped_and_that_took_the_middle_time(tmp_path: Path) -> None:
    """Fails where it depends on the trials' order, or is one that an object stopped."""
    trials = [
        ("d", shown(closing(20))),
        ("a", shown(closing(30, stopped=True))),
        ("c", shown(closing(31))),
        ("b", shown(closing(60))),
        ("e", shown(None)),
    ]
    text = estimates_of(trials)
    assert text == estimates_of(trials[::-1])
    assert text is not None
    told = json.loads(text)["hands"][0]["closing"]
    assert told["trial"] == "c"
    assert told["trials"] == ["a", "b", "c", "d"]
    assert told["close_s_sd"] == pytest.approx(np.std([0.3, 0.6, 0.31, 0.2], ddof=1), abs=1e-6)
    found = read(tmp_path, trials).of(gripper())
    assert found is not None
    assert found.closing is not None
    assert found.closing.way == pytest.approx(closing(31).way, abs=1e-6)


def test_where_a_closing_ends_is_kept(tmp_path: Path) -> None:
    """Fails where another trial's close, which an object stopped, goes on to the limits."""
    made = replace(closing(stopped=True), until=np.full(2, 0.004))
    found = read(tmp_path, [("a", shown(made))]).of(gripper())
    assert found is not None
    assert found.closing is not None
    assert found.closing.until == pytest.approx([0.004, 0.004])
    hand = closing_as(gripper(), found.closing, "estimates")
    assert hand.targets(10.0, np.full(2, OPEN)) == pytest.approx([0.004, 0.004])


def test_what_two_trials_agree_on_is_an_empty_close(tmp_path: Path) -> None:
    """Fails where one trial's rest, such as an object's size, is how the hand closes on nothing."""
    one = [("a", shown(closing(), 0.020)), ("b", shown(closing(), 0.010))]
    found = read(tmp_path, one).of(gripper())
    assert found is not None
    assert found.empty is None
    two = [*one, ("c", shown(closing(), 0.0104))]
    found = read(tmp_path, two).of(gripper())
    assert found is not None
    assert found.empty == pytest.approx([0.0102, 0.0102])


def test_another_hand_takes_nothing(tmp_path: Path) -> None:
    found = read(tmp_path, [("a", shown(closing()))])
    hand = gripper()
    joints = hand.geometry.description.joints
    longer = {k: replace(j, upper=2 * j.upper) for k, j in joints.items()}
    other = replace(hand.geometry.description, joints=longer)
    assert found.of(replace(hand, geometry=replace(hand.geometry, description=other))) is None
    assert found.of("no hand") is None
    assert estimates_of([]) is None


@pytest.mark.parametrize(
    "damage",
    [
        lambda t: {**t, "version": 2},
        lambda t: {**t, "period_s": 0.02},
        lambda t: {**t, "hands": [{**t["hands"][0], "joints": ["jaw"]}]},
        lambda t: {**t, "hands": [{**t["hands"][0], "new": 1}]},
        lambda t: [],
    ],
)
def test_a_file_that_holds_no_estimates_is_refused(tmp_path: Path, damage: Any) -> None:
    text = estimates_of([("a", shown(closing()))])
    assert text is not None
    path = tmp_path / "other.json"
    path.write_text(json.dumps(damage(json.loads(text))))
    with pytest.raises(UsageError, match="these are no estimates"):
        read_estimates(path)
    with pytest.raises(UsageError, match="can't be read"):
        read_estimates(tmp_path / "missing.json")


def ends(rest: float, effort: float | None = None) -> tuple[list[JointSample], list[JointSample]]:
    samples = states(rest, effort)
    return samples, [s for s in samples if s.t_ns > (END_S - 0.5) * 1e9]


@pytest.mark.parametrize(
    ("rest", "holds"), [(0.0105, False), (0.005, False), (0.025, True), (0.0, False)]
)
def test_a_width_tells_beside_that_of_an_empty_close(rest: float, holds: bool) -> None:
    """Fails where jaws without efforts say nothing although others show where they close."""
    samples, end = ends(rest)
    found = described_grip(gripper(), samples, round(CLOSE_S * 1e9), end, np.full(2, 0.010))
    assert found is not None
    assert found[0] is holds


def test_efforts_count_before_a_width(tmp_path: Path) -> None:
    """A commanded width short of an empty close is no grip where no finger presses."""
    samples, end = ends(0.025, 2.0)
    found = described_grip(gripper(), samples, round(CLOSE_S * 1e9), end, np.full(2, 0.010))
    assert found is not None
    assert not found[0]


# a whole trial


def described(close: float | None = 0.0, elsewhere: HandEstimate | None = None) -> TrialLog:
    """A trial of the five-finger hand under names that dgeval does not know."""
    samples = [
        replace(s, positions={renamed(k): v for k, v in s.positions.items()})
        for s in joint_samples(RECORDED)
    ]
    trial = trial_of(description=renamed(urdf_of()), joints=samples, close=close)
    assert isinstance(trial.robot.hand, DescribedHand)
    return log_of(trial, elsewhere)


def test_a_hand_that_never_closed_closes_as_in_another_trial() -> None:
    """Fails where it closes to its limits although another trial of it shows how it closes."""
    closed = scene_of(described(), hindsight_of())
    assert isinstance(closed, Scene)
    assert closed.closing is not None
    elsewhere = HandEstimate(closed.closing)
    log = described(None, elsewhere)
    never = scene_of(log, hindsight_of())
    assert isinstance(never, Scene)
    hand, recorded = never.gripper, closed.gripper
    assert isinstance(hand, DescribedHand)
    assert hand.closing_source == "estimates"
    assert hand.close_s == recorded.close_s
    before = closed.closing.before
    assert hand.targets(0.2, before) == pytest.approx(recorded.targets(0.2, before))
    # what the trial itself shows counts first
    own = scene_of(described(0.0, HandEstimate(closing())), hindsight_of())
    assert isinstance(own, Scene)
    assert isinstance(own.gripper, DescribedHand)
    assert own.gripper.closing_source == "recorded"
    alone = scene_of(described(None), hindsight_of())
    assert isinstance(alone, Scene)
    assert isinstance(alone.gripper, DescribedHand)
    assert alone.gripper.closing_source == "limits"


def test_only_what_is_known_to_have_failed_shows_an_empty_close() -> None:
    """Fails where fingers that say themselves that they are empty teach others so."""
    log = described()
    told = replace(log, label="failure")
    found = hand_shown(told, hindsight_of(), outcome_of(told, hindsight_of()), None)
    assert found is not None
    assert found.empty is not None
    assert found.closing is not None
    by_fingers = Ended("failure", "inferred", "", 0.03, by_fingers=True)
    found = hand_shown(told, hindsight_of(), by_fingers, None)
    assert found is not None
    assert found.empty is None
    assert hand_shown(described(None), hindsight_of(), by_fingers, None) is None


def test_a_close_that_no_trial_shows_has_no_certain_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails where the way to the limits in half a second is as good as a recorded close."""
    made: list[float] = []

    class StopError(ValueError):
        pass

    def twin(scene: Scene, *_: Any) -> Any:
        made.append(scene.gripper.close_s)
        if len(made) == 5:
            raise StopError
        from dgeval.worlds.hand_and_object import UnstableError

        raise UnstableError

    monkeypatch.setattr("dgeval.verdict.draws.Twin", twin)
    for source in ("limits", "recorded"):
        scene = scene_of(described(0.0 if source == "recorded" else None), hindsight_of())
        assert isinstance(scene, Scene)
        made.clear()
        draws_of(scene, "twin", 3, 0)
        assert made[0] == scene.gripper.close_s
        assert (len(set(made)) == 5) is (source == "limits")


def test_a_slower_hand_takes_the_same_way() -> None:
    hand = closing_as(gripper(), closing(), "recorded")
    slow = slowed(hand, 2.0)
    opened = np.full(2, OPEN)
    assert slow.targets(0.2, opened) == pytest.approx(hand.targets(0.1, opened))
    assert slow.close_s == 2 * hand.close_s


# force


def pressing(effort: float) -> list[JointSample]:
    """Jaws whose drives give so much, N, from 2 s on, and 0.5 N before the close."""
    return [
        replace(s, efforts=dict.fromkeys(s.positions, effort if s.t_ns > 2e9 else 0.5))
        for s in states(0.015, None)
    ]


@pytest.mark.parametrize(
    ("effort", "force"),
    [(20.5, (20 / 1.5, 30.0)), (-49.5, (50 / 1.5, 60.0)), (1.0, None), (700.0, None)],
)
def test_recorded_efforts_narrow_the_force(
    effort: float, force: tuple[float, float] | None
) -> None:
    """Fails where the zero of an effort counts, or per cent and milliamperes are taken for N."""
    found = recorded_force(gripper(), pressing(effort), round(CLOSE_S * 1e9), round(END_S * 1e9))
    assert found == (None if force is None else pytest.approx(force))


def test_no_drive_gives_more_than_its_description_says() -> None:
    """Fails where a draw of 60 N drives a gripper that is built for 20."""
    hand = gripper()
    joints = hand.geometry.description.joints
    weak = {k: replace(j, effort=20.0) for k, j in joints.items()}
    described = replace(hand.geometry.description, joints=weak)
    hand = replace(hand, geometry=replace(hand.geometry, description=described))
    assert hand.force_factors(1.0) == pytest.approx([1.0, 1.0])
    assert hand.force_factors(4.0) == pytest.approx([20 / 15, 20 / 15])
    assert gripper().force_factors(4.0) == pytest.approx([4.0, 4.0])
