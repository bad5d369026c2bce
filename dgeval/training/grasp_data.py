"""Five-finger grasps of procedural objects, tried in physics: what FFHNet learns from.

An object stands on a table; the hand flies to a pose, closes, lifts, and is shaken. Poses come from a random sampler
(SIMULATION section 6a) and from perturbing those that held; poses in which the open hand overlaps the object are kept as
failures without a try. Later an evaluator learns from what it would choose itself: the highest scores of thousands of
candidates are where its own mistakes are.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray

from dgeval import __version__
from dgeval.determinism import generator, limit_threads
from dgeval.geometry import Array, increment, invert
from dgeval.networks.ffhnet import FFHGenerator, load_evaluator, load_generator
from dgeval.planning.grasps import (
    Candidates,
    EncodedCloud,
    Networks,
    draw,
    encode_cloud,
    free_of,
    propose,
)
from dgeval.recording.containers.container import sha256_of
from dgeval.robots.hand import hand_for
from dgeval.simulation.grasps import FlyingHand, candidate
from dgeval.training.views import cloud_of, views_of
from dgeval.worlds.objects import ObjectModel, at, procedural_object, surface_points

HAND = hand_for("ffhnet")

VERSION = 2  # of what is drawn below: files of another one are made again
NOISE_SCALES = (
    (0.003, np.radians(3)),
    (0.008, np.radians(8)),
    (0.016, np.radians(16)),
)  # m, rad; perturbed positives
APPROACH_M, APPROACH_SD, APPROACH_RAD = (
    (0.01, 0.10),
    0.008,
    np.radians(6),
)  # back along the fingers, and off to the side
OVERLAP = 0.002  # m; hand and object deeper in each other than this: no pose a robot could be in
LIGHT_TOUCH = 0.004  # m; proposals may touch by so much, as hands do that arrive
PROPOSED_VIEWS = 8
MOST_DRAWN = 15_000  # candidates per object
CHOSEN_VIEWS, CHOSEN_DRAWS = 8, 8  # of an object, from which an evaluator chooses
BEST_SCORED = 300  # candidates that are looked at


@dataclass(frozen=True)
class GraspData:
    """Tried grasps of one object: T_object_palm (n, 4, 4), joints (n, 15) rad before closing, held (n,), overlapping (n,)."""

    T_object_palm: Array
    joints: Array
    held: NDArray[np.bool_]
    overlapping: NDArray[np.bool_]


def make_grasps(thing: ObjectModel, seed: int, tried: int) -> GraspData:
    """About `tried` grasps simulated, a third of them drawn at random and the others round those that held."""
    world = FlyingHand(thing)
    T_object_base = invert(at(0.5, 0.0, thing.rest_height()))
    rows: list[tuple[Array, Array, bool, bool]] = []

    def attempt(T: Array, preshape: Array) -> bool:
        world.put(T, preshape)
        held = world.lifts(preshape, shake=True)
        rows.append((T, preshape, held, False))
        return held

    good: list[tuple[Array, Array]] = []
    overlaps = 0
    for k in range(MOST_DRAWN):
        if len(rows) - overlaps >= tried // 3:
            break
        T, preshape = candidate(generator(seed, f"grasps/{thing.name}", k), thing)
        world.put(T, preshape)
        if world.touches():
            if overlaps < tried // 4 and world.penetration() > OVERLAP:
                rows.append((T, preshape, False, True))
                overlaps += 1
            continue
        if attempt(T, preshape):
            good.append((T, preshape))
    k = 0
    while good and len(rows) - overlaps < tried and k < 20 * tried:
        rng = generator(seed, f"perturbed/{thing.name}", k)
        T, preshape = good[int(rng.integers(len(good)))]
        metres, radians = NOISE_SCALES[k % len(NOISE_SCALES)]
        T = T @ increment(np.concatenate([rng.normal(0, metres, 3), rng.normal(0, radians, 3)]))
        k += 1
        world.put(T, preshape)
        if world.touches():
            if overlaps < tried // 2 and world.penetration() > OVERLAP:
                rows.append((T, preshape, False, True))
                overlaps += 1
        elif attempt(T, preshape):
            good.append((T, preshape))
    for k in range(5 * tried // 8 if good else 0):
        T, preshape = on_the_way(good, generator(seed, f"approach/{thing.name}", k))
        world.put(T, preshape)
        if not world.touches():
            attempt(T, preshape)
    return GraspData(
        np.array([T_object_base @ T @ HAND.T_hand_palm for T, _, _, _ in rows]),
        np.array([p for _, p, _, _ in rows]),
        np.array([h for _, _, h, _ in rows]),
        np.array([o for _, _, _, o in rows]),
    )


def on_the_way(good: list[tuple[Array, Array]], rng: np.random.Generator) -> tuple[Array, Array]:
    """A hand, T_base_hand, and its fingers that have not arrived yet at a grasp that held: where closing is too early."""
    T, preshape = good[int(rng.integers(len(good)))]
    metres = rng.normal(0, APPROACH_SD, 3)
    metres[2] -= rng.uniform(*APPROACH_M)  # the hand's z runs along its fingers
    return T @ increment(np.concatenate([metres, rng.normal(0, APPROACH_RAD, 3)])), preshape


def try_proposed(thing: ObjectModel, network: FFHGenerator, seed: int, tried: int) -> GraspData:
    """What a generator proposes for views of an object, tried: what its evaluator will have to tell apart.

    A light touch of object or table pushes as it would in an approach; only deeper overlaps are failures without a try.
    """
    world = FlyingHand(thing)
    views = views_of(thing, PROPOSED_VIEWS, network.dec_bn1.num_features, seed + 1)
    poses, joints, held, overlapping = [], [], [], []
    for k, view in enumerate(views):
        bps = torch.from_numpy(view.bps)[None]
        T_view_palm, drawn = draw(
            bps, network, -(-tried // PROPOSED_VIEWS), seed, f"proposed/{thing.name}", k
        )
        for T, q in zip(invert(view.T_view_object) @ T_view_palm, drawn, strict=True):
            world.put_palm(T, q)
            deep = world.penetration(anything=True) > LIGHT_TOUCH
            poses.append(T)
            joints.append(q)
            overlapping.append(deep)
            held.append(not deep and world.lifts(q, shake=True))
    return GraspData(np.array(poses), np.array(joints), np.array(held), np.array(overlapping))


def holds(world: FlyingHand, T_object_palm: Array, joints: Array) -> bool:
    """Whether a hand put there holds the object through lift and shake; one that lies deeper in it or in the table doesn't.

    A view says nothing of the far side, so many that look free lie in it; physics alone would push them out and lift.
    """
    world.put_palm(T_object_palm, joints)
    return world.penetration(anything=True) <= LIGHT_TOUCH and world.lifts(joints, shake=True)


def free_on_table(
    thing: ObjectModel, T_cloud_object: Array, cloud: EncodedCloud, candidates: Candidates
) -> NDArray[np.bool_]:
    """Which candidates (n,) lie at most a light touch deep in the cloud of a standing object and in its table."""
    normal = T_cloud_object[:3, 2]
    support = normal, float(normal @ T_cloud_object[:3, 3]) - thing.rest_height()
    return free_of(cloud, candidates.T_cloud_palm, candidates.joints, support, LIGHT_TOUCH)


def try_selected(
    thing: ObjectModel, networks: Networks, seed: int, views: int, draws: int = 1
) -> tuple[list[EncodedCloud], Array, Array, Array, NDArray[np.bool_]]:
    """What would be chosen for views of an object, tried: of draws x 256 candidates, the BEST_SCORED of them, those that are
    free: the four best and four at random.

    Returns the clouds, by grasp; T_cloud_palm (n, 4, 4) and T_object_palm (n, 4, 4); joints (n, 15); held (n,).
    """
    world = FlyingHand(thing)
    surface = surface_points(thing, 12_000, generator(seed, f"selected/{thing.name}", 0))
    clouds, poses, in_object, joints, held = [], [], [], [], []
    for k in range(views):
        rng = generator(seed, f"selected view/{thing.name}", k)
        points, T_cloud_object = cloud_of(surface, k % 2 == 1, rng)
        cloud = encode_cloud(points, networks)
        parts = [propose(cloud, networks, 256, seed, k + 1000 * draw) for draw in range(draws)]
        drawn = Candidates(
            np.concatenate([p.T_cloud_palm for p in parts]),
            np.concatenate([p.joints for p in parts]),
            np.concatenate([p.scores for p in parts]),
        )
        order = np.argsort(-drawn.scores, kind="stable")[:BEST_SCORED]
        top = Candidates(drawn.T_cloud_palm[order], drawn.joints[order], drawn.scores[order])
        free = order[free_on_table(thing, T_cloud_object, cloud, top)]
        for row in [*free[:4], *rng.permutation(np.sort(free[4:]))[:4]]:
            T_object_palm = invert(T_cloud_object) @ drawn.T_cloud_palm[row]
            clouds.append(cloud)
            poses.append(drawn.T_cloud_palm[row])
            in_object.append(T_object_palm)
            joints.append(drawn.joints[row])
            held.append(holds(world, T_object_palm, drawn.joints[row]))
    shape = (-1, 4, 4)
    return (
        clouds,
        np.reshape(poses, shape),
        np.reshape(in_object, shape),
        np.reshape(joints, (-1, 15)),
        np.array(held, bool),
    )


def write_grasps(
    index: int,
    out: Path,
    seed: int,
    tried: int,
    weights: Path | None = None,
    evaluator: Path | None = None,
) -> Path:
    """Grasps of procedural object `index` as OUT/<object>.npz; a finished file of the same settings is kept.

    weights: of a generator whose proposals are tried in place of sampled grasps; with `evaluator`, those that it chooses.
    """
    limit_threads()
    out.mkdir(parents=True, exist_ok=True)
    thing = procedural_object(index, seed)
    path = out / f"{thing.name}.npz"
    about = f"dgeval {__version__} grasps {VERSION} mujoco {mujoco.__version__} seed {seed} tried {tried}"
    if weights is not None:
        about += f" proposed by {sha256_of(weights)}"
    if evaluator is not None:
        about += f" chosen by {sha256_of(evaluator)}"
    if path.is_file() and str(np.load(path)["about"]) == about:
        return path
    if weights is None:
        data = make_grasps(thing, seed, tried)
    elif evaluator is None:
        data = try_proposed(thing, load_generator(weights), seed, tried)
    else:
        networks = Networks(load_generator(weights), load_evaluator(evaluator), upright=True)
        _, _, T, joints, held = try_selected(thing, networks, seed, CHOSEN_VIEWS, CHOSEN_DRAWS)
        data = GraspData(T, joints, held, np.zeros(len(held), np.bool_))
    part = path.with_suffix(".part.npz")
    np.savez_compressed(
        part,
        about=about,
        T_object_palm=data.T_object_palm.astype(np.float32),
        joints=data.joints.astype(np.float32),
        held=data.held,
        overlapping=data.overlapping,
    )
    part.rename(path)
    return path


def read_grasps(path: Path) -> GraspData:
    """A file of `write_grasps`."""
    with np.load(path) as file:
        poses, joints = file["T_object_palm"].astype(np.float64), file["joints"].astype(np.float64)
        return GraspData(poses, joints, file["held"], file["overlapping"])
