"""Whether depth is in metres, by what a scene can be and by the camera's own motion.

A camera that moves by a known way past things that stand still sees their depth change by that way.
Depth in units that are too large changes by too much. Depth that is too small can't be told in this
way from things that move with the camera; only the range says it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np

from dgeval.geometry import Array, Intrinsics, invert
from dgeval.recording.frame import Frame

# m, between which the middle depth of a manipulation scene lies; ours
LEAST_DEPTH_M, MOST_DEPTH_M = 0.08, 10.0
MOVED_M = 0.05  # m, between two frames, from which on the camera's motion tells; ours
MOST_MOVED_M = 0.25  # m; frames farther apart hardly show the same things
FACTORS = np.geomspace(0.03, 30.0, 41)  # tried; neighbours differ by 19 %
LEAST_VOTES, AGREE = 3, 1.5  # pairs that must vote, and the factor within which half must agree
# times, by which depth must be too large to be called wrong; something that comes towards the
# camera as fast as the camera towards it gives 2; ours
SURE = 2.5
# share of the depth, by which a unit that is called wrong must fit worse: against the best, and at
# least; ours
WORSE, LEAST_WORSE = 3.0, 0.02
# z of the optical frame looks along x of the body, and x of it to the body's right
T_BODY_OPTICAL = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
LEAST_PAIRS, CONTRADICTS = 5, 0.05  # pairs, and share of the depth by which poses don't fit; ours
EVERY = 7  # px, of rows and columns that are looked at
LEAST_POINTS = 200


def wrong_unit(frames: Sequence[Frame]) -> tuple[str, float] | None:
    """What is wrong with the depth of some frames of a trial, and the factor that it lacks.

    None where it fits, or where nothing can be said.
    """
    readings = [f.depth[f.depth > 0] for f in frames]
    every = np.concatenate(readings) if readings else np.zeros(0, np.float32)
    if not len(every):
        return None
    middle = float(np.median(every))
    if not LEAST_DEPTH_M <= middle <= MOST_DEPTH_M:
        factor = 1e-3 if middle > MOST_DEPTH_M else 1e3
        return f"the middle depth of the first frames is {middle:.3g} m, which no scene has", factor
    by_motion = factor_by_motion(frames)
    # a larger factor says only that what is seen moves with the camera, as the hand itself does
    if by_motion is None or by_motion > 1 / SURE:
        return None
    what = f"the camera's motion fits depth that is {by_motion:.2g} times as large"
    return f"{what} (the middle depth is {middle:.3g} m)", by_motion


def factor_by_motion(frames: Sequence[Frame]) -> float | None:
    """The factor of depth at which the frames agree best, 1.0 where that is as good as any.

    Each pair of frames votes; None where none can.
    """
    pairs = []
    for a, b in combinations(frames, 2):
        if a.T_base_camera is None or b.T_base_camera is None:
            continue
        T_b_a = invert(b.T_base_camera) @ a.T_base_camera
        if not MOVED_M <= np.linalg.norm(T_b_a[:3, 3]) <= MOST_MOVED_M:
            continue
        misfit = _misfit(a, b, T_b_a)
        pairs.append((misfit, misfit(1.0)))
    votes = [1.0 for _, at_one in pairs if at_one <= LEAST_WORSE]
    if 2 * len(votes) > len(pairs):
        return 1.0  # whatever the others say
    for misfit_of, at_one in pairs:
        if at_one <= LEAST_WORSE:
            continue
        misfits = np.array([misfit_of(float(factor)) for factor in FACTORS])
        if np.isnan(misfits).all():
            continue
        best = int(np.nanargmin(misfits))
        if np.isnan(at_one):  # as recorded the frames hardly overlap, which itself may be the fault
            if misfits[best] > LEAST_WORSE:
                continue
            at_one = np.inf
        is_sharp = at_one > max(LEAST_WORSE, WORSE * misfits[best])
        votes.append(float(FACTORS[best]) if is_sharp else 1.0)
    if not votes:
        return None
    middle = float(np.median(votes))
    agree = np.abs(np.log(np.array(votes) / middle)) < np.log(AGREE)
    return middle if len(votes) >= LEAST_VOTES and agree.mean() > 0.5 else 1.0


def wrong_poses(frames: Sequence[Frame]) -> str | None:
    """What is wrong with the camera's poses, by its own motion past things that stand still; None
    where they fit, or where nothing can be said.

    Either they are of a body frame, x forward and z up, and not of the optical one, or they fit
    nothing: in no two frames is a point where the other has it.
    """
    given, turned = [], []
    for a, b in combinations(frames, 2):
        if a.T_base_camera is None or b.T_base_camera is None:
            continue
        T_b_a = invert(b.T_base_camera) @ a.T_base_camera
        if not MOVED_M <= np.linalg.norm(T_b_a[:3, 3]) <= MOST_MOVED_M:
            continue
        as_given, as_turned = _misfit(a, b, T_b_a)(1.0), float("nan")
        if not as_given <= LEAST_WORSE:
            as_turned = _misfit(a, b, invert(T_BODY_OPTICAL) @ T_b_a @ T_BODY_OPTICAL)(1.0)
        if not np.isnan([as_given, as_turned]).all():  # else the pictures have nothing in common
            given.append(as_given)
            turned.append(as_turned)
    if len(given) < LEAST_PAIRS:
        return None
    if float((np.array(turned) <= LEAST_WORSE).mean()) > 0.5:
        return "is of the camera's body, x forward and z up, and not of its optical frame"
    share = float(np.nanmedian(given)) if not np.isnan(given).all() else float("nan")
    if share > CONTRADICTS and not (np.array(given) <= LEAST_WORSE).any():
        return f"does not fit what it sees: what stands still seems to move by {share:.0%}"
    return None


def _misfit(a: Frame, b: Frame, T_b_a: Array) -> Callable[[float], float]:
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
