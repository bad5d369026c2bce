"""Catches: links elsewhere than MuJoCo has them, a lost coupling, files that a text names."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from dgeval.errors import UsageError
from dgeval.geometry import Array
from dgeval.robots.described_hand import DescribedHand, described_hand
from dgeval.robots.description import Description
from dgeval.robots.hand_links import HandLinks, hand_links
from dgeval.robots.loading import load_description
from dgeval.robots.mjcf_description import is_mjcf
from tests.robots.urdf_texts import GRIPPER, PADS, robot

# defaults, degrees, Euler angles, an anchor off the body's frame, two joints on one body, a
# reference position, a site, a coupling with offset
ARM = """<?xml version="1.0"?>
<!-- made for a test -->
<mujoco model="arm">
  <compiler angle="degree" eulerseq="zyx"/>
  <default><default class="finger">
    <joint type="slide" axis="0 1 0" range="-0.01 0.04"/>
  </default></default>
  <worldbody>
    <geom type="plane" size="1 1 0.1"/>
    <body name="base" pos="0.1 0 0.3" euler="30 10 0">
      <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.03"/>
      <body name="upper" pos="0 0 0.2" euler="0 20 0">
        <joint name="shoulder" axis="0 1 0" pos="0 0.02 0.05" range="-90 90" limited="true"/>
        <geom type="box" size="0.02 0.03 0.1" pos="0 0 0.1" euler="0 0 15"/>
        <geom type="sphere" size="0.2" contype="0" conaffinity="0"/>
        <body name="wrist" pos="0 0 0.25">
          <joint name="pitch" axis="1 0 0" ref="20"/>
          <joint name="roll" axis="0 0 1" pos="0.01 0 0"/>
          <geom type="ellipsoid" size="0.02 0.03 0.04"/>
          <site name="tcp" pos="0 0 0.1" euler="90 0 0"/>
          <body name="left" pos="0 0.01 0.06">
            <joint name="jaw" class="finger" limited="true"/>
            <geom type="cylinder" size="0.01 0.02"/>
          </body>
          <body name="right" pos="0 -0.01 0.06">
            <joint name="other" class="finger" axis="0 -1 0" ref="0.005" limited="true"/>
            <geom type="mesh" mesh="wedge"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <asset><mesh name="wedge" vertex="0 0 0  0.02 0 0  0 0.02 0  0 0 0.04" scale="1 1 2"/></asset>
  <equality><joint joint1="other" joint2="jaw" polycoef="0.002 0.5 0 0 0"/></equality>
</mujoco>"""


def loaded(text: str, mesh_dirs: tuple[str, ...] = ()) -> Description:
    return load_description(text, "a test", mesh_dirs, 0.01)


def poses(description: Description, positions: dict[str, float]) -> dict[str, Array]:
    """By link, T_world_link."""
    out = {"world": np.eye(4)}
    while len(out) <= len(description.joints):
        for joint in description.joints.values():
            if joint.parent in out:
                out[joint.child] = out[joint.parent] @ joint.moved(positions.get(joint.name, 0.0))
    return out


def test_links_are_where_mujoco_has_them() -> None:
    description = loaded(ARM)
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(20):
        data.qpos[:] = rng.uniform(-0.8, 0.8, model.nq)
        mujoco.mj_kinematics(model, data)
        named = {model.joint(j).name: float(data.qpos[j]) for j in range(model.njnt)}
        T = poses(description, named)
        for b in range(1, model.nbody):
            link = T[model.body(b).name]
            np.testing.assert_allclose(link[:3, 3], data.xpos[b], atol=1e-12)
            np.testing.assert_allclose(link[:3, :3], data.xmat[b].reshape(3, 3), atol=1e-12)
        np.testing.assert_allclose(T["tcp"][:3, 3], data.site_xpos[0], atol=1e-12)
        np.testing.assert_allclose(T["tcp"][:3, :3], data.site_xmat[0].reshape(3, 3), atol=1e-12)
    assert description.notes == []


def test_solids_limits_and_coupling() -> None:
    description = loaded(ARM)
    kinds = {link: [s.kind for s in shapes] for link, shapes in description.shapes.items()}
    assert kinds == {
        "world": [], "base": ["capsule"], "upper": ["box"], "wrist": ["hull"],
        "left": ["cylinder"], "right": ["hull"],
    }  # fmt: skip
    capsule, box = description.shapes["base"][0], description.shapes["upper"][0]
    assert capsule.size == pytest.approx((0.03, 0.1))
    assert capsule.T_link_shape[:3, 3] == pytest.approx([0, 0, 0.1])
    assert box.size == (0.02, 0.03, 0.1)
    corners = description.shapes["right"][0].corners
    assert corners is not None
    assert corners.max(axis=0) == pytest.approx([0.02, 0.02, 0.08])
    ball = description.shapes["wrist"][0].corners
    assert ball is not None
    assert np.ptp(ball, axis=0)[2] == pytest.approx(0.08)
    joints = {j.name: j for j in description.joints.values()}
    assert (joints["shoulder"].lower, joints["shoulder"].upper) == pytest.approx(
        (-np.pi / 2, np.pi / 2)
    )
    assert (joints["jaw"].lower, joints["jaw"].upper, joints["jaw"].kind) == (
        -0.01, 0.04, "prismatic",
    )  # fmt: skip
    assert not np.isfinite(joints["roll"].upper)
    other = joints["other"]
    assert other.follows == "jaw"
    # MuJoCo's constraint: q_other - 0.005 = 0.002 + 0.5 q_jaw
    assert (other.multiplier, other.offset) == pytest.approx((0.5, 0.007))
    assert other.at(0.02) == pytest.approx(other.moved(0.017))


def test_what_cant_be_taken_whole_is_said(tmp_path: Path) -> None:
    text = ARM.replace('vertex="0 0 0  0.02 0 0  0 0.02 0  0 0 0.04"', 'file="gone.stl"')
    description = loaded(text, (str(tmp_path),))
    [note] = description.notes
    assert "gone.stl is not found (link right)" in note
    assert "capsules from joint origins stand in for: right" in note
    lost = ARM.replace('mesh="wedge"', 'mesh="nowhere"')
    assert "a mesh 'nowhere' that the text does not have (link right)" in loaded(lost).notes[0]
    free = ARM.replace('<geom type="capsule"', '<freejoint name="afloat"/><geom type="capsule"')
    assert loaded(free).notes == ["the free joint afloat is taken as fixed"]
    bent = ARM.replace("0.002 0.5 0 0 0", "0.002 0.5 0.1 0 0")
    assert loaded(bent).notes == [
        "joint other is coupled otherwise than by a factor: taken as free"
    ]
    pulled = ARM.replace(
        "<equality>",
        '<tendon><fixed name="t"><joint joint="pitch" coef="1"/><joint joint="roll" coef="1"/>'
        "</fixed></tendon><equality>",
    )
    assert loaded(pulled).notes == ["a tendon drives pitch, roll together: each must be recorded"]
    twice = pulled.replace("</tendon>", '<fixed name="u"><joint joint="pitch" coef="1"/>'
                           '<joint joint="roll" coef="-1"/></fixed></tendon>')  # fmt: skip
    assert loaded(twice).notes == loaded(pulled).notes
    coupled = pulled.replace('joint="pitch"', 'joint="jaw"')
    coupled = coupled.replace('joint="roll"', 'joint="other"')
    assert loaded(coupled).notes == []  # one follows the other, whatever drives both


def test_a_part_of_a_model_that_is_in_radians_is_told() -> None:
    """As robosuite's grippers are, whose <compiler> stands in the robot that they are put on."""
    part = ARM.replace('<compiler angle="degree" eulerseq="zyx"/>', '<compiler eulerseq="zyx"/>')
    assert loaded(part).notes == []
    part = part.replace('range="-90 90"', 'range="-1.57 1.57"')
    [note] = loaded(part).notes
    assert note.startswith("no joint turns by more than 3.1 degrees")
    stated = ARM.replace('range="-90 90"', 'range="-1.57 1.57"')
    assert loaded(stated).notes == []


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("<worldbody>", '<include file="other.xml"/><worldbody>', "<include>, which names other"),
        ("<asset>", '<asset><model name="m" file="other.xml"/>', "<model>, which names other"),
        ("</worldbody>", "", "no MJCF that MuJoCo takes"),
        ('pos="0.1 0 0.3"', 'pos="nan 0 0.3"', "a test"),
    ],
)
def test_a_text_that_is_broken_or_names_other_files_is_refused(
    old: str, new: str, why: str
) -> None:
    assert old in ARM
    with pytest.raises(UsageError, match=why):
        loaded(ARM.replace(old, new, 1))


def hand_in(text: str) -> DescribedHand:
    description = loaded(text)
    links = hand_links(description, "hand", {"jaw", "other_jaw"})
    assert isinstance(links, HandLinks), links
    return described_hand(description, links, np.eye(4), np.full(2, 0.04))


def test_the_same_gripper_in_both_formats_is_one_hand() -> None:
    pad = '<geom type="box" size="0.01 0.005 0.025" pos="0 {} 0.025"/>'
    text = f"""<mujoco><worldbody><body name="base_link">
      <body name="flange" pos="0 0 1.1"><body name="hand">
        <geom type="box" size="0.02 0.1 0.03" pos="0 0 0.03"/><site name="tcp" pos="0 0 0.1"/>
        <body name="left" pos="0 0 0.06">
          <joint name="jaw" type="slide" axis="0 1 0" range="0 0.04" limited="true"/>
          {pad.format(0.005)}
        </body>
        <body name="right" pos="0 0 0.06">
          <joint name="other_jaw" type="slide" axis="0 -1 0" range="0 0.04" limited="true"/>
          {pad.format(-0.005)}
        </body>
      </body></body></body></worldbody></mujoco>"""
    mine, urdf = hand_in(text), hand_in(robot(GRIPPER, PADS))
    assert mine.joints == urdf.joints
    assert mine.centre == pytest.approx(urdf.centre)
    assert mine.geometry.closed == pytest.approx(urdf.geometry.closed)
    np.testing.assert_allclose(
        mine.geometry.tips_at(mine.geometry.open), urdf.geometry.tips_at(urdf.geometry.open)
    )


def test_a_urdf_with_words_for_mujoco_stays_a_urdf() -> None:
    text = robot(GRIPPER, PADS).replace(
        "</robot>", '<mujoco><compiler discardvisual="false"/></mujoco></robot>'
    )
    assert set(loaded(text).joints) == set(loaded(robot(GRIPPER, PADS)).joints)


def test_the_comments_before_a_description_cost_no_time() -> None:
    """Fails where what a text is is told by a search that tries every pairing of its comments: a
    description under the banner that xacro writes is then never read.
    """
    banner = '<?xml version="1.0" ?>\n' + "<!-- === -->\n" * 60
    assert not is_mjcf(banner + robot(GRIPPER, PADS))
    assert is_mjcf("\n" + banner + "<mujoco/>")
    assert not is_mjcf("")
    assert not is_mjcf('<sdf version="1.9"/>')
    assert not is_mjcf("<!-- never closed")


def test_a_part_of_an_mjcf_is_named_as_that() -> None:
    with pytest.raises(UsageError, match="a part of an MJCF"):
        loaded("<mujocoinclude><body name='palm'/></mujocoinclude>")
