"""Catches a seed of Contact-GraspNet that is not on the target, or that the arm can hardly do."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dgeval.config import load_config
from dgeval.networks.contact_graspnet import JawGrasps
from dgeval.planning.vfas import loop
from dgeval.planning.vfas.contacts import CONFIDENT, Rank, by_room, seed_from_contacts
from dgeval.planning.vfas.loop import SEED_TRIES, VfasLoop


class Given:
    """In the network's place: the same grasps, whatever the cloud."""

    def __init__(self, grasps: JawGrasps) -> None:
        self.given, self.clouds = grasps, []  # type: ignore[var-annotated]

    def grasps(self, cloud: np.ndarray) -> JawGrasps:
        self.clouds.append(cloud)
        return self.given


def given_grasps() -> JawGrasps:
    """Six grasps, x the closing direction: contacts at x = 0, 0.1, …, 0.5 m, 4 cm wide."""
    T = np.tile(np.eye(4), (6, 1, 1))
    T[:, 0, 3] = 0.1 * np.arange(6) + 0.02
    width = np.array([0.04, 0.04, 0.04, 0.04, 0.09, 0.04])
    return JawGrasps(T, width, np.array([0.9, 0.8, CONFIDENT, 0.7, 0.95, 0.3]))


def seeded(target: np.ndarray | None, rank: Rank, network: Given | None = None) -> int | None:
    """Number of the grasp that is the seed, of those given."""
    cloud = np.random.default_rng(0).uniform(-0.1, 0.6, (60_000, 3))
    network = network or Given(given_grasps())
    T = seed_from_contacts(cloud, target, network, rank, 0.08, 3)  # type: ignore[arg-type]
    return None if T is None else round((T[0, 3] - 0.02) * 10)


def near(*metres: float) -> np.ndarray:
    """Points of a target at some x."""
    return np.array([[x, 0.0, 0.0] for x in metres])


def test_a_seed_is_confident_fits_the_jaws_and_lies_on_the_target() -> None:
    """Catches a seed on the table or a neighbour, one that is too wide, one of no confidence."""

    def leftmost(poses: np.ndarray) -> np.ndarray:
        return -poses[:, 0, 3]

    def rightmost(poses: np.ndarray) -> np.ndarray:
        return poses[:, 0, 3]

    assert seeded(None, leftmost) == 0
    assert seeded(None, rightmost) == 5
    assert seeded(near(0.1, 0.2, 0.303, 0.375), leftmost) == 1
    assert seeded(near(0.1, 0.2, 0.303, 0.375), rightmost) == 3  # not 4, which is 9 cm wide
    assert seeded(near(0.2, 0.4, 0.25), leftmost) is None


def test_what_the_arm_cannot_do_is_no_seed() -> None:
    """Catches a rank that is not asked, and a seed out of reach."""
    assert seeded(None, lambda poses: np.full(len(poses), -np.inf)) is None


def test_the_network_is_shown_the_targets_surroundings() -> None:
    """Catches a target that gets a tenth of the contacts, as the network sees the whole table."""
    network = Given(given_grasps())
    seeded(near(0.1, 0.18), lambda poses: np.zeros(len(poses)), network)
    low, high = network.clouds[0].min(axis=0), network.clouds[0].max(axis=0)
    assert np.all(low > [-0.011, -0.15, -0.15])
    assert np.all(high < [0.291, 0.151, 0.151])
    few = Given(given_grasps())  # with too few points about the target it isn't asked
    assert seeded(near(2.0), lambda poses: np.zeros(len(poses)), few) is None
    assert few.clouds == []


def test_seeds_are_ranked_by_the_arms_room_before_and_at_the_grasp() -> None:
    """Catches a pre-grasp out of reach, and a rank by the better of the two poses."""
    rooms = {0.0: 0.9, -0.1: 0.2, 1.0: 0.5, 0.9: 0.4, 2.0: 0.9, 1.9: None}
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 2, 3] = (0.0, 1.0, 2.0)
    marks = by_room(lambda T: rooms[round(T[2, 3], 3)], 0.1, poses)
    assert marks.tolist() == [0.2, 0.4, -np.inf]


def loop_asked(
    monkeypatch: pytest.MonkeyPatch, reach: Any, found: bool
) -> tuple[VfasLoop, list[Any]]:
    """A planner whose seeds come from Contact-GraspNet, and how that was asked."""
    asked: list[Any] = []

    def seeds(_cloud: Any, target: Any, _network: Any, rank: Any, *_: Any) -> np.ndarray | None:
        asked.append((target, rank(np.eye(4)[None]).tolist()))
        return np.eye(4) if found else None

    monkeypatch.setattr(loop, "seed_from_contacts", seeds)
    monkeypatch.setattr(loop, "contact_graspnet_of", lambda weights: weights)
    monkeypatch.setattr(VfasLoop, "_quality", lambda self, cloud, poses: np.full(len(poses), 0.25))
    config = load_config("vfas", ("vfas.contact_graspnet=made.pth",))
    return VfasLoop(config, None, None, reach), asked


FRAME: Any = SimpleNamespace(t_ns=7)


def test_no_seed_is_asked_for_before_the_target_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a seed on the table, 30 cm beside a target that is told later."""
    planner, asked = loop_asked(monkeypatch, lambda t_ns: lambda T: t_ns / 10, found=True)
    assert planner._seed(FRAME, np.zeros((9, 3)), np.eye(4), None) is None
    assert asked == []
    target = near(0.1)
    assert planner._seed(FRAME, np.zeros((9, 3)), np.eye(4), target) is not None
    assert asked == [(target, [0.7])]  # the arm at the seed's time ranks it


def test_the_evaluator_ranks_where_the_arm_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a fallback that isn't there, and the network asked in every frame for ever."""
    for reach in (None, lambda t_ns: None):
        planner, asked = loop_asked(monkeypatch, reach, found=False)
        for _ in range(SEED_TRIES + 3):
            planner._seed(FRAME, np.zeros((9, 3)), np.eye(4), near(0.1))
        assert [ranks for _, ranks in asked] == [[0.25]] * SEED_TRIES
