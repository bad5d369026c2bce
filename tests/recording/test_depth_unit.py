"""Catches: depth in another unit read as if it were metres, and a good recording called wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dgeval.geometry import Intrinsics
from dgeval.recording.camera_motion import moved_pairs
from dgeval.recording.depth_unit import factor_by_motion, inverse_fits, is_inverse, wrong_unit
from dgeval.recording.frame import Frame

CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)


def plane(height: float, x: float, tilt: float, scale: float, noise: int = 0) -> Frame:
    """A table seen from above, z of the camera downwards; depth times scale."""
    c, s = np.cos(np.pi + tilt), np.sin(np.pi + tilt)
    T = np.eye(4)
    T[:3, :3] = [[1, 0, 0], [0, c, -s], [0, s, c]]
    T[:3, 3] = [x, 0.0, height]
    v, u = np.mgrid[0:120, 0:160]
    rays = np.stack([(u - 79.5) / 150, (v - 59.5) / 150, np.ones_like(u)], axis=-1) @ T[:3, :3].T
    depth = -height / rays[..., 2]
    depth = depth + 0.002 * np.random.default_rng(noise).standard_normal(depth.shape)
    colour = np.zeros((120, 160, 3), np.uint8)
    return Frame(noise, noise, colour, (depth * scale).astype(np.float32), CAMERA, T, None)


@pytest.mark.parametrize("scale", [1.0, 10.0, 4.0])
def test_a_descent_tells_the_unit(scale: float) -> None:
    """Fails where ten times too large passes, as 0.1 mm read as millimetres does."""
    frames = [plane(0.6 - 0.04 * k, 0.01 * k, 0.2, scale, k) for k in range(8)]
    factor = factor_by_motion(moved_pairs(frames))
    assert factor is not None
    assert abs(np.log(factor * scale)) < 0.2
    assert (wrong_unit(frames, moved_pairs(frames)) is None) == (scale == 1.0)


def test_a_camera_that_only_slides_along_the_table_tells_nothing_wrong() -> None:
    """Fails where the share of a few noisy pixels decides."""
    frames = [plane(0.5, 0.03 * k, 0.0, 1.0, k) for k in range(8)]
    assert wrong_unit(frames, moved_pairs(frames)) is None


def test_a_camera_that_stands_still_says_nothing() -> None:
    frames = [plane(0.5, 0.0, 0.1, 10.0, k) for k in range(8)]
    assert factor_by_motion(moved_pairs(frames)) is None
    assert wrong_unit(frames, moved_pairs(frames)) is None


def test_millimetres_as_metres_need_no_motion() -> None:
    found = wrong_unit([plane(0.5, 0.0, 0.0, 1000.0)], [])
    assert found is not None
    assert found[1] == 1e-3


def test_what_moves_with_the_camera_is_no_wrong_unit() -> None:
    """Fails where a hand that fills the picture, always at one depth, calls the unit wrong."""
    frames = [plane(0.6 - 0.04 * k, 0.01 * k, 0.2, 1.0, k) for k in range(8)]
    still = [replace(f, depth=frames[0].depth) for f in frames]
    assert wrong_unit(still, moved_pairs(still)) is None


def test_what_comes_towards_the_camera_is_no_wrong_unit() -> None:
    """Fails where an object that is handed over as fast as the camera comes calls it wrong."""
    seen = [plane(0.6 - 0.06 * k, 0.0, 0.2, 1.0, k) for k in range(6)]
    camera = [plane(0.6 - 0.03 * k, 0.0, 0.2, 1.0, k) for k in range(6)]
    frames = [replace(a, T_base_camera=b.T_base_camera) for a, b in zip(seen, camera, strict=True)]
    assert wrong_unit(frames, moved_pairs(frames)) is None


def test_inverse_depth_is_told_by_what_is_flat() -> None:
    """Fails where disparity in 1/m, which about 1 m away has the size of depth, passes for metres,
    or where depth in metres is called inverse.
    """
    tilted = [plane(0.8, 0.03 * k, 0.5, 1.0, k) for k in range(6)]
    inverse = [replace(f, depth=(1.0 / f.depth).astype(np.float32)) for f in tilted]
    assert is_inverse(inverse)
    assert not is_inverse(tilted)
    from_above = [plane(0.8, 0.03 * k, 0.0, 1.0, k) for k in range(6)]
    assert not is_inverse(from_above)
    assert not is_inverse([replace(f, depth=np.zeros_like(f.depth)) for f in tilted])
    for flat in (0.4, 0.7, 1.1):  # exact, as a simulator's: what rounding prefers is no vote
        assert not is_inverse([replace(f, depth=np.full_like(f.depth, flat)) for f in tilted])


def test_inverse_depth_is_told_by_the_cameras_motion() -> None:
    """Fails where a table seen from above, on which both ways are flat, hides that z is 1/z."""
    descent = [plane(0.6 - 0.04 * k, 0.01 * k, 0.2, 1.0, k) for k in range(8)]
    assert inverse_fits([replace(f, depth=(1.0 / f.depth).astype(np.float32)) for f in descent])
    assert not inverse_fits(descent)
