"""Catches: a gate that refuses good fits on a noisy sensor, or opens for wrong camera poses."""

from __future__ import annotations

import numpy as np
import pytest
from dgeval.geometry import Array, Intrinsics, depth_sigma
from dgeval.perception.depth_noise import DepthNoise
from dgeval.recording.frame import Frame

CAMERA = Intrinsics(320, 240, 290.0, 290.0, 160.0, 120.0)
COLOUR = np.zeros((240, 320, 3), np.uint8)


def wall(distance: float, sigma: float, rng: np.random.Generator) -> Array:
    """Depth (h, w) m of a wall before the camera; no reading in 5 % of the pixels."""
    depth = distance + rng.normal(0, sigma, (240, 320))
    return np.where(rng.random(depth.shape) < 0.05, 0.0, depth).astype(np.float32)


def seen(sigma: float, step_m: float, said_m: float, frames: int = 20) -> DepthNoise:
    """A camera that nears a wall by step_m a frame, and whose poses say said_m."""
    noise, rng = DepthNoise(), np.random.default_rng(0)
    for k in range(frames):
        T = np.eye(4)
        T[2, 3] = k * said_m
        depth = wall(1.1 - k * step_m, sigma, rng)
        noise.see(Frame(k, k, COLOUR, depth, CAMERA, T, None), T)
    return noise


@pytest.mark.parametrize("sigma", [0.003, 0.0045])
def test_the_noise_of_a_wall_is_measured(sigma: float) -> None:
    """Fails by the square root of two where the difference of two readings is taken for one."""
    noise = seen(sigma, 0.002, 0.002)
    assert noise.sigma(np.array([1.1])) == pytest.approx([sigma], rel=0.05)


def test_less_noise_than_the_sensor_model_says_closes_no_gate() -> None:
    """Fails where errors that two frames share, and a model doesn't, refuse good fits."""
    noise = seen(0.0002, 0.002, 0.002)
    assert noise.sigma(np.array([1.1])) == pytest.approx(depth_sigma(np.array([1.1])))


def test_wrong_poses_open_the_gate_by_no_more_than_is_believed() -> None:
    noise = seen(0.001, 0.002, 0.022)
    assert noise.sigma(np.array([1.1])) == pytest.approx(3 * depth_sigma(np.array([1.1])))


def test_nothing_is_measured_without_poses_or_from_few_frames() -> None:
    noise, rng = DepthNoise(), np.random.default_rng(0)
    for k in range(20):
        noise.see(Frame(k, k, COLOUR, wall(1.1, 0.004, rng), CAMERA, None, None), None)
    assert noise.sigma(np.array([0.5, 1.1])) == pytest.approx(depth_sigma(np.array([0.5, 1.1])))
    assert not len(seen(0.004, 0.0, 0.0, 1).measured()[0])


def test_what_is_measured_at_one_range_holds_at_others() -> None:
    """The factor on the sensor model is carried to ranges that the recording doesn't show."""
    noise = seen(2 * float(depth_sigma(1.1)), 0.0, 0.0)
    assert noise.sigma(np.array([0.6])) == pytest.approx(2 * depth_sigma(np.array([0.6])), rel=0.1)


def test_the_noise_and_its_source_are_told() -> None:
    """Fails where a reader can't tell a measured noise from an assumed one."""
    assert seen(0.004, 0.0, 0.0).told() == (
        "depth noise: 4.0 mm at 1.10 m, measured between frames by the camera's poses"
    )
    assert DepthNoise().told().startswith("depth noise: 1.2 mm at 0.5 m by the sensor model, not")
