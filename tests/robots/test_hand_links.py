"""Catches: an arm, a leg or a bar of a linkage taken for a finger; a hand that is not found, and
nobody says why; couplings that are dropped; descriptions that are no tree.
"""

from __future__ import annotations

import pytest
from dgeval.errors import UsageError
from dgeval.robots.description import Description
from dgeval.robots.hand_links import HandLinks, hand_links
from dgeval.robots.loading import load_description
from tests.robots.urdf_texts import ARM, GRIPPER, follows, joint, robot


def loaded(joints: list[str]) -> Description:
    return load_description(robot(joints), "a test", (), 0.01)


def fingers(found: HandLinks | str) -> list[str]:
    assert isinstance(found, HandLinks), found
    return [finger[0] for finger in found.fingers]


@pytest.mark.parametrize("palm", ["hand", "tcp", "flange", "lower"])
def test_the_hand_is_what_moves_on_the_palm_or_beyond_the_wrist(palm: str) -> None:
    found = hand_links(loaded(GRIPPER), palm, {"jaw", "wrist"})
    assert fingers(found) == ["left", "right"]
    assert isinstance(found, HandLinks)
    assert found.base == "hand"
    assert set(found.palm) == {"flange", "hand", "tcp"}


def test_one_jaw_faces_what_is_fixed() -> None:
    found = hand_links(loaded([*ARM, joint("jaw", "flange", "left")]), "flange", {"jaw"})
    assert fingers(found) == ["left"]


@pytest.mark.parametrize("palm", ["flange", "lower"])
def test_a_finger_that_is_a_linkage_is_no_hand(palm: str) -> None:
    """Fails where the deepest parting is taken, whose bars follow a joint above it."""
    linkage = [*GRIPPER[:5]]
    for side in ("left", "right"):
        drive = follows("left_drive") if side == "right" else ""
        linkage.append(
            joint(f"{side}_drive", "hand", f"{side}_knuckle", xyz="0 0 0.05", mimic=drive)
        )
        for bar in ("inner", "outer"):
            name, mimic = f"{side}_{bar}", follows("left_drive", -1.0)
            linkage.append(joint(name, f"{side}_knuckle", name, xyz="0 0 0.03", mimic=mimic))
    found = hand_links(loaded(linkage), palm, {"left_drive", "wrist"})
    assert fingers(found) == ["left_knuckle", "right_knuckle"]


def test_of_two_hands_the_palms_own() -> None:
    arms = []
    for side in ("l", "r"):
        arms += [
            joint(f"{side}_shoulder", "torso", f"{side}_upper", xyz="0 0 0.5"),
            joint(f"{side}_elbow", f"{side}_upper", f"{side}_palm", xyz="0 0 0.5"),
            joint(f"{side}_a", f"{side}_palm", f"{side}_thumb"),
            joint(f"{side}_b", f"{side}_palm", f"{side}_index"),
        ]
    description = loaded(arms)
    known = {joint.name for joint in description.joints.values()}
    assert fingers(hand_links(description, "r_palm", known)) == ["r_index", "r_thumb"]
    assert "l_palm or r_palm" in str(hand_links(description, "torso", known))


def test_a_finger_on_a_joint_of_the_palm_is_one_of_the_hand() -> None:
    """Fails where the palm's joint that moves two fingers is a hand of its own."""
    moves = [
        joint("a", "palm", "thumb"),
        joint("b", "palm", "index"),
        joint("metacarpal", "palm", "half", xyz="0 0 0.05"),
        joint("c", "half", "ring", xyz="0 0 0.05"),
        joint("d", "half", "little", xyz="0 0 0.05"),
    ]
    found = hand_links(loaded(moves), "palm", {"a", "b", "c", "d", "metacarpal"})
    assert fingers(found) == ["half", "index", "thumb"]


def test_an_arm_without_a_hand_has_none() -> None:
    tool = [*ARM, joint("mount", "flange", "tool0", "fixed")]
    assert "no hand that moves" in str(hand_links(loaded(tool), "tool0", {"wrist"}))


def test_a_jaw_that_has_the_palms_name_is_told_with_its_palm() -> None:
    """Fails where "no hand that moves" is all that is said of a low-cost arm's one jaw."""
    arm = [*ARM, joint("jaw", "flange", "gripper")]
    said = str(hand_links(loaded(arm), "gripper", {"jaw"}))
    assert "--set frames.palm=flange" in said
    assert not isinstance(hand_links(loaded(arm), "flange", {"jaw"}), str)


def test_what_reaches_far_is_no_finger() -> None:
    """Fails where the legs of a walking robot are the fingers of its trunk."""
    legs = []
    for side in ("l", "r"):
        legs += [
            joint(f"{side}_hip", "trunk", f"{side}_thigh"),
            joint(f"{side}_knee", f"{side}_thigh", f"{side}_shin", xyz="0 0 -0.4"),
        ]
    description = loaded(legs)
    known = {joint.name for joint in description.joints.values()}
    assert "no finger" in str(hand_links(description, "trunk", known))


def test_a_posture_that_nobody_recorded_is_told() -> None:
    found = hand_links(loaded(GRIPPER), "hand", {"wrist"})
    assert "not recorded: no positions of jaw, other_jaw" in str(found)


def test_limits_that_are_upside_down_are_told() -> None:
    wrong = [*ARM, joint("jaw", "flange", "left", limits=(1.0, -1.0))]
    assert "upside down" in str(hand_links(loaded(wrong), "flange", {"jaw"}))


def test_couplings_multiply_along_a_chain() -> None:
    """q3 = -2 (0.5 q1 + 0.1) + 0.3 = -q1 + 0.1."""
    chain = [
        joint("q3", "b", "c", mimic=follows("q2", -2.0, 0.3)),
        joint("q2", "a", "b", mimic=follows("q1", 0.5, 0.1)),
        joint("q1", "base", "a"),
    ]
    q3 = loaded(chain).joints["c"]
    assert (q3.follows, q3.multiplier) == ("q1", -1.0)
    assert q3.offset == pytest.approx(0.1)


def test_a_coupling_to_a_name_without_its_side_is_found_on_that_side() -> None:
    both = []
    for side in ("Left", "Right"):
        both += [
            joint(f"{side}_index_q1", "base", f"{side}_1"),
            joint(f"{side}_index_q2", f"{side}_1", f"{side}_2", mimic=follows("index_q1", 1.05)),
        ]
    description = loaded(both)
    assert description.joints["Right_2"].follows == "Right_index_q1"
    assert any("taken for Right_index_q1" in note for note in description.notes)


def test_a_coupling_to_nothing_is_told() -> None:
    description = loaded([joint("a", "base", "x", mimic=follows("b"))])
    assert any("a follows b, which there is not" in note for note in description.notes)
    assert "not recorded" in str(hand_links(description, "base", {"a_of_another_robot"}))


def test_couplings_in_a_circle_are_told() -> None:
    circle = [
        joint("a", "base", "x", mimic=follows("b")),
        joint("b", "base", "y", mimic=follows("a")),
    ]
    description = loaded(circle)
    assert description.joints["x"].follows == "a"
    assert any("circle" in note for note in description.notes)


@pytest.mark.parametrize(
    ("joints", "told"),
    [
        ([joint("a", "x", "y"), joint("b", "y", "x")], "hangs on itself"),
        ([joint("a", "x", "y"), joint("b", "z", "y")], "the link y hangs on 2 joints"),
        ([joint("a", "x", "y"), joint("a", "y", "z")], "2 joints are called a"),
    ],
)
def test_what_is_no_tree_is_refused(joints: list[str], told: str) -> None:
    """Fails where poses are looked for without end, or the last of two parents counts."""
    with pytest.raises(UsageError, match=told):
        loaded(joints)


def test_a_link_that_there_is_not_is_named() -> None:
    text = robot([joint("a", "x", "y")]).replace('<link name="y"></link>', "")
    with pytest.raises(UsageError, match="names the link y"):
        load_description(text, "a test", (), 0.01)
