"""How well frames that a camera took from several places agree on what stands still."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dgeval.geometry import Array, Intrinsics, invert
from dgeval.recording.frame import Frame

MOVED_M = 0.05  # m, between two frames, from which on the camera's motion tells; ours
MOST_MOVED_M = 0.25  # m; frames farther apart hardly show the same things
EVERY = 7  # px, of rows and columns that are looked at
LEAST_POINTS = 200
LEAST_WORSE = 0.02  # share of the depth, by which frames that agree may differ at most; ours


@dataclass(frozen=True)
class MovedPair:
    """Two frames between which the camera moved by a way that tells.

    misfit: by the factor of depth, the median share by which the depth of frame b differs from that
    of frame a, carried into b; NaN where they hardly overlap. as_given: at factor 1.
    """

    a: Frame
    b: Frame
    misfit: Callable[[float], float]
    as_given: float


def moved_pairs(frames: Sequence[Frame]) -> list[MovedPair]:
    """All pairs of frames, in order, whose cameras are MOVED_M to MOST_MOVED_M apart."""
    out = []
    for a, b in combinations(frames, 2):
        if a.T_base_camera is None or b.T_base_camera is None:
            continue
        T_b_a = invert(b.T_base_camera) @ a.T_base_camera
        if MOVED_M <= np.linalg.norm(T_b_a[:3, 3]) <= MOST_MOVED_M:
            misfit = misfit_of(a, b, T_b_a)
            out.append(MovedPair(a, b, misfit, misfit(1.0)))
    return out


def misfit_of(a: Frame, b: Frame, T_b_a: Array) -> Callable[[float], float]:
    """By the factor of depth, the median share by which the depth of frame b differs from that of
    frame a, carried into b; NaN where they hardly overlap.
    """
    camera: Intrinsics = a.camera
    v, u = np.mgrid[0 : camera.height : EVERY, 0 : camera.width : EVERY]
    z = a.depth[v, u].astype(np.float64)
    seen = z > 0
    turned = camera.backproject(u[seen], v[seen], z[seen]) @ T_b_a[:3, :3].T

    def misfit(factor: float) -> float:
        points = turned * factor + T_b_a[:3, 3]
        points = points[points[:, 2] > 0.01]
        pixels = np.rint(b.camera.project(points)).astype(int)
        inside = ((pixels >= 0) & (pixels < (b.camera.width, b.camera.height))).all(axis=1)
        if inside.sum() < LEAST_POINTS:
            return float("nan")
        there = b.depth[pixels[inside, 1], pixels[inside, 0]].astype(np.float64) * factor
        both = there > 0
        if both.sum() < LEAST_POINTS:
            return float("nan")
        return float(np.median(np.abs(there[both] - points[inside, 2][both]) / there[both]))

    return misfit
