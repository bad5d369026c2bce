"""Catches: a hand that lacks what dgeval asks of it; code outside robots/ with a finger's name."""

from __future__ import annotations

import ast
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from dgeval import plugins
from dgeval.errors import UsageError
from dgeval.robots import hand as interface
from dgeval.robots.hand import KnownHand, hand_for, hand_named, hand_of, hands
from dgeval.robots.loading import load_description
from dgeval.robots.urdf import robot_urdf
from dgeval.worlds.objects import ten_objects
from dgeval.worlds.scene import build

PACKAGE = Path(interface.__file__).parents[1]
FINGERS = re.compile(
    r"\b(thumb|index|middle|ring|little|left_jaw|right_jaw|left|right)(_\d|_jaw)\b"
)
EACH = pytest.mark.parametrize("hand", hands(), ids=lambda h: h.name)


def test_there_are_two_hands() -> None:
    """Catches a hand's file that is not read from the folder."""
    assert [h.name for h in hands()] == ["dlr_hit_hand", "parallel_jaw"]


@EACH
def test_a_hand_is_complete(hand: KnownHand) -> None:
    """Catches joints, drives, limits and solids that do not fit each other."""
    k = len(hand.drives)
    assert set(hand.drives) <= set(hand.joints)
    assert set(hand.grip.joints) <= set(hand.joints)
    assert hand.open.shape == (k,)
    assert hand.drive_limits.shape == (2, k)
    assert (hand.drive_limits[0] <= hand.open).all()
    assert (hand.open <= hand.drive_limits[1]).all()
    assert hand.positions(hand.open).shape == (len(hand.joints),)
    assert np.allclose(hand.targets(0.0, hand.open), hand.open)
    assert hand.random_preshape(np.random.default_rng(0)).shape == (k,)
    solids = hand.solids(np.tile(hand.open, (3, 1)))
    assert solids.axes.shape[0] == 3
    assert solids.axes.shape[2:] == (2, 3)
    assert hand_named(hand.name) is hand
    assert hand_of(hand.joints) is hand
    assert hand_of(hand.drives[:-1]) is None


@EACH
def test_physics_and_description_of_a_hand_agree(hand: KnownHand) -> None:
    """Catches a joint that is missing, or elsewhere, in the description or in the physics."""
    model = build(ten_objects()["apple"], robot="hand", gripper=hand)
    for joint in hand.joints:
        assert model.joint(joint).name == joint
    assert [model.actuator(d).name for d in hand.drives] == list(hand.drives)
    description = load_description(robot_urdf(hand.T_hand_camera, hand), hand.name, (), 0.01)
    assert {j.name for j in description.joints.values()} >= set(hand.joints)
    solid = [model.geom(g) for g in range(model.ngeom)]
    fingers = {g.name.split("_")[0] for g in solid if g.contype[0] == 2}
    assert set(hand.fingers) <= fingers


@EACH
def test_a_closing_hand_gets_closed(hand: KnownHand) -> None:
    """Catches a wrong sign: the drives must move monotonically towards closed."""
    states = np.array([hand.targets(t, hand.open) for t in np.linspace(0, 1, 21)])
    steps = np.diff(states, axis=0)
    assert ((steps >= -1e-12).all(axis=0) | (steps <= 1e-12).all(axis=0)).all()
    assert np.abs(states[-1] - states[0]).max() > 0.01


def test_nothing_else_knows_a_finger() -> None:
    """Catches a finger's name, or a hand's file, in the code of another package."""
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.parent.name == "robots":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                assert " " in node.value or not FINGERS.search(node.value), (path, node.value)
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(
                "dgeval.robots."
            ):
                allowed = ("hand", "mjcf", "urdf", "diana7", "description", "recognition")
                allowed += (
                    "loading",
                    "hand_links",
                    "described_hand",
                    "hand_solids",
                    "hand_geometry",
                    "link_surface",
                )
                assert node.module.split(".")[2] in allowed, (path, node.module)


THIRD = '''
"""A claw of two fingers that turn."""
from dataclasses import replace
from dgeval.robots.parallel_jaw import HAND as JAW

NAMES = ("claw_left", "claw_right")
HAND = replace(JAW, name="claw", drives=NAMES, joints=NAMES)
'''


@pytest.fixture
def forget() -> object:
    """The table of hands is read anew before and after a test."""
    hands.cache_clear()
    yield
    hands.cache_clear()


@pytest.mark.usefixtures("forget")
def test_a_third_hand_is_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a list of hands anywhere in the code: a new file alone must add a hand."""
    import dgeval.robots

    (tmp_path / "claw.py").write_text(THIRD)
    monkeypatch.setattr(dgeval.robots, "__path__", [*dgeval.robots.__path__, str(tmp_path)])
    assert [h.name for h in hands()] == ["claw", "dlr_hit_hand", "parallel_jaw"]
    third = hand_of({"claw_left", "claw_right", "arm_1"})
    assert third is not None
    assert third.name == "claw"
    sys.modules.pop("dgeval.robots.claw")


@pytest.mark.usefixtures("forget")
def test_a_third_hand_comes_from_an_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a hand of an installed package that is not listed."""
    module = ModuleType("claw")
    exec(THIRD, module.__dict__)

    entry = SimpleNamespace(name="claw", value="claw", dist=None, load=lambda: module)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry])
    assert hand_named("claw").drives == ("claw_left", "claw_right")


def test_a_hand_that_is_not_there_is_named() -> None:
    """Catches an error that does not name the hands there are."""
    with pytest.raises(KeyError, match="dlr_hit_hand, parallel_jaw"):
        hand_named("claw")


def test_geoms_of_a_hand_meet_objects_alone() -> None:
    """Catches a hand whose links push each other, and one that passes through the object."""
    for hand in hands():
        model = build(ten_objects()["apple"], robot="hand", gripper=hand)
        hand_geoms = [g for g in range(model.ngeom) if model.geom(g).contype[0] == 2]
        assert hand_geoms
        for g in hand_geoms:
            assert model.geom_conaffinity[g] == 1
        assert mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "hand_base") > 0


@pytest.mark.usefixtures("forget")
@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({}, "the entry point 'mine' in the group dgeval.hands names my_hand, which has no HAND"),
        ({"HAND": hands()[0]}, "two hands are called 'dlr_hit_hand', in"),
        (
            {"HAND": replace(hands()[0], name="mine")},
            "one hand must have the grasp network 'ffhnet'; it is that of dlr_hit_hand, mine",
        ),
    ],
)
def test_a_hand_that_cannot_be_used_is_named(
    monkeypatch: pytest.MonkeyPatch, attributes: dict[str, Any], message: str
) -> None:
    """Catches an installed hand left out in silence, one that replaces dgeval's own, and weights
    that go to whichever hand comes first.
    """
    module = ModuleType("my_hand")
    module.__dict__.update(attributes)
    entry = SimpleNamespace(name="mine", value="my_hand", dist=None, load=lambda: module)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry])
    with pytest.raises(UsageError, match=re.escape(message)):
        hand_for("ffhnet")
