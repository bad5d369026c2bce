"""Whether the camera's poses fit its colour pictures, by points that it sees again.

Depth alone hardly tells a mirrored picture from a true one over a flat table, nor a joint that
turns the wrong way. Points of the texture do: carried into the base frame, what stands still stays
where it is, and what lies on a belt or a turntable moves evenly, whatever the camera does. Of a
camera that itself moves evenly all the time, the wrong axis can't be told from a belt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from dgeval.determinism import generator
from dgeval.geometry import Array, invert
from dgeval.recording.frame import Frame

WIDTH = 320  # px, of the pictures in which points are looked for
MOST_POINTS, CONTRAST = 400, 0.015  # SIFT, per picture
RATIO = 0.8  # Lowe 2004, of the distances to the best and the second best point
# m, and share of the middle depth, by which the camera moves between two frames at least; ours
STEP_M, STEP_SHARE = 0.04, 0.1
TRIPLES = 200  # of points, drawn to find the motion that most points share
AGREES = 0.015  # share of the depth, by which a point may miss the motion that it shares; ours
LEAST_AGREE, LEAST_SHARE = 12, 0.4  # points, and share of the points, that share a motion; ours
WITH_CAMERA = 0.2  # share of the camera's motion, below which points move with the camera; ours
LEAST_STEPS = 4
LEAST_SPIN = 0.05  # rad/s, about the vertical, of a scene that is said to turn
# share of the steps in which right poses fit, and share of the camera's motion by which the scene
# seems to move along; ours. Over 49 simulated trials with right poses at most 0.042, in 48 of them
# 0.014; with mirrored pictures more than 0.05 in 41 of 48, with an axis that runs the other way in
# 42 of 49; with depth 40 mm too far more than 0.015 in 34 of 47
MUST_FIT = 0.4
NOT_QUITE, CONTRADICTS = 0.015, 0.06


@dataclass(frozen=True)
class SceneStep:
    """How most of what is seen in two frames seems to move, by the camera's given poses.

    seconds: between them. moved_m: by the camera. middle: (3,) m, base frame, of what is seen.
    shift: (3,) m, of the middle. turn: (3,) rad, rotation vector, base frame.
    """

    seconds: float
    moved_m: float
    middle: Array
    shift: Array
    turn: Array


@dataclass(frozen=True)
class _Points:
    """Points of a picture: (N, 3) m in the camera's frame, and (N, 128) what they look like."""

    xyz: Array
    looks: Array


def scene_steps(frames: Sequence[Frame]) -> list[SceneStep]:
    """From each frame to the next one from which the camera has moved by STEP_M, where enough of
    the same points are seen.
    """
    posed = [f for f in frames if f.T_base_camera is not None]
    seen: dict[int, _Points] = {}
    out = []
    rng = generator(0, "scene_motion", 0)
    for i, a in enumerate(posed):
        assert a.T_base_camera is not None
        far = float(np.median(a.depth[a.depth > 0])) if (a.depth > 0).any() else 0.0
        for j in range(i + 1, len(posed)):
            b = posed[j]
            assert b.T_base_camera is not None
            moved = float(np.linalg.norm(b.T_base_camera[:3, 3] - a.T_base_camera[:3, 3]))
            if moved < max(STEP_M, STEP_SHARE * far):
                continue
            for k in (i, j):
                if k not in seen:
                    seen[k] = _points_of(posed[k])
            pair = _same_points(seen[i], seen[j])
            motion = _shared_motion(*pair, moved, rng)
            if motion is not None:
                T_b_a, middle_a = motion
                T_moved = b.T_base_camera @ T_b_a @ invert(a.T_base_camera)
                was = a.T_base_camera[:3, :3] @ middle_a + a.T_base_camera[:3, 3]
                now = T_moved[:3, :3] @ was + T_moved[:3, 3]
                turn = Rotation.from_matrix(T_moved[:3, :3]).as_rotvec()
                seconds = (b.t_ns - a.t_ns) * 1e-9
                out.append(SceneStep(seconds, moved, was, now - was, turn))
            break
    return out


def seeming_motion(steps: Sequence[SceneStep]) -> float | None:
    """The share of the camera's motion by which the scene moves neither not at all nor evenly, in
    the best MUST_FIT of the steps. Evenly: with one velocity, and one turn rate about the vertical.

    In the other steps a hand may push what it comes to. None with too few steps.
    """
    if len(steps) < LEAST_STEPS:
        return None
    seconds = np.array([s.seconds for s in steps])[:, None]
    middle = np.array([s.middle for s in steps])
    shift = np.array([s.shift for s in steps])
    moved = np.array([s.moved_m for s in steps])
    spin = float(np.median(np.array([s.turn[2] for s in steps]) / seconds[:, 0]))
    if abs(spin) < LEAST_SPIN:
        spin = 0.0
    lever = middle - np.median(middle, axis=0)
    evenly = shift - spin * seconds * np.stack([-lever[:, 1], lever[:, 0], 0 * lever[:, 0]], axis=1)
    still = np.linalg.norm(shift, axis=1)
    shares = [
        np.minimum(still, np.linalg.norm(evenly - velocity * seconds, axis=1)) / moved
        for velocity in evenly / seconds
    ]
    return float(min(np.sort(s)[int(MUST_FIT * len(steps))] for s in shares))


def _points_of(frame: Frame) -> _Points:
    """Points of the texture whose depth is known."""
    grey = cv2.cvtColor(frame.colour, cv2.COLOR_RGB2GRAY)
    scale = min(1.0, WIDTH / grey.shape[1])
    if scale < 1.0:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    sift = cv2.SIFT.create(nfeatures=MOST_POINTS, contrastThreshold=CONTRAST)
    corners, looks = sift.detectAndCompute(grey, None)
    if not corners:
        return _Points(np.zeros((0, 3)), np.zeros((0, 128)))
    uv = (np.array([c.pt for c in corners]) + 0.5) / scale - 0.5
    height, width = frame.depth.shape
    at = np.clip(np.rint(uv).astype(int), 0, (width - 1, height - 1))
    z = frame.depth[at[:, 1], at[:, 0]].astype(np.float64)
    known = z > 0
    xyz = frame.camera.backproject(uv[known, 0], uv[known, 1], z[known])
    return _Points(xyz, looks[known].astype(np.float64))


def _same_points(a: _Points, b: _Points) -> tuple[Array, Array]:
    """(N, 3) each, m, in the frames of two cameras: points that look alike and unlike others."""
    if len(a.xyz) < 2 or len(b.xyz) < 2:
        return np.zeros((0, 3)), np.zeros((0, 3))
    alike = a.looks @ b.looks.T
    apart = np.sqrt(
        np.maximum(
            (a.looks**2).sum(axis=1)[:, None] + (b.looks**2).sum(axis=1)[None] - 2 * alike, 0
        )
    )
    two = np.argpartition(apart, 1, axis=1)[:, :2]
    best, second = np.take_along_axis(apart, two, axis=1).T
    nearest = two[:, 0]
    swap = second < best
    nearest = np.where(swap, two[:, 1], nearest)
    best, second = np.minimum(best, second), np.maximum(best, second)
    clear = best < RATIO * second
    return a.xyz[clear], b.xyz[nearest[clear]]


def _shared_motion(
    a: Array, b: Array, moved_m: float, rng: np.random.Generator
) -> tuple[Array, Array] | None:
    """T_b_a that most points share, and their middle in a; None where too few do.

    Points that move with the camera, as those on the hand, are left out.
    """
    with_camera = np.linalg.norm(b - a, axis=1) < WITH_CAMERA * moved_m
    a, b = a[~with_camera], b[~with_camera]
    if len(a) < LEAST_AGREE:
        return None
    triples = rng.integers(0, len(a), (TRIPLES, 3))
    T = _rigid(a[triples], b[triples])
    off = np.linalg.norm(np.einsum("kij,nj->kni", T[:, :3, :3], a) + T[:, None, :3, 3] - b, axis=2)
    shared = off < AGREES * b[:, 2]
    agree = shared[int(shared.sum(axis=1).argmax())]
    for _ in range(3):
        if agree.sum() < LEAST_AGREE:
            return None
        T_b_a = _rigid(a[None, agree], b[None, agree])[0]
        off_all = np.linalg.norm(a @ T_b_a[:3, :3].T + T_b_a[:3, 3] - b, axis=1)
        agree = off_all < AGREES * b[:, 2]
    if agree.sum() < max(LEAST_AGREE, LEAST_SHARE * len(a)):
        return None
    return T_b_a, a[agree].mean(axis=0)


def _rigid(a: Array, b: Array) -> Array:
    """(K, 4, 4): T that maps the points a (K, N, 3) onto b best, Kabsch 1976."""
    middle_a, middle_b = a.mean(axis=1), b.mean(axis=1)
    u, _, vt = np.linalg.svd(
        np.einsum("kni,knj->kij", a - middle_a[:, None], b - middle_b[:, None])
    )
    v, ut = vt.transpose(0, 2, 1), u.transpose(0, 2, 1)
    proper = np.ones((len(a), 3))
    proper[:, 2] = np.sign(np.linalg.det(v @ ut))
    out = np.tile(np.eye(4), (len(a), 1, 1))
    out[:, :3, :3] = (v * proper[:, None]) @ ut
    out[:, :3, 3] = middle_b - np.einsum("kij,kj->ki", out[:, :3, :3], middle_a)
    return out
