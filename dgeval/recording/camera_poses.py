"""Whether the camera's poses fit what it sees, by its own motion past things that stand still."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from dgeval.geometry import Array, invert, pose_from_matrix
from dgeval.recording.camera_motion import LEAST_WORSE, MovedPair, misfit_of
from dgeval.recording.transforms import TransformTree

# pairs, and median share of the depth by which poses don't fit; over 60 simulated approaches with
# right ones it is at most 0.022, as a target that comes near spoils some pairs, and in two of 94
# more, of a turntable and of a handover, 0.04 and 0.05
LEAST_PAIRS, CONTRADICTS = 5, 0.055
MOST_FROM_PALM_M = 1.5  # m, of a camera that moves with the palm; ours
# share of the depth by which poses misfit at most that are right, and how many times more those do
# whose quaternion is in another order; ours
FITS, WORSE = 0.01, 2.5
MOVES_WITH_M = 0.01  # m, by which a camera on the palm seems to move in its frame at most; ours
# z of the optical frame looks along x of the body, and x of it to the body's right
T_BODY_OPTICAL = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def wrong_poses(
    pairs: Sequence[MovedPair], tree: TransformTree, base: str, camera: str
) -> tuple[str, str] | None:
    """What is wrong with T_base_camera of the tree, and what mends it; None where it fits, or
    nothing can be said.

    It is of a body frame, x forward and z up, and not of the optical one; or a quaternion above the
    camera is written w first; or most pairs of frames contradict it.
    """
    given = np.array([pair.as_given for pair in pairs])
    if not len(given) or (given <= FITS).mean() > 0.5:
        return None

    def as_optical(t_ns: int) -> Array | None:
        T = tree.lookup(base, camera, t_ns)
        return None if T is None else T @ T_BODY_OPTICAL

    turned = _misfits(pairs, as_optical)
    turned[given <= LEAST_WORSE] = np.nan
    comparable = ~np.isnan(given) | ~np.isnan(turned)  # else the pictures have nothing in common
    if comparable.sum() >= LEAST_PAIRS and (turned[comparable] <= LEAST_WORSE).mean() > 0.5:
        numbers = ",".join(f"{v:.5g}" for v in pose_from_matrix(T_BODY_OPTICAL))
        return (
            f"the pose of the frame {camera!r} is of the camera's body, x forward and z up, "
            "and not of its optical frame",
            "record the optical frame as the pictures' frame_id, or name it (frames.camera); where "
            f"there is none: --set frames.camera={camera}_optical "
            f"--set calibration.flange={camera} "
            f"--set 'calibration.T_flange_camera=[{numbers}]'",
        )
    for child in tree.ancestors(camera):
        other = tree.with_w_first(child)
        if child == base or other is None:
            continue
        misfits = _misfits(pairs, partial(other.lookup, base, camera))
        both = ~np.isnan(given) & ~np.isnan(misfits)
        if (misfits <= FITS).sum() < LEAST_PAIRS or not both.any():
            continue
        least = max(WORSE * float(np.median(misfits[both])), FITS)
        if np.nanmedian(misfits) <= FITS and np.median(given[both]) > least:
            return (
                f"the quaternion of the transform to {child!r} is written w first: read so, what "
                "stands still stays where it is",
                "write it x, y, z, w",
            )
    if comparable.sum() < LEAST_PAIRS or _each_fits_another(pairs, given):
        return None
    given = given[~np.isnan(given)]
    share = float(np.median(given)) if len(given) else float("nan")
    if share > CONTRADICTS:
        return (
            f"the pose of the frame {camera!r} does not fit what it sees: what stands still seems "
            f"to move by {share:.0%}",
            "is it the optical frame (frames.camera), is the hand-eye calibration right, and are "
            "the camera's stamps on the robot's clock (clock.colour.offset_ns)?",
        )
    return None


def _each_fits_another(pairs: Sequence[MovedPair], given: Array) -> bool:
    """Whether most frames fit another one from elsewhere. Then what the others show has moved, as
    where a target comes up to the camera.
    """
    best: dict[int, float] = {}  # by frame
    for pair, misfit in zip(pairs, given.tolist(), strict=True):
        for frame in (pair.a, pair.b):
            best[frame.index] = np.fmin(best.get(frame.index, np.nan), misfit)
    known = [misfit for misfit in best.values() if np.isfinite(misfit)]
    return bool(known) and float(np.median(known)) <= FITS


def far_from_palm(
    tree: TransformTree, base: str, palm: str, camera: str, times: Sequence[int]
) -> str | None:
    """What is wrong where a camera moves with the palm and is far from it; None where it is near.

    times: ns, at which both are looked for.
    """
    known = [T[:3, 3] for t in times if (T := tree.lookup(palm, camera, t)) is not None]
    way = [T[:3, 3] for t in times if (T := tree.lookup(base, palm, t)) is not None]
    if len(known) < 2 or np.ptp(np.array(known), axis=0).max() > MOVES_WITH_M:
        return None
    if len(way) < 2 or np.ptp(np.array(way), axis=0).max() < 2 * MOVES_WITH_M:
        return None  # both stand still
    apart = float(np.linalg.norm(known[0]))
    if apart <= MOST_FROM_PALM_M:
        return None
    return f"the camera is {apart:.3g} m from the palm {palm!r} that it moves with: are those mm?"


def _misfits(pairs: Sequence[MovedPair], pose: Callable[[int], Array | None]) -> Array:
    """By pair, the misfit with T_base_camera at a time, ns, from elsewhere; NaN without."""
    out = []
    for pair in pairs:
        T_a, T_b = pose(pair.a.t_ns), pose(pair.b.t_ns)
        if T_a is None or T_b is None:
            out.append(np.nan)
        else:
            out.append(misfit_of(pair.a, pair.b, invert(T_b) @ T_a)(1.0))
    return np.array(out)
