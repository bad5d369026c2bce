"""Which depth pixels belong to the target.

In the first frame the box and depth steps decide, afterwards the model.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dgeval.config import Config, PlaneConfig
from dgeval.determinism import generator
from dgeval.geometry import Array, Box, Intrinsics, cross, depth_sigma
from dgeval.perception.plane import Plane, fit_plane
from dgeval.perception.self_filter import hand_pixels
from dgeval.perception.types import Window
from dgeval.recording.frame import Frame

Mask = NDArray[np.bool_]
# m; neighbouring pixels with a larger difference of depth (and over 1 % of the range) lie on
# different surfaces
DEPTH_STEP = 0.015
IN_FRONT_M = 0.025  # m, by which something that hides the target is nearer than it


def grow(box: Box, share: float, pixels: float, camera: Intrinsics) -> Window:
    """Window of the box px grown by `share` of its size plus `pixels`, inside the image.

    It may be empty.
    """
    dx, dy = (box[2] - box[0]) * share + pixels, (box[3] - box[1]) * share + pixels
    x0, y0 = max(0, int(box[0] - dx)), max(0, int(box[1] - dy))
    return (
        x0,
        y0,
        min(camera.width, int(np.ceil(box[2] + dx))),
        min(camera.height, int(np.ceil(box[3] + dy))),
    )


def is_empty(window: Window) -> bool:
    """Whether a window contains no pixel."""
    return window[0] >= window[2] or window[1] >= window[3]


def points_of(depth: NDArray[np.float32], window: Window, mask: Mask, camera: Intrinsics) -> Array:
    """Points (n, 3) m, camera frame, of the masked pixels of a depth window, in row order."""
    v, u = np.nonzero(mask)
    return camera.backproject(
        u + float(window[0]), v + float(window[1]), depth[v, u].astype(np.float64)
    )


def fill(depth: NDArray[np.float32], size: int = 3) -> NDArray[np.float32]:
    """Depth (h, w) m with small holes filled by the farthest neighbour within size x size pixels.

    So a grid of holes does not cut a surface apart.
    """
    wide = cv2.dilate(depth, np.ones((size, size), np.uint8))
    return np.where(depth > 0, depth, wide).astype(np.float32)


def surrounding_plane(
    depth: NDArray[np.float32],
    window: Window,
    inner: Box,
    blocked: Mask,
    camera: Intrinsics,
    rng: np.random.Generator,
    config: PlaneConfig,
) -> Plane | None:
    """The dominant plane in a window outside the inner box px, so without the target's own faces.

    blocked (h, w): pixels to leave out.
    """
    if not config.enabled:
        return None
    around = (depth > 0) & ~blocked
    x0, y0, x1, y1 = (
        int(inner[0]) - window[0],
        int(inner[1]) - window[1],
        int(inner[2]) - window[0],
        int(inner[3]) - window[1],
    )
    around[max(0, y0) : max(0, y1), max(0, x0) : max(0, x1)] = False
    v, u = np.nonzero(around)
    step = max(1, len(v) // 600)
    v, u = v[::step], u[::step]
    points = camera.backproject(
        u + float(window[0]), v + float(window[1]), depth[v, u].astype(np.float64)
    )
    return fit_plane(points, rng, config)


def free_pixels(
    frame: Frame, window: Window, inner: Box, config: Config
) -> tuple[NDArray[np.float32], Mask, Plane | None]:
    """Depth (h, w) m of a window, its pixels that are neither hand nor plane, and the plane.

    inner: px, of the target; the plane is looked for around it.
    """
    depth = frame.depth[window[1] : window[3], window[0] : window[2]]
    hand = np.zeros(depth.shape, dtype=bool)
    if frame.hand is not None:
        origin = (window[0], window[1])
        hand = hand_pixels(depth, origin, frame.camera, frame.hand, config.self_filter.margin)
    rng = generator(config.seed, "plane", frame.index)
    plane = surrounding_plane(depth, window, inner, hand, frame.camera, rng, config.plane)
    return depth, above_plane(depth, window, frame.camera, plane, config.plane) & ~hand, plane


def height_map(
    depth: NDArray[np.float32], window: Window, camera: Intrinsics, plane: Plane
) -> NDArray[np.float32]:
    """Height (h, w) m above the plane of every pixel of a window; meaningless where depth is 0."""
    u = plane.n[0] * (np.arange(window[0], window[2]) - camera.cx) / camera.fx
    v = plane.n[1] * (np.arange(window[1], window[3]) - camera.cy) / camera.fy + plane.n[2]
    return np.asarray(
        depth * (u[None, :] + v[:, None]).astype(np.float32) + np.float32(plane.d), dtype=np.float32
    )


def above_plane(
    depth: NDArray[np.float32],
    window: Window,
    camera: Intrinsics,
    plane: Plane | None,
    config: PlaneConfig,
) -> Mask:
    """Pixels (h, w) with depth that lie above the plane by more than its tolerance."""
    valid: Mask = depth > 0
    if plane is None:
        return valid
    return valid & (
        height_map(depth, window, camera, plane) > config.tolerance_sigmas * depth_sigma(depth)
    )


def components(depth: NDArray[np.float32], free: Mask) -> tuple[int, NDArray[np.int32]]:
    """Connected surfaces without a depth step: number of labels and labels (h, w), 0 for none."""
    filled = fill(np.where(free, depth, 0.0).astype(np.float32))
    limit = np.maximum(DEPTH_STEP, 0.01 * filled)
    kernel = np.ones((3, 3), np.uint8)
    low = cv2.erode(np.where(filled > 0, filled, np.float32(1e3)).astype(np.float32), kernel)
    smooth = (filled > 0) & (filled - low < limit)
    count, labels = cv2.connectedComponents(smooth.astype(np.uint8), connectivity=4)
    return count, np.asarray(labels, dtype=np.int32)


def segment_box(depth: NDArray[np.float32], window: Window, free: Mask, box: Box) -> Mask:
    """The target's pixels (h, w) in the frame in which its box px is given.

    Of the surfaces with most of their area inside the box: the largest, and all others at a similar
    depth. If no surface lies mostly inside, the part of the largest one that is inside.
    """
    count, labels = components(depth, free)
    inside = np.zeros(depth.shape, dtype=bool)
    x0, y0 = max(0, int(box[0]) - window[0]), max(0, int(box[1]) - window[1])
    inside[
        y0 : max(0, int(np.ceil(box[3])) - window[1]), x0 : max(0, int(np.ceil(box[2])) - window[0])
    ] = True
    within = np.bincount(labels[inside], minlength=count)
    total = np.bincount(labels.ravel(), minlength=count)
    within[0] = 0
    if within.max() == 0:
        return free & inside
    mostly = within > 0.7 * total
    candidates = (
        np.where(mostly, within, 0) if (mostly & (within > 0.2 * within.max())).any() else within
    )
    main = int(np.argmax(candidates))
    depth_main = (
        float(np.median(depth[(labels == main) & (depth > 0)]))
        if ((labels == main) & (depth > 0)).any()
        else 0.0
    )
    chosen = labels == main
    for label in range(1, count):
        if label != main and mostly[label] and within[label] >= 10:
            z = depth[(labels == label) & (depth > 0)]
            if len(z) and abs(float(np.median(z)) - depth_main) < 0.1:
                chosen |= labels == label
    # pixels at depth steps belong to no surface; those next to the target at its depth are its edge
    rim = cv2.dilate(chosen.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    near = fill(np.where(chosen, depth, 0.0).astype(np.float32), 5)
    rim &= np.abs(depth - near) < DEPTH_STEP
    return np.asarray((chosen | rim) & free & inside)


def near_side(
    shape: tuple[int, ...], window: Window, points: Array, camera: Intrinsics
) -> NDArray[np.float32]:
    """Depth (h, w) m of the side of points (n, 3) m, camera frame, that a window sees, 0 beside."""
    pixels = np.rint(camera.project(points)).astype(int) - np.array(window[:2])
    height, width = shape
    inside = (
        (pixels[:, 0] >= 0) & (pixels[:, 0] < width) & (pixels[:, 1] >= 0) & (pixels[:, 1] < height)
    )
    order = np.argsort(-points[inside, 2], kind="stable")  # the nearest is written last
    drawn = np.zeros(shape, np.float32)
    px = pixels[inside][order]
    drawn[px[:, 1], px[:, 0]] = points[inside, 2][order]
    # the model is a set of points: fill the gaps between them
    spacing = 5
    near = np.where(drawn > 0, drawn, np.float32(10.0)).astype(np.float32)
    front = cv2.erode(near, np.ones((spacing, spacing), np.uint8))
    return np.where(front < 10.0, front, 0.0).astype(np.float32)


def segment_model(
    depth: NDArray[np.float32],
    window: Window,
    free: Mask,
    points: Array,
    camera: Intrinsics,
    reach: int,
) -> tuple[Mask, NDArray[np.float32]]:
    """The target's pixels (h, w): near the silhouette of its model and close to it in depth.

    Also the depth (h, w) m of the model's near side, 0 beside its silhouette.

    points (n, 3) m: the model's, camera frame. reach: px beyond the silhouette; pixels there must
    be connected to it.
    """
    front = near_side(depth.shape, window, points, camera)
    core = (front > 0) & free & (np.abs(depth - front) < 0.02)
    # what newly came into view
    wide = cv2.erode(
        np.where(front > 0, front, np.float32(10.0)).astype(np.float32),
        np.ones((2 * reach + 1, 2 * reach + 1), np.uint8),
    )
    band = (front == 0) & (wide < 10.0) & free & (depth - wide < 0.04) & (wide - depth < 0.02)
    count, labels = components(depth, core | band)
    if count > 1:
        hits = np.bincount(labels[core], minlength=count)
        size = np.bincount(labels.ravel(), minlength=count)
        linked = hits > 0.25 * size
        linked[0] = False
        band &= linked[labels]
    return without_strays(core | band, depth > 0), front


def hidden_part(
    front: NDArray[np.float32], depth: NDArray[np.float32], unlike: Mask
) -> tuple[Mask, float]:
    """Pixels (h, w) where something nearer, or of another colour, is in front of the target.

    Also their share of its silhouette. front (h, w) m: the model's near side, 0 beside it. unlike
    (h, w): pixels that don't have its colours.
    """
    hidden = (front > 0) & (((depth > 0) & (depth < front - IN_FRONT_M)) | unlike)
    return hidden, float(hidden.sum() / max(1, int((front > 0).sum())))


def seen_part(box: Box, window: Window, seen: Mask) -> Box:
    """The part of the target's box px around the pixels of a window in which it is seen."""
    clean = cv2.morphologyEx(seen.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    if not clean.any():
        return box
    x0, y0, x1, y1 = extent(clean, window)
    return max(box[0], x0 - 1), max(box[1], y0 - 1), min(box[2], x1 + 1), min(box[3], y1 + 1)


def extent(mask: Mask, window: Window) -> Box:
    """Box px, in the image, of the pixels of a window's mask."""
    v, u = np.nonzero(mask)
    return (
        float(u.min() + window[0]),
        float(v.min() + window[1]),
        float(u.max() + 1 + window[0]),
        float(v.max() + 1 + window[1]),
    )


def without_strays(mask: Mask, valid: Mask) -> Mask:
    """The mask without pixels whose neighbours with depth are mostly outside it: noise."""
    share = cv2.blur(mask.astype(np.float32), (5, 5)) / np.maximum(
        cv2.blur(valid.astype(np.float32), (5, 5)), np.float32(1e-3)
    )
    return np.asarray(mask & (share > 0.4))


def smoothed(depth: NDArray[np.float32], mask: Mask) -> NDArray[np.float32]:
    """Depth (h, w) m, Gaussian-smoothed over masked pixels; 0 where too few of them are near."""
    total = cv2.GaussianBlur(mask.astype(np.float32), (7, 7), 1.5)
    smooth = cv2.GaussianBlur(np.where(mask, depth, np.float32(0.0)), (7, 7), 1.5)
    return np.where(total > 0.15, smooth / np.maximum(total, np.float32(1e-6)), np.float32(0.0))


def normals_at(
    smooth: NDArray[np.float32],
    window: Window,
    v: NDArray[np.intp],
    u: NDArray[np.intp],
    camera: Intrinsics,
) -> Array:
    """Unit normals (n, 3) towards the camera at pixels (v, u) of a smoothed window.

    Zero where a neighbouring pixel has no depth, or where there is a depth step.
    """
    step = 2
    height, width = smooth.shape
    neighbours = []
    for dv, du in ((0, step), (0, -step), (step, 0), (-step, 0)):
        vv, uu = np.clip(v + dv, 0, height - 1), np.clip(u + du, 0, width - 1)
        z = smooth[vv, uu].astype(np.float64)
        neighbours.append(camera.backproject(uu + float(window[0]), vv + float(window[1]), z))
    right, left, down, up = neighbours
    n = cross(down - up, right - left)
    length = np.linalg.norm(n, axis=1)
    ok = (
        (length > 0)
        & (np.abs(right[:, 2] - left[:, 2]) < DEPTH_STEP)
        & (np.abs(down[:, 2] - up[:, 2]) < DEPTH_STEP)
    )
    for neighbour in neighbours:
        ok &= neighbour[:, 2] > 0
    out = np.zeros((len(v), 3))
    out[ok] = n[ok] / length[ok, None]
    out[np.einsum("ij,ij->i", out, right) > 0] *= -1
    return out
