"""Whether the camera's poses fit its colour pictures, by points that it sees again.

Depth alone hardly tells a mirrored picture from a true one over a flat table, nor a joint that
turns the wrong way. Points of the texture do: carried into the base frame, what stands still stays
where it is, and what lies on a belt or a turntable moves evenly, whatever the camera does. Of a
camera that itself moves evenly all the time, the wrong axis can't be told from a belt.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgeval.determinism import generator
from dgeval.geometry import Array, best_rigid, increment, invert, transform
from dgeval.recording.frame import Frame

WIDTH = 320  # px, of the pictures in which points are looked for
MOST_POINTS, CONTRAST = 400, 0.015  # SIFT, per picture
RATIO = 0.8  # Lowe 2004, of the distances to the best and the second best point
# m, and share of the middle depth, by which the camera moves between two frames at least; ours
STEP_M, STEP_SHARE = 0.04, 0.1
TRIPLES = 200  # of points, drawn to find the motion that most points share
AGREES = 0.015  # share of the depth, by which a point may miss the motion that it shares; ours
LEAST_AGREE, LEAST_SHARE = 12, 0.4  # points, and share of the points, that share a motion; ours
# of the picture's sides, how far the points that share a motion reach in the upper quartile of the
# steps. Less is one thing, which a hand may hold: in 13 simulated handovers to a jaw, whose view
# shows little else, it is 0.21 to 0.30, in 72 other trials at least 0.33 in all but five; ours
LEAST_EXTENT = 0.33
WITH_CAMERA = 0.2  # share of the camera's motion, below which points move with the camera; ours
LEAST_STEPS = 4
LEAST_SPIN = 0.05  # rad/s, about the vertical, of a scene that is said to turn
# share of the steps in which right poses fit, and share of the camera's motion by which the scene
# seems to move along; ours. Over 49 simulated trials with right poses at most 0.042, in 48 of them
# 0.014; with mirrored pictures more than 0.05 in 41 of 48, with an axis that runs the other way in
# 42 of 49; with depth 40 mm too far more than 0.015 in 34 of 47
MUST_FIT = 0.4
NOT_QUITE, CONTRADICTS = 0.015, 0.06
LEAST_LEFT = 0.1  # of a point's depth, whatever is taken off


@dataclass(frozen=True)
class Correction:
    """What would be right if something of the recording were wrong; by default nothing is.

    factor, farther_m: depth is `factor` times as far, and `farther_m` on top. focal: focal lengths
    are `focal` times as large. principal (2,): the principal point is farther right and down, in
    focal lengths. turned (3,) rad: the camera's pose is T_base_camera followed by this rotation
    vector, in the camera's frame. later_s: the robot was where the pictures were taken this much
    after their stamps. depth_later_s: depth alone was taken this much after its stamps.
    """

    factor: float = 1.0
    farther_m: float = 0.0
    focal: float = 1.0
    principal: tuple[float, float] = (0.0, 0.0)
    turned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    later_s: float = 0.0
    depth_later_s: float = 0.0

    def of(self, points: Array) -> Array:
        """Points (n, 3) m of the camera's frame, each where it would be. Poses are apart."""
        along = np.maximum(self.factor + self.farther_m / points[:, 2:], LEAST_LEFT)
        moved = points - points[:, 2:] * [*self.principal, 0.0]
        return moved * along / [self.focal, self.focal, 1.0]


AS_RECORDED = Correction()


@dataclass(frozen=True)
class SceneStep:
    """Two frames by whose points most of what is seen moves as one.

    t_a_ns, t_b_ns: their times. moved_m: by the camera. T_base_a, T_base_b (4, 4): its given poses.
    a, b (n, 3) m: the same points in the camera's frame, then and later.
    """

    t_a_ns: int
    t_b_ns: int
    moved_m: float
    T_base_a: Array
    T_base_b: Array
    a: Array
    b: Array

    @property
    def seconds(self) -> float:
        """Between the two, s."""
        return (self.t_b_ns - self.t_a_ns) * 1e-9

    def seeming(self, corrected: Correction) -> tuple[Array, Array, Array]:
        """How the scene seems to move by the camera's poses: its middle, the middle's shift, (3,)
        m, and its turn, (3,) rad, a rotation vector, all in the base frame.
        """
        a, b = corrected.of(self.a), corrected.of(self.b)
        T_turned = increment(np.array([0.0, 0.0, 0.0, *corrected.turned]))
        T_base_a, T_base_b = self.T_base_a @ T_turned, self.T_base_b @ T_turned
        T_moved = T_base_b @ best_rigid(a, b) @ invert(T_base_a)
        was = transform(T_base_a, a.mean(axis=0)[None])
        shift = transform(T_moved, was) - was
        return was[0], shift[0], Rotation.from_matrix(T_moved[:3, :3]).as_rotvec()


@dataclass(frozen=True)
class _Points:
    """Points of a picture: (N, 3) m in the camera's frame, and (N, 128) what they look like."""

    xyz: Array
    looks: NDArray[np.float32]


def scene_steps(frames: Sequence[Frame]) -> list[SceneStep]:
    """From each frame to the next one from which the camera has moved by STEP_M, where enough of
    the same points are seen. None where what moves as one is but a small part of the picture.
    """
    posed = [f for f in frames if f.T_base_camera is not None]
    seen: dict[int, _Points] = {}
    rng = generator(0, "scene_motion", 0)
    out, extents = [], []
    for i, j in _far_enough(posed):
        for k in (i, j):
            if k not in seen:
                seen[k] = _points_of(posed[k])
        T_a, T_b = posed[i].T_base_camera, posed[j].T_base_camera
        assert T_a is not None
        assert T_b is not None
        moved_m = float(np.linalg.norm(T_b[:3, 3] - T_a[:3, 3]))
        shared = _moving_as_one(*_same_points(seen[i], seen[j]), moved_m, rng)
        if shared is not None:
            extents.append(_extent(shared[1], posed[j]))
            out.append(SceneStep(posed[i].t_ns, posed[j].t_ns, moved_m, T_a, T_b, *shared))
    return out if out and float(np.quantile(extents, 0.75)) >= LEAST_EXTENT else []


def _extent(points: Array, frame: Frame) -> float:
    """Of most of the points (n, 3) m, in shares of the picture's sides, their geometric mean."""
    camera = frame.camera
    sides = np.array([camera.fx / camera.width, camera.fy / camera.height])
    low, high = np.quantile(points[:, :2] / points[:, 2:] * sides, [0.1, 0.9], axis=0)
    return float(np.sqrt(np.prod(high - low)))


def _far_enough(posed: Sequence[Frame]) -> Iterator[tuple[int, int]]:
    """Each frame and the next one from which the camera has moved far enough for what it sees."""
    for i, a in enumerate(posed):
        far = float(np.median(a.depth[a.depth > 0])) if (a.depth > 0).any() else 0.0
        for j in range(i + 1, len(posed)):
            T_a, T_b = a.T_base_camera, posed[j].T_base_camera
            assert T_a is not None
            assert T_b is not None
            if np.linalg.norm(T_b[:3, 3] - T_a[:3, 3]) >= max(STEP_M, STEP_SHARE * far):
                yield i, j
                break


def seeming_motion(steps: Sequence[SceneStep], corrected: Correction = AS_RECORDED) -> float | None:
    """The share of the camera's motion by which the scene moves neither not at all nor evenly, in
    the best MUST_FIT of the steps. Evenly: with one velocity, and one turn rate about the vertical.

    In the other steps a hand may push what it comes to. None with too few steps.
    """
    if len(steps) < LEAST_STEPS:
        return None
    seconds = np.array([s.seconds for s in steps])
    middle, shift, turn = (
        np.array(listed) for listed in zip(*(s.seeming(corrected) for s in steps), strict=True)
    )
    moved = np.array([s.moved_m for s in steps])
    still = np.linalg.norm(shift, axis=1)
    # a belt or a turntable may also stand for a while: each step's motion is tried for all
    shares = [
        np.minimum(still, np.linalg.norm(shift - moving, axis=1)) / moved
        for moving in _as_each(seconds, middle, shift, turn[:, 2] / seconds)
    ]
    return float(min(np.sort(s)[int(MUST_FIT * len(steps))] for s in shares))


def _as_each(seconds: Array, middle: Array, shift: Array, spins: Array) -> Iterator[Array]:
    """By step, the shifts (n, 3) m of all steps if all moved evenly as this one does: along, or
    about a vertical axis. seconds, spins (n,) s, rad/s; middle, shift (n, 3) m.
    """
    for k, spin in enumerate(spins):
        along = shift[k] / seconds[k] * seconds[:, None]
        if abs(spin) >= LEAST_SPIN:
            turned = np.exp(1j * spin * seconds) - 1.0  # of a point at 1 from the axis
            at, moved = (v[:, 0] + 1j * v[:, 1] for v in (middle, shift))
            axis = at[k] - moved[k] / turned[k]
            along[:, :2] = np.stack([(f := turned * (at - axis)).real, f.imag], axis=1)
        yield along


def _points_of(frame: Frame) -> _Points:
    """Points of the texture whose depth is known."""
    grey = cv2.cvtColor(frame.colour, cv2.COLOR_RGB2GRAY)
    scale = min(1.0, WIDTH / grey.shape[1])
    if scale < 1.0:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    sift = cv2.SIFT.create(nfeatures=MOST_POINTS, contrastThreshold=CONTRAST)
    corners, looks = sift.detectAndCompute(grey, None)
    if not corners:
        return _Points(np.zeros((0, 3)), np.zeros((0, 128), np.float32))
    uv = (np.array([c.pt for c in corners]) + 0.5) / scale - 0.5
    height, width = frame.depth.shape
    at = np.clip(np.rint(uv).astype(int), 0, (width - 1, height - 1))
    z = frame.depth[at[:, 1], at[:, 0]].astype(np.float64)
    known = z > 0
    xyz = frame.camera.backproject(uv[known, 0], uv[known, 1], z[known])
    return _Points(xyz, looks[known])


def _same_points(a: _Points, b: _Points) -> tuple[Array, Array]:
    """(N, 3) each, m, in the frames of two cameras: points that look alike and unlike others."""
    if len(a.xyz) < 2 or len(b.xyz) < 2:
        return np.zeros((0, 3)), np.zeros((0, 3))
    two = cv2.BFMatcher(cv2.NORM_L2).knnMatch(a.looks, b.looks, k=2)
    clear = [best for best, second in two if best.distance < RATIO * second.distance]
    return a.xyz[[m.queryIdx for m in clear]], b.xyz[[m.trainIdx for m in clear]]


def _moving_as_one(
    a: Array, b: Array, moved_m: float, rng: np.random.Generator
) -> tuple[Array, Array] | None:
    """Those of the points (N, 3) that share the motion which most have; None where too few do.

    Points that move with the camera, as those on the hand, are left out.
    """
    with_camera = np.linalg.norm(b - a, axis=1) < WITH_CAMERA * moved_m
    a, b = a[~with_camera], b[~with_camera]
    if len(a) < LEAST_AGREE:
        return None
    triples = rng.integers(0, len(a), (TRIPLES, 3))
    T = best_rigid(a[triples], b[triples])
    off = np.linalg.norm(np.einsum("kij,nj->kni", T[:, :3, :3], a) + T[:, None, :3, 3] - b, axis=2)
    shared = off < AGREES * b[:, 2]
    agree = shared[int(shared.sum(axis=1).argmax())]
    for _ in range(3):
        if agree.sum() < LEAST_AGREE:
            return None
        T_b_a = best_rigid(a[agree], b[agree])
        agree = np.linalg.norm(transform(T_b_a, a) - b, axis=1) < AGREES * b[:, 2]
    if agree.sum() < max(LEAST_AGREE, LEAST_SHARE * len(a)):
        return None
    return a[agree], b[agree]
