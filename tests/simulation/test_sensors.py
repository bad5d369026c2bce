"""The stereo depth camera of the simulator: each test names the fault that it catches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dgeval.determinism import generator
from dgeval.geometry import Array, Intrinsics, increment
from dgeval.simulation import sensors
from dgeval.simulation.sensors import (
    D405,
    D435,
    DepthImage,
    DepthProfile,
    Image32,
    align_to_colour,
    colour_from_depth,
    colour_intrinsics,
    depth_intrinsics,
    measure_depth,
)

SIZES = [(640, 480), (424, 240)]
SHARP = replace(
    D435, subpixel_sigma=0.0, flying=0.0, edge_hole=0.0, min_range=0.1
)  # geometry without chance


def flat(camera: Intrinsics, z: float) -> Image32:
    return np.full((camera.height, camera.width), z, np.float32)


def tilted(camera: Intrinsics, z: float, slope_x: float, slope_y: float = 0.0) -> Image32:
    """Plane through the axis at z with the given tangents of its tilt.

    Z = z + slope_x X + slope_y Y, in m.
    """
    u = (np.arange(camera.width) - camera.cx)[None] / camera.fx
    v = (np.arange(camera.height) - camera.cy)[:, None] / camera.fy
    return np.asarray(z / (1 - slope_x * u - slope_y * v), np.float32)


def shoot(exact: Image32, camera: Intrinsics, profile: DepthProfile, frame: int = 0) -> DepthImage:
    return measure_depth(exact, camera, profile, generator(5, "depth", frame))


def disparity(camera: Intrinsics, profile: DepthProfile, z: float) -> float:
    return camera.fx * profile.baseline / z


@pytest.mark.parametrize(
    ("size", "depth", "colour"),
    [((640, 480), 385, 620.8), ((424, 240), 212.6, 310.4), ((1280, 720), 641.7, 931.2)],
)
def test_focal_lengths_are_those_of_the_streams_of_a_d435(
    size: tuple[int, int], depth: float, colour: float
) -> None:
    """Catches scaling with width alone, which is 20 % wrong in 4:3.

    Real ones have 383, 211, 638 px (depth) and 612, 306, 919 px (colour).
    """
    assert depth_intrinsics(D435, *size).fx == pytest.approx(depth, abs=0.1)
    assert colour_intrinsics(D435, *size).fx == pytest.approx(colour, abs=0.1)
    assert colour_intrinsics(D405, *size) == depth_intrinsics(D405, *size)
    assert depth_intrinsics(D435, *size).cx == (size[0] - 1) / 2


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("z", [0.3, 0.5, 0.8, 1.2])
def test_noise_of_a_wall_is_that_of_the_formula_without_bias(
    size: tuple[int, int], z: float
) -> None:
    """Catches noise in metres instead of disparity, a wrong kernel norm, and one-sided rounding."""
    camera = depth_intrinsics(D435, *size)
    errors = []
    for k in range(
        4
    ):  # a quarter millimetre apart, since the rounding to 1 mm depends on where the wall is
        depth = shoot(flat(camera, z + k * 0.00025), camera, D435, k)
        errors.append(depth[depth > 0] * 0.001 - (z + k * 0.00025))
    error = np.concatenate(errors)
    per_px = z * z / (camera.fx * D435.baseline)
    expected = np.sqrt((per_px * 0.08) ** 2 + (per_px / 32) ** 2 / 12 + 0.001**2 / 12)
    assert error.std() == pytest.approx(expected, rel=0.12)
    assert abs(error.mean()) < 0.0003


def test_noise_is_smooth_over_a_matching_window() -> None:
    """Catches white noise, which averages out far faster than a stereo camera's, and weaker noise
    at the border.
    """
    noise = sensors._noise((480, 640), 2.0, generator(1, "n", 0))
    assert np.corrcoef(noise[:, :-1].ravel(), noise[:, 1:].ravel())[0, 1] == pytest.approx(
        np.exp(-1 / 16), abs=0.01
    )
    assert abs(np.corrcoef(noise[:, :-14].ravel(), noise[:, 14:].ravel())[0, 1]) < 0.05
    assert noise.std() == pytest.approx(1, abs=0.03)
    assert np.concatenate([noise[:2].ravel(), noise[:, -2:].ravel()]).std() == pytest.approx(
        1, abs=0.12
    )
    assert np.mean(noise**4) == pytest.approx(3, abs=0.2)


def test_noise_grows_with_slope() -> None:
    """Catches noise that does not depend on the slope."""
    camera = depth_intrinsics(D435, 640, 480)
    spread = []
    for slope in (0.0, 1.5):
        exact = tilted(camera, 0.6, 0.0, slope)
        depth = shoot(exact, camera, D435)
        d = np.divide(1, depth, where=depth > 0, out=np.zeros(depth.shape)) * 1000 - 1 / exact
        spread.append(d[200:280][depth[200:280] > 0].std())
    assert 1.15 < spread[1] / spread[0] < 1.6


@pytest.mark.parametrize("profile", [D435, D405])
@pytest.mark.parametrize("size", SIZES)
def test_nothing_is_measured_below_the_minimum_range(
    profile: DepthProfile, size: tuple[int, int]
) -> None:
    """Catches noise or mixed values that leak below it, a step instead of a ramp, and a limit that
    depends on the image's size.
    """
    camera = depth_intrinsics(profile, *size)
    nearest = profile.min_range
    assert not shoot(flat(camera, 0.97 * nearest), camera, profile).any()
    slanted = shoot(tilted(camera, nearest, 0.3), camera, profile)
    assert slanted[slanted > 0].min() >= round(nearest * 1000)
    visible = slice(None), slice(int(disparity(camera, profile, nearest)) + 2, None)
    shares = [
        np.mean(shoot(flat(camera, nearest * k), camera, profile)[visible] > 0)
        for k in (1.03, 1.07, 1.2)
    ]
    assert 0.1 < shares[0] < shares[1] < 0.9
    assert shares[2] == 1


def test_nothing_is_measured_beyond_the_maximum_range_or_the_range_of_the_counts() -> None:
    """Catches a range without an end, and counts that overflow."""
    camera = depth_intrinsics(D435, 424, 240)
    assert not shoot(flat(camera, 10.5), camera, SHARP).any()
    assert shoot(flat(camera, 9.5), camera, SHARP).any()
    assert not shoot(
        flat(camera, 80.0), camera, replace(D435, max_range=1000.0, subpixel_sigma=0.0)
    ).any()


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("z", [0.4, 0.7])
def test_a_box_hides_the_wall_on_its_left_only(size: tuple[int, int], z: float) -> None:
    """Catches a second imager on the wrong side, a shadow of wrong width, and shadows above and
    below.
    """
    camera = depth_intrinsics(SHARP, *size)
    width, height = size
    left, right, top, bottom = width // 2, width * 3 // 4, height // 4, height * 3 // 4
    exact = flat(camera, 0.8)
    exact[top:bottom, left:right] = z
    hole = shoot(exact, camera, SHARP) == 0
    expected = disparity(camera, SHARP, z) - disparity(camera, SHARP, 0.8)
    band = int(np.ceil(disparity(camera, SHARP, 0.8)))  # outside the second image
    assert hole[:, : band - 2].all()
    rows = hole[top:bottom]
    assert abs(rows[:, band + 2 : left].sum(axis=1) - expected).max() <= 1.5
    assert rows[:, int(left - expected + 2) : left - 1].all()
    assert not rows[:, left:].any()
    assert not hole[: top - 1, band + 2 :].any()
    assert not hole[bottom + 1 :, band + 2 :].any()


def test_the_wall_shows_between_a_thin_rod_and_its_shadow() -> None:
    """Catches a suffix minimum in place of an occlusion test, which would lose the whole gap."""
    camera = depth_intrinsics(SHARP, 640, 480)
    exact = flat(camera, 0.8)
    exact[:, 400:410] = 0.4
    row = shoot(exact, camera, SHARP)[240]
    start = 400 - (disparity(camera, SHARP, 0.4) - disparity(camera, SHARP, 0.8))
    lost = np.flatnonzero(row[40:] == 0) + 40
    assert lost.min() == pytest.approx(start, abs=1.5)
    assert lost.max() == pytest.approx(start + 9, abs=1.5)
    assert len(lost) == pytest.approx(10, abs=2)


def test_the_shadow_of_a_board_that_the_second_imager_sees_larger_is_whole() -> None:
    """Catches a wall that shows through the empty columns between the points of the board."""
    camera = depth_intrinsics(SHARP, 640, 480)
    exact = flat(camera, 1.2)
    exact[:, 250:400] = tilted(camera, 0.4, 1.2)[:, 250:400]
    edge = int(250 - disparity(camera, SHARP, float(exact[0, 250])) + disparity(camera, SHARP, 1.2))
    assert not shoot(exact, camera, SHARP)[:, edge + 2 : 249].any()


@pytest.mark.parametrize("slope", [-1.7, -0.8, 0.8, 1.7])
def test_a_tilted_plane_hides_nothing_of_itself_and_has_no_edges(slope: float) -> None:
    """Catches a slanted surface that is taken for a depth edge or for its own occluder.

    Several of its pixels fall into one column of the second image.
    """
    camera = depth_intrinsics(D435, 640, 480)
    x = np.broadcast_to((np.arange(640) - camera.cx)[None] / camera.fx, (480, 640))
    y = np.broadcast_to((np.arange(480) - camera.cy)[:, None] / camera.fy, (480, 640))
    for tilt in ((slope, 0.0), (0.0, slope)):
        exact = tilted(camera, 0.25, *tilt)
        depth = shoot(exact, camera, replace(D435, min_range=0.15))
        cos = (1 - tilt[0] * x - tilt[1] * y) / np.sqrt((1 + slope**2) * (1 + x**2 + y**2))
        inside = (exact > 0.17) & (exact < 2) & (cos > np.cos(np.radians(64)))
        inside &= np.arange(640)[None] > camera.fx * D435.baseline / exact + 2
        assert inside.sum() > 10000
        assert np.mean(depth[inside] > 0) > 0.999
        assert (np.abs(depth * 0.001 - exact)[inside] < 0.04 * exact[inside] ** 2 + 0.001).all()


def test_grazing_surfaces_are_lost() -> None:
    """Catches incidence taken from the optical axis instead of the ray, or left out."""
    camera = depth_intrinsics(D435, 640, 480)
    below = (np.arange(480) - camera.cy)[:, None] / camera.fy
    z = np.where(below > 0.02, 0.2 / np.maximum(below, 0.02), 0)  # a floor 0.2 m under the camera
    exact = np.broadcast_to(z, (480, 640)).astype(np.float32)
    depth = shoot(exact, camera, SHARP)
    side = (np.arange(640) - camera.cx)[None] / camera.fx
    angle = np.degrees(np.arccos(np.clip(below, 0, None) / np.sqrt(1 + below**2 + side**2)))
    visible = (exact > 0) & (np.arange(640)[None] > camera.fx * 0.05 / np.maximum(exact, 0.1) + 2)
    visible[:260] = False  # the horizon is an edge
    assert not depth[visible & (angle > 81)].any()
    assert np.mean(depth[visible & (angle > 67) & (angle < 78)] > 0) == pytest.approx(0.6, abs=0.04)
    assert np.mean(depth[visible & (angle < 63)] > 0) > 0.999


def test_edges_have_holes_and_values_between_the_surfaces() -> None:
    """Clean edges, mixed values outside the two surfaces, wrong shares."""
    camera = depth_intrinsics(D435, 640, 480)
    profile = replace(D435, subpixel_sigma=0.0)
    exact = flat(camera, 0.8)
    exact[:, 200:400] = 0.4
    depth = np.concatenate([shoot(exact, camera, profile, k)[:, 398:402] for k in range(4)])
    mixed = (depth > 405) & (depth < 790)
    assert np.mean(depth == 0) == pytest.approx(profile.edge_hole, abs=0.05)
    assert np.mean(mixed) == pytest.approx(profile.flying, abs=0.05)
    assert depth[depth > 0].min() >= 399
    assert depth.max() <= 802
    clean = shoot(exact, camera, replace(profile, flying=0.0, edge_hole=0.0))[:, 398:402]
    np.testing.assert_array_equal(clean, np.broadcast_to(clean[0], clean.shape))
    assert clean.all()


def test_equal_generators_give_equal_bytes_and_others_do_not() -> None:
    camera = depth_intrinsics(D435, 424, 240)
    exact = tilted(camera, 0.5, 0.5)
    before = exact.tobytes()
    first = shoot(exact, camera, D435, 3)
    assert first.dtype == np.uint16
    assert first.tobytes() == shoot(exact, camera, D435, 3).tobytes()
    assert first.tobytes() != shoot(exact, camera, D435, 4).tobytes()
    assert exact.tobytes() == before


def test_draws_of_a_pixel_do_not_depend_on_the_rest_of_the_image() -> None:
    """Catches draws that depend on what is visible.

    One changed pixel would change the noise of a whole twin image.
    """
    camera = depth_intrinsics(D435, 424, 240)
    one, other = flat(camera, 0.5), flat(camera, 0.5)
    other[:100] = 0
    np.testing.assert_array_equal(shoot(one, camera, D435)[104:], shoot(other, camera, D435)[104:])


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf, -1.0, 1e-30])
def test_what_is_not_a_depth_stays_nothing(bad: float) -> None:
    """Catches a warning, an exception, a value where there is no surface, or a
    hole that spreads.
    """
    camera = depth_intrinsics(D435, 424, 240)
    exact = flat(camera, 0.5)
    exact[100:120, 200:230] = bad
    depth = shoot(exact, camera, D435)
    assert not depth[100:120, 200:230].any()
    assert np.mean(depth[80:140, 150:280] > 0) > 0.9
    assert not shoot(flat(camera, bad), camera, D435).any()


CAMERA = Intrinsics(640, 480, 385.0, 385.0, 319.5, 239.5)


def offset(x: float) -> Array:
    T = np.eye(4)
    T[0, 3] = x
    return T


@pytest.mark.parametrize("T", [np.eye(4), offset(1e-7), increment(np.array([0, 0, 0, 0, 0, 1e-7]))])
def test_alignment_to_the_same_camera_changes_nothing(T: Array) -> None:
    """Catches rectangles a pixel too large, and rounding by truncation.

    Nearly equal transforms are aligned pixel by pixel, equal ones are copied.
    """
    depth = generator(1, "a", 0).integers(0, 65535, (480, 640)).astype(np.uint16)
    depth[::7] = 0
    np.testing.assert_array_equal(align_to_colour(depth, CAMERA, CAMERA, T, 0.001), depth)


def test_alignment_shifts_a_plane_by_its_disparity() -> None:
    """Catches the wrong sign or the inverse transform.

    The colour camera of a D435 lies at -x, so its image shifts to +x.
    """
    T = colour_from_depth(D435)
    assert T[0, 3] == 0.015
    depth = np.zeros((480, 640), np.uint16)
    depth[100:300, 200:400] = 385  # 385 px * 15 mm / 385 mm = 15 px
    expected = np.zeros_like(depth)
    expected[100:300, 215:415] = 385
    np.testing.assert_array_equal(align_to_colour(depth, CAMERA, CAMERA, T, 0.001), expected)


@pytest.mark.parametrize("side", [1, -1])
def test_alignment_keeps_the_nearest(side: int) -> None:
    """The last writer instead of the nearest, in either direction of the shift."""
    depth = np.full((480, 640), 770, np.uint16)
    depth[:, 300:340] = 385
    out = align_to_colour(depth, CAMERA, CAMERA, offset(0.015 * side), 0.001)
    columns = np.flatnonzero(out[240] == 385)
    assert columns.tolist() == list(range(300 + 15 * side, 340 + 15 * side))
    gap = np.flatnonzero(out[240, 20:620] == 0) + 20  # what the depth camera did not see
    assert len(gap) == pytest.approx(7.5, abs=1)
    assert (gap < 315).all() if side > 0 else (gap > 324).all()


@pytest.mark.parametrize("scale", [1.0, 1.15, 1.3, 1.61])
@pytest.mark.parametrize("slope", [-0.8, 0.0, 0.8])
def test_alignment_leaves_no_cracks_when_it_magnifies(scale: float, slope: float) -> None:
    """Catches points drawn instead of rectangles.

    Neighbours at different depth part by a fraction of a pixel.
    """
    colour = replace(CAMERA, fx=385 * scale, fy=385 * scale)
    depth = np.rint(tilted(CAMERA, 0.5, slope, 0.3) * 1000).astype(np.uint16)
    T = increment(np.array([0.015, 0.001, -0.001, 0.004, -0.003, 0.005]))
    out = align_to_colour(depth, CAMERA, colour, T, 0.001)[40:440, 60:600]
    assert out.all()


def test_alignment_puts_points_where_they_are() -> None:
    """Points of both images must agree.

    Catches depth along the wrong camera's axis, intrinsics mixed up, and a unit left out.
    """
    colour = Intrinsics(424, 240, 310.0, 305.0, 208.0, 121.0)
    T = increment(np.array([0.015, -0.01, 0.02, 0.02, -0.03, 0.01]))
    depth = np.rint(tilted(CAMERA, 0.5, 0.5, 0.2) * 10000).astype(np.uint16)
    out = align_to_colour(depth, CAMERA, colour, T, 0.0001)
    v, u = np.nonzero(out)
    points = colour.backproject(u, v, (out[v, u] * 0.0001).astype(np.float64))
    back = (points - T[:3, 3]) @ T[:3, :3]
    assert len(points) > 0.95 * out.size
    assert np.abs(back[:, 2] - 0.5 - 0.5 * back[:, 0] - 0.2 * back[:, 1]).max() < 0.0015


def test_alignment_of_nothing_and_of_what_is_behind() -> None:
    T = np.eye(4)
    T[2, 3] = -0.5
    depth = np.full((480, 640), 400, np.uint16)
    assert not align_to_colour(depth, CAMERA, CAMERA, T, 0.001).any()
    assert not align_to_colour(np.zeros_like(depth), CAMERA, CAMERA, T, 0.001).any()
