"""Jaw grasps of procedural objects tried in physics, with what the wrist camera sees before each: VFAS-Grasp's evaluator.

The paper takes ACRONYM's grasps, which are not ours to ship, and Isaac Gym. Here poses are drawn on an object on a table,
moved as the planner's own sampling moves its seed (and up to three times as far), and every one that is free of contact and
has something between its fingers is closed, lifted and shaken. So offsets along z, x and y get their true label: the
paper's hard negatives, without its test that they are unlike any known grasp.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgeval import __version__
from dgeval.determinism import generator, limit_threads
from dgeval.geometry import Array, invert, transform
from dgeval.planning.vfas.selection import perturbed
from dgeval.robots.hand import hand_for
from dgeval.simulation.jaw_grasps import FlyingJaw, between_fingers, seed_pose
from dgeval.simulation.render import Renderer
from dgeval.simulation.sensors import D405, depth_intrinsics
from dgeval.worlds.objects import ObjectModel, at, procedural_object, surface_points
from dgeval.worlds.scene import Camera, pose_of

HAND = hand_for("vfas")

VERSION = 1
SIZE = 160, 120  # px of the drawn view; some three thousand points in the crop
POINTS = 6000  # kept of a view
NEAR = 0.16  # m about the grasp, of what is kept
PER_SEED = 24  # poses round each seed
OTHER_SHARE = 0.4  # of scenes with a second object near
CAMERAS = tuple(
    Camera(name, depth_intrinsics(D405, *SIZE), HAND.T_hand_camera) for name in ("colour", "depth")
)
GRAZING = np.cos(np.radians(80.0))  # of the angle between normal and ray


@dataclass(frozen=True)
class Scene:
    """One view, and poses near the seed it was taken for, all in the seed's grasp frame.

    points (n, 3) m; grazing (n,), table (n,): seen at 80 degrees and more, part of the table. T_seed_grasp (m, 4, 4),
    held (m,), table_hit (m,): the gripper meets the table.
    """

    points: NDArray[np.float32]
    grazing: NDArray[np.bool_]
    table: NDArray[np.bool_]
    T_seed_grasp: Array
    held: NDArray[np.bool_]
    table_hit: NDArray[np.bool_]


def view(
    world: FlyingJaw, renderer: Renderer, T_base_seed: Array, rng: np.random.Generator
) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """What the camera sees from about the pre-grasp pose: points (n, 3) in the seed's frame, grazing, table."""
    moved = perturbed(T_base_seed[None], np.array([0.03] * 3), np.radians(8), rng)[0] @ at(
        0, 0, -rng.uniform(0.07, 0.15)
    )
    world.put(moved)
    mujoco.mj_camlight(world.model, world.data)
    k = CAMERAS[0].intrinsics
    depth = renderer.exact_depth("depth").astype(float)
    v, u = np.indices(depth.shape)
    camera = k.backproject(u.ravel(), v.ravel(), depth.ravel()).reshape(*depth.shape, 3)
    normal = np.cross(np.gradient(camera, axis=1), np.gradient(camera, axis=0))
    along = np.abs((normal * camera).sum(-1)) / np.maximum(
        np.linalg.norm(normal, axis=-1) * np.linalg.norm(camera, axis=-1), 1e-12
    )
    T_base_camera = pose_of(world.data, "hand_base") @ HAND.T_hand_camera
    base = transform(T_base_camera, camera.reshape(-1, 3))
    local = transform(invert(T_base_seed), base)
    own = renderer.mask_of(np.flatnonzero(world.is_hand).tolist()).ravel()
    kept = np.flatnonzero(
        (depth.ravel() > D405.min_range) & (np.abs(local).max(axis=1) < NEAR) & ~own
    )
    kept = np.sort(rng.permutation(kept)[:POINTS])
    return local[kept], (along.ravel() < GRAZING)[kept], (base[:, 2] < 0.002)[kept]


def scenes_of(
    thing: ObjectModel, other: ObjectModel, seed: int, seeds: int, per_seed: int = PER_SEED
) -> list[Scene]:
    """Up to `seeds` scenes of an object; each draws its own place of the other one."""
    out: list[Scene] = []
    world = FlyingJaw(thing, other, CAMERAS)
    surface = surface_points(thing, 6000, generator(seed, f"jaw surface/{thing.name}", 0))
    T_base_object = at(0.5, 0, thing.rest_height())
    with Renderer(world, (CAMERAS[0], CAMERAS[1]), D405, seed, 0) as renderer:
        for k in range(60 * seeds):
            if len(out) == seeds:
                break
            rng = generator(seed, f"jaw scene/{thing.name}", k)
            T_object_seed = seed_pose(surface, rng)
            near, turn = rng.random() < OTHER_SHARE, rng.uniform(0, 2 * np.pi)
            far = float(
                np.linalg.norm(thing.extent()[:2]) / 2
                + np.linalg.norm(other.extent()[:2]) / 2
                + rng.uniform(0.005, 0.06)
            )
            place = (0.5 + far * np.cos(turn), far * np.sin(turn)) if near else (3.0, 0.0)
            world.T_base_other = at(
                place[0], place[1], other.rest_height(), Rotation.from_euler("z", turn).as_matrix()
            )
            if T_object_seed is None:
                continue
            T_base_seed = T_base_object @ T_object_seed
            # most poses drawn overlap or fail: enough of the like come from moving good ones
            if not all(world.approach_free(T_base_seed)) and rng.random() < 0.97:
                continue
            world.put(T_base_seed)
            if not world.lifts() and rng.random() < 0.8:
                continue
            size = (1.0, 2.0, 3.0)[k % 3]
            poses = perturbed(
                np.tile(T_base_seed, (per_seed, 1, 1)),
                np.full(3, 0.02 * size),
                np.radians(5) * size,
                rng,
            )
            poses[0] = T_base_seed
            near_ones = per_seed // 4
            poses[1 : 1 + near_ones] = perturbed(
                np.tile(T_base_seed, (near_ones, 1, 1)), np.full(3, 0.008), np.radians(4), rng
            )
            held, table_hit = np.zeros(per_seed, bool), np.zeros(per_seed, bool)
            for i, T in enumerate(poses):
                free, over_table = world.approach_free(T)
                table_hit[i] = not over_table
                if free and over_table and between_fingers(surface, invert(T) @ T_base_object) > 3:
                    world.put(T)
                    held[i] = world.lifts()
            points, grazing, table = view(world, renderer, T_base_seed, rng)
            if len(points) >= 200:
                out.append(
                    Scene(
                        points.astype(np.float32),
                        grazing,
                        table,
                        invert(T_base_seed) @ poses,
                        held,
                        table_hit,
                    )
                )
    return out


def write_scenes(index: int, out: Path, seed: int, seeds: int) -> Path:
    """Scenes of procedural object `index` as OUT/<object>.npz; a finished file of the same settings is kept."""
    limit_threads()
    out.mkdir(parents=True, exist_ok=True)
    thing = procedural_object(index, seed)
    path = out / f"{thing.name}.npz"
    about = (
        f"dgeval {__version__} jaw {VERSION} mujoco {mujoco.__version__} seed {seed} seeds {seeds}"
    )
    if path.is_file() and str(np.load(path)["about"]) == about:
        return path
    scenes = scenes_of(thing, procedural_object(index + 1000, seed), seed, seeds)
    part = path.with_suffix(".part.npz")
    counts = np.cumsum([0, *(len(s.points) for s in scenes)])
    stacked: dict[str, Any] = {
        "points": np.concatenate([s.points for s in scenes] or [np.empty((0, 3), np.float32)]),
        "grazing": np.concatenate([s.grazing for s in scenes] or [np.empty(0, bool)]),
        "table": np.concatenate([s.table for s in scenes] or [np.empty(0, bool)]),
        "T_seed_grasp": np.array([s.T_seed_grasp for s in scenes], dtype=np.float32).reshape(
            -1, PER_SEED, 4, 4
        ),
        "held": np.array([s.held for s in scenes], dtype=bool).reshape(-1, PER_SEED),
        "table_hit": np.array([s.table_hit for s in scenes], dtype=bool).reshape(-1, PER_SEED),
    }
    np.savez_compressed(part, about=about, counts=counts, **stacked)
    part.rename(path)
    return path


def read_scenes(path: Path) -> list[Scene]:
    """A file of `write_scenes`."""
    with np.load(path) as file:
        c = file["counts"]
        points, grazing, table = file["points"], file["grazing"], file["table"]
        poses, held, hit = file["T_seed_grasp"].astype(np.float64), file["held"], file["table_hit"]
    return [
        Scene(
            points[c[i] : c[i + 1]],
            grazing[c[i] : c[i + 1]],
            table[c[i] : c[i + 1]],
            poses[i],
            held[i],
            hit[i],
        )
        for i in range(len(held))
    ]
