"""Jaw grasps of procedural objects, tried in physics: the training data of VFAS-Grasp's evaluator.

Each scene holds what the wrist camera sees before a grasp, and labelled poses near it. The paper
uses ACRONYM's grasps, which we may not ship, and Isaac Gym. Here a seed pose is drawn on an object
on a table, and moved as the planner's sampling moves its seed, up to three times as far. A pose
whose approach is free of contact and that has points between the fingers is closed, lifted and
shaken; any other pose is a failure. So offsets along z, x and y get their true label. The paper
uses such offsets as hard negatives and tests that they are unlike any known grasp; here that test
is not needed.
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

VERSION = 1  # of the sampling below; files of another version are made again
SIZE = 160, 120  # px, width and height of the rendered view; about 3000 points in the crop
POINTS = 6000  # most points kept of a view
NEAR = 0.16  # m on each axis of the seed's frame, within which points are kept
PER_SEED = 24  # poses per scene, the seed included
OTHER_SHARE = 0.4  # of scenes, with a second object near
CAMERAS = tuple(
    Camera(name, depth_intrinsics(D405, *SIZE), HAND.T_hand_camera) for name in ("colour", "depth")
)
# cosine of the angle between surface normal and ray, below which a point counts as grazing
GRAZING = np.cos(np.radians(80.0))


@dataclass(frozen=True)
class Scene:
    """One view and the poses near the seed it was taken for, all in the seed's grasp frame.

    - points (n, 3) float32, m.
    - grazing (n,): points seen at 80 degrees or more from the surface normal.
    - table (n,): points of the table.
    - T_seed_grasp (m, 4, 4): the poses.
    - held (m,): whether the pose held the object.
    - table_hit (m,): whether the gripper meets the table on its approach.
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
    """What the wrist camera sees from near the pre-grasp pose of a seed, T_base_seed (4, 4).

    Returns points (n, 3) m in the seed's frame, and for each whether it is grazing and whether it
    is of the table, as in `Scene`. The gripper itself is left out.
    """
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
    cosine = np.abs((normal * camera).sum(-1)) / np.maximum(
        np.linalg.norm(normal, axis=-1) * np.linalg.norm(camera, axis=-1), 1e-12
    )
    T_base_camera = pose_of(world.data, "hand_base") @ HAND.T_hand_camera
    base = transform(T_base_camera, camera.reshape(-1, 3))
    local = transform(invert(T_base_seed), base)
    of_gripper = renderer.mask_of(np.flatnonzero(world.is_hand).tolist()).ravel()
    kept = np.flatnonzero(
        (depth.ravel() > D405.min_range) & (np.abs(local).max(axis=1) < NEAR) & ~of_gripper
    )
    kept = np.sort(rng.permutation(kept)[:POINTS])
    return local[kept], (cosine.ravel() < GRAZING)[kept], (base[:, 2] < 0.002)[kept]


def scenes_of(
    object_model: ObjectModel, other: ObjectModel, seed: int, seeds: int, per_seed: int = PER_SEED
) -> list[Scene]:
    """Up to `seeds` scenes of an object, each with `per_seed` poses.

    In each scene the other object stands at a random place near the first one, or far away.
    """
    out: list[Scene] = []
    world = FlyingJaw(object_model, other, CAMERAS)
    surface = surface_points(
        object_model, 6000, generator(seed, f"jaw surface/{object_model.name}", 0)
    )
    T_base_object = at(0.5, 0, object_model.rest_height())
    with Renderer(world, (CAMERAS[0], CAMERAS[1]), D405, seed, 0) as renderer:
        for k in range(60 * seeds):
            if len(out) == seeds:
                break
            rng = generator(seed, f"jaw scene/{object_model.name}", k)
            T_object_seed = seed_pose(surface, rng)
            near, turn = rng.random() < OTHER_SHARE, rng.uniform(0, 2 * np.pi)
            distance = float(
                np.linalg.norm(object_model.extent()[:2]) / 2
                + np.linalg.norm(other.extent()[:2]) / 2
                + rng.uniform(0.005, 0.06)
            )
            place = (0.5 + distance * np.cos(turn), distance * np.sin(turn)) if near else (3.0, 0.0)
            world.T_base_other = at(
                place[0], place[1], other.rest_height(), Rotation.from_euler("z", turn).as_matrix()
            )
            if T_object_seed is None:
                continue
            T_base_seed = T_base_object @ T_object_seed
            # Most random seeds overlap or fail. Keep few of these: moving good seeds gives enough.
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
    """Write scenes of procedural object `index` to OUT/<object>.npz; returns the path.

    A finished file of the same settings is kept.
    """
    limit_threads()
    out.mkdir(parents=True, exist_ok=True)
    object_model = procedural_object(index, seed)
    path = out / f"{object_model.name}.npz"
    about = (
        f"dgeval {__version__} jaw {VERSION} mujoco {mujoco.__version__} seed {seed} seeds {seeds}"
    )
    if path.is_file() and str(np.load(path)["about"]) == about:
        return path
    scenes = scenes_of(object_model, procedural_object(index + 1000, seed), seed, seeds)
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
    """Read a file of `write_scenes`."""
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
