"""Catches: a gripper in another frame, of another width or of other links than the log's own."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.config import Config
from dgeval.geometry import Array, increment, invert, transform
from dgeval.perception.types import Observation
from dgeval.planning.vfas import replayed
from dgeval.planning.vfas.gripper import Gripper, apart, gripper_of, trained_gripper
from dgeval.planning.vfas.selection import Selected
from dgeval.replay.notes import vfas_notes
from dgeval.robots.described_hand import DescribedHand, described_hand
from dgeval.robots.dlr_hit_hand import HAND as FIVE_FINGERS
from dgeval.robots.hand import hand_for
from dgeval.robots.hand_links import HandLinks, hand_links
from dgeval.robots.loading import load_description
from dgeval.robots.urdf import robot_urdf
from tests.robots.urdf_texts import GRIPPER, PADS, box, joint, robot


def described(text: str, palm: str, opened: float, T_base_palm: Array) -> DescribedHand:
    description = load_description(text, "a test", (), 0.01)
    recorded = {j.name for j in description.joints.values() if j.follows == j.name}
    links = hand_links(description, palm, recorded)
    assert isinstance(links, HandLinks), links
    start = np.full(len(links.joints(description)), opened)
    return described_hand(description, links, T_base_palm, start)


def of(hand: DescribedHand) -> Gripper:
    gripper = gripper_of(hand)
    assert isinstance(gripper, Gripper), gripper
    return gripper


@pytest.mark.parametrize("opened", [0.04, 0.015])
def test_frame_width_and_links_are_the_descriptions(opened: float) -> None:
    """Pads of 10 x 20 x 50 mm slide along y, and end 0.11 m before the hand."""
    gripper = of(described(robot(GRIPPER, PADS), "hand", opened, np.eye(4)))
    assert gripper.opening == pytest.approx(2 * opened, abs=1e-4)
    T = gripper.T_palm_grasp
    np.testing.assert_allclose(T[:3, 3], [0, 0, 0.10], atol=1e-6)
    np.testing.assert_array_equal(T[:3, 2], [0, 0, 1])
    np.testing.assert_array_equal(np.abs(T[:3, 0]), [0, 1, 0])
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    points = gripper.points(600, np.random.default_rng(0))
    off = np.abs(points - [0, 0, -0.015])
    off[:, 0] -= opened + 0.005
    share = np.abs(off) / [0.005, 0.01, 0.025]
    assert share.max() < 1 + 1e-6
    np.testing.assert_allclose(share.max(axis=1), 1, atol=1e-6)  # on a surface
    assert 0.4 < (points[:, 0] > 0).mean() < 0.6


def test_a_turned_palm_frame_has_the_same_gripper() -> None:
    """Catches the palm's axes taken for the gripper's."""
    turn = increment(np.array([0.02, -0.01, 0.03, 0.3, -0.2, 1.2]))
    straight, turned = (described(robot(GRIPPER, PADS), "hand", 0.04, T) for T in (np.eye(4), turn))
    np.testing.assert_allclose(turn @ of(turned).T_palm_grasp, of(straight).T_palm_grasp, atol=1e-9)
    assert apart(of(turned), of(straight)) < 0.002


def test_the_trained_gripper_by_its_description_is_alike() -> None:
    jaw = hand_for("vfas")
    text = robot_urdf(jaw.T_hand_camera, jaw)
    mine = of(described(text, "hand_base", jaw.open[0], jaw.T_hand_palm))
    np.testing.assert_allclose(mine.T_palm_grasp, np.eye(4), atol=1e-6)
    assert mine.opening == pytest.approx(jaw.opening, abs=1e-3)
    assert apart(mine, trained_gripper()) < 0.003
    notes = vfas_notes(Config(), True, jaw)
    assert "sliding fingers stand for" in notes[0]
    assert not any("the log's gripper" in n or "of its training" in n for n in notes)


def test_another_gripper_is_said_and_what_is_none_too() -> None:
    wide = described(robot(GRIPPER, PADS), "hand", 0.04, np.eye(4))
    said = vfas_notes(Config(), True, wide)
    assert "sliding fingers" not in said[0]
    assert "the log's gripper, 0.080 m wide (2 fingers on 'hand'" in said[1]
    assert "trained with one of 0.100 m" in said[1]
    third = joint("third", "hand", "end", "prismatic", "0 0 0.06", "1 0 0", (0.0, 0.04))
    pads = {**PADS, "end": box("0.01 0.02 0.05", "0.005 0 0.025")}
    three = described(robot([*GRIPPER, third], pads), "hand", 0.04, np.eye(4))
    for hand in (three, FIVE_FINGERS):
        assert gripper_of(hand) == f"{hand.told} is no gripper of two jaws"
        said = vfas_notes(Config(), True, hand)
        assert "the gripper of its training, 0.10 m wide" in said[1]
    assert "no hand" in str(gripper_of(None))


@pytest.mark.parametrize("hertz", [15.0, 20.0, 25.0, 30.0, 60.0])
def test_iterations_are_at_20_hz_whatever_the_camera_is(
    hertz: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fails where the time by which a frame was late is lost: 15 iterations/s at 30 Hz."""
    times: list[int] = []

    class Loop:
        velocity = None

        def __init__(self, *_: object) -> None: ...

        def step(self, frame: Seen, _T_base_camera: Array, **_: object) -> None:
            times.append(frame.t_ns)

    monkeypatch.setattr(replayed, "VfasLoop", Loop)
    planner = replayed.VfasGrasps(Config(), np.eye(4), trained_gripper())
    late = np.random.default_rng(0).uniform(-2e6, 2e6, round(10 * hertz))
    for k, jitter in enumerate(late):
        planner.step(Seen(round(k * 1e9 / hertz + jitter), np.eye(4)), np.eye(4))  # type: ignore[arg-type]
    assert abs(len(times) - 10 * min(20.0, hertz)) <= 1


@dataclass(frozen=True)
class Seen:
    """What the planner reads of a frame."""

    t_ns: int
    T_base_palm: Array


def test_poses_go_in_and_come_out_as_the_palms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a seed, a hand or a goal in the wrong one of the two frames."""
    T_palm_grasp = increment(np.array([0.0, 0.01, 0.1, 0.1, 0.2, 1.5]))
    palm, seed = (increment(np.array([0.5, y, 0.3, 3.0, 0.1, 0.2])) for y in (0.1, 0.2))
    seen, asked, targets = [], [], []
    arm: Any = SimpleNamespace(at=lambda t_ns: SimpleNamespace(room=lambda T: T))
    observation = Observation(np.array([[0.1, 0.2, 0.5]]), np.zeros((1, 3)))

    class Loop:
        velocity = None

        def __init__(
            self, _config: Config, T_base_seed: Array, _gripper: Gripper, reach: Any
        ) -> None:
            seen.append(T_base_seed)
            asked.append(reach(7)(T_base_seed))

        def step(self, frame: Seen, _T_base_camera: Array, target: Array) -> Selected:
            seen.append(frame.T_base_palm)
            targets.append(target)
            return Selected(seen[0], seen[0], 1.0, 1.0, 0.0, 1.0, 64, True, False)

    monkeypatch.setattr(replayed, "VfasLoop", Loop)
    gripper = Gripper(T_palm_grasp, 0.08, trained_gripper().points, "a test's")
    planner = replayed.VfasGrasps(Config(), seed, gripper, arm)
    result = planner.step(Seen(0, palm), palm, observation)  # type: ignore[arg-type]
    np.testing.assert_allclose(asked[0], seed, atol=1e-12)  # the arm is asked of palm poses
    np.testing.assert_allclose(targets[0], transform(palm, observation.points), atol=1e-12)
    np.testing.assert_allclose(seen[0], seed @ T_palm_grasp, atol=1e-12)
    np.testing.assert_allclose(seen[1], palm @ T_palm_grasp, atol=1e-12)
    assert result is not None
    assert result.command is not None
    np.testing.assert_allclose(result.selected.T_base_goal, seed, atol=1e-12)
    np.testing.assert_allclose(result.selected.T_base_seed, seed, atol=1e-12)
    assert result.command.error_linear == pytest.approx(0.1)
    turned = invert(palm) @ seed
    np.testing.assert_allclose(turned[:3, :3], np.eye(3), atol=1e-12)
    assert result.command.error_angular == pytest.approx(0.0, abs=1e-6)
