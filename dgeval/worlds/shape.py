"""A solid from a partial cloud, for physics: what stands on its support is filled down to it.

A camera over a table sees tops and some sides of an object. The object stands beneath what is seen,
so points are carried down to the support. That would turn round objects into cylinders, so a ball
is tried first; then a box, whose edges a hull would round. A hull would close hollow objects; where
points lie deep inside the hull, the solid is a round vessel or is made of columns.
"""

from __future__ import annotations

import contextlib

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError, cKDTree

from dgeval.geometry import Array
from dgeval.worlds.objects import ObjectModel, Part, at, vessel
from dgeval.worlds.textures import Look

# All values are ours.
LOOK = Look("mottled", (150, 150, 150))  # RGB, grey: the cloud has no colour
# kg/m^3, of household objects (docs/simulation.md, "Objects"); a log does not give it.
DENSITY = 350.0
MASS_RANGE = (0.03, 0.60)  # kg, to which the mass is clipped
BALL_RMS = 0.002  # m, most RMS residual of a ball's best sphere
BALL_SHARE = 0.9  # least share of a ball's points within three times BALL_RMS
BOX_OFF = 0.0016  # m, most mean distance of the points from the faces of the best upright box
FACE_POINTS = 12  # points that place a face, and that make a handle
RIM = 0.012  # m, height of the band under a vessel's top to which a circle is fitted
RIM_OFF = 0.005  # m, distance from the circle up to which points count
WALL = 0.004  # m, thickness of a vessel's wall
OUTSIDE = 0.007  # m outside a vessel's wall, from where on points are its handle
# m, radius of the neighbourhood that a plane is fitted to. The 1.2 mm of noise that hindsight has
# then leave hulls 0.5 to 1 mm too large.
SMOOTHED = 0.010
LEAST_POINTS = 20  # without as many points there is no shape
CELL = 0.007  # m, side of the cells in which columns of hollow objects are built
LIKE_HEIGHT = 0.008  # m, heights this near to each other become one column
HOLLOW_DEPTH = 0.010  # m below the surface around it, from where on a cell lies inside
HOLLOW_SHARE = 0.12  # least share of the footprint's cells that lie inside a hollow object


def solid_from_cloud(
    points: Array, name: str = "cloud", held: bool = False
) -> tuple[ObjectModel, Array]:
    """Model and centre (3,) m from points (n, 3) m in a frame with z up from the support (z = 0).

    The model's frame has the same axes and its origin at the centre, which is over the support by
    the model's rest height. held: the object is in a hand; nothing is known of what is below the
    lowest point, so points are not carried down further. ValueError where the points span no
    volume.
    """
    if len(points) < LEAST_POINTS:
        raise ValueError(f"{len(points)} points of the object over its support have no shape")
    inliers = _without_strays(points)
    if held:
        low = np.array([0.0, 0.0, float(inliers[:, 2].min())])
        model, centre = solid_from_cloud(points - low, name)
        return model, centre + low
    ball = _ball(inliers)
    if ball is not None:
        centre, radius = ball
        mass = _mass(4 / 3 * np.pi * radius**3)
        centre = np.array([centre[0], centre[1], radius])  # it stands on its support
        return ObjectModel(
            name, mass, (Part("sphere", np.eye(4), (radius,)),), LOOK, rolls=True
        ), centre
    box = _box(inliers)
    if box is not None:
        T, half = box
        return ObjectModel(
            name,
            _mass(float(8 * np.prod(half))),
            (Part("box", _turned(T), tuple(half.tolist())),),
            LOOK,
        ), T[:3, 3]
    inliers = _smoothed(inliers)
    parts = _columns(inliers)
    parts = (_vessel(inliers) or parts) if parts else (_hull(inliers),)
    low = np.min([_corner(p, -1) for p in parts], axis=0)
    high = np.max([_corner(p, 1) for p in parts], axis=0)
    centre = (low + high) / 2
    moved = tuple(Part(p.kind, at(*-centre) @ p.T_object_part, p.size, p.vertices) for p in parts)
    return ObjectModel(name, _mass(sum(p.volume() for p in moved)), moved, LOOK), centre


def _mass(volume: float) -> float:
    """Mass, kg, of a volume, m^3."""
    return float(np.clip(DENSITY * volume, *MASS_RANGE))


def _corner(part: Part, sign: int) -> Array:
    """Greatest (sign 1) or least (sign -1) coordinates (3,) m of a part."""
    return np.array([sign * -part.lowest(-sign * e) for e in np.eye(3)])


def well_surrounded(points: Array) -> NDArray[np.bool_]:
    """Which points (n, 3) m of a surface have enough neighbours.

    Flying pixels and remains of the hand have not, and would swell its hull.
    """
    count = cKDTree(points).query_ball_point(points, 0.008, return_length=True)
    return np.asarray(count >= max(4, 0.25 * float(np.median(count))))


def _without_strays(points: Array) -> Array:
    """Points that are well surrounded, and not the outermost along any axis."""
    kept = points[well_surrounded(points)]
    if len(kept) < LEAST_POINTS:
        return points
    low, high = np.quantile(kept, [0.003, 0.997], axis=0)
    kept = kept[((kept >= low) & (kept <= high)).all(axis=1)]
    return kept if len(kept) >= LEAST_POINTS else points


def _smoothed(points: Array) -> Array:
    """Points moved onto planes through their neighbours.

    A hull of noisy points would be some 3 mm too large on every side.
    """
    out = points.copy()
    tree = cKDTree(points)
    for i in range(len(points)):
        around = points[tree.query_ball_point(points[i], SMOOTHED)]
        if len(around) < 6:
            continue
        weights = np.exp(-2 * ((around - points[i]) ** 2).sum(axis=1, keepdims=True) / SMOOTHED**2)
        middle = (weights * around).sum(axis=0) / weights.sum()
        normal = np.linalg.eigh((weights * (around - middle)).T @ (around - middle))[1][:, 0]
        out[i] -= normal * (normal @ (points[i] - middle))
    return out


def _ball(points: Array) -> tuple[Array, float] | None:
    """Centre (3,) m and radius m of a sphere that explains the points, or None."""
    A = np.column_stack([2 * points, np.ones(len(points))])
    x, *_ = np.linalg.lstsq(A, (points**2).sum(axis=1), rcond=None)
    radius = float(np.sqrt(max(x[3] + x[:3] @ x[:3], 0.0)))
    residual = np.abs(np.linalg.norm(points - x[:3], axis=1) - radius)
    # a ball on a table touches it: that tells a sphere from a bowl or a rounded box
    standing = abs(x[2] - radius) < 0.15 * radius
    good = (
        float(np.sqrt(np.mean(residual**2))) < BALL_RMS
        and float(np.mean(residual < 3 * BALL_RMS)) > BALL_SHARE
    )
    return (x[:3], radius) if good and standing and 0.01 < radius < 0.15 else None


def _box(points: Array) -> tuple[Array, Array] | None:
    """T (4, 4) and half sizes (3,) m of an upright box on the support that explains the points.

    None if no box does. A face lies at the median of its points: a hull of the same points has
    round edges, on which no finger grips.
    """
    best: tuple[float, float, Array, Array] | None = None
    rectangle = np.radians(cv2.minAreaRect(points[:, :2].astype(np.float32))[2])
    for yaw in rectangle + np.radians(np.arange(-6.0, 6.1, 1.0)):
        c, s = np.cos(yaw), np.sin(yaw)
        local = points @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        low, high = np.quantile(local, [0.01, 0.99], axis=0)
        for _ in range(3):
            faces = np.stack(
                [
                    local[:, 0] - low[0],
                    high[0] - local[:, 0],
                    local[:, 1] - low[1],
                    high[1] - local[:, 1],
                    high[2] - local[:, 2],
                ]
            )
            nearest = np.abs(faces).argmin(axis=0)
            for k, (side, axis) in enumerate([(low, 0), (high, 0), (low, 1), (high, 1), (high, 2)]):
                if (nearest == k).sum() >= FACE_POINTS:
                    side[axis] = np.median(local[nearest == k, axis])
        cost = float(np.minimum(np.abs(faces).min(axis=0), 3 * BOX_OFF).mean())
        if best is None or cost < best[0]:
            best = cost, float(yaw), low, high
    assert best is not None
    cost, yaw, low, high = best
    if cost > BOX_OFF or (high - low).min() < 0.01:
        return None
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    middle, half = (low + high) / 2, (high - low) / 2
    middle[2] = half[2] = high[2] / 2
    T[:3, 3] = T[:3, :3] @ middle
    return T, half


def _turned(T: Array) -> Array:
    """The rotation of T alone."""
    out = T.copy()
    out[:3, 3] = 0.0
    return out


def _hull(points: Array) -> Part:
    """The convex hull of the points and of their projection onto the support.

    ValueError where they span no volume.
    """
    down = points.copy()
    down[:, 2] = 0.0
    both = np.concatenate([points[points[:, 2] > 0], down])
    try:
        hull = ConvexHull(both)
    except QhullError as error:
        raise ValueError(f"the cloud of {len(points)} points spans no volume") from error
    corners = both[hull.vertices]
    if len(corners) > 120:
        # MuJoCo needs no more; the farthest along many directions keep the shape
        k = np.arange(400) + 0.5
        polar, turn = np.arccos(1 - 2 * k / 400), np.pi * (1 + 5**0.5) * k
        directions = np.column_stack(
            [np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)]
        )
        corners = corners[np.unique((corners @ directions.T).argmax(axis=0))]
    return Part("hull", np.eye(4), vertices=corners)


def _vessel(points: Array) -> tuple[Part, ...] | None:
    """Walls and floor of an open round vessel, and what stands out of it (a handle) as one hull.

    None of other shapes.
    """
    height = float(np.quantile(points[:, 2], 0.98))
    rim = points[points[:, 2] > height - RIM]
    for _ in range(4):  # without the handle, which lies outside
        A = np.column_stack([2 * rim[:, :2], np.ones(len(rim))])
        x, *_ = np.linalg.lstsq(A, (rim[:, :2] ** 2).sum(axis=1), rcond=None)
        radius = float(np.sqrt(max(x[2] + x[:2] @ x[:2], 0.0)))
        off = np.linalg.norm(rim[:, :2] - x[:2], axis=1) - radius
        if (np.abs(off) < RIM_OFF).sum() < 0.6 * len(rim):
            return None
        if (np.abs(off) < RIM_OFF).all():
            break
        rim = rim[np.abs(off) < RIM_OFF]
    if float(np.sqrt(np.mean(off**2))) > RIM_OFF / 2:
        return None
    r = np.linalg.norm(points[:, :2] - x[:2], axis=1)
    wall = np.abs(r - radius) < 0.35 * radius
    taper = (
        float(np.clip(np.polyfit(points[wall, 2], r[wall], 1)[0], -0.3, 0.3))
        if np.ptp(points[wall, 2]) > 0.02
        else 0.0
    )
    r_bottom = radius - taper * (height - RIM / 2)
    r_top = radius + taper * RIM / 2
    parts = vessel("cloud", r_bottom + WALL / 2, r_top + WALL / 2, height, WALL, 1.0, LOOK).parts
    middle = at(float(x[0]), float(x[1]), height / 2)
    out = [Part(p.kind, middle @ p.T_object_part, p.size) for p in parts]
    outside = points[r > r_bottom + taper * points[:, 2] + OUTSIDE]
    if len(outside) >= FACE_POINTS:
        with contextlib.suppress(QhullError):
            out.append(Part("hull", np.eye(4), vertices=outside[ConvexHull(outside).vertices]))
    return tuple(out)


def _columns(points: Array) -> tuple[Part, ...] | None:
    """Boxes from the support up to the observed surface, joined along rows of similar height.

    None for an object that is not hollow.
    """
    low = points[:, :2].min(axis=0)
    cells = np.floor((points[:, :2] - low) / CELL).astype(int)
    shape = cells.max(axis=0) + 1
    top = np.full(shape, -1.0)
    np.maximum.at(top, (cells[:, 0], cells[:, 1]), points[:, 2])
    observed = top >= 0
    # inside the footprint: cells enclosed by observed ones along both axes
    inside = np.ones(shape, bool)
    for axis in (0, 1):
        before = np.maximum.accumulate(top, axis=axis)
        after = np.flip(np.maximum.accumulate(np.flip(top, axis), axis=axis), axis)
        inside &= np.minimum(before, after) > np.where(observed, top, 0.0) + HOLLOW_DEPTH
    if inside.sum() < HOLLOW_SHARE * (observed | inside).sum():
        return None
    height = np.where(observed, top, 0.0)
    height[inside & ~observed] = 0.005  # a floor that nobody saw
    parts: list[Part] = []
    free = height > 0.002
    for i in range(shape[0]):
        for j in range(shape[1]):
            if not free[i, j]:
                continue
            # the largest rectangle of similar height, first along one axis, then along the other
            similar = free & (np.abs(height - height[i, j]) < LIKE_HEIGHT)
            b = j + 1
            while b < shape[1] and similar[i, b]:
                b += 1
            a = i + 1
            while a < shape[0] and similar[a, j:b].all():
                a += 1
            free[i:a, j:b] = False
            h = float(height[i:a, j:b].mean())
            x, y = low[0] + (i + a) / 2 * CELL, low[1] + (j + b) / 2 * CELL
            parts.append(
                Part("box", at(x, y, h / 2), ((a - i) * CELL / 2, (b - j) * CELL / 2, h / 2))
            )
    return tuple(parts) or None
