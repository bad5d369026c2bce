"""Catches: a hand that is judged as another one, since its joints have the same names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from dgeval.geometry import increment
from dgeval.robots.description import Description, Joint
from dgeval.robots.hand import KnownHand, hands
from dgeval.robots.loading import load_description
from dgeval.robots.recognition import known_hand
from dgeval.robots.urdf import robot_urdf

EACH = pytest.mark.parametrize("hand", hands(), ids=lambda hand: hand.name)


def described(hand: KnownHand) -> Description:
    return load_description(robot_urdf(hand.T_hand_camera, hand), hand.name, (), 0.01)


def changed(hand: KnownHand, change: Callable[[Joint], Joint]) -> Description:
    """The hand with its last drive's joint changed."""
    own = described(hand)
    joints = {
        child: change(joint) if joint.name == hand.drives[-1] else joint
        for child, joint in own.joints.items()
    }
    return replace(own, joints=joints)


@EACH
def test_a_known_hand_is_known_by_its_own_description(hand: KnownHand) -> None:
    assert known_hand(described(hand)) == (hand, "")


@EACH
def test_a_known_hand_is_known_by_its_description_as_mjcf(hand: KnownHand) -> None:
    """Of MuJoCo's own import of the URDF: a second road to the same joints."""
    spec = mujoco.MjSpec.from_string(robot_urdf(hand.T_hand_camera, hand))
    spec.compiler.fusestatic = False
    spec.compiler.boundmass = spec.compiler.boundinertia = 1e-3
    spec.compile()
    assert known_hand(load_description(spec.to_xml(), hand.name, (), 0.01)) == (hand, "")


@EACH
@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            lambda j: replace(j, origin=j.origin @ increment(np.array([0.005, 0, 0, 0, 0, 0]))),
            "5 mm",
        ),
        (lambda j: replace(j, axis=-j.axis), "180 degrees"),
        (lambda j: replace(j, upper=j.upper * 1.2), "limits"),
        (lambda j: replace(j, kind="prismatic" if j.kind == "revolute" else "revolute"), "is "),
    ],
)
def test_the_same_names_on_another_hand(
    hand: KnownHand, change: Callable[[Joint], Joint], told: str
) -> None:
    """Fails where a Panda whose fingers are called left_jaw and right_jaw is judged as that jaw."""
    found, note = known_hand(changed(hand, change))
    assert found is None
    assert told in note
    assert hand.name in note


@EACH
def test_what_a_calibration_changes_is_the_same_hand(hand: KnownHand) -> None:
    """Fails where a millimetre, or a degree, makes a known hand unknown."""
    a_little = increment(np.array([0.001, 0, 0, 0, 0, np.radians(1.0)]))
    found, note = known_hand(changed(hand, lambda j: replace(j, origin=j.origin @ a_little)))
    assert (found, note) == (hand, "")


@EACH
def test_a_finger_on_another_link(hand: KnownHand) -> None:
    """Fails where a joint of that name anywhere on the robot is the hand's."""
    found, note = known_hand(changed(hand, lambda j: replace(j, parent="link_1")))
    assert found is None
    assert note
