"""Depth brought into the colour picture, held against the same scene cast ray by ray.

Catches: the wrong camera's matrix or the inverse transform, half a pixel, depth along the wrong
axis, a background that shines through what is in front of it, and cracks.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from dgeval.geometry import Array, Intrinsics, increment
from dgeval.recording.alignment import Alignment
from tests.recording.recorders import DEPTH as DEPTH_TOPIC
from tests.recording.recorders import INFO, Message, opened, write

DEPTH = Intrinsics(424, 240, 213.0, 212.0, 210.6, 121.3)
COLOUR = Intrinsics(640, 480, 612.0, 611.0, 322.4, 236.8)
# m and rad: a D435's colour camera; one that is mounted by hand, farther off and turned
MOUNTS = {
    "beside": np.array([0.015, 0.0, 0.0, 0.0, 0.0, 0.0]),
    "by hand": np.array([0.060, -0.020, 0.010, 0.03, -0.05, 0.02]),
}


BALL, RADIUS = np.array([-0.10, 0.02, 0.50]), 0.06  # m, the depth camera's frame
WALL, WALL_M = increment(np.array([0, 0, 0, 0.2, 0.1, 0]))[:3, 2], 1.0  # normal, and its distance
T_BOX = increment(np.array([0.10, -0.02, 0.60, 0.3, 0.6, 0.1]))
HALF = np.array([0.06, 0.04, 0.05])


def seen(k: Intrinsics, T_camera_world: Array) -> Array:
    """Depth of a tilted wall with a ball and a turned box before it, (H, W) m, by casting rays.

    inf where nothing is hit. The world is the depth camera's frame.
    """
    u, v = np.meshgrid(np.arange(k.width), np.arange(k.height))
    rays = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones(u.shape)], axis=-1)
    R, t = T_camera_world[:3, :3], T_camera_world[:3, 3]
    d, o = rays @ R, -R.T @ t  # a unit of d is a unit along the axis: the parameter is the depth
    hits = [(WALL_M - o @ WALL) / (d @ WALL)]
    a, b, c = (d * d).sum(-1), d @ (o - BALL), (o - BALL) @ (o - BALL) - RADIUS**2
    root = b * b - a * c
    hits.append(np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf))
    d_box, o_box = d @ T_BOX[:3, :3], T_BOX[:3, :3].T @ (o - T_BOX[:3, 3])
    one, two = (-HALF - o_box) / d_box, (HALF - o_box) / d_box
    enter, leave = np.minimum(one, two).max(-1), np.maximum(one, two).min(-1)
    hits.append(np.where((enter < leave) & (enter > 0), enter, np.inf))
    return np.asarray(np.min(hits, axis=0))


@pytest.mark.parametrize("mount", sorted(MOUNTS))
def test_aligned_depth_is_what_the_colour_camera_would_measure(mount: str) -> None:
    T = increment(MOUNTS[mount])
    measured = seen(DEPTH, np.eye(4))
    measured[~np.isfinite(measured)] = 0.0
    aligned = Alignment(DEPTH, COLOUR, T).apply(measured.astype(np.float32)).astype(float)
    true = seen(COLOUR, T)

    # what the depth camera sees of the colour camera's picture
    u, v = np.meshgrid(np.arange(COLOUR.width), np.arange(COLOUR.height))
    points = np.stack([(u - COLOUR.cx) / COLOUR.fx, (v - COLOUR.cy) / COLOUR.fy, np.ones(u.shape)])
    with np.errstate(invalid="ignore"):
        there = np.einsum("ij,jhw->ihw", T[:3, :3].T, points * true - T[:3, 3, None, None])
        du = np.rint(there[0] / there[2] * DEPTH.fx + DEPTH.cx)
        dv = np.rint(there[1] / there[2] * DEPTH.fy + DEPTH.cy)
    inside = np.isfinite(true) & (du >= 2) & (du < DEPTH.width - 2) & (dv >= 2)
    inside &= dv < DEPTH.height - 2
    at = np.where(inside, dv, 0).astype(int), np.where(inside, du, 0).astype(int)
    visible = inside & (np.abs(measured[at] - there[2]) < 0.01)
    hidden = inside & (measured[at] < there[2] - 0.05)

    both = visible & (aligned > 0)
    error = np.abs(aligned - true)[both]
    assert both.sum() > 0.98 * visible.sum(), "cracks"
    # a depth pixel is three colour pixels wide, and 3 mm deep on a slope of 45 degrees
    assert np.median(error) < 0.0015
    assert (error > 0.02).mean() < 0.02, "only at edges"
    near = visible & (true < 0.75)
    assert (aligned[near] > true[near] + 0.05).mean() < 0.01, "the wall shines through"
    assert hidden.sum() > 300
    assert (aligned[hidden] == 0).mean() > 0.5, "what only the colour camera sees has no depth"


def test_the_mount_matters() -> None:
    """The same measure fails with the inverse transform, so it can tell."""
    T = increment(MOUNTS["by hand"])
    measured = seen(DEPTH, np.eye(4))
    measured[~np.isfinite(measured)] = 0.0
    aligned = Alignment(DEPTH, COLOUR, np.linalg.inv(T)).apply(measured.astype(np.float32))
    true = seen(COLOUR, T)
    both = np.isfinite(true) & (aligned > 0)
    assert np.median(np.abs(aligned - true)[both]) > 0.005


def test_one_frame_with_two_matrices_is_not_aligned(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where depth with intrinsics of its own is laid on colour pixel by pixel, since both
    bear one frame's name and one size.
    """
    listed = list(messages)
    for m in messages:
        if m[1] == INFO:
            other = copy.deepcopy(m[3])
            other.k = other.k * np.array([0.7, 1, 1, 1, 0.7, 1, 1, 1, 1])
            listed.append([m[0], DEPTH_TOPIC.rsplit("/", 2)[0] + "/camera_info", m[2], other])
    trial = opened(write(tmp_path / "a.mcap", listed))
    assert trial.reader.camera.alignment is not None
    assert trial.reader.camera.alignment.depth.fx == pytest.approx(0.7 * trial.camera.fx)


def _half(message: Message) -> Message:
    value = replace(message[3])
    data = np.asarray(value.data, np.uint8)
    small = np.ascontiguousarray(cv2.imdecode(data[12:], cv2.IMREAD_UNCHANGED)[::2, ::2])
    value.data = np.concatenate([data[:12], cv2.imencode(".png", small)[1].ravel()])
    return [*message[:3], value]


def test_aligned_depth_at_half_the_resolution_is_read(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where it is said to be brought into the colour picture, and no frame can be used."""
    halved = [_half(m) if m[1] == DEPTH_TOPIC else m for m in messages]
    trial = opened(write(tmp_path / "a.mcap", halved))
    whole = opened(write(tmp_path / "b.mcap", messages))
    assert trial.checks == ()
    pairs = zip(trial.frames(), whole.frames(), strict=True)
    depths = [(frame.depth, expected.depth) for frame, expected in pairs]
    seen = np.array([((a > 0) & (b > 0)).sum() for a, b in depths])
    assert seen.sum() > 0.95 * sum((b > 0).sum() for _, b in depths)
    off = np.concatenate([np.abs(a - b)[(a > 0) & (b > 0)] for a, b in depths])
    assert np.median(off) < 0.002
