"""Grasps of the model cloud by FFHNet: candidates with their scores, and the score of any palm pose (GraspEval)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from dgeval.config import GraspsConfig
from dgeval.determinism import generator
from dgeval.errors import UsageError
from dgeval.geometry import Array
from dgeval.networks.bps import basis, encode
from dgeval.networks.ffhnet import (
    N_JOINTS,
    FFHEvaluator,
    FFHGenerator,
    load_evaluator,
    load_generator,
    palms_of,
    poses_of,
)  # fmt: skip
from dgeval.planning.hand_overlap import depth_below, overlap, standing_points
from dgeval.robots.hand import Hand, hand_for

UPRIGHT = np.diag(
    [1.0, -1.0, -1.0]
)  # R_cloud_base of what dgeval's own weights learned: z down, whatever the camera's
OVERLAP_POINTS = 300  # of a cloud, in which overlaps are looked for
CHUNK = 32  # candidates whose overlap is calculated at a time
KEPT_SLACK = 2.5  # times the overlap allowed, for the grasp chosen last: a cloud's noise shall not take it away
MOST_TRIED = 32  # candidates out of the arm's reach, after which there is none
WAY_STEPS = 3


@dataclass(frozen=True)
class Networks:
    """Generator and evaluator of the same basis, for one hand.

    upright: they learned clouds whose z points down; else, as the authors', clouds with the axes of the camera.
    """

    generator: FFHGenerator
    evaluator: FFHEvaluator
    upright: bool = False
    hand: Hand = field(default_factory=lambda: hand_for("ffhnet"))

    @property
    def n_bps(self) -> int:
        return self.generator.dec_bn1.num_features

    def R_cloud_base(self, T_base_camera: Array) -> Array:
        """(3, 3): the axes that a cloud is to be given in. An upright base frame has its z up."""
        return UPRIGHT if self.upright else T_base_camera[:3, :3].T


@dataclass(frozen=True)
class EncodedCloud:
    """What the networks see of a cloud: bps (1, n) of it about its mean (3,) m, in the axes it was given in.

    points: some of it (m, 3), and of what stands under it, to look for overlaps with `hand`.
    """

    bps: torch.Tensor
    mean: Array
    points: Array
    hand: Hand


@dataclass(frozen=True)
class Candidates:
    """Grasps in the frame of the cloud: T_cloud_palm (n, 4, 4), joints before closing (n, 15) rad, scores (n,) in 0..1.

    kept: the last one is the grasp chosen before.
    """

    T_cloud_palm: Array
    joints: Array
    scores: Array
    kept: bool = False


def networks_of(config: GraspsConfig) -> Networks:
    """The networks of a configuration, read once. UsageError where files are missing, broken or of different bases."""
    return _load(config.generator, config.evaluator)


@cache
def _load(generator_file: str | None, evaluator_file: str | None) -> Networks:
    shipped = Path(str(resources.files("dgeval.networks") / "weights"))
    first = load_generator(
        Path(generator_file) if generator_file else shipped / "ffhnet_generator.safetensors"
    )
    second = load_evaluator(
        Path(evaluator_file) if evaluator_file else shipped / "ffhnet_evaluator_fingers.safetensors"
    )
    networks = Networks(first, second, second.upright)
    of_evaluator = second.bn1.num_features - 12 - (N_JOINTS if second.joints else 0)
    if of_evaluator != networks.n_bps:
        what = f"the generator takes {networks.n_bps} basis points, the evaluator {of_evaluator}"
        raise UsageError(what, hint="give both of grasps.generator and grasps.evaluator")
    return networks


def encode_cloud(
    points: Array, networks: Networks, support: tuple[Array, float] | None = None
) -> EncodedCloud:
    """points (m, 3) m with the axes that the networks learned; support: normal and offset of the plane they stand on."""
    mean = points.mean(axis=0)
    bps = torch.from_numpy(encode(points - mean, basis(networks.n_bps)))[None]
    some = points[:: -(-len(points) // OVERLAP_POINTS)]
    return EncodedCloud(
        bps,
        mean,
        some if support is None else np.concatenate([some, standing_points(points, *support)]),
        networks.hand,
    )


def draw(
    bps: torch.Tensor, network: FFHGenerator, n: int, seed: int, stage: str, frame: int
) -> tuple[Array, Array]:
    """n grasps of a cloud by (seed, stage, frame) alone: T (n, 4, 4) about its mean, joints (n, 15) within their limits."""
    draws = torch.Generator().manual_seed(int(generator(seed, stage, frame).integers(2**63)))
    palms = network.generate(bps, n, draws)
    return poses_of(palms), np.clip(palms.joints.double().numpy(), *hand_for("ffhnet").drive_limits)


def propose(
    cloud: EncodedCloud,
    networks: Networks,
    n: int,
    seed: int,
    frame: int,
    kept: tuple[Array, Array] | None = None,
) -> Candidates:
    """n grasps drawn for a cloud, the same for the same seed and frame, scored; joints within the hand's limits.

    kept: T_cloud_palm (4, 4) and joints (15,) of the grasp chosen before, where it is now: it stays in the choice, as the
    last one. Else a new draw in every frame lets the choice jump by decimetres and the hand never arrives (ours).
    """
    T, joints = draw(cloud.bps, networks.generator, n, seed, "grasps", frame)
    with torch.inference_mode():
        scores = networks.evaluator(cloud.bps, palms_of(T, joints))
    T[:, :3, 3] += cloud.mean
    out = Candidates(T, joints, scores.double().numpy())
    if kept is None:
        return out
    again = evaluate(cloud, networks, kept[0][None], kept[1][None])
    return Candidates(
        np.concatenate([out.T_cloud_palm, kept[0][None]]),
        np.concatenate([out.joints, kept[1][None]]),
        np.concatenate([out.scores, again]),
        kept=True,
    )


def overlap_allowed(rows: NDArray[np.intp], n: int, kept: bool, most: float) -> Array:
    """m, of rows (k,) of n candidates of which the last one may be the one chosen before."""
    return np.where(kept & (rows == n - 1), KEPT_SLACK * most, most)


def free_of(
    cloud: EncodedCloud,
    T_cloud_palm: Array,
    joints: Array,
    support: tuple[Array, float] | None,
    most: float | Array,
) -> NDArray[np.bool_]:
    """Whether the preshaped hand at poses (n, 4, 4) lies at most `most` m, (n,), deep in the cloud and below its support.

    support: normal (3,) and offset m of the plane in the cloud's frame.
    """
    deep = overlap(cloud.points, T_cloud_palm, joints, cloud.hand)
    if support is not None:
        deep = np.maximum(deep, depth_below(*support, T_cloud_palm, joints, cloud.hand))
    return np.asarray(deep <= most)


def way_free(
    cloud: EncodedCloud,
    T_cloud_palm: Array,
    joints: Array,
    hand: Array,
    support: tuple[Array, float] | None,
    config: GraspsConfig,
) -> bool:
    """Whether the preshaped hand is free at WAY_STEPS places over the last `way_m` before a grasp (4, 4), joints (15,).

    hand (3,) m: where the palm comes from, straight and turned as in the grasp already. Ours: without it the hand pushes
    tall things over on the way.
    """
    back = hand - T_cloud_palm[:3, 3]
    length = float(np.linalg.norm(back))
    if config.way_m == 0.0 or length < 1e-6:
        return True
    places = np.tile(T_cloud_palm, (WAY_STEPS, 1, 1))
    shares = np.minimum(np.arange(1, WAY_STEPS + 1) / WAY_STEPS * config.way_m, length) / length
    places[:, :3, 3] += shares[:, None] * back
    return bool(
        free_of(cloud, places, np.tile(joints, (WAY_STEPS, 1)), support, config.max_overlap).all()
    )


class Feasible:
    """Which of one set of candidates a robot could take, asked in the order of the metric and remembered.

    free: rows (k,) -> whether the hand there is free of the cloud (k,); reaches: row -> whether the arm gets there.
    """

    def __init__(
        self,
        free: Callable[[NDArray[np.intp]], NDArray[np.bool_]] | None,
        reaches: Callable[[int], bool] | None,
    ) -> None:
        self._free, self._reaches = free, reaches
        self._known_free: dict[int, bool] = {}
        self._known_reached: dict[int, bool] = {}

    def first(self, order: NDArray[np.intp]) -> int | None:
        """The first in an order that is both; None where none is, or after MOST_TRIED that can't be reached."""
        tried = 0
        rows: list[int] = order.tolist()
        for position, row in enumerate(rows):
            if self._free is not None and row not in self._known_free:
                some = order[position : position + CHUNK]
                self._known_free.update(zip(some.tolist(), self._free(some).tolist(), strict=True))
            if not self._known_free.get(row, True):
                continue
            if self._reaches is None:
                return row
            if row not in self._known_reached:
                self._known_reached[row] = self._reaches(row)
            if self._known_reached[row]:
                return row
            tried += 1
            if tried == MOST_TRIED:
                break
        return None


def evaluate(cloud: EncodedCloud, networks: Networks, T_cloud_palm: Array, joints: Array) -> Array:
    """Scores (n,) of palm poses (n, 4, 4) in the cloud's frame; joints (n, 15) matter to an evaluator with fingers only."""
    T = T_cloud_palm.copy()
    T[:, :3, 3] -= cloud.mean
    with torch.inference_mode():
        scores = networks.evaluator(cloud.bps, palms_of(T, joints))
    return np.asarray(scores.double().numpy())
