"""A small ray caster for synthetic recordings: boxes and capsules over a plane, exact depth.

It needs no graphics card and no physics engine, so that a recording with known truth can be made
anywhere. Sensor noise follows `dgeval.geometry.depth_sigma`. Edges lose pixels, and depth is
quantised as in a structured-light camera.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from dgeval.geometry import Array, Intrinsics, depth_sigma, invert
from numpy.typing import NDArray

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Box:
    """Half lengths, m; one texture (square RGB image) per face in the order +x -x +y -y +z -z."""

    half: tuple[float, float, float]
    faces: list[Image]


@dataclass(frozen=True)
class Capsule:
    """Segment along z with half length and radius, m; one colour RGB."""

    radius: float
    half: float
    colour: tuple[int, int, int]


@dataclass
class Scene:
    """Solids with T_world_solid, over the plane z = 0 with a texture of `tile` m."""

    table: Image
    tile: float = 1.2
    solids: list[tuple[Box | Capsule, Array]] = field(default_factory=list)


def speckle(
    rng: np.random.Generator, base: tuple[int, int, int], contrast: float, size: int = 256
) -> Image:
    """A texture with detail at several scales around a base colour."""
    out = np.zeros((size, size, 3))
    for cells in (4, 8, 16, 32, 64):
        noise = rng.standard_normal((cells, cells, 3)) * 0.6 + rng.standard_normal(
            (cells, cells, 1)
        )
        out += cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
    return np.clip(np.array(base) + out / 2.2 * contrast, 0, 255).astype(np.uint8)


def printed(rng: np.random.Generator, base: tuple[int, int, int], size: int = 256) -> Image:
    """A texture like a package: blocks and letters on a base colour."""
    image = np.full((size, size, 3), base, np.uint8)
    for _ in range(14):
        a = rng.integers(0, size, 2)
        b = a + rng.integers(size // 12, size // 3, 2)
        colour = tuple(int(c) for c in rng.integers(20, 235, 3))
        cv2.rectangle(image, tuple(map(int, a)), tuple(map(int, b)), colour, -1)
    for _ in range(7):
        at = tuple(map(int, rng.integers(10, size - 60, 2)))
        text = "".join(chr(int(c)) for c in rng.integers(65, 91, 5))
        colour = tuple(int(c) for c in rng.integers(0, 255, 3))
        cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.9, colour, 2, cv2.LINE_AA)
    return image


def _sample(texture: Image, u: Array, v: Array) -> Array:
    """Bilinear texture look-up at u, v in [0, 1)."""
    x = np.asarray(u * (texture.shape[1] - 1), np.float32).reshape(1, -1)
    y = np.asarray(v * (texture.shape[0] - 1), np.float32).reshape(1, -1)
    # OpenCV's remap takes at most 32767 columns
    parts = [
        cv2.remap(
            texture,
            x[:, i : i + 30000],
            y[:, i : i + 30000],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REFLECT,
        )
        for i in range(0, x.shape[1], 30000)
    ]
    return np.concatenate(parts, axis=1)[0].astype(np.float64)


def render(
    scene: Scene, camera: Intrinsics, T_world_camera: Array
) -> tuple[Image, Array, NDArray[np.int16]]:
    """Colour (H, W, 3), exact depth (H, W) m, index of the visible solid (-1 table, -2 none)."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    rays = np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u, dtype=float)], -1
    ).reshape(-1, 3)
    directions = rays @ T_world_camera[:3, :3].T  # unit camera depth per unit of ray parameter
    origin = T_world_camera[:3, 3]
    depth = np.full(len(rays), np.inf)
    colour = np.full((len(rays), 3), 40.0)
    ids = np.full(len(rays), -2, np.int16)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -origin[2] / directions[:, 2]
        hit = (t > 0) & (t < 4)
        p = origin[:2] + directions[hit, :2] * t[hit, None]
        depth[hit], ids[hit] = t[hit], -1
        uv = np.abs((p / (2 * scene.tile)) % 1.0 * 2 - 1)
        colour[hit] = _sample(scene.table, uv[:, 0], uv[:, 1])
        for i, (solid, T_world_solid) in enumerate(scene.solids):
            T = invert(T_world_solid)
            o = T[:3, :3] @ origin + T[:3, 3]
            d = directions @ T[:3, :3].T
            distance, shade = (
                _hit_box(solid, o, d) if isinstance(solid, Box) else _hit_capsule(solid, o, d)
            )
            nearer = distance < depth
            depth[nearer], ids[nearer] = distance[nearer], i
            colour[nearer] = shade(nearer)
    shape = (camera.height, camera.width)
    depth[~np.isfinite(depth)] = 0.0
    return (
        np.clip(colour, 0, 255).astype(np.uint8).reshape(*shape, 3),
        depth.reshape(shape),
        ids.reshape(shape),
    )


def _hit_box(box: Box, o: Array, d: Array):  # type: ignore[no-untyped-def]
    half = np.array(box.half)
    t1, t2 = (-half - o) / d, (half - o) / d
    enter, leave = np.minimum(t1, t2), np.maximum(t1, t2)
    axis = np.argmax(enter, axis=1)
    near, far = enter.max(axis=1), leave.min(axis=1)
    near = np.where((near < far) & (near > 0), near, np.inf)

    def shade(chosen: NDArray[np.bool_]) -> Array:
        p = o + d[chosen] * near[chosen, None]
        out = np.zeros((len(p), 3))
        for a in range(3):
            for sign in (0, 1):
                face = (axis[chosen] == a) & ((p[:, a] < 0) == bool(sign))
                others = [k for k in range(3) if k != a]
                uv = np.clip(p[face][:, others] / (2 * half[others]) + 0.5, 0, 0.999)
                out[face] = (
                    _sample(box.faces[2 * a + sign], uv[:, 0], uv[:, 1]) * (1.0, 0.85, 0.95)[a]
                    if face.any()
                    else 0
                )
        return out

    return near, shade


def _hit_capsule(capsule: Capsule, o: Array, d: Array):  # type: ignore[no-untyped-def]
    near = np.full(len(d), np.inf)
    a = (d[:, :2] ** 2).sum(1)
    b = d[:, :2] @ o[:2]
    c = o[:2] @ o[:2] - capsule.radius**2
    t = (-b - np.sqrt(b * b - a * c)) / a
    z = o[2] + t * d[:, 2]
    ok = (t > 0) & (np.abs(z) <= capsule.half)
    near[ok] = t[ok]
    for end in (-capsule.half, capsule.half):
        e = o - np.array([0, 0, end])
        a3 = (d**2).sum(1)
        b3 = d @ e
        t = (-b3 - np.sqrt(b3 * b3 - a3 * (e @ e - capsule.radius**2))) / a3
        near = np.where((t > 0) & (t < near), t, near)

    def shade(chosen: NDArray[np.bool_]) -> Array:
        p = o + d[chosen] * near[chosen, None]
        p[:, 2] -= np.clip(p[:, 2], -capsule.half, capsule.half)
        light = 0.55 + 0.45 * np.clip(p @ np.array([0.4, -0.5, 0.75]) / capsule.radius, -1, 1)
        return np.asarray(light[:, None] * np.array(capsule.colour, dtype=float))

    return near, shade


def add_noise(
    rng: np.random.Generator, colour: Image, depth: Array, minimum: float = 0.0
) -> tuple[Image, NDArray[np.uint16]]:
    """Add sensor noise: colour (H, W, 3) uint8, depth (H, W) uint16 mm, 0 where none is measured.

    depth: (H, W) m. minimum: m; nearer depth is not measured.
    """
    noisy = cv2.GaussianBlur(colour, (3, 3), 0.6).astype(np.float64) + rng.normal(
        0, 2.5, colour.shape
    )
    # depth noise of neighbouring pixels is correlated, because the matching windows overlap
    field_ = cv2.GaussianBlur(rng.standard_normal(depth.shape), (5, 5), 1.0)
    field_ /= field_.std()
    z = depth + field_ * depth_sigma(depth)
    disparity = np.where(depth > 0, 580.0 * 0.075 / np.maximum(z, 1e-6), 0)
    z = np.where(depth > 0, 580.0 * 0.075 / np.maximum(np.round(disparity * 8) / 8, 1e-6), 0)
    edge = cv2.dilate(
        (np.abs(cv2.Laplacian(depth, cv2.CV_64F)) > 0.03).astype(np.uint8),
        np.ones((3, 3), np.uint8),
    )
    lost = (
        (edge > 0) & (rng.random(depth.shape) < 0.6)
        | (rng.random(depth.shape) < 0.004)
        | (depth <= minimum)
    )
    millimetres = np.where(lost, 0, np.round(z * 1000))
    return np.clip(noisy, 0, 255).astype(np.uint8), np.clip(millimetres, 0, 65534).astype(np.uint16)
