"""Five-finger grasps of procedural objects, tried in physics: the training data of FFHNet.

An object stands on a table. The hand flies to a pose, closes, lifts, and is shaken. Poses come from
a random sampler (docs/simulation.md, "Known grasps") and from perturbing grasps that held. A pose
in which the open hand overlaps the object is a failure and is not tried. Later an evaluator also
learns from grasps that it would choose itself, because its mistakes are among the highest scores of
thousands of candidates, and from hands that are still short of those, because the score of the hand
as it is decides when the fingers close.
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

VERSION = 2  # of the sampling below; files of another version are made again
# standard deviations (m, rad) of the perturbations of grasps that held
NOISE_SCALES = ((0.003, np.radians(3)), (0.008, np.radians(8)), (0.016, np.radians(16)))
# of hands that have not arrived at a grasp yet:
APPROACH_M = (0.01, 0.10)  # m, least and greatest distance back along the fingers
APPROACH_SD = 0.008  # m, standard deviation on each axis, on top of that
APPROACH_RAD = np.radians(6)  # rad, standard deviation of the rotation on each axis
MIN_OVERLAP = 0.002  # m; a hand deeper in the object than this is in a pose no robot can be in
# m; a proposed hand may penetrate object or table by this much, as a hand does that arrives
MAX_PENETRATION = 0.004
PROPOSED_VIEWS = 8  # per object, for which a generator's proposals are tried
MAX_CANDIDATES = 15_000  # random candidates per object
CHOSEN_VIEWS = 8  # per object, for which an evaluator's choices are tried
CHOSEN_DRAWS = 8  # times 256 candidates per view, which the evaluator chooses from
BEST_SCORED = 300  # candidates with the highest scores; the free ones among them may be chosen
# hands short of a chosen grasp:
SHORT_M = (0.005, 0.08)  # m, least and greatest distance back along the fingers
SHORT_SD = 0.004  # m, standard deviation on each axis, on top of that
SHORT_RAD = np.radians(4)  # rad, standard deviation of the rotation on each axis
SHORT_OF_HELD = 2  # tries short of a choice that held; of any other one


@dataclass(frozen=True)
class GraspData:
    """Tried grasps of one object.

    - T_object_palm (n, 4, 4), m.
    - joints (n, 15): before closing, rad.
    - held (n,): whether the hand held the object through lift and shake.
    - overlapping (n,): whether the hand before closing lay in object or table; not tried.
    """

    T_object_palm: Array
    joints: Array
    held: NDArray[np.bool_]
    overlapping: NDArray[np.bool_]


def make_grasps(object_model: ObjectModel, seed: int, tried: int) -> GraspData:
    """Try about `tried` grasps of an object: a third random, the others near those that held.

    Besides these come overlapping hands, and hands that have not arrived yet at a grasp that held.
    """
    world = FlyingHand(object_model)
    T_object_base = invert(at(0.5, 0.0, object_model.rest_height()))
    rows: list[tuple[Array, Array, bool, bool]] = []

    def attempt(T: Array, preshape: Array) -> bool:
        world.put(T, preshape)
        held = world.lifts(preshape, shake=True)
        rows.append((T, preshape, held, False))
        return held

    held_grasps: list[tuple[Array, Array]] = []
    overlaps = 0
    for k in range(MAX_CANDIDATES):
        if len(rows) - overlaps >= tried // 3:
            break
        T, preshape = candidate(generator(seed, f"grasps/{object_model.name}", k), object_model)
        world.put(T, preshape)
        if world.touches():
            if overlaps < tried // 4 and world.penetration() > MIN_OVERLAP:
                rows.append((T, preshape, False, True))
                overlaps += 1
            continue
        if attempt(T, preshape):
            held_grasps.append((T, preshape))
    k = 0
    while held_grasps and len(rows) - overlaps < tried and k < 20 * tried:
        rng = generator(seed, f"perturbed/{object_model.name}", k)
        T, preshape = held_grasps[int(rng.integers(len(held_grasps)))]
        metres, radians = NOISE_SCALES[k % len(NOISE_SCALES)]
        T = T @ increment(np.concatenate([rng.normal(0, metres, 3), rng.normal(0, radians, 3)]))
        k += 1
        world.put(T, preshape)
        if world.touches():
            if overlaps < tried // 2 and world.penetration() > MIN_OVERLAP:
                rows.append((T, preshape, False, True))
                overlaps += 1
        elif attempt(T, preshape):
            held_grasps.append((T, preshape))
    for k in range(5 * tried // 8 if held_grasps else 0):
        T, preshape = partway_grasp(
            held_grasps, generator(seed, f"approach/{object_model.name}", k)
        )
        world.put(T, preshape)
        if not world.touches():
            attempt(T, preshape)
    return GraspData(
        np.array([T_object_base @ T @ HAND.T_hand_palm for T, _, _, _ in rows]),
        np.array([p for _, p, _, _ in rows]),
        np.array([h for _, _, h, _ in rows]),
        np.array([o for _, _, _, o in rows]),
    )


def partway_grasp(
    held_grasps: list[tuple[Array, Array]], rng: np.random.Generator
) -> tuple[Array, Array]:
    """T_base_hand (4, 4) and joints (15,) of a hand on its way to one of the grasps that held.

    Closing there is too early.
    """
    T, preshape = held_grasps[int(rng.integers(len(held_grasps)))]
    return T @ drawn_back(rng, APPROACH_M, APPROACH_SD, APPROACH_RAD), preshape


def drawn_back(
    rng: np.random.Generator, distance: tuple[float, float], sd: float, sd_rad: float
) -> Array:
    """T_hand_back (4, 4): a hand moved back along its fingers by a uniform distance, m.

    sd (m) and sd_rad (rad): standard deviations of a disturbance on each axis, on top of that.
    """
    metres = rng.normal(0, sd, 3)
    metres[2] -= rng.uniform(*distance)  # the hand's z runs along its fingers
    return increment(np.concatenate([metres, rng.normal(0, sd_rad, 3)]))


def try_proposed(
    object_model: ObjectModel, network: FFHGenerator, seed: int, tried: int
) -> GraspData:
    """Try a generator's proposals for views of an object, about `tried` in all.

    An evaluator will have to tell these apart. A hand that penetrates object or table by up to
    MAX_PENETRATION is tried: the contact pushes as it would in an approach. A deeper one is a
    failure and is not tried.
    """
    world = FlyingHand(object_model)
    views = views_of(object_model, PROPOSED_VIEWS, network.dec_bn1.num_features, seed + 1)
    poses, joints, held, overlapping = [], [], [], []
    for k, view in enumerate(views):
        bps = torch.from_numpy(view.bps)[None]
        T_view_palm, drawn = draw(
            bps, network, -(-tried // PROPOSED_VIEWS), seed, f"proposed/{object_model.name}", k
        )
        for T, q in zip(invert(view.T_view_object) @ T_view_palm, drawn, strict=True):
            world.put_palm(T, q)
            deep = world.penetration(anything=True) > MAX_PENETRATION
            poses.append(T)
            joints.append(q)
            overlapping.append(deep)
            held.append(not deep and world.lifts(q, shake=True))
    return GraspData(np.array(poses), np.array(joints), np.array(held), np.array(overlapping))


def holds(world: FlyingHand, T_object_palm: Array, joints: Array) -> bool:
    """Whether a hand put at T_object_palm (4, 4) holds the object through lift and shake.

    A hand deeper than MAX_PENETRATION in object or table does not hold. A view does not show an
    object's far side, so many hands that look free lie in it; physics alone would push them out and
    lift.
    """
    world.put_palm(T_object_palm, joints)
    return world.penetration(anything=True) <= MAX_PENETRATION and world.lifts(joints, shake=True)


def free_on_table(
    object_model: ObjectModel, T_cloud_object: Array, cloud: EncodedCloud, candidates: Candidates
) -> NDArray[np.bool_]:
    """Which candidates (n,) penetrate neither a standing object's cloud nor its table too deep.

    The limit is MAX_PENETRATION.
    """
    normal = T_cloud_object[:3, 2]
    support = normal, float(normal @ T_cloud_object[:3, 3]) - object_model.rest_height()
    return free_of(cloud, candidates.T_cloud_palm, candidates.joints, support, MAX_PENETRATION)


def try_selected(
    object_model: ObjectModel, networks: Networks, seed: int, views: int, draws: int = 1
) -> tuple[list[EncodedCloud], Array, Array, Array, NDArray[np.bool_]]:
    """Try the grasps that an evaluator would choose for views of an object.

    Each view has draws x 256 candidates. Of the BEST_SCORED that are free, the four best and four
    random others are tried. Returns the cloud of each grasp; T_cloud_palm (n, 4, 4); T_object_palm
    (n, 4, 4); joints (n, 15) rad; held (n,).
    """
    world = FlyingHand(object_model)
    surface = surface_points(
        object_model, 12_000, generator(seed, f"selected/{object_model.name}", 0)
    )
    clouds, poses, in_object, joints, held = [], [], [], [], []
    for k in range(views):
        rng = generator(seed, f"selected view/{object_model.name}", k)
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
        free = order[free_on_table(object_model, T_cloud_object, cloud, top)]
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


def try_short(object_model: ObjectModel, chosen: GraspData, seed: int) -> GraspData:
    """Try hands 5 to 80 mm short of an evaluator's choices.

    Closing there is too early for most of them; some hold all the same.
    """
    world = FlyingHand(object_model)
    poses, joints, held = [], [], []
    for k, (T, q, was_held) in enumerate(
        zip(chosen.T_object_palm, chosen.joints, chosen.held, strict=True)
    ):
        rng = generator(seed, f"short/{object_model.name}", k)
        for _ in range(SHORT_OF_HELD if was_held else 1):
            back = drawn_back(rng, SHORT_M, SHORT_SD, SHORT_RAD)
            short = T @ invert(HAND.T_hand_palm) @ back @ HAND.T_hand_palm
            poses.append(short)
            joints.append(q)
            held.append(holds(world, short, q))
    return GraspData(
        np.reshape(poses, (-1, 4, 4)),
        np.reshape(joints, (-1, 15)),
        np.array(held, bool),
        np.zeros(len(held), np.bool_),
    )


def write_grasps(
    index: int,
    out: Path,
    seed: int,
    tried: int,
    weights: Path | None = None,
    evaluator: Path | None = None,
    chosen: Path | None = None,
) -> Path:
    """Write tried grasps of procedural object `index` to OUT/<object>.npz; returns the path.

    A finished file of the same settings is kept. weights: file of a generator; its proposals are
    tried instead of sampled grasps. evaluator: file of an evaluator; with `weights`, its choices
    are tried. chosen: folder of such choices; with `evaluator`, hands short of them are tried.
    """
    limit_threads()
    out.mkdir(parents=True, exist_ok=True)
    object_model = procedural_object(index, seed)
    path = out / f"{object_model.name}.npz"
    about = (
        f"dgeval {__version__} grasps {VERSION} mujoco {mujoco.__version__} "
        f"seed {seed} tried {tried}"
    )
    if weights is not None:
        about += f" proposed by {sha256_of(weights)}"
    if evaluator is not None:
        about += f" chosen by {sha256_of(evaluator)}"
    if chosen is not None:
        about += " short of them"
    if path.is_file() and str(np.load(path)["about"]) == about:
        return path
    if chosen is not None:
        data = try_short(object_model, read_grasps(chosen / path.name), seed)
    elif weights is None:
        data = make_grasps(object_model, seed, tried)
    elif evaluator is None:
        data = try_proposed(object_model, load_generator(weights), seed, tried)
    else:
        networks = Networks(load_generator(weights), load_evaluator(evaluator), upright=True)
        _, _, T, joints, held = try_selected(
            object_model, networks, seed, CHOSEN_VIEWS, CHOSEN_DRAWS
        )
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
    """Read a file of `write_grasps`."""
    with np.load(path) as file:
        poses, joints = file["T_object_palm"].astype(np.float64), file["joints"].astype(np.float64)
        return GraspData(poses, joints, file["held"], file["overlapping"])
