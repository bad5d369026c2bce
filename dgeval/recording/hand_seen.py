"""Whether depth shows the hand where its description, its joints and the camera's pose put it.

A camera that is mounted elsewhere than its calibration says sees all of the hand beside its place.
A description of another hand puts a finger where depth shows what lies behind it. Nearer than a
camera can measure there is no depth, and nothing is said.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from dgeval.determinism import generator
from dgeval.geometry import Array, invert, transform
from dgeval.recording.frame import Frame
from dgeval.robots.description import LinkShape
from dgeval.robots.link_surface import POINT_M2, surface_samples

NO_OUTLINES: Mapping[str, list[LinkShape]] = MappingProxyType({})
MOST_POINTS = 600  # of the hand that are looked for in a frame
NEAREST_M = 0.03  # m, from the camera, of a point that is looked for
FINE = 320  # cells of a picture's width, in which the outline is found
GAP_M = 2.5 * float(np.sqrt(POINT_M2))  # m, between points of one surface at most
ACROSS = 80  # cells of a picture's width, in which the foremost points are found
BEHIND_IT_M = 0.006  # m, behind the foremost of its cell, from which on a point is hidden; ours
# of a point's depth: m, and share of it, by which depth may differ where it shows the hand; ours
SAME_M, SAME_SHARE = 0.006, 0.006
THROUGH_M = 0.020  # m, farther than that, from which on depth shows what is behind the hand; ours
EDGE_M, EDGE_PX = 0.004, 3.0  # from the outline, where depth shows either; ours
STEPS_M = (0.016, 0.008, 0.004, 0.002, 0.001)  # of the search for where the hand is
STARTS_M = 0.020  # m, to each side, from which it is searched too
ROUNDS = 8  # of one length of step at most
# frames in which depth agrees with so many points of the hand; and points, all frames together, and
# times as many as in its place, where the hand is seen off; ours. Over 110 simulated trials with a
# right calibration the best shift is then at most 4 mm; with fewer points it is up to 9
LEAST_FRAMES, LEAST_AGREE = 5, 15
LEAST_SCORE, TIMES_BETTER = 250.0, 1.5
# a point is gone through in so many frames, and so much of those that tell; points, and share of
# those of a link that should be seen, that are gone through where the link is told; ours. In those
# trials at most 19 points and 0.28; with a thumb's axis reversed 27 and 0.41, or more
NEARLY_ALL, LEAST_POINTS, MOST_THROUGH = 0.8, 20, 0.35
NOTED_M = 0.008  # m, of a shift that is told; ours


@dataclass(frozen=True)
class HandSeen:
    """Where the hand is seen, against where it should be.

    is_told: whether enough of it is seen to say so; else the rest is as if it were in its place.
    shift (3,) m: in the camera's frame, by which all of it is seen off; zero where it is seen in
    its place but for a link. link: through which depth shows what lies behind it, "" for none.
    through: the share of the link, away from its outline, where depth does so. hidden: links of
    which too little is seen to say where they are.
    """

    is_told: bool
    shift: Array = field(default_factory=lambda: np.zeros(3))
    link: str = ""
    through: float = 0.0
    hidden: tuple[str, ...] = ()

    @property
    def is_off(self) -> bool:
        return bool(self.link) or bool(self.shift.any())


@dataclass(frozen=True)
class _View:
    """The hand's foremost points in one frame: (n, 3) m in the camera's frame, and which of all
    they are. inner: those away from the outline. some: those of a few, by which a shift is sought.
    """

    frame: Frame
    points: Array
    index: NDArray[np.intp]
    inner: NDArray[np.bool_]
    some: NDArray[np.intp]


# depth (f, H, W) m, points (n, 3) m, the frame of each, and cameras (f, 4): fx, fy, cx, cy in px
_Stacked = tuple[NDArray[np.float32], Array, NDArray[np.intp], Array]


def hand_seen(
    frames: Sequence[Frame], outlines: Mapping[str, list[LinkShape]] = NO_OUTLINES
) -> HandSeen:
    """Where depth shows the hand, against where it should be.

    outlines: what is seen of links whose solids are rough, in the link's frame.
    """
    views, links = _views(frames, outlines)
    if len(views) < LEAST_FRAMES:
        return HandSeen(False)
    stacked = _stacked(views)
    there = _score(*stacked, np.zeros(3))
    shift, best = _shift(stacked)
    if best < LEAST_SCORE or sum(_agree(v, shift) >= LEAST_AGREE for v in views) < LEAST_FRAMES:
        return HandSeen(False)
    if best < TIMES_BETTER * there:
        shift = np.zeros(3)
    link, share = _through(views, links, shift)
    hidden = _hidden(views, links, shift)
    if share >= MOST_THROUGH:
        return HandSeen(True, link=link, through=share, hidden=hidden)
    off = shift if np.linalg.norm(shift) >= NOTED_M else np.zeros(3)
    return HandSeen(True, off, hidden=hidden)


def _views(
    frames: Sequence[Frame], outlines: Mapping[str, list[LinkShape]]
) -> tuple[list[_View], NDArray[np.str_]]:
    """The hand as it should be seen in each frame, and the link of each of its points."""
    surfaces: dict[str, Array] = {}  # (n, 3) m, in the link's frame
    views: list[_View] = []
    rng = generator(0, "hand_seen", 0)
    for frame in frames:
        poses = {s.link: T @ invert(s.T_link_shape) for s, T in frame.hand or ()}
        if not views:
            surfaces = {link: _surface(link, frame, outlines) for link in sorted(poses)}
            surfaces = {link: points for link, points in surfaces.items() if len(points)}
        if not surfaces or not poses.keys() >= surfaces.keys():
            continue
        points = np.vstack([transform(poses[link], at) for link, at in surfaces.items()])
        front, inner = _foremost(points, frame)
        some = np.sort(rng.permutation(len(front))[:MOST_POINTS])
        views.append(_View(frame, points[front], front, inner, some))
    return views, np.repeat(list(surfaces), [len(points) for points in surfaces.values()])


def _surface(link: str, frame: Frame, outlines: Mapping[str, list[LinkShape]]) -> Array:
    """Points (n, 3) m on what is seen of a link, in its frame; none where it is not known."""
    shapes = [s for s, _ in frame.hand or () if s.link == link and not s.rough]
    shapes = outlines.get(link) or shapes
    listed = [transform(s.T_link_shape, surface_samples(s)) for s in shapes]
    return np.vstack(listed) if listed else np.zeros((0, 3))


def _hidden(views: Sequence[_View], links: NDArray[np.str_], shift: Array) -> tuple[str, ...]:
    """The links of which depth shows too few points in their place, shifted, over all frames."""
    seen = np.zeros(len(links))
    for view in views:
        farther, same = _farther(view.points + shift, view.frame)
        seen[view.index] += np.abs(farther) < same
    return tuple(str(n) for n in np.unique(links) if seen[links == n].sum() < LEAST_POINTS)


def _through(views: Sequence[_View], links: NDArray[np.str_], shift: Array) -> tuple[str, float]:
    """The link that depth goes through most, shifted, and the share of what should be seen of it.

    Counted are points away from the outline, each over all frames: depth beside an edge is often
    that of what lies behind.
    """
    inner, through, shown = np.zeros((3, len(links)))
    for view in views:
        at = view.index[view.inner]
        farther, same = _farther(view.points[view.inner] + shift, view.frame)
        inner[at] += 1
        through[at] += farther > same + THROUGH_M
        shown[at] += np.abs(farther) < same
    gone = (through >= LEAST_FRAMES) & (through >= NEARLY_ALL * (through + shown))
    worst = "", 0.0
    for link in np.unique(links):
        of_link = links == link
        count = int((gone & of_link).sum())
        share = count / max(1, int((of_link & (inner >= LEAST_FRAMES)).sum()))
        if count >= LEAST_POINTS and share > worst[1]:
            worst = str(link), share
    return worst


def _foremost(points: Array, frame: Frame) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Which of the points no other hides, and which of these lie away from the outline."""
    u, v, inside = _pixels(points, frame)
    if not inside.any():
        return np.zeros(0, np.intp), np.zeros(0, bool)
    cell = max(1, frame.depth.shape[1] // ACROSS)
    z = points[:, 2]
    nearest = np.full([side // cell + 1 for side in frame.depth.shape], np.inf)
    np.minimum.at(nearest, (v[inside] // cell, u[inside] // cell), z[inside])
    nearest = minimum_filter(nearest, 3)
    front = np.flatnonzero(inside)
    cells = v[front] // cell, u[front] // cell
    kept = z[front] < nearest[cells] + BEHIND_IT_M
    front = front[kept]
    return front, _away_from_outline(u, v, inside, float(np.median(z[front])), frame)[front]


def _away_from_outline(
    u: NDArray[np.intp],
    v: NDArray[np.intp],
    inside: NDArray[np.bool_],
    far_m: float,
    frame: Frame,
) -> NDArray[np.bool_]:
    """Which of the points, by column and row, lie away from the outline of all of them.

    far_m: of the hand from the camera, m.
    """
    cell = max(1, frame.depth.shape[1] // FINE)
    empty = np.ones([side // cell + 1 for side in frame.depth.shape], bool)
    empty[v[inside] // cell, u[inside] // cell] = False
    gap = GAP_M * frame.camera.fx / far_m / cell
    edge = max(EDGE_PX, EDGE_M * frame.camera.fx / far_m) / cell
    # the points grown together, and what is then farther from the outside than they have grown
    covered = np.pad(_from_nearest_zero(empty) <= gap, 1, constant_values=True)
    inner = _from_nearest_zero(covered)[1:-1, 1:-1] > gap + edge
    out = np.zeros(len(u), bool)
    out[inside] = inner[v[inside] // cell, u[inside] // cell]
    return out


def _from_nearest_zero(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Of each pixel the distance to the nearest one that is not in the mask, px."""
    image = mask.astype(np.uint8)
    return np.asarray(cv2.distanceTransform(image, cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)


def _pixels(
    points: Array, frame: Frame
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
    """Columns and rows of points (n, 3) m, and which lie in the picture."""
    ahead = points[:, 2] > NEAREST_M
    before = np.where(ahead[:, None], points, [0.0, 0.0, NEAREST_M])
    u, v = np.rint(frame.camera.project(before)).astype(np.intp).T
    height, width = frame.depth.shape
    return u, v, ahead & (u >= 0) & (u < width) & (v >= 0) & (v < height)


@njit(cache=True, inline="always")
def _farther_at(
    depth: NDArray[np.float32], cameras: Array, k: int, x: float, y: float, z: float
) -> float:
    """By how much depth of frame k is farther than a point, m; NaN without depth there."""
    if z <= NEAREST_M:
        return np.nan
    u = int(np.rint(cameras[k, 0] * x / z + cameras[k, 2]))
    v = int(np.rint(cameras[k, 1] * y / z + cameras[k, 3]))
    _, height, width = depth.shape
    if u < 0 or u >= width or v < 0 or v >= height or depth[k, v, u] <= 0:
        return np.nan
    return float(depth[k, v, u] - z)


@njit(cache=True)
def _farther_each(depth: NDArray[np.float32], cameras: Array, points: Array) -> Array:
    """`_farther_at` of each of the points (n, 3) m, in the only frame."""
    out = np.empty(len(points))
    for i in range(len(points)):
        out[i] = _farther_at(depth, cameras, 0, points[i, 0], points[i, 1], points[i, 2])
    return out


def _farther(points: Array, frame: Frame) -> tuple[Array, Array]:
    """(n,) m each: by how much depth is farther than a point, NaN without; and the tolerance."""
    farther = _farther_each(frame.depth[None], _camera(frame)[None], points)
    return farther, SAME_M + SAME_SHARE * points[:, 2]


def _camera(frame: Frame) -> Array:
    """(4,) px: fx, fy, cx, cy."""
    k = frame.camera
    return np.array([k.fx, k.fy, k.cx, k.cy])


def _agree(view: _View, shift: Array) -> int:
    """How many of a frame's few points depth agrees with when they are shifted."""
    farther, same = _farther(view.points[view.some] + shift, view.frame)
    return int((np.abs(farther) < same).sum())


def _stacked(views: Sequence[_View]) -> _Stacked:
    """The views' few points and depth, as `_score` takes them."""
    depth = np.stack([view.frame.depth for view in views])
    points = [view.points[view.some] for view in views]
    which = np.repeat(np.arange(len(views)), [len(p) for p in points])
    return depth, np.vstack(points), which, np.array([_camera(view.frame) for view in views])


@njit(cache=True)
def _score(
    depth: NDArray[np.float32],
    points: Array,
    which: NDArray[np.intp],
    cameras: Array,
    shift: Array,
) -> float:
    """How many points depth agrees with when they are shifted, less those that it goes through."""
    total = 0.0
    for i in range(len(points)):
        x, y, z = points[i, 0] + shift[0], points[i, 1] + shift[1], points[i, 2] + shift[2]
        farther = _farther_at(depth, cameras, which[i], x, y, z)
        same = SAME_M + SAME_SHARE * z
        if abs(farther) < same:
            total += 1.0 - (farther / same) ** 2
        elif farther > same + THROUGH_M:
            total -= 1.0
    return total


def _shift(views: _Stacked) -> tuple[Array, float]:
    """The shift (3,) m at which depth agrees best, and its score."""
    found: tuple[float, Array] = (-np.inf, np.zeros(3))
    sides = np.vstack([np.eye(3), -np.eye(3)])
    for start in np.vstack([np.zeros((1, 3)), STARTS_M * sides]):
        at, best = start, _score(*views, start)
        for step in STEPS_M:
            for _ in range(ROUNDS):
                tried = [(_score(*views, at + step * side), k) for k, side in enumerate(sides)]
                score, k = max(tried)
                if score <= best:
                    break
                best, at = score, at + step * sides[k]
        if best > found[0]:
            found = best, at
    return found[1], found[0]
