"""What would make the camera's poses fit its pictures, where they don't: each kind of error tried.

Wrong depth, intrinsics, hand-eye calibration and times all let a still scene seem to move along
with the camera (`scene_motion`), each in its own way: depth with the motion along the view, a
principal point with the motion across it, a turned camera with both, a delay with changes of speed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from dgeval.geometry import Array, invert, transform
from dgeval.recording.scene_motion import (
    LEAST_LEFT,
    LEAST_STEPS,
    Correction,
    SceneStep,
    seeming_motion,
)

# from which share on corrections are tried, the share that is left at most where one explains what
# is seen, and how many times better it fits; ours
SUSPECT, EXPLAINED, TIMES_BETTER = 0.010, 0.008, 3.0
# times as much, or this share more, may be left by another that explains it about as well; ours
AS_WELL, AS_WELL_SHARE = 3.0, 0.003
FACTORS = np.geomspace(0.15, 6.6, 97)  # of depth, that are tried; neighbours differ by 4 %
FOCALS = np.geomspace(0.6, 1.7, 27)  # of focal lengths, that are tried
FINER = np.linspace(0.96, 1.04, 17)  # of the best of them
FARTHER_M = np.arange(-0.15, 0.151, 0.005)  # m, on top of depth, that are tried
LATER_S = np.arange(-0.25, 0.2501, 0.01)  # s, that are tried
FIRST_ANGLE = 0.03  # rad and focal lengths, first steps of the search for a turn and a middle
MOST_TRIES = 120  # per search; two searches, one to each side
# less is no finding: in the logarithm, m, s, focal lengths, rad; ours
LEAST_FACTOR, LEAST_FARTHER_M, LEAST_LATER_S = 0.06, 0.020, 0.020
LEAST_PRINCIPAL, LEAST_TURN = 0.03, np.radians(1.0)
# a hand-eye calibration that is off by more is none, a principal point not of this picture; ours
MOST_TURN, MOST_PRINCIPAL = np.radians(10.0), 0.3


def corrections(
    steps: Sequence[SceneStep], seeming: float, pose_at: Callable[[int], Array | None]
) -> list[Correction]:
    """With which the scene moves as it should by the camera's poses, of each kind at most one, the
    best first; those that explain it much worse than the best are left out. None where what is
    recorded is as good as any, or where no other explains it.

    seeming: `seeming_motion` of the steps as recorded. pose_at: T_base_camera at a time in ns.
    """
    if seeming <= SUSPECT:
        return []
    found = [*_by_depth_or_focal(steps)]
    found += [_later(steps, pose_at, _with_pictures), _later(steps, pose_at, _with_depth)]
    found += [_searched(steps, 2, _with_principal), _searched(steps, 3, _with_turn)]
    explains = min(EXPLAINED, seeming / TIMES_BETTER)
    listed = sorted((f for f in found if f[0] <= explains and _is_other(f[1])), key=lambda f: f[0])
    if not listed:
        return []
    most = max(AS_WELL * listed[0][0], listed[0][0] + AS_WELL_SHARE)
    return [correction for left, correction in listed if left <= most]


def _left(steps: Sequence[SceneStep], correction: Correction) -> float:
    share = seeming_motion(steps, correction)
    return np.inf if share is None else share


def _best_of(steps: Sequence[SceneStep], tried: Iterable[Correction]) -> tuple[float, Correction]:
    return min(((_left(steps, c), c) for c in tried), key=lambda found: found[0])


def _by_depth_or_focal(steps: Sequence[SceneStep]) -> list[tuple[float, Correction]]:
    nearest_m = float(np.quantile(np.concatenate([step.a[:, 2] for step in steps]), 0.05))
    factor = _best_of(steps, (Correction(factor=float(f)) for f in FACTORS))[1].factor
    focal = _best_of(steps, (Correction(focal=float(f)) for f in FOCALS))[1].focal
    farther = (Correction(farther_m=float(m)) for m in FARTHER_M if m > -nearest_m / 2)
    return [
        _best_of(steps, farther),
        _best_of(steps, (Correction(factor=factor * float(f)) for f in FINER)),
        _best_of(steps, (Correction(focal=focal * float(f)) for f in FINER)),
    ]


def poses_then(
    steps: Sequence[SceneStep], pose_at: Callable[[int], Array | None], later_s: float
) -> list[tuple[SceneStep, Array, Array]]:
    """The steps with the camera's poses `later_s` after their two times, where both are known."""
    later_ns = round(later_s * 1e9)
    found = ((s, pose_at(s.t_a_ns + later_ns), pose_at(s.t_b_ns + later_ns)) for s in steps)
    return [(s, T_a, T_b) for s, T_a, T_b in found if T_a is not None and T_b is not None]


def _later(
    steps: Sequence[SceneStep],
    pose_at: Callable[[int], Array | None],
    made: Callable[[SceneStep, Array, Array, float], tuple[SceneStep, Correction]],
) -> tuple[float, Correction]:
    """The best of LATER_S at which the camera's pose is known in all steps but one.

    made: the step and the correction, by the camera's poses at that time and by how much it is.
    """
    found = np.inf, Correction()
    for later_s in LATER_S:
        then = poses_then(steps, pose_at, float(later_s))
        moved = [made(step, T_a, T_b, float(later_s)) for step, T_a, T_b in then]
        if len(moved) < max(LEAST_STEPS, len(steps) - 1):
            continue
        left = _left([step for step, _ in moved], Correction())
        if left < found[0]:
            found = left, moved[0][1]
    return found


def _with_pictures(
    step: SceneStep, T_a: Array, T_b: Array, later_s: float
) -> tuple[SceneStep, Correction]:
    """The robot was there when the pictures were taken."""
    return replace(step, T_base_a=T_a, T_base_b=T_b), Correction(later_s=later_s)


def _with_depth(
    step: SceneStep, T_a: Array, T_b: Array, later_s: float
) -> tuple[SceneStep, Correction]:
    """The robot was there when depth was taken: it is that of other places of the scene."""
    a = _seen_from_there(step.a, invert(step.T_base_a) @ T_a)
    b = _seen_from_there(step.b, invert(step.T_base_b) @ T_b)
    return replace(step, a=a, b=b), Correction(depth_later_s=later_s)


def _seen_from_there(points: Array, T_camera_then: Array) -> Array:
    """Points (n, 3) m, each on its ray as far as the scene is there, by depth from another place.

    T_camera_then (4, 4): the camera's pose when depth was taken, in the camera's frame of colour.
    The inverse depth of a plane is linear over the picture: its slope is that of all points.
    """
    there = transform(T_camera_then, points)
    inverse = 1.0 / np.maximum(there[:, 2], LEAST_LEFT * points[:, 2])
    at, ray = there[:, :2] * inverse[:, None], points[:, :2] / points[:, 2:]
    linear = np.column_stack([np.ones(len(at)), at])
    slope = np.linalg.lstsq(linear, inverse, rcond=None)[0][1:]
    inverse = inverse + (ray - at) @ slope
    depth = 1.0 / np.clip(inverse, LEAST_LEFT / points[:, 2], 1.0 / (LEAST_LEFT * points[:, 2]))
    return np.column_stack([ray, np.ones(len(ray))]) * depth[:, None]


def _with_principal(x: Array) -> Correction:
    return Correction(principal=(float(x[0]), float(x[1])))


def _with_turn(x: Array) -> Correction:
    return Correction(turned=(float(x[0]), float(x[1]), float(x[2])))


def _searched(
    steps: Sequence[SceneStep], numbers: int, made: Callable[[Array], Correction]
) -> tuple[float, Correction]:
    """The best by two searches (Nelder & Mead 1965) from none, one to each side."""

    def left(x: Array) -> float:
        return _left(steps, made(x))

    found = np.inf, Correction()
    for side in (FIRST_ANGLE, -FIRST_ANGLE):
        simplex = np.vstack([np.zeros(numbers), side * np.eye(numbers)])
        best = minimize(
            left,
            np.zeros(numbers),
            method="Nelder-Mead",
            options={
                "initial_simplex": simplex,
                "maxfev": MOST_TRIES,
                "xatol": 1e-3,
                "fatol": 1e-5,
            },
        )
        if best.fun < found[0]:
            found = float(best.fun), made(best.x)
    return found


def _is_other(c: Correction) -> bool:
    """Whether it differs from what is recorded by enough to be told, and can be."""
    share = max(abs(np.log(c.factor)), abs(np.log(c.focal)))
    turn = float(np.linalg.norm(c.turned))
    return bool(
        share >= LEAST_FACTOR
        or abs(c.farther_m) >= LEAST_FARTHER_M
        or max(abs(c.later_s), abs(c.depth_later_s)) >= LEAST_LATER_S - 1e-9
        or LEAST_PRINCIPAL <= np.hypot(*c.principal) <= MOST_PRINCIPAL
        or LEAST_TURN <= turn <= MOST_TURN
    )
