"""Catches: distortion left in points, taken out the wrong way, a lens that folds back."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from dgeval.config import Config
from dgeval.geometry import Intrinsics
from dgeval.recording.lens import lens_of
from dgeval.recording.manifest import find_trials
from dgeval.recording.messages import CameraModel
from dgeval.recording.trials import open_trial
from tests.recording.recorders import (
    COLOUR,
    DEPTH,
    INFO,
    Message,
    depth_codes,
    image,
    opened,
    write,
)

MATRIX = Intrinsics(320, 240, 300.0, 305.0, 158.0, 121.0)
K = np.array([[300.0, 0, 158.0], [0, 305.0, 121.0], [0, 0, 1.0]])
LENSES = {
    "plumb_bob": (-0.25, 0.08, 0.001, -0.002, 0.0),
    "rational_polynomial": (0.4, -2.5, 0.0005, -0.0003, 1.4, 0.28, -2.3, 1.35),
    "equidistant": (0.05, -0.02, 0.003, -0.001),
}


def through(name: str, points: np.ndarray) -> np.ndarray:
    """Where the lens shows the pixels (n, 2) of an ideal camera, by OpenCV's own functions."""
    rays = np.column_stack([(points - K[:2, 2]) / np.diag(K)[:2], np.ones(len(points))])
    D = np.array(LENSES[name])
    if name == "equidistant":
        shown, _ = cv2.fisheye.projectPoints(rays[:, None], np.zeros(3), np.zeros(3), K, D)
    else:
        shown, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, D)
    return np.asarray(shown).reshape(-1, 2)


@pytest.mark.parametrize("name", sorted(LENSES))
def test_dots_stand_where_a_pinhole_camera_has_them(name: str) -> None:
    """Fails where the distortion is applied the other way round, or with another model."""
    ideal = np.array([[x, y] for x in range(30, 300, 45) for y in range(30, 220, 45)], float)
    depth = np.zeros((240, 320), np.float32)
    for k, (u, v) in enumerate(np.rint(through(name, ideal)).astype(int)):
        depth[v - 1 : v + 2, u - 1 : u + 2] = k + 1
    lens, note = lens_of(CameraModel(MATRIX, "c", LENSES[name], lens_model=name), MATRIX)
    assert lens is not None
    assert "taken out" in note
    straight = lens.depth(depth)
    for k, place in enumerate(ideal):
        rows, columns = np.nonzero(straight == k + 1)
        assert np.abs(np.array([columns.mean(), rows.mean()]) - place).max() < 1.0


@pytest.mark.parametrize("name", sorted(LENSES))
def test_a_box_goes_with_the_picture(name: str) -> None:
    """Fails where a box that a person drew stays at the recorded picture's place."""
    lens, _ = lens_of(CameraModel(MATRIX, "c", LENSES[name], lens_model=name), MATRIX)
    assert lens is not None
    corners = np.array([[220.0, 150.0], [290.0, 210.0]])
    (x0, y0), (x1, y1) = through(name, corners)
    assert np.allclose(lens.box((x0, y0, x1, y1)), (220, 150, 290, 210), atol=6.0)


def test_what_a_lens_folds_back_is_not_seen() -> None:
    """Fails where the corners show a second picture of the middle."""
    model = CameraModel(MATRIX, "c", (-0.9, 0.0, 0.0, 0.0), lens_model="plumb_bob")
    wide = Intrinsics(320, 240, 150.0, 150.0, 159.5, 119.5)
    lens, _ = lens_of(model, wide)
    assert lens is not None
    assert lens.depth(np.ones((240, 320), np.float32))[0, 0] == 0.0
    assert lens.depth(np.ones((240, 320), np.float32))[120, 160] == 1.0


def test_a_small_or_unknown_distortion_stays() -> None:
    """Fails where a picture is drawn anew for nothing, or by a model that nobody named."""
    none = lens_of(CameraModel(MATRIX, "c", (1e-4, 0, 0, 0, 0), lens_model="plumb_bob"), MATRIX)
    assert none == (None, "")
    lens, note = lens_of(CameraModel(MATRIX, "c", (0.1, 0.2), lens_model="spherical"), MATRIX)
    assert lens is None
    assert "spherical" in note
    assert "not removed" in note


@pytest.mark.slow
def test_points_of_a_warped_recording_are_the_originals(
    tmp_path: Path, messages: list[Message]
) -> None:
    """Fails where depth's points are those of the warped picture (up to 20 mm off at its edge)."""
    info = next(m[3] for m in messages if m[1] == INFO)
    k = np.asarray(info.k).reshape(3, 3)
    D = np.array([-0.15, 0.05, 0.001, -0.001, 0.0])
    size = info.width, info.height
    u, v = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in size))
    ideal = cv2.undistortPoints(np.stack([u, v], axis=-1).reshape(-1, 1, 2), k, D, P=k)
    maps = [np.ascontiguousarray(ideal.reshape(*u.shape, 2)[..., i]) for i in range(2)]
    changed = []
    for m in messages:
        log_ns, topic, kind, value = m
        if topic == INFO:
            value = copy.deepcopy(value)
            value.d = D
        elif topic == COLOUR:
            picture = cv2.imdecode(np.asarray(value.data, np.uint8), cv2.IMREAD_COLOR)
            value = copy.deepcopy(value)
            warped = cv2.remap(picture, *maps, cv2.INTER_LINEAR)
            value.data = cv2.imencode(".png", warped)[1].ravel()
        elif topic == DEPTH:
            codes = cv2.remap(depth_codes(value), *maps, cv2.INTER_NEAREST)
            kind, value = "sensor_msgs/msg/Image", image(value, codes, "16UC1")
        changed.append([log_ns, topic, kind, value])
    trial = opened(write(tmp_path / "warped.mcap", changed))
    assert any("taken out" in note for note in trial.notes)
    plain = opened(write(tmp_path / "plain.mcap", messages))
    for got, want in zip(list(trial.frames())[:20:6], list(plain.frames())[:20:6], strict=True):
        both = (got.depth > 0) & (want.depth > 0)
        assert both.mean() > 0.9 * (want.depth > 0).mean()
        assert np.mean(np.abs(got.depth - want.depth)[both] < 0.003) > 0.97
        assert np.mean(np.abs(got.colour.astype(int) - want.colour)[20:-20, 20:-20] < 25) > 0.97
        assert got.colour_file is None
    (spec,) = find_trials([tmp_path / "warped.mcap"])
    boxed = open_trial(replace(spec, bbox=(10.0, 10.0, 60.0, 50.0)), Config())
    assert boxed.spec.bbox is not None
    assert boxed.spec.bbox[0] < 10.0
