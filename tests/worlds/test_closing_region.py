"""The region that a hand closes in, against closed forms.

Catches: fingers that are swept from another posture, a palm or a first phalanx that counts, joints
that go through their limits, and a region in another frame than the hand's.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from dgeval.robots import dlr_hit_hand
from dgeval.robots.dlr_hit_hand import HAND as FIVE_FINGERS
from dgeval.robots.hand import BASE
from dgeval.robots.parallel_jaw import DISTAL, PROXIMAL, TRAVEL, T_hand_grasp
from dgeval.robots.parallel_jaw import HAND as JAW
from dgeval.worlds.closing_region import closing_region, last_solids, points_within
from dgeval.worlds.objects import ten_objects
from dgeval.worlds.scene import build
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation


@pytest.fixture(scope="module")
def jaw() -> mujoco.MjModel:
    return build(ten_objects()["apple"], robot="hand", gripper=JAW)


@pytest.mark.parametrize("open_m", [TRAVEL, 0.02])
def test_the_region_of_sliding_jaws_is_a_prism(jaw: mujoco.MjModel, open_m: float) -> None:
    """Both links of a jaw are one body: from the outer face of one to that of the other, as wide as
    the wider of them, from the end of the proximal link to the fingertip.
    """
    region = closing_region(jaw, JAW, np.full(2, open_m))
    tip = T_hand_grasp[2, 3] + DISTAL[1][2] + DISTAL[0][2]
    outer = open_m + PROXIMAL[1][0] + PROXIMAL[0][0]
    root = T_hand_grasp[2, 3] + PROXIMAL[1][2] - PROXIMAL[0][2]
    middle = np.array([0.0, 0.0, T_hand_grasp[2, 3] + DISTAL[1][2]])

    def depth(*point: float) -> float:
        return float(region.depth(np.array([point]))[0])

    assert depth(0.0, 0.0, tip - 0.001) == pytest.approx(0.001, abs=1e-9)
    assert depth(0.0, 0.0, tip + 0.002) == pytest.approx(-0.002, abs=1e-9)
    assert depth(0.0, DISTAL[0][1] - 0.001, middle[2]) == pytest.approx(0.001, abs=1e-9)
    assert depth(0.0, 0.0, root + 0.001) == pytest.approx(0.001, abs=1e-9)
    low = T_hand_grasp[2, 3] + PROXIMAL[1][2]
    assert depth(outer - 0.001, 0.0, low) == pytest.approx(0.001, abs=1e-9)
    assert depth(outer + 0.003, 0.0, low) == pytest.approx(-0.003, abs=1e-9)


def test_an_object_between_the_jaws_and_one_before_them(jaw: mujoco.MjModel) -> None:
    """The jaws are 22 mm wide, so that nothing is deeper than 11 mm between them. A lattice of at
    most 12 mm fills a box; its corners are among its points.
    """
    region = closing_region(jaw, JAW, JAW.open)
    assert region.deepest == pytest.approx(DISTAL[0][1], abs=1e-6)
    model = build(ten_objects()["sugar_box"], robot="hand", gripper=JAW)
    geoms = [g for g in range(model.ngeom) if model.geom(g).name.startswith("object_")]
    points = points_within(model, geoms)
    half = ten_objects()["sugar_box"].extent() / 2
    assert np.abs(points).max(axis=0) == pytest.approx(half)
    tip = T_hand_grasp[2, 3] + DISTAL[1][2] + DISTAL[0][2]
    nearest = cKDTree(points).query(np.random.default_rng(2).uniform(-half, half, (500, 3)))[0]
    assert nearest.max() < 0.006 * np.sqrt(3)
    # upright, its end before the hand; its middle is far off
    ends = np.array([[0.0, 0.0, half[2] + tip + off] for off in (-0.005, 0.001)])
    assert region.depth(points + ends[0]).max() == pytest.approx(0.005)
    assert region.depth(points + ends[1]).max() == pytest.approx(-0.001)


def test_the_fingers_of_a_hand_sweep_in_front_of_its_palm() -> None:
    """The place that held objects are at is inside, the middle of the palm is not; spread fingers
    close in more than bent ones, and turning the world changes nothing.
    """
    model = build(ten_objects()["apple"], robot="hand", gripper=FIVE_FINGERS)
    region = closing_region(model, FIVE_FINGERS, FIVE_FINGERS.open)
    middle, inside = FIVE_FINGERS.centre, region.depth(FIVE_FINGERS.centre[None])[0]
    assert inside > 0.02
    assert region.depth(np.array([dlr_hit_hand.PALM_BOXES[0][1]]))[0] < -0.01
    bent = closing_region(model, FIVE_FINGERS, np.tile([0.0, 1.2, 1.0], 5))
    points = middle + np.random.default_rng(0).uniform(-0.1, 0.1, (4000, 3))
    assert (bent.depth(points) > 0).sum() < 0.5 * (region.depth(points) > 0).sum()


def test_the_region_is_in_the_frame_of_the_hand_on_an_arm(jaw: mujoco.MjModel) -> None:
    """Catches a region of the world's frame: on an arm the hand's base is elsewhere."""
    arm = build(ten_objects()["apple"], robot="arm", gripper=JAW)
    flying, mounted = (closing_region(m, JAW, JAW.open) for m in (jaw, arm))
    points = np.random.default_rng(1).uniform(-0.1, 0.2, (100, 3))
    np.testing.assert_allclose(flying.depth(points), mounted.depth(points), atol=1e-9)


def test_only_the_last_links_of_fingers_sweep() -> None:
    """Catches a first phalanx, or something fixed to the palm, that counts as a fingertip."""
    model = build(ten_objects()["apple"], robot="hand", gripper=FIVE_FINGERS)
    named = {model.geom(g).name for g in last_solids(model, FIVE_FINGERS)}
    assert named == {f"{finger}_3" for finger in FIVE_FINGERS.fingers}
    spec = mujoco.MjSpec()
    base = spec.worldbody.add_body(name=BASE)
    JAW.add(spec, base)
    mount = base.add_body(name="mount")
    solid = mount.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.05] * 3, name="palm_mount")
    solid.contype = 2
    mounted = spec.compile()
    with_mount = closing_region(mounted, JAW, JAW.open)
    assert with_mount.deepest == pytest.approx(DISTAL[0][1], abs=1e-6)
    no_finger = replace(JAW, fingers=("thumb",))
    with pytest.raises(ValueError, match="no finger of parallel_jaw"):
        closing_region(mounted, no_finger, JAW.open)


@pytest.mark.parametrize("kind", ["CYLINDER", "CAPSULE", "SPHERE", "ELLIPSOID", "BOX"])
def test_a_solid_is_filled_where_it_is(kind: str) -> None:
    """Catches a size, a place or a turn that is left out: MuJoCo's own bounds are the reference."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body()
    turn = Rotation.from_euler("xyz", [0.4, -0.7, 1.1])
    x, y, z, w = turn.as_quat()
    body.add_geom(
        type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"),
        size=[0.02, 0.05, 0.03], pos=[0.1, -0.2, 0.3], quat=[w, x, y, z],
    )  # fmt: skip
    model = spec.compile()
    points = points_within(model, [0])
    local = turn.inv().apply(points - [0.1, -0.2, 0.3])
    centre, half = model.geom_aabb[0][:3], model.geom_aabb[0][3:]
    np.testing.assert_allclose(local.max(axis=0), centre + half, rtol=0.02)
    np.testing.assert_allclose(local.min(axis=0), centre - half, rtol=0.02)


def test_what_a_hand_is_told_beyond_its_limits_is_not_swept(jaw: mujoco.MjModel) -> None:
    """A drive that presses is sent far beyond where its joint ends."""
    presses = replace(JAW, targets=lambda _, drives: np.full_like(drives, -0.5))
    region = closing_region(jaw, presses, JAW.open)
    low = T_hand_grasp[2, 3] + PROXIMAL[1][2]
    assert region.depth(np.array([[PROXIMAL[1][0] + PROXIMAL[0][0] + 0.003, 0.0, low]]))[0] < 0
