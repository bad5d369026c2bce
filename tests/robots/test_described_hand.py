"""Catches: fingertips, grasp centre or closing direction of a described hand that are not those of
its geometry; a described hand that can't hold what it should, or holds what it can't.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dgeval.geometry import Array, increment
from dgeval.robots.described_hand import DescribedHand, described_hand
from dgeval.robots.hand import KnownHand, hands
from dgeval.robots.hand_links import HandLinks, hand_links
from dgeval.robots.loading import load_description
from dgeval.robots.urdf import robot_urdf
from dgeval.worlds.hand_and_object import CloseAndLift, HandOnHandle
from dgeval.worlds.objects import ten_objects
from dgeval.worlds.scene import build
from tests.robots.urdf_texts import ARM, GRIPPER, PADS, box, follows, joint, robot


def made(text: str, palm: str, at: dict[str, float]) -> DescribedHand:
    description = load_description(text, "a test", (), 0.01)
    recorded = {j.name for j in description.joints.values() if j.follows == j.name}
    links = hand_links(description, palm, recorded)
    assert isinstance(links, HandLinks), links
    start = np.array([at.get(j.name, 0.0) for j in links.joints(description)])
    return described_hand(description, links, np.eye(4), start)


def gripper(opened: float = 0.04) -> DescribedHand:
    return made(robot(GRIPPER, PADS), "hand", {"jaw": opened, "other_jaw": opened})


def test_jaws_close_to_the_middle_and_meet_behind_their_ends() -> None:
    hand = gripper()
    assert hand.geometry.closed == pytest.approx([0.0, 0.0])
    assert hand.geometry.tips_at(hand.geometry.open)[:, 2] == pytest.approx([0.11, 0.11])
    assert hand.centre == pytest.approx([0.0, 0.0, 0.10], abs=1e-6)


def test_a_finger_that_first_goes_away_from_the_thumb_closes() -> None:
    """Fails where a tenth of the way decides: a coupled finger swings out before it curls in, as an
    Ability Hand's index does. By the closed form: 10 cm from the thumb, 10.3 after a tenth, 9.5
    after half.
    """
    bone = box("0.004 0.004 0.05", "0 0 0.025")
    text = robot(
        [
            joint("q1", "palm", "a", axis="0 1 0", limits=(0.0, 2.09)),
            joint(
                "q2", "a", "b", "revolute", "0 0 0.05", "0 1 0", (0.0, 2.66), follows("q1", 1.06)
            ),
            joint("thumb", "palm", "t", "revolute", "-0.01 0 -0.08", "0 1 0", (-0.01, 0.01)),
        ],
        {
            "palm": box("0.02 0.02 0.02", "0 0 -0.5"),
            "a": bone,
            "b": bone,
            "t": box("0.004 0.004 0.08", "0 0 0.04"),
        },
    )
    geometry = made(text, "palm", {}).geometry
    assert dict(zip(geometry.names, geometry.closed, strict=True))["q1"] == pytest.approx(2.09)
    assert geometry.closes
    assert not gripper(0.0).geometry.closes  # it is closed already


def test_a_closed_hand_that_is_given_goes_before_the_limits() -> None:
    """Fails where a hand that never closes all the way is closed to its limits."""
    description = load_description(robot(GRIPPER, PADS), "a test", (), 0.01)
    links = hand_links(description, "hand", {"jaw"})
    assert isinstance(links, HandLinks)
    hand = described_hand(description, links, np.eye(4), np.full(2, 0.04), {"jaw": 0.01}, 0.2)
    assert hand.geometry.closed == pytest.approx([0.01, 0.01])
    assert hand.targets(0.1, hand.geometry.open) == pytest.approx([0.025, 0.025])
    assert (hand.closing_source, hand.close_s) == ("set", 0.2)


def test_two_jaws_come_to_an_object_across_the_way_that_they_close() -> None:
    """Fails where a palm whose solids lie to one side tilts the approach into the closing way."""
    one_sided = {**PADS, "hand": box("0.02 0.04 0.06", "0 0.01 0.03")}
    hand = made(robot(GRIPPER, one_sided), "hand", {"jaw": 0.04, "other_jaw": 0.04})
    assert hand.approach == pytest.approx([0, 0, 1], abs=1e-9)


def curling(limit: float) -> DescribedHand:
    """Two fingers of two links of 50 mm, 180 mm apart, that curl inwards up to a limit."""
    chain, solids = [*ARM], {"flange": box("0.2 0.07 0.024", "0 0 0")}
    for side, name in ((-1, "a"), (1, "b")):
        axis, limits = f"0 {-side} 0", (-0.4, limit)
        near, far = f"{name}_near", f"{name}_far"
        root = f"{0.09 * side} 0 0.012"
        chain.append(joint(f"{name}_1", "flange", near, "revolute", root, axis, limits))
        chain.append(joint(f"{name}_2", near, far, "revolute", "0 0 0.05", axis, limits))
        solids |= dict.fromkeys((near, far), box("0.016 0.016 0.05", "0 0 0.025"))
    return made(robot(chain, solids), "flange", {"a_1": -0.3, "b_1": -0.3})


@pytest.mark.parametrize("limit", [1.2, 1.9, 3.0])
def test_fingers_whose_limits_fold_them_through_the_palm_meet_before_it(limit: float) -> None:
    """Fails where the grasp's centre lies behind the palm, as an Allegro's did, and the approach
    leads away from what is grasped.
    """
    hand = curling(limit)
    assert hand.centre[2] > 0.02
    assert np.abs(hand.centre[:2]).max() < 0.01
    assert hand.approach == pytest.approx([0, 0, 1], abs=0.02)


def test_a_users_centre_and_approach_are_in_the_palms_frame() -> None:
    """Fails where they are taken in the frame of the base, or the direction's length counts."""
    description = load_description(robot(GRIPPER, PADS), "a test", (), 0.01)
    links = hand_links(description, "hand", {"jaw"})
    assert isinstance(links, HandLinks)
    T = increment(np.array([0.0, 0.0, 0.05, 0.0, np.pi / 2, 0.0]))  # the palm's x points to base -z
    at, along = np.array([0.0, 0.0, 0.03]), np.array([-2.0, 0.0, 0.0])
    hand = described_hand(description, links, T, np.full(2, 0.04), centre=at, approach=along)
    assert hand.centre == pytest.approx([0.03, 0.0, 0.05])
    assert hand.approach == pytest.approx([0.0, 0.0, 1.0])


def test_an_axis_that_points_the_other_way_closes_the_other_way() -> None:
    turned = [
        *GRIPPER[:5],
        joint("jaw", "hand", "left", "prismatic", "0 0 0.06", "0 -1 0", (-0.04, 0.0)),
        joint("other_jaw", "hand", "right", "prismatic", "0 0 0.06", "0 1 0", (-0.04, 0.0)),
    ]
    hand = made(robot(turned, PADS), "hand", {"jaw": -0.04, "other_jaw": -0.04})
    assert hand.geometry.closed == pytest.approx([0.0, 0.0])


def test_one_jaw_closes_to_what_is_fixed() -> None:
    """A jaw that turns about y, beside a fixed one of the same length along z."""
    solids = {
        "flange": box("0.02 0.02 0.1", "-0.03 0 0.05"),
        "jaw": box("0.02 0.02 0.1", "0.01 0 0.05"),
    }
    text = robot([*ARM, joint("j", "flange", "jaw", axis="0 1 0", limits=(-0.3, 1.5))], solids)
    hand = made(text, "flange", {"j": 0.8})
    assert hand.geometry.closed == pytest.approx([-0.3])
    assert -0.03 < hand.centre[0] < 0.02
    assert 0.07 < hand.centre[2] < 0.1


@pytest.mark.parametrize("hand", hands(), ids=lambda hand: hand.name)
def test_a_known_hands_grasp_centre_follows_from_its_description(hand: KnownHand) -> None:
    at = dict(zip(hand.joints, hand.positions(hand.open), strict=True))
    found = made(robot_urdf(hand.T_hand_camera, hand), "hand_base", at)
    assert set(found.joints) == set(hand.joints)
    assert found.centre == pytest.approx(hand.centre, abs=0.01)
    turned = np.degrees(np.arccos(found.approach @ hand.approach))
    assert turned < 22  # the five-finger hand's thumb stands beside its palm


def test_links_without_any_solid_become_capsules() -> None:
    hand = made(robot(GRIPPER), "hand", {"jaw": 0.04, "other_jaw": 0.04})
    assert hand.without_solids
    kinds = {shape.kind for shape, _ in hand.geometry.shapes(hand.geometry.open)}
    assert kinds <= {"capsule", "sphere"}


class Flying(HandOnHandle):
    """A hand that follows its handle as the twin's does, without a recording."""


def lifted(hand: DescribedHand, force: float, mass: float) -> bool:
    """Whether the hand lifts a box of 50 mm that stands between its jaws, from above."""
    target = ten_objects()["foam_brick"]
    model = build(target, 0.0, "hand", gripper=hand)
    world = Flying(model, hand, target.rest_height())
    model.actuator_forcerange[world.drives] *= force
    model.actuator_gainprm[world.drives] *= force
    model.actuator_biasprm[world.drives] *= force
    body = model.body("object").id
    model.body_mass[body] *= mass
    model.body_inertia[body] *= mass
    # z of the hand down, its centre in the object's middle
    place = np.array([0.5, 0.0, target.rest_height() + hand.centre[2]])
    world.place_object(np.array([0.5, 0.0, target.rest_height(), 1, 0, 0, 0]), np.zeros(6))
    world.fly_to(np.array([*place, 0, 1, 0, 0]))
    world.place_fingers(hand.geometry.open)
    return CloseAndLift(world, hand.geometry.open, np.zeros(3)).finish()


def test_a_described_gripper_holds_what_it_can_and_no_more() -> None:
    """Fails where drives are too weak or too soft, or solids don't touch; and where anything is
    held.
    """
    hand = gripper()
    assert lifted(hand, 1.0, 1.0)
    assert not lifted(hand, 0.1, 30.0)


def test_coupled_jaws_move_alike() -> None:
    """The coupling asked for is the one in physics: MuJoCo drops what it can't resolve."""
    hand = gripper()
    model = build(ten_objects()["foam_brick"], 0.0, "hand", gripper=hand)
    names = {model.joint(i).name for i in range(model.njnt)}
    assert set(hand.joints) <= names
    couples = [k for k in range(model.neq) if model.eq_type[k] == 2]
    assert len(couples) == 1
    data: Array = model.eq_data[couples[0]]
    assert data[:2] == pytest.approx([0.0, 1.0])


MESH_TEXTS = {
    "pointer.stl": "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 1234\n",
    "flat.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "empty.obj": "",
    "other.dae": "<a/>",
    "nan.obj": "v nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n",
    "mm.obj": "v 0 0 0\nv 80 0 0\nv 0 80 0\nv 0 0 80\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n",
}


@pytest.mark.parametrize("name", [*MESH_TEXTS, "absent.stl"])
def test_a_mesh_that_gives_no_solid_is_told_with_its_link(tmp_path: Path, name: str) -> None:
    """Fails where a broken file ends the run, or gives a hand of 80 m, or one without a finger."""
    if name in MESH_TEXTS:
        (tmp_path / name).write_text(MESH_TEXTS[name])
    mesh = f'<collision><geometry><mesh filename="package://m/{name}"/></geometry></collision>'
    text = robot(GRIPPER, {**PADS, "left": mesh})
    description = load_description(text, "a.urdf", (str(tmp_path),), 0.01)
    assert f"{name} " in description.notes[0]
    assert "(link left)" in description.notes[0]
    assert {s.kind for s in description.shapes["left"]} <= {"capsule", "sphere"}
    assert description.shapes["left"]


def test_a_primitive_without_a_size_is_told() -> None:
    text = robot(GRIPPER, {**PADS, "left": box("0.02 0 0.05")})
    description = load_description(text, "a.urdf", (), 0.01)
    assert "a box of size 0 (link left)" in description.notes[0]
    assert {s.kind for s in description.shapes["left"]} <= {"capsule", "sphere"}


def linkage() -> str:
    """A gripper of two cranks with bars beside them, which keep its pads parallel. Its meshes are
    missing, and only the pads are boxes.
    """
    bar = {"mimic": follows("crank")}
    back = {"mimic": follows("crank", -1.0), "limits": (-0.8, 0.0)}
    missing = '<collision><geometry><mesh filename="package://g/no.stl"/></geometry></collision>'
    heavy = '<inertial><origin xyz="0 0.06 0"/><mass value="0.03"/></inertial>' + missing
    joints = [
        joint("crank", "hand", "crank_l", xyz="0 -0.03 0.055", axis="-1 0 0", limits=(0.0, 0.8)),
        joint("pad_l_joint", "crank_l", "pad_l", xyz="0 -0.04 0.04", axis="-1 0 0", **back),
        joint("bar_l_joint", "hand", "bar_l", xyz="0 -0.01 0.06", axis="-1 0 0", **bar),
        joint("crank_r_joint", "hand", "crank_r", xyz="0 0.03 0.055", axis="1 0 0", **bar),
        joint("pad_r_joint", "crank_r", "pad_r", xyz="0 0.04 0.04", axis="1 0 0", **back),
        joint("bar_r_joint", "hand", "bar_r", xyz="0 0.01 0.06", axis="1 0 0", **bar),
    ]
    solids = dict.fromkeys(["crank_l", "crank_r"], missing)
    solids |= dict.fromkeys(["bar_l", "bar_r"], heavy)
    solids |= dict.fromkeys(["pad_l", "pad_r"], box("0.02 0.006 0.05", "0 0 0.03"))
    return robot([*ARM, joint("mount", "flange", "hand", "fixed"), *joints], solids)


def test_a_bar_of_a_linkage_is_no_finger() -> None:
    """Fails where its centre of mass makes it the hand's longest finger, without its mesh."""
    hand = made(linkage(), "hand", {})
    assert [link for link, _ in hand.geometry.tips] == ["pad_l", "pad_r"]
    assert hand.told.startswith("2 fingers")
    assert hand.centre[:2] == pytest.approx([0.0, 0.0], abs=1e-6)
    # a bar runs along its crank, and is as long
    (bar,) = hand.geometry.description.shapes["bar_r"]
    assert 2 * bar.T_link_shape[:3, 3] == pytest.approx([0.0, 0.04, 0.04])


def short_thumb() -> DescribedHand:
    """Two long fingers on knuckles that have no solid, and a thumb half as long, of two joints."""
    joints, solids = [], {"palm": box("0.08 0.02 0.02", "0 0 -0.01")}
    for side, x in (("a", -0.02), ("b", 0.02)):
        k, f, d = (f"{part}_{side}" for part in ("knuckle", "finger", "distal"))
        joints += [
            joint(f"spread_{side}", "palm", k, xyz=f"{x} 0 0.08", axis="0 1 0", limits=(-0.2, 0.2)),
            joint(f"bend_{side}", k, f, axis="1 0 0", limits=(0.0, 1.5)),
            joint(f"curl_{side}", f, d, xyz="0 0 0.04", axis="1 0 0", limits=(0.0, 1.5)),
        ]
        solids |= {f: box("0.01 0.01 0.04", "0 0 0.02"), d: box("0.01 0.01 0.03", "0 0 0.015")}
    joints += [
        joint("base", "palm", "near", xyz="0 -0.05 0.02", axis="1 0 0", limits=(-1.0, 0.0)),
        joint("end", "near", "thumb", xyz="0 0 0.03", axis="1 0 0", limits=(-1.0, 0.0)),
    ]
    solids |= {"near": box("0.01 0.01 0.03", "0 0 0.015"), "thumb": box("0.01 0.01 0.02")}
    mount = joint("mount", "flange", "palm", "fixed")
    return made(robot([*ARM, mount, *joints], solids), "palm", {})


def test_a_thumb_of_several_joints_is_a_finger_however_short() -> None:
    """Fails where it is taken for a linkage's bar: fingers side by side then never close."""
    geometry = short_thumb().geometry
    assert [link for link, _ in geometry.tips] == ["distal_a", "distal_b", "thumb"]
    closed = dict(zip(geometry.names, geometry.closed, strict=True))
    assert closed["bend_a"] == closed["bend_b"] == 1.5


def test_a_knuckle_without_a_solid_reaches_nowhere() -> None:
    """Fails where it is as long as the palm behind it, and its end is the fingertip."""
    knuckle = joint("spread", "palm", "knuckle", xyz="0 0 0.08", axis="0 1 0")
    missing = '<collision><geometry><mesh filename="package://g/no.stl"/></geometry></collision>'
    text = robot([knuckle, joint("bend", "knuckle", "finger", axis="1 0 0")], {"knuckle": missing})
    [shape] = load_description(text, "a test", (), 0.01).shapes["knuckle"]
    assert shape.kind == "sphere"


def test_a_finger_that_parts_has_a_tip_at_each_end() -> None:
    """Fails where two pads on one side count as one, and the hand's centre is before that one."""
    pads = [
        joint("side_l", "hand", "left", xyz="0 -0.03 0", axis="-1 0 0", limits=(0.0, 0.6)),
        joint("side_r", "hand", "right", xyz="0 0.03 0", axis="1 0 0", limits=(0.0, 0.6)),
        joint("end_a", "left", "a", xyz="0.02 0 0.08", axis="-1 0 0", limits=(0.0, 0.1)),
        joint("end_b", "left", "b", xyz="-0.02 0 0.08", axis="-1 0 0", limits=(0.0, 0.1)),
        joint("end_c", "right", "c", xyz="0 0 0.08", axis="1 0 0", limits=(0.0, 0.1)),
    ]
    solids = dict.fromkeys("abc", box("0.01 0.01 0.02", "0 0 0.01"))
    hand = made(robot([*ARM, joint("mount", "flange", "hand", "fixed"), *pads], solids), "hand", {})
    assert [link for link, _ in hand.geometry.tips] == ["a", "b", "c"]
    assert hand.centre[0] == pytest.approx(0.0, abs=1e-6)
