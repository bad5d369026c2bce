"""Whether depth is in metres, by what a scene can be and by the camera's own motion.

A camera that moves by a known way past things that stand still sees their depth change by that way.
Depth in units that are too large changes by too much. Depth that is too small can't be told in this
way from things that move with the camera; only the range says it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgeval.geometry import Array
from dgeval.recording.camera_motion import LEAST_WORSE, MovedPair, moved_pairs
from dgeval.recording.frame import Frame

SMOOTHER = 0.1  # times as rough, at most, is depth whose swapped bytes are put right; ours
# m, between which the middle depth of a manipulation scene lies; ours
LEAST_DEPTH_M, MOST_DEPTH_M = 0.08, 10.0
LEAST_CUT = 0.05  # share of the readings that have the largest one, where depth is cut there; ours
# sides of the patches that may be planes, in parts of the picture's width; how many of its columns
# are looked at; share of the readings that count; of their middle, by which a plane may miss them;
# and by how many times the other way must miss them more, for a vote; ours
PATCHES, COLUMNS, INLIERS, IS_PLANE, FITS_BETTER = (4, 3, 2), 160, 0.9, 0.004, 2.5
LEAST_MISS = 1e-4  # of the middle, that the other way must miss at least: less is rounding; ours
LEAST_VOTES_INVERSE, MOSTLY_INVERSE = 12, 0.9  # patches that vote, and the share that agrees; ours
FACTORS = np.geomspace(0.03, 30.0, 41)  # tried; neighbours differ by 19 %
LEAST_VOTES, AGREE = 3, 1.5  # pairs that must vote, and the factor within which half must agree
# times, by which depth must be too large to be called wrong; something that comes towards the
# camera as fast as the camera towards it gives 2; ours
SURE = 2.5
WORSE = 3.0  # times, by which a unit that is called wrong must fit worse than the best; ours


def wrong_unit(frames: Sequence[Frame], pairs: Sequence[MovedPair]) -> tuple[str, float] | None:
    """What is wrong with the depth of some frames of a trial, and the factor that it lacks.

    pairs: of the frames. None where it fits, or where nothing can be said.
    """
    readings = [f.depth[f.depth > 0] for f in frames]
    every = np.concatenate(readings) if readings else np.zeros(0, np.float32)
    if not len(every):
        return None
    middle = float(np.median(every))
    if not LEAST_DEPTH_M <= middle <= MOST_DEPTH_M:
        factor = 1e-3 if middle > MOST_DEPTH_M else 1e3
        return f"the middle depth of the first frames is {middle:.3g} m, which no scene has", factor
    by_motion = factor_by_motion(pairs)
    # a larger factor says only that what is seen moves with the camera, as the hand itself does
    if by_motion is None or by_motion > 1 / SURE:
        return None
    what = f"the camera's motion fits depth that is {by_motion:.2g} times as large"
    return f"{what} (the middle depth is {middle:.3g} m)", by_motion


def is_inverse(frames: Sequence[Frame]) -> bool:
    """Whether the readings are 1/m, as disparity is, and not m.

    Over a plane 1/z is linear in the pixel's place, and z is not. So in patches that one of both
    fits well, and the other doesn't, the one that fits is 1/z. A plane that faces the camera, or
    that is far away, fits both ways and tells nothing.
    """
    votes: list[bool] = []
    for frame in frames:
        step = max(1, frame.depth.shape[1] // COLUMNS)
        depth = frame.depth[::step, ::step].astype(np.float64)
        for parts in PATCHES:
            for patch in _patches(depth, depth.shape[1] // parts):
                as_read, inverse = _misses(patch), _misses(_inverted(patch))
                better, worse = sorted((as_read, inverse))
                if better <= IS_PLANE and worse > max(FITS_BETTER * better, LEAST_MISS):
                    votes.append(as_read < inverse)
    return len(votes) >= LEAST_VOTES_INVERSE and float(np.mean(votes)) >= MOSTLY_INVERSE


def inverse_fits(frames: Sequence[Frame]) -> bool:
    """Whether the camera's motion fits the readings turned over, 1/m, in most pairs of frames."""
    pairs = moved_pairs([replace(f, depth=_inverted(f.depth)) for f in frames])
    votes = sum(pair.as_given <= LEAST_WORSE for pair in pairs)
    return votes >= LEAST_VOTES and 2 * votes > len(pairs)


def _patches(depth: Array, side: int) -> Iterator[Array]:
    """Squares of so many px, each half beside the one before, with readings nearly everywhere."""
    height, width = depth.shape
    for top in range(0, height - side + 1, max(1, side // 2)):
        for left in range(0, width - side + 1, max(1, side // 2)):
            patch = depth[top : top + side, left : left + side]
            if (patch > 0).mean() >= INLIERS:
                yield patch


def _inverted(depth: NDArray[Any]) -> NDArray[Any]:
    return np.where(depth > 0, 1.0 / np.where(depth > 0, depth, 1.0), 0.0)


def _misses(patch: Array) -> float:
    """By how much, of its middle value, the readings > 0 of a patch miss a linear one: the root of
    the mean square over the nearest ones, INLIERS of them.
    """
    v, u = np.nonzero(patch > 0)
    known = patch[v, u]
    linear = np.stack([u - u.mean(), v - v.mean(), np.ones(len(u))], axis=1)
    nearest = max(1, round(INLIERS * len(known)))
    near = np.arange(len(known))
    miss = np.zeros(len(known))
    for _ in range(2):
        at = linear[near]
        fit = np.linalg.lstsq(at.T @ at, at.T @ known[near], rcond=None)[0]
        miss = np.abs(known - linear @ fit)
        near = np.argpartition(miss, nearest - 1)[:nearest]
    return float(np.sqrt(np.mean(miss[near] ** 2)) / np.median(known))


def bytes_swapped(frames: Sequence[Frame], scale: float | None) -> float | None:
    """The middle depth, m, with the two bytes of each reading swapped; None unless a scene has it,
    and it is far smoother along the rows than as read. scale: m per unit.
    """
    unit = 1e-3 if scale is None else scale
    as_read: list[Array] = []
    swapped: list[Array] = []
    for frame in frames:
        codes = np.rint(frame.depth / unit).astype(np.uint16)
        for listed, image in ((as_read, codes), (swapped, codes.byteswap())):
            listed.append(image.astype(np.float64) * unit)
    known = np.concatenate([s[a > 0] for a, s in zip(as_read, swapped, strict=True)])
    if not len(known):
        return None
    rough = [np.median([np.abs(np.diff(d, axis=1)).mean() for d in x]) for x in (as_read, swapped)]
    middle = float(np.median(known))
    smoother = rough[1] < SMOOTHER * rough[0]
    return middle if smoother and LEAST_DEPTH_M <= middle <= MOST_DEPTH_M else None


def cut_at(frames: Sequence[Frame]) -> tuple[float, float] | None:
    """The depth, m, at which a driver cuts all that is farther, and its share of the readings.

    None unless it is the largest reading, exactly, in three frames or more, and a large part of
    each of these: what a scene has there differs from frame to frame.
    """
    readings = [f.depth[f.depth > 0] for f in frames]
    farthest = max((float(r.max(initial=0.0)) for r in readings), default=0.0)
    shares = [float(np.mean(r == np.float32(farthest))) for r in readings if len(r)]
    reached = [share for share in shares if share]
    share = float(np.median(reached)) if len(reached) >= 3 else 0.0
    return (farthest, share) if share >= LEAST_CUT else None


def factor_by_motion(pairs: Sequence[MovedPair]) -> float | None:
    """The factor of depth at which the frames agree best, 1.0 where that is as good as any.

    Each pair of frames votes; None where none can.
    """
    votes = [1.0 for pair in pairs if pair.as_given <= LEAST_WORSE]
    if 2 * len(votes) > len(pairs):
        return 1.0  # whatever the others say
    for pair in pairs:
        at_one = pair.as_given
        if at_one <= LEAST_WORSE:
            continue
        misfits = np.array([pair.misfit(float(factor)) for factor in FACTORS])
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
