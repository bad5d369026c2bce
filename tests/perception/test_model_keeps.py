"""Catches: a model that forgets what is out of view, and one that keeps what was seen through."""

from __future__ import annotations

import numpy as np
from dgeval.config import FusionConfig
from dgeval.determinism import generator
from dgeval.geometry import Array, Intrinsics
from dgeval.perception.free_space import seen_through
from dgeval.perception.fusion import CUBE_M, LEAST_IN_CUBE, Fusion, thinned
from dgeval.perception.types import Observation
from hypothesis import given, settings
from hypothesis import strategies as st

CAMERA = Intrinsics(320, 240, 290.0, 290.0, 160.0, 120.0)


def sheet(rng: np.random.Generator, n: int, x: tuple[float, float]) -> Array:
    """Points (n, 3) m of a sheet 5 cm high between two places in x."""
    return np.column_stack([rng.uniform(*x, n), rng.uniform(0, 0.05, n), np.full(n, 0.5)])


def test_what_is_out_of_view_is_not_forgotten() -> None:
    """Fails where each merge thins the whole model alike: after 100 frames of its left half the
    right half would be gone, and the target's box half of what it is.
    """
    rng = np.random.default_rng(0)
    whole, left = sheet(rng, 900, (0.0, 0.10)), sheet(rng, 900, (0.0, 0.05))
    fusion = Fusion(FusionConfig(max_model_points=1000))
    for k in range(100):
        points = whole if k == 0 else left
        normals = np.tile([0.0, 0.0, -1.0], (len(points), 1))
        fusion.step(Observation(points, normals), np.eye(4), generator(0, "fusion", k))
    assert fusion.model is not None
    right = fusion.model.points[fusion.model.points[:, 0] > 0.05]
    n_cubes = 25  # of the right half
    assert len(fusion.model.points) == 1000
    assert len(right) >= 0.9 * n_cubes * LEAST_IN_CUBE
    assert len(right) < 0.25 * 1000, "what is in view must have most of the points"


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**31),
    st.integers(2, 400),
    st.floats(0.0, 1.0),
    st.sampled_from([0.005, 0.05, 0.8]),
)
def test_thinning_keeps_as_many_as_asked_and_some_of_each_cube(
    seed: int, m: int, share: float, size: float
) -> None:
    """Fails for models larger than any quota, single points, and places left of the origin."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-size, size, (m, 3))
    n = max(1, round(share * m))
    chosen = thinned(points, n, rng)
    assert len(chosen) == n
    assert (np.diff(chosen) > 0).all()
    cells = np.floor(points / CUBE_M).astype(int)
    _, cube = np.unique(cells, axis=0, return_inverse=True)
    before = np.bincount(cube.ravel())
    after = np.bincount(cube.ravel()[chosen], minlength=len(before))
    least = max(k for k in range(LEAST_IN_CUBE + 1) if np.minimum(before, k).sum() <= n)
    assert (after >= np.minimum(before, least)).all()


def test_points_before_farther_readings_are_seen_through() -> None:
    """Fails where a missing reading, something in front, or noise counts as seen through, and where
    the edge of the image is read past.
    """
    depth = np.full((240, 320), 0.5, np.float32)
    depth[:, :100] = 0.0
    depth[:, 200:] = 0.3
    points = np.array(
        [
            [0.0, 0.0, 0.45],  # 5 cm before what is there
            [0.0, 0.0, 0.495],  # within noise
            [0.0, 0.0, 0.55],  # behind it
            [-0.2, 0.0, 0.45],  # no reading
            [0.1, 0.0, 0.45],  # something nearer
            [5.0, 0.0, 0.45],  # beside the image
            [0.0, 0.0, -0.45],  # behind the camera
        ]
    )
    assert seen_through(points, depth, CAMERA).tolist() == [True, *[False] * 6]


def test_a_frame_that_sees_through_most_of_the_model_takes_nothing_out() -> None:
    """Fails where one wrong pose empties the model."""
    rng = np.random.default_rng(0)
    points = sheet(rng, 400, (0.0, 0.05))
    observation = Observation(points, np.tile([0.0, 0.0, -1.0], (400, 1)))
    for share, left in ((0.2, 720), (0.5, 800)):
        fusion = Fusion(FusionConfig(max_model_points=2000))
        fusion.step(observation, np.eye(4), rng)
        gone = np.arange(400) < share * 400
        fusion.step(observation, np.eye(4), rng, gone)
        assert fusion.model is not None
        assert len(fusion.model.points) == left
