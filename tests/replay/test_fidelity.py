"""Catches a replay told as faithful to a robot that believed something else, and the other way."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from dgeval import api
from dgeval.config import load_config
from dgeval.geometry import matrix_from_pose, pose_from_matrix
from dgeval.planning.control import Choice, Control, GraspResult
from dgeval.planning.proposals import Proposals
from dgeval.planning.servo import ServoCommand
from dgeval.recording.contract import COMMAND_TOPIC, MASK_TOPIC, TARGET_TOPIC, VELOCITY_TOPIC
from dgeval.recording.messages import StampedPose
from dgeval.recording.scan import TopicTimes
from dgeval.replay import fidelity
from dgeval.replay.causal import Step
from dgeval.replay.fidelity import Compared, fidelity_notes
from dgeval.replay.replayed import Replayed
from dgeval.verdict.log import Recorded

CONFIG = load_config("dynamic")
FRAMES = 30
Recording = tuple[Any, list[Step]]


@pytest.fixture(scope="module")
def replayed(demo: Path) -> Recording:
    """A trial and its first two seconds of replay, in which the target was seen."""
    trial = api.open_trial(demo)
    return trial, list(itertools.islice(api.replay_trial(trial), FRAMES))


def beside(
    replayed: Recording,
    monkeypatch: pytest.MonkeyPatch,
    late_ns: int = 0,
    pose: Callable[[int, np.ndarray], np.ndarray] = lambda _, T: T,
    velocity: float = 0.0,
    twist: float = 1.0,
    mask_px: int = 0,
    every: int = 1,
) -> dict[str, fidelity.Fidelity]:
    """The stages of a replay beside a robot that believed the same, but for what is given.

    late_ns: of the target's stamps. pose(frame, T_camera_model). velocity: m/s more. twist: factor.
    mask_px: by which its masks are wider. every: frame of which something is recorded.
    """
    trial, steps = replayed
    own = steps[::every]
    axes = np.eye(4)  # the robot's model has axes of its own
    axes[:3, :3], axes[:3, 3] = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], (0.1, 0.2, 0.3)
    poses = [
        StampedPose(
            s.frame.t_ns + late_ns,
            "",
            "",
            pose_from_matrix(pose(s.frame.index, s.T_camera_model) @ axes),  # type: ignore[arg-type]
        )
        for s in own
        if s.T_camera_model is not None
    ]
    more = np.array([0, 0, velocity, 0, 0, 0])
    speeds = [
        (s.frame.t_ns, np.append(s.perceived.estimate.velocity, np.zeros(3)) + more)
        for s in own
        if s.perceived.estimate is not None
    ]
    commands = [
        (c.t_ns, c.command.twist * twist) for s in own for c in s.periods if c.command is not None
    ]
    masks = []
    for s in own:
        whole = np.zeros(s.frame.depth.shape, np.uint8)
        if s.tracked.mask is not None and s.tracked.window is not None:
            x0, y0, x1, y1 = s.tracked.window
            whole[y0:y1, x0:x1] = s.tracked.mask
        wider = np.ones((1, 2 * mask_px + 1), np.uint8)
        masks.append((s.frame.t_ns, cv2.dilate(whole, wider) > 0))
    scan = replace(
        trial.scan,
        poses={TARGET_TOPIC: poses},
        twists={VELOCITY_TOPIC: speeds, COMMAND_TOPIC: commands},
        times={MASK_TOPIC: TopicTimes()},
        numbers={},
    )
    monkeypatch.setattr(
        fidelity,
        "_masks",
        lambda _, since, until: fidelity._in_order([m for m in masks if since <= m[0] <= until]),
    )
    compared = Compared(replace(trial, scan=scan), CONFIG)
    for step in steps:
        compared.add(step)
    return {one.stage: one for one in compared.until(steps[-1].frame.t_ns)}


def test_a_robot_that_believed_the_same(
    replayed: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fails where the axes of the robot's model, or of its grasps, count as an error."""
    found = beside(replayed, monkeypatch)
    assert {name: one.is_faithful for name, one in found.items()} == dict.fromkeys(
        ("target", "velocity", "mask", "twist"), True
    )
    assert all(max(one.errors) < 1e-6 for one in found.values())
    (note,) = fidelity_notes(tuple(found.values()))
    assert note.count("(faithful)") == 4
    assert fidelity_notes(()) == []


def commanding(replayed: Recording, factor: float, velocity: float | None = None) -> Compared:
    """A replay beside a robot of which only commands are recorded, and velocities if given."""
    trial, steps = replayed
    commands = [
        (c.t_ns, c.command.twist * factor)
        for s in steps
        for c in s.periods
        if c.command is not None
    ]
    twists = {COMMAND_TOPIC: commands}
    if velocity is not None:
        own = [(s.frame.t_ns, s.perceived.estimate) for s in steps]
        more = np.array([velocity, 0, 0, 0, 0, 0])
        twists[VELOCITY_TOPIC] = [
            (t, np.append(e.velocity, np.zeros(3)) + more) for t, e in own if e is not None
        ]
    scan = replace(trial.scan, poses={}, twists=twists, times={}, numbers={})
    compared = Compared(replace(trial, scan=scan), CONFIG)
    for step in steps:
        compared.add(step)
    return compared


def test_a_replay_speaks_for_a_robot_that_commanded_the_same(replayed: Recording) -> None:
    """Fails where a replay whose commands are others', or one with another velocity, speaks."""
    _, steps = replayed
    end_ns = steps[-1].frame.t_ns
    assert commanding(replayed, 1.0).speaks(end_ns)
    assert commanding(replayed, 1.0, 0.0).speaks(end_ns)
    assert not commanding(replayed, 1.2).speaks(end_ns)
    assert not commanding(replayed, 1.0, 0.02).speaks(end_ns)
    assert not commanding(replayed, 1.0).speaks(steps[0].frame.t_ns)  # too little is recorded


def test_a_faithful_replay_completes_what_the_robot_recorded(replayed: Recording) -> None:
    """Fails where a recorded belief is replaced, or a model is put beside another's poses."""
    _, steps = replayed
    own = commanding(replayed, 1.0).own
    known = [s for s in steps if s.T_camera_model is not None]
    assert [p.t_ns for p in own.targets] == [s.frame.t_ns for s in known]
    assert np.allclose(matrix_from_pose(own.targets[-1].pose), known[-1].T_camera_model)
    assert own.seen_ns == [s.frame.t_ns for s in steps if s.accepted]
    times = [c.t_ns for s in steps for c in s.periods if c.grasps is not None and c.grasps.choice]
    assert [p.t_ns for p in own.grasps] == times
    speeds = [(5, np.ones(6))]
    empty = np.zeros(0, dtype=np.int64)
    recorded = Recorded((), (), empty, tuple(speeds), (), lambda _: None)
    completed = recorded.completed_by(own)
    assert (completed.source, completed.velocities) == ("replayed_faithful", tuple(speeds))
    assert (list(completed.targets), list(completed.grasps)) == (own.targets, own.grasps)
    assert completed.seen_ns.tolist() == own.seen_ns
    assert np.array_equal(completed.model(0), steps[-1].model.points)  # type: ignore[arg-type,union-attr]
    theirs = replace(recorded, targets=tuple(own.targets[:3]), grasps=tuple(own.grasps[:3]))
    assert theirs.completed_by(own) is theirs
    half = replace(recorded, targets=tuple(own.targets[:3])).completed_by(own)
    assert (len(half.targets), half.model(0), half.seen_ns.tolist()) == (3, None, [])


def drifts(frame: int, T: np.ndarray) -> np.ndarray:
    """A belief that slides off by 0.3 mm a frame."""
    out = T.copy()
    out[0, 3] += 0.0003 * frame
    return out


@pytest.mark.parametrize(
    ("given", "stage"),
    [
        ({"pose": drifts}, "target"),
        ({"late_ns": 66_666_667}, "target"),  # one frame, of a target that moves at 0.08 m/s
        ({"velocity": 0.012}, "velocity"),
        ({"twist": 1.2}, "twist"),
        ({"mask_px": 12}, "mask"),
    ],
)
def test_another_robot_is_found_at_its_stage(
    given: dict[str, Any], stage: str, replayed: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fails where one stage's difference is told of another, or not at all."""
    found = beside(replayed, monkeypatch, **given)
    assert [name for name, one in found.items() if not one.is_faithful] == [stage]
    assert found[stage].word == "not faithful"


def test_a_few_values_say_nothing(replayed: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails where two matching values in the last second make a replay faithful."""
    found = beside(replayed, monkeypatch, every=5)
    for stage in ("target", "velocity", "mask"):
        assert found[stage].is_faithful is None
        assert found[stage].word == "not known"
        assert "recorded values" in found[stage].told


def test_a_replay_that_lost_what_the_robot_tracked_is_not_faithful(
    replayed: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fails where a replay without a target is told as nothing recorded."""
    trial, steps = replayed
    lost = replace(steps[-1].perceived.fused, centroid=None)
    blind = [
        replace(s, perceived=replace(s.perceived, fused=lost, estimate=None)) for s in steps[10:]
    ]
    monkeypatch.setattr(fidelity, "LAST_S", 1.2)
    monkeypatch.setattr(Compared, "add", added_from(blind, Compared.add))
    found = beside((trial, steps), monkeypatch)
    for stage in ("target", "velocity"):
        assert found[stage].is_faithful is False
        assert "the replay has none in most of" in found[stage].told


def added_from(blind: list[Step], add: Callable[[Compared, Step], None]) -> Any:
    """`Compared.add`, with frames from the tenth on in place of those of the same number."""
    return lambda compared, step: add(
        compared, blind[step.frame.index - 10] if step.frame.index >= 10 else step
    )


def test_what_is_taken_from_the_log_is_not_held_against_it(demo: Path) -> None:
    """Fails where a recorded grasp, used by the replay, shows how faithful the replay is."""
    trial = api.open_trial(demo)
    compared = Compared(trial, CONFIG)
    choice = Choice(np.eye(4), 0.9, 0.8, 0.7)
    zero = ServoCommand(0.0, 0.0, np.zeros(6))
    step: Any = SimpleNamespace(
        frame=SimpleNamespace(t_ns=trial.pairs[20].t_ns),
        T_base_camera=None,
        candidates=None,
        T_camera_model=None,
        model=None,
        accepted=False,
        perceived=SimpleNamespace(estimate=None),
        tracked=SimpleNamespace(mask=None, window=None),
        periods=[
            Control(trial.pairs[20].t_ns - k * 10_000_000, GraspResult(1, choice), True, zero)
            for k in range(60, 0, -1)
        ],
    )
    compared.add(step)
    stages = {one.stage for one in compared.until(trial.pairs[20].t_ns)}
    assert not stages & {"grasp", "score"}


@pytest.mark.parametrize(
    ("decided_ms", "score", "away_m", "expected"),
    [
        (500, 0.5, 0.0, {"grasp": True, "score": True, "decision": True}),
        (520, 0.5, 0.0, {"grasp": True, "score": True, "decision": False}),
        (None, 0.5, 0.0, {"grasp": True, "score": True, "decision": False}),
        (500, 0.56, 0.0, {"grasp": True, "score": False, "decision": True}),
        # the score is then of another grasp's fingers
        (500, 0.5, 0.006, {"grasp": False, "decision": True}),
    ],
)
def test_the_choice_of_a_replay_that_chooses_itself(
    decided_ms: int | None,
    score: float,
    away_m: float,
    expected: dict[str, bool],
    demo: Path,
) -> None:
    """Fails where a decision 20 ms later, another score or another grasp is told as the same."""
    config = load_config("dynamic", ("grasps.source=ffhnet",))
    trial = api.open_trial(demo, config)
    first = trial.pairs[0].t_ns
    times = [first + k * 10_000_000 for k in range(100)]
    numbers = {
        "/dgeval/belief/score": [(t, 0.5) for t in times],
        "/dgeval/belief/execute": [(t, float(t >= first + 500_000_000)) for t in times],
    }
    identity = np.array([0, 0, 0, 0, 0, 0, 1.0])
    poses = {"/dgeval/belief/grasp": [StampedPose(t, "", "", identity) for t in times]}
    scan = replace(trial.scan, numbers=numbers, poses=poses, twists={}, times={})
    compared = Compared(replace(trial, scan=scan), config)
    grasp = np.eye(4)
    grasp[0, 3] = away_m
    result = GraspResult(9, Choice(grasp, score, 0.8, 0.7))
    periods = [
        Control(t, result, decided_ms is not None and t >= first + decided_ms * 1_000_000, None)
        for t in times
    ]
    step: Any = SimpleNamespace(
        frame=SimpleNamespace(t_ns=times[-1]),
        T_base_camera=None,
        candidates=None,
        T_camera_model=None,
        model=None,
        accepted=False,
        perceived=SimpleNamespace(estimate=None),
        tracked=SimpleNamespace(mask=None, window=None),
        periods=periods,
    )
    compared.add(step)
    stages = compared.until(times[-1])
    assert {one.stage: one.is_faithful for one in stages} == expected
    never = "decision: one of the two never closes (not faithful"
    assert (never in fidelity_notes(stages)[0]) is (decided_ms is None)


@pytest.mark.parametrize(
    ("changed", "stage"),
    [
        ("servo.c_p_v=1.2", "twist"),
        ("servo.c_d_v=2.4", "twist"),
        ("servo.c_O=0.24", "twist"),
        ("estimation.sigma_acceleration=0.6", "velocity"),
    ],
)
def test_a_stage_is_told_by_what_it_makes_of_the_robots_own_inputs(
    changed: str, stage: str, replayed: Recording
) -> None:
    """Fails where 20 % of a gain hides within the bound of the twist, or is told of another stage.

    The steps are the robot's own, so that nothing but the stages on its inputs can differ.
    """
    trial, steps = replayed
    own = Replayed()
    for step in steps:
        own.add(step)
    robot = own.as_robot(trial)
    for given, expected in (((), set()), ((changed,), {stage})):
        compared = Compared(robot, load_config("dynamic", given))
        for step in steps:
            compared.add(step)
        found = compared.until(steps[-1].frame.t_ns)
        assert {one.stage for one in found if one.is_same is False} == expected
        assert {one.stage for one in found if one.is_same is not None} == {"velocity", "twist"}
        assert all(one.is_faithful for one in found)


def test_what_two_seeds_are_apart_is_no_difference(
    replayed: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fails where seeds excuse what they don't reach, or one they don't touch is doubted."""
    trial, steps = replayed
    found = beside(replayed, monkeypatch, velocity=0.012)["velocity"]
    as_far, nearer = (fidelity._beside_seeds(found, (s,)) for s in (0.013, 0.011))
    assert (as_far.is_faithful, as_far.word, nearer.is_faithful) == (None, "not known", False)
    assert "two seeds of the replay: 13 mm/s apart" in as_far.told
    assert "two seeds of the replay: 11 mm/s apart" in nearer.told
    good = beside(replayed, monkeypatch)["velocity"]
    assert fidelity._beside_seeds(good, (0.5,)).is_faithful
    # another seed of the same replay is drawn, and held against it
    own = Replayed()
    for step in steps:
        own.add(step)
    seeds: list[int] = []

    def drawn(_: Any, config: Any, **__: Any) -> list[Step]:
        seeds.append(config.seed)
        return steps

    monkeypatch.setattr(fidelity, "replay", drawn)
    config = load_config("dynamic", ("fidelity.seeds=2", "seed=4"))
    spread = fidelity.spread_of(trial, config, own, steps[-1].frame.t_ns)
    assert seeds == [5, 6]
    assert set(spread) == {"target", "velocity", "twist"}
    assert max(max(errors) for errors in spread.values()) < 1e-9


def test_a_replay_that_ruled_out_every_candidate_is_recorded_too(replayed: Recording) -> None:
    """Fails where an empty set of candidates costs the trial."""
    trial, steps = replayed
    own = Replayed()
    own.add(steps[0])
    drawn = Proposals(np.eye(4)[None], np.zeros((1, 0)), np.array([0.5]), left_out={0})
    own.candidates.append((steps[0].frame.t_ns, np.eye(4), drawn))
    assert own.as_robot(trial).choices.candidates == ()


@pytest.mark.parametrize("late_s", [0.0, 0.065, -0.03])
def test_a_delay_is_told_as_one(late_s: float) -> None:
    """Fails where a delay has the other sign, or another value than the one it has."""
    seconds = np.arange(100) * 0.01
    theirs = [(round(t * 1e9), np.array([np.sin(9 * t), t, 0.0])) for t in seconds]
    ours = [
        (round(t * 1e9), np.array([np.sin(9 * (t - late_s)), t - late_s, 0.0])) for t in seconds
    ]
    assert fidelity._delay(ours, theirs, 1e-3) == pytest.approx(late_s)
    shifted = [(t, v + np.array([0.006, 0.0, 0.0])) for t, v in theirs]
    assert fidelity._delay(shifted, theirs, 1e-3) == 0.0
    noise = np.random.default_rng(0).normal(0, 1, (100, 3))
    noisy = [(t, v + n) for (t, v), n in zip(theirs, noise, strict=True)]
    assert fidelity._delay(noisy, theirs, 1e-3) == 0.0
    told = fidelity.Fidelity("velocity", 30, (0.02,), False, late_s=late_s).told
    assert ("as if later by 65 ms" in told) is (late_s > 0)
    assert ("as if earlier by 30 ms" in told) is (late_s < 0)
