"""Catches grasps that stay behind their target, and decisions that fall between two frames."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from dgeval.config import Config, load_config
from dgeval.geometry import invert
from dgeval.perception.types import Model
from dgeval.planning import model_grasps
from dgeval.planning.carried import Belief
from dgeval.planning.control import Controller, HandState
from dgeval.planning.model_grasps import FFHNetProposals, ModelGrasps
from dgeval.planning.proposals import Proposals
from dgeval.planning.recorded_arm import RecordedArm
from dgeval.planning.recorded_grasps import RecordedGrasps
from dgeval.recording.choices import Numbers, RecordedChoices
from dgeval.recording.robot import JointTrack, RobotStates
from dgeval.recording.transforms import TransformTree
from dgeval.replay.causal import recorded_decisions
from dgeval.robots.hand import hand_named

HAND = hand_named("dlr_hit_hand")
MODEL = Model(np.array([[0.0, 0, 0], [0.02, 0, 0]]), np.tile([0.0, 0, 1], (2, 1)))
FRAME_NS, STATE_NS = 33_333_333, 10_000_000


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


class NearScores(Proposals):
    """Candidates whose evaluator says how near the hand is to the first of them."""

    def hand_scores(self, T_object_palm: Any, preshapes: Any, networks: Any) -> Any:  # noqa: ARG002
        apart = np.linalg.norm(T_object_palm[:, :3, 3] - self.T_object_palm[0, :3, 3], axis=1)
        return np.exp(-apart / 0.1)


@pytest.fixture
def two_grasps(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Two candidates to the left and right of the target, and the times they were drawn at."""
    drawn: list[float] = []

    def draw(points: Any, T_base_object: Any, *_: Any) -> Proposals:
        drawn.append(float(T_base_object[1, 3]))
        poses = np.array([at(-0.1, 0, 0.05), at(0.1, 0, 0.05)])
        return NearScores(poses, np.zeros((2, 15)), np.array([0.8, 0.8]))

    networks: Any = type("Networks", (), {"c_e": 0.7})()
    monkeypatch.setattr(model_grasps, "drawn_proposals", draw)
    monkeypatch.setattr(model_grasps, "networks_of", lambda _: networks)
    return drawn


def robot() -> RobotStates:
    return RobotStates(TransformTree(), "camera", "base", "palm", None, (), JointTrack(), ())


def belief(t_ns: int, velocity: float, seen: bool) -> Belief:
    """Of a target that moves along y, as replay hands it on: carried to its frame already."""
    y = velocity * t_ns * 1e-9
    return Belief(t_ns, at(y=y), np.array([0, velocity, 0]), seen)


def ffhnet_grasps(config: Config) -> ModelGrasps:
    """Grasps for a robot of which nothing is known."""
    arm = RecordedArm(robot(), config.sync.max_pose_gap_s)
    return ModelGrasps(FFHNetProposals(config), arm.reaches, config)


def run_blind(config: Config, velocity: float, palm_x: float) -> tuple[Controller, list[Any]]:
    """One frame with the target, then half a second of frames without it, states at 100 Hz.

    palm_x: where the hand is from the first lost frame on, m.
    """
    controller = Controller(ffhnet_grasps(config), HAND, config)
    controller.see(0, 0, belief(0, velocity, True), MODEL, np.eye(4))
    out = controller.run([HandState(0, at(-0.3), np.eye(4))])
    for k in range(1, 16):
        t_ns = k * FRAME_NS
        first = -(-(t_ns - FRAME_NS + 1) // STATE_NS) * STATE_NS
        stamps = range(first, t_ns, STATE_NS)
        out += controller.run([HandState(t, at(palm_x), np.eye(4)) for t in stamps])
        controller.see(t_ns, k, belief(t_ns, velocity, False), MODEL, np.eye(4))
    return controller, [*out, controller.at(HandState(500_000_000, at(palm_x), np.eye(4)))]


def test_a_grasp_goes_on_with_its_target_while_it_is_not_seen(two_grasps: list[float]) -> None:
    """Fails where the grasp stays where the newest accepted frame put it: 100 mm off after half a
    second at 0.2 m/s.
    """
    config = load_config("dynamic")
    for velocity in (0.2, 0.0):
        _, periods = run_blind(config, velocity, -0.3)
        places = np.array([p.grasps.choice.T_base_palm[:3, 3] for p in periods])
        moved = places[-1] - places[0]
        assert np.allclose(moved, [0, velocity * 0.5, 0], atol=1e-9)
    assert two_grasps == [0.0, 0.0], "drawn once each: a lost frame has no new candidates"


def test_what_was_chosen_stays_chosen_while_the_target_is_not_seen(
    two_grasps: list[float],
) -> None:
    """Fails where the choice changes with nothing new known: the hand is nearer to the other one
    from the first lost frame on.
    """
    config = load_config("dynamic")
    controller, periods = run_blind(config, 0.0, 0.3)
    lost = [p for p in periods if p.t_ns > FRAME_NS]
    assert {float(p.grasps.choice.T_base_palm[0, 3]) for p in lost} == {0.1}, "as of the frame"
    hand = HandState(510_000_000, at(-0.3), np.eye(4))
    assert controller.at(hand).grasps.choice.T_base_palm[0, 3] == 0.1  # type: ignore[union-attr]
    controller.see(520_000_000, 16, belief(520_000_000, 0.0, True), MODEL, np.eye(4))
    seen = controller.at(replace(hand, t_ns=520_000_000))
    assert seen.grasps.choice.T_base_palm[0, 3] == -0.1  # type: ignore[union-attr]
    assert len(two_grasps) == 2


def test_a_stated_latency_is_made_up_for(two_grasps: list[float]) -> None:
    """Fails where a late result is used as if it were of now: 20 mm behind at 0.2 m/s."""
    config = load_config("dynamic", ("schedule.perception_latency_s=0.1",))
    controller = Controller(ffhnet_grasps(config), HAND, config)
    controller.see(0, 0, belief(0, 0.2, True), MODEL, np.eye(4))
    early, usable = controller.run(
        [HandState(t, at(-0.3), np.eye(4)) for t in (90_000_000, 100_000_000)]
    )
    assert early.grasps is None
    assert usable.grasps is not None
    assert usable.grasps.choice is not None
    assert usable.grasps.choice.T_base_palm[1, 3] == pytest.approx(0.02)
    assert two_grasps == [0.0]


def test_the_hand_is_scored_where_it_is_on_the_target(two_grasps: list[float]) -> None:
    """Fails where the hand's score is of another state of a batch, or of a target left behind."""
    config = load_config("dynamic")
    controller = Controller(ffhnet_grasps(config), HAND, config)
    controller.see(0, 0, belief(0, 0.2, True), MODEL, np.eye(4))
    stamps = (0, 100_000_000, 200_000_000)
    hands = [at(-0.1 - 0.1 * k, 0.02 * k, 0.05) for k in range(3)]  # with the target along y
    states = [HandState(t, hand, np.eye(4)) for t, hand in zip(stamps, hands, strict=True)]
    scores = [p.grasps.choice.hand_score for p in controller.run(states)]  # type: ignore[union-attr]
    assert scores == pytest.approx(np.exp([0.0, -1.0, -2.0]))
    executed = [p.execute for p in controller.run(states[:2])]
    assert executed == [True, False], "0.7 lies between the first two"
    assert len(two_grasps) == 1


def recorded(**given: Any) -> RecordedChoices:
    return RecordedChoices((0,), (at(0.0),), **given)


def test_a_threshold_that_is_crossed_between_two_frames_is_seen() -> None:
    """Fails where execution is asked at frames alone: the replay would never have closed."""
    peak = Numbers((0, 50_000_000, 60_000_000), (0.2, 0.9, 0.3))
    config = load_config("dynamic")
    controller = Controller(RecordedGrasps(recorded(hand_scores=peak), config), HAND, config)
    states = [HandState(t, at(0.01), None) for t in range(0, 100_000_000, STATE_NS)]
    executed = [p.t_ns for p in controller.run(states) if p.execute]
    assert executed == [50_000_000]
    frames = (0, FRAME_NS, 2 * FRAME_NS)
    assert not any(controller.at(HandState(t, at(0.01), None)).execute for t in frames)


def test_the_robots_own_decision_counts_where_it_is_recorded() -> None:
    """Fails where a score under the threshold overrules the robot that did close."""
    config = load_config("dynamic")
    given = recorded(
        hand_scores=Numbers((0,), (0.2,)), decisions=Numbers((0, 40_000_000), (0.0, 1.0))
    )
    controller = Controller(RecordedGrasps(given, config), HAND, config, given.decisions)
    states = [HandState(t, at(0.01), None) for t in range(0, 60_000_000, STATE_NS)]
    assert [p.t_ns for p in controller.run(states) if p.execute] == [40_000_000, 50_000_000]
    later = Controller(RecordedGrasps(given, config), HAND, config, Numbers((90_000_000,), (1.0,)))
    assert [p.execute for p in later.run(states)] == [None] * len(states), "absent is not no"


@pytest.mark.parametrize(
    ("settings", "count"),
    [((), True), (("execution.c_e=0.5",), False), (("schedule.grasps_latency_s=0.1",), False),
     (("execution.c_e=0.5", "execution.decision=recorded"), True)],
)  # fmt: skip
def test_decisions_speak_of_the_grasps_as_the_robot_had_them(
    settings: tuple[str, ...], count: bool
) -> None:
    """Fails where grasps that come later, or another threshold, change nothing."""
    given = recorded(decisions=Numbers((0,), (1.0,)))
    found = recorded_decisions(given, "recorded", load_config("dynamic", settings))
    assert found == (given.decisions if count else None)


def test_the_metric_is_that_of_the_grasps_own_score() -> None:
    """Fails where the score of the hand as it is stands in equations 3 to 5 for the grasp's."""
    config = load_config("dynamic")
    hand, own = Numbers((0,), (0.2,)), Numbers((0,), (0.9,))
    for scores, metric in ((own, 0.9 - 0.1 * 0.5), (Numbers(), None)):
        grasps = RecordedGrasps(recorded(scores=scores, hand_scores=hand), config)
        result = Controller(grasps, HAND, config).at(HandState(0, at(0.5), None)).grasps
        assert result is not None
        assert result.choice is not None
        assert result.choice.metric == (None if metric is None else pytest.approx(metric))
        assert result.choice.hand_score == 0.2


def test_control_periods_are_the_states_of_what_moves_fastest() -> None:
    """Fails where the camera's rate, or a slow link's, is taken for that of control."""
    tree = TransformTree()
    pose = np.array([0, 0, 0, 0, 0, 0, 1.0])
    for t in range(0, 1_000_000_000, 100_000_000):
        tree.add_moving(t, "base", "arm", pose)
    for t in range(0, 1_000_000_000, 2_000_000):
        tree.add_moving(t, "arm", "palm", np.concatenate([[t * 1e-9], pose[1:]]))
    states = replace(robot(), tree=tree)
    assert np.diff(states.palm_stamps(0.008)).tolist() == [8_000_000] * 124
    assert len(states.palm_stamps(0.001)) == 500
    jitter = np.random.default_rng(0).uniform(-2e5, 2e5, 125)
    tree = TransformTree()
    for k, late in enumerate(jitter):
        at_125_hz = np.concatenate([[k * 0.01], pose[1:]])
        tree.add_moving(round(k * 8e6 + late), "base", "palm", at_125_hz)
    for t in range(0, 1_000_000_000, 2_000_000):
        tree.add_moving(t, "palm", "mount", pose)  # said again and again, and never moved
    states = replace(robot(), tree=tree, palm_frame="mount")
    assert len(states.palm_stamps(0.008)) == 125, "none is left out for its jitter"
    assert replace(states, palm_frame=None).palm_stamps(0.008) == []


def test_a_belief_is_carried_both_ways_in_time() -> None:
    """Closed form: position plus velocity times time, the orientation kept."""
    T = at(0.1, 0.2, 0.3)
    T[:3, :3] = np.diag([-1.0, -1.0, 1.0])
    b = Belief(1_000_000_000, T, np.array([0.2, 0, -0.1]), True)
    for seconds in (0.5, -0.25, 0.0):
        T_then = b.at(1_000_000_000 + round(seconds * 1e9))
        expected = np.array([0.2, 0, -0.1]) * seconds
        assert np.allclose((T_then - T)[:3, 3], expected, atol=1e-12)
        assert np.array_equal(T_then[:3, :3], T[:3, :3])
    assert np.array_equal(invert(T) @ b.T_base_object, np.eye(4))
