"""Whether depth lies on the colour picture: steps of depth are where colour has an edge.

Depth that is mirrored, or of another viewpoint than its frame says, gives every point of the
target another colour, and no other check sees it over a flat table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.recording.frame import Frame

WIDTH = 160  # px, of the pictures that are compared
FARTHEST = 24  # px of WIDTH, by which depth is shifted at most
STEP = 0.05  # share of the depth from a pixel to the next that is an edge; ours
LEAST_EDGE, LEAST_FRAMES = 15, 6  # px of a frame's edges, frames that have so many
BRIGHT, MOST_BRIGHT = 90.0, 1.5  # quantile in %, of colour's gradient, that is 1, and its limit
# px of WIDTH and score: a shift that is told, how far halves of the frames may differ in it, the
# score that it has at least, and the share of it that no shift may have; ours. Over 31 simulated
# trials the shift is at most 3.2 px, and no larger one of 85 more has a score above 0.38; shifted
# by 4 % of the width it is told in 19 of the 31
LEAST_SHIFT, AGREE, LEAST_SCORE, AS_GOOD = 3.5, 2, 0.5, 0.9
TURNED_SCORE, TURNED_BETTER = 0.6, 0.15  # of depth turned over, told in all 31; ours
TURNS = {  # of an (H, W) picture, and the sign of its edges' direction
    "left for right": (slice(None), slice(None, None, -1), -1.0),
    "upside down": (slice(None, None, -1), slice(None), -1.0),
    "turned by 180°": (slice(None, None, -1), slice(None, None, -1), 1.0),
}
CUT = "as the middle of a larger picture"
Planes = NDArray[np.float32]


@dataclass(frozen=True)
class DepthOff:
    """Depth that does not lie on colour.

    turned: a key of TURNS, or CUT, "" where it is only shifted. right, down: px of the frames, by
    which depth lies beside colour. share: of the frames' width, that they make together.
    """

    turned: str
    right: float = 0.0
    down: float = 0.0
    share: float = 0.0


def depth_off(frames: Sequence[Frame], shrunk: float = 1.0) -> DepthOff | None:
    """How depth lies beside colour in these frames; None where it fits, or where too little shows.

    shrunk: how wide depth is that counts as resized, as share of the picture it was made of; it may
    have been cut out of its middle instead.

    The score of a shift is the mean, over the near side's pixels at steps of depth, of colour's
    gradient there, and of how far both run the same way.
    """
    colours = [_colour_edges(f) for f in frames]
    edges = _with_edges(colours, [_depth_edges(f) for f in frames])
    if len(edges) < LEAST_FRAMES:
        return None
    scores = np.array([_scores(colour, depth, FARTHEST) for colour, depth in edges])
    found, best, none = _best(scores)
    by_turn = {
        name: _unshifted([(c, _turned(d, *turn)) for c, d in edges]) for name, turn in TURNS.items()
    }
    if shrunk < 1.0:
        smaller = [replace(f, depth=_middle(f.depth, shrunk)) for f in frames]
        cut = _with_edges(colours, [_depth_edges(f) for f in smaller])
        if len(cut) >= LEAST_FRAMES:
            by_turn[CUT] = _unshifted(cut)
    name = max(by_turn, key=lambda turn: by_turn[turn])
    if by_turn[name] >= max(TURNED_SCORE, best + TURNED_BETTER):
        return DepthOff(name)
    halves = [_best(scores[k::2])[0] for k in (0, 1)]
    if (
        np.hypot(*found) < LEAST_SHIFT
        or np.abs(found).max() == FARTHEST  # no peak: it may go on rising from there
        or best < LEAST_SCORE
        or none > AS_GOOD * best
        or np.abs(halves[0] - halves[1]).max() > AGREE
    ):
        return None
    down, right = -found * frames[0].depth.shape[1] / WIDTH
    return DepthOff("", float(right), float(down), float(np.hypot(*found)) / WIDTH)


def _with_edges(colours: list[Planes], depths: list[Planes]) -> list[tuple[Planes, Planes]]:
    """The frames whose depth has steps enough."""
    pairs = zip(colours, depths, strict=True)
    return [(colour, depth) for colour, depth in pairs if depth[0].sum() >= LEAST_EDGE]


def _unshifted(edges: list[tuple[Planes, Planes]]) -> float:
    """The best mean score, with hardly a shift."""
    return float(np.mean([_scores(colour, depth, AGREE) for colour, depth in edges], axis=0).max())


def _middle(depth: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    """Depth made smaller, in the middle of a picture of the same size without readings."""
    height, width = depth.shape
    rows, columns = round(height * share), round(width * share)
    small = cv2.resize(depth, (columns, rows), interpolation=cv2.INTER_NEAREST)
    out = np.zeros_like(depth)
    top, left = (height - rows) // 2, (width - columns) // 2
    out[top : top + rows, left : left + columns] = small
    return out


def _best(scores: Planes) -> tuple[NDArray[np.int64], float, float]:
    """Of scores (N, S, S): the shift of the best mean, (2,) px down and right, its score, and that
    of no shift, give or take a pixel.
    """
    mean = scores.mean(axis=0)
    at = np.array(np.unravel_index(int(mean.argmax()), mean.shape))
    middle = slice(FARTHEST - 1, FARTHEST + 2)
    return at - FARTHEST, float(mean.max()), float(mean[middle, middle].max())


def _scores(colour: Planes, depth: Planes, farthest: int) -> Planes:
    """(S, S), S = 2 farthest + 1, by the shift of depth, down and right from -farthest on."""
    margin = ((0, 0), (farthest, farthest), (farthest, farthest))
    wide = np.pad(colour, margin, mode="edge")
    total = sum(
        cv2.matchTemplate(plane, edges, cv2.TM_CCORR)
        for plane, edges in zip(wide, np.ascontiguousarray(depth), strict=True)
    )
    return np.asarray(total / depth[0].sum(), dtype=np.float32)


def _turned(edges: Planes, rows: slice, columns: slice, sign: float) -> Planes:
    return edges[:, rows, columns] * np.array([1.0, 1.0, sign], np.float32)[:, None, None]


def _with_direction(strength: Planes, x: Planes, y: Planes) -> Planes:
    """(3, H, W) the strength, and the strength times cosine and sine of twice the direction: of a
    step up and of a step down they are the same.
    """
    twice = 2.0 * np.arctan2(y, x)
    return np.stack([strength, strength * np.cos(twice), strength * np.sin(twice)]).astype(
        np.float32
    )


def _small(frame: Frame) -> tuple[int, int]:
    height, width = frame.depth.shape
    return WIDTH, round(height * WIDTH / width)


def _colour_edges(frame: Frame) -> Planes:
    grey = cv2.cvtColor(frame.colour, cv2.COLOR_RGB2GRAY)
    grey = cv2.resize(grey, _small(frame), interpolation=cv2.INTER_AREA).astype(np.float32)
    x, y = cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    size = np.hypot(x, y)
    strength = np.minimum(size / (np.percentile(size, BRIGHT) + 1e-6), MOST_BRIGHT)
    planes = _with_direction(strength, x, y)
    planes[0] -= planes[0].mean()
    return planes


def _depth_edges(frame: Frame) -> Planes:
    """Of the near side of each step between known depths."""
    depth = cv2.resize(frame.depth, _small(frame), interpolation=cv2.INTER_NEAREST)
    known = depth > 0
    near = np.where(known, 1.0 / np.where(known, depth, 1.0), 0.0).astype(np.float32)
    around = np.ones((3, 3), np.uint8)
    nearest = cv2.dilate(near, around)
    farthest = cv2.erode(np.where(known, near, np.inf).astype(np.float32), around)
    all_known = cv2.erode(known.astype(np.uint8), around) > 0
    farthest = np.where(all_known, farthest, nearest)
    step = (nearest - farthest > STEP * nearest) & (near > (nearest + farthest) / 2)
    x, y = cv2.Sobel(near, cv2.CV_32F, 1, 0), cv2.Sobel(near, cv2.CV_32F, 0, 1)
    return _with_direction(step.astype(np.float32), x, y)
