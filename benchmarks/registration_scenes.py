"""Rendered observations and models of boxes on a table at a given range.

Cropping and normals are those of dgeval's own stages.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from datasets.raycast import Box, Scene, add_noise, render
from dgeval.config import FusionConfig, ObservationConfig
from dgeval.geometry import Array, Intrinsics, increment, invert, transform
from dgeval.perception.fusion import Fusion
from dgeval.perception.observation import observe
from dgeval.perception.types import Features, Model, Observation, Tracked
from dgeval.recording.frame import Frame
from numpy.typing import NDArray

from benchmarks.synthetic import look_at

FULL = Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)
BOXES: dict[str, tuple[float, float, float]] = {  # half lengths m
    "box 16x10x7 cm": (0.080, 0.050, 0.035),
    "gelatin box 8.5x7.3x2.8 cm": (0.0425, 0.0365, 0.014),
    "foam brick 7.8x5.1x5.1 cm": (0.039, 0.0255, 0.0255),
}
LARGE: dict[str, tuple[float, float, float]] = {
    "parcel 20x20x15 cm": (0.10, 0.10, 0.075),
    "parcel 30x20x15 cm": (0.15, 0.10, 0.075),
}
RANGES = (0.3, 0.5, 0.7, 1.0)  # m
ELEVATION, AZIMUTH, YAW = 0.75, 0.3, 0.6  # rad
FEATURES, FEATURE_NOISE_PX = 60, 0.5
GREY = np.full((8, 8, 3), 128, np.uint8)


@dataclass(frozen=True)
class View:
    """One rendered view without noise.

    camera: a crop of FULL. depth: (H, W) m. mask: pixels of the box.
    """

    camera: Intrinsics
    depth: Array
    mask: NDArray[np.bool_]
    T_camera_object: Array


def view(
    half: tuple[float, float, float], distance: float, turn: float, shift: Array, yaw: float
) -> View:
    """Render the box from `distance` m, the camera turned by `turn` rad about the vertical.

    half: half lengths of the box, m. shift, yaw: of the box on the table, (3,) m and rad.
    """
    T_object = increment(np.array([*shift, 0.0, 0.0, YAW + yaw]))
    T_object[2, 3] += half[2]
    at = np.array([0.0, 0.0, half[2]])
    azimuth = AZIMUTH + turn
    ray = np.array(
        [
            np.cos(azimuth) * np.cos(ELEVATION),
            np.sin(azimuth) * np.cos(ELEVATION),
            np.sin(ELEVATION),
        ]
    )
    T_camera = look_at(at + distance * ray, at, turn)
    T = invert(T_camera) @ T_object
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.array(
        half
    )
    pixels = FULL.project(transform(T, corners))
    x0, y0 = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 8, 0)
    x1, y1 = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 8, (FULL.width, FULL.height))
    crop = Intrinsics(int(x1 - x0), int(y1 - y0), FULL.fx, FULL.fy, FULL.cx - x0, FULL.cy - y0)
    _, depth, ids = render(Scene(GREY, 1.2, [(Box(half, [GREY] * 6), T_object)]), crop, T_camera)
    return View(crop, depth, ids == 0, T)


def observed(rendered: View, rng: np.random.Generator) -> Observation:
    """P_t of a view with the sensor noise of datasets/raycast.py and the true mask."""
    colour, millimetres = add_noise(
        rng, np.zeros((*rendered.depth.shape, 3), np.uint8), rendered.depth
    )
    depth = (millimetres / 1000.0).astype(np.float32)
    frame = Frame(0, 0, colour, depth, rendered.camera, None, None)
    window = (0, 0, rendered.camera.width, rendered.camera.height)
    mask = rendered.mask & (depth > 0)
    tracked = Tracked("tracked", tuple(float(v) for v in window), window, mask, int(mask.sum()))  # type: ignore[arg-type]
    observation = observe(frame, tracked, rng, ObservationConfig())
    assert observation is not None
    return observation


def model(half: tuple[float, float, float], distance: float, rng: np.random.Generator) -> Model:
    """Q after six accepted frames at true poses, over which the camera turns by 5 degrees.

    The model frame is the object frame.
    """
    return model_of(
        [
            view(half, distance, float(turn), np.zeros(3), 0.0)
            for turn in np.linspace(-0.045, 0.045, 6)
        ],
        rng,
    )


def model_of(views: list[View], rng: np.random.Generator) -> Model:
    """Q after views at true poses, each with new noise. The model frame is the object frame."""
    fusion = Fusion(FusionConfig())
    for rendered in views:
        fusion.step(observed(rendered, rng), invert(rendered.T_camera_object), rng)
    assert fusion.model is not None
    return fusion.model


def features(rendered: View, rng: np.random.Generator) -> Features:
    """Points of the visible faces, and their pixels with a tracker's noise of FEATURE_NOISE_PX."""
    v, u = np.nonzero(rendered.mask)
    chosen = rng.choice(len(v), min(FEATURES, len(v)), replace=False)
    points = rendered.camera.backproject(
        u[chosen].astype(float), v[chosen].astype(float), rendered.depth[v[chosen], u[chosen]]
    )
    pixels = rendered.camera.project(points) + rng.normal(0, FEATURE_NOISE_PX, (len(points), 2))
    return Features(transform(invert(rendered.T_camera_object), points), pixels)


def disturbed(T: Array, rng: np.random.Generator, metres: float, angle: float) -> Array:
    """T with its origin shifted by `metres` and its axes turned by `angle` rad, both at random."""
    shift, axis = rng.standard_normal(3), rng.standard_normal(3)
    out = T.copy()
    out[:3, :3] = (
        increment(np.concatenate([np.zeros(3), axis / np.linalg.norm(axis) * angle]))[:3, :3]
        @ T[:3, :3]
    )
    out[:3, 3] += shift / np.linalg.norm(shift) * metres
    return out
