"""Grasps of the model cloud by FFHNet: scored candidates, and scores of any palm poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from dgeval.config import GraspsConfig
from dgeval.determinism import generator
from dgeval.errors import UsageError
from dgeval.geometry import Array
from dgeval.networks.bps import basis, encode
from dgeval.networks.checkpoints import shipped
from dgeval.networks.ffhnet import (
    N_JOINTS,
    FFHEvaluator,
    FFHGenerator,
    load_evaluator,
    load_generator,
    palms_of,
    poses_of,
)
from dgeval.planning.execution import PAPER_C_E
from dgeval.planning.hand_overlap import depth_below, overlap, standing_points
from dgeval.robots.hand import KnownHand, hand_for

# R_cloud_base for dgeval's own weights: they learned clouds with z down, whatever the camera's axes
UPRIGHT = np.diag([1.0, -1.0, -1.0])
OVERLAP_POINTS = 300  # points of a cloud that are tested for lying inside the hand
CHUNK = 32  # candidates whose overlap is calculated at a time
# factor on the allowed overlap for the grasp chosen before, so that noise of the cloud does not
# exclude it
KEPT_SLACK = 2.5
MOST_TRIED = 32  # candidates that the arm can't reach before the search ends without one
# threshold of the shipped evaluator, which says chances where the authors' is surer
# (dgeval/networks/weights/README.md)
SHIPPED_C_E = 0.4
PATH_STEPS = 3  # places tested on the path to a grasp


@dataclass(frozen=True)
class Networks:
    """Generator and evaluator with the same basis points, for one hand.

    upright: they learned clouds with z down; else clouds in the camera's axes, as the authors'.
    c_e: score of the hand above which to close, which belongs to the evaluator.
    """

    generator: FFHGenerator
    evaluator: FFHEvaluator
    upright: bool = False
    hand: KnownHand = field(default_factory=lambda: hand_for("ffhnet"))
    c_e: float = PAPER_C_E

    @property
    def n_bps(self) -> int:
        """Number of basis points."""
        return self.generator.dec_bn1.num_features

    def R_cloud_base(self, T_base_camera: Array) -> Array:
        """Rotation (3, 3) from the base frame, whose z is up, to the axes of the clouds."""
        return UPRIGHT if self.upright else T_base_camera[:3, :3].T


@dataclass(frozen=True)
class EncodedCloud:
    """The networks' input for a cloud: bps (1, n) m with the cloud's mean (3,) m subtracted.

    points (m, 3) m: a part of the cloud, and points below it inside what stands on the support;
    they are tested for lying inside `hand`. All in the axes of the cloud.
    """

    bps: torch.Tensor
    mean: Array
    points: Array
    hand: KnownHand


@dataclass(frozen=True)
class Candidates:
    """Grasps in the cloud's frame: T_cloud_palm (n, 4, 4), joints (n, 15) rad, scores (n,) in 0..1.

    joints: before closing. kept: the last one is the grasp chosen before.
    """

    T_cloud_palm: Array
    joints: Array
    scores: Array
    kept: bool = False


def networks_of(config: GraspsConfig) -> Networks:
    """The networks of a configuration, read once.

    UsageError if a file is missing or broken, or if the two have different numbers of basis points.
    """
    return _load(config.generator, config.evaluator)


@cache
def _load(generator_file: str | None, evaluator_file: str | None) -> Networks:
    own = shipped("ffhnet_generator.safetensors"), shipped("ffhnet_evaluator_fingers.safetensors")
    grasp_generator = load_generator(Path(generator_file) if generator_file else own[0])
    grasp_evaluator = load_evaluator(Path(evaluator_file) if evaluator_file else own[1])
    networks = Networks(
        grasp_generator,
        grasp_evaluator,
        grasp_evaluator.upright,
        c_e=PAPER_C_E if evaluator_file else SHIPPED_C_E,
    )
    n_evaluator = (
        grasp_evaluator.bn1.num_features - 12 - (N_JOINTS if grasp_evaluator.joints else 0)
    )
    if n_evaluator != networks.n_bps:
        message = f"the generator takes {networks.n_bps} basis points, the evaluator {n_evaluator}"
        raise UsageError(message, hint="give both of grasps.generator and grasps.evaluator")
    return networks


def encode_cloud(
    points: Array, networks: Networks, support: tuple[Array, float] | None = None
) -> EncodedCloud:
    """The networks' input for points (m, 3) m, in the axes that the networks learned.

    support: normal (3,) and offset m of the plane that the object stands on.
    """
    mean = points.mean(axis=0)
    bps = torch.from_numpy(encode(points - mean, basis(networks.n_bps)))[None]
    sampled = points[:: -(-len(points) // OVERLAP_POINTS)]
    return EncodedCloud(
        bps,
        mean,
        sampled
        if support is None
        else np.concatenate([sampled, standing_points(points, *support)]),
        networks.hand,
    )


def draw(
    bps: torch.Tensor, network: FFHGenerator, n: int, seed: int, stage: str, frame: int
) -> tuple[Array, Array]:
    """n grasps of a cloud, drawn by (seed, stage, frame) alone.

    Returns poses (n, 4, 4) with the cloud's mean as origin, and joints (n, 15) rad, clipped to
    their limits.
    """
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
    """n scored grasps of a cloud, the same for the same seed and frame; joints within their limits.

    kept (ours): T_cloud_palm (4, 4) and joints (15,) rad of the grasp chosen before, moved with the
    object. It stays among the candidates, as the last one. Without it the choice jumps by
    decimetres with the new draws of every frame, and the hand never arrives.
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
    """Allowed overlap (k,) m of rows (k,) of n candidates; `most` m for all but the kept one.

    kept: the last candidate is the grasp chosen before.
    """
    return np.where(kept & (rows == n - 1), KEPT_SLACK * most, most)


def free_of(
    cloud: EncodedCloud,
    T_cloud_palm: Array,
    joints: Array,
    support: tuple[Array, float] | None,
    most: float | Array,
) -> NDArray[np.bool_]:
    """Whether (n,) the preshaped hand penetrates cloud and support by `most` m at most.

    T_cloud_palm (n, 4, 4), joints (n, 15) rad, most: one value or (n,). support: normal (3,) and
    offset m of the plane, cloud's frame.
    """
    deep = overlap(cloud.points, T_cloud_palm, joints, cloud.hand)
    if support is not None:
        deep = np.maximum(deep, depth_below(*support, T_cloud_palm, joints, cloud.hand))
    return np.asarray(deep <= most)


def approach_free(
    cloud: EncodedCloud,
    T_cloud_palm: Array,
    joints: Array,
    palm_position: Array,
    support: tuple[Array, float] | None,
    config: GraspsConfig,
) -> bool:
    """Whether the preshaped hand is free at PATH_STEPS places over the last `way_m` before a grasp.

    T_cloud_palm (4, 4), joints (15,) rad; palm_position (3,) m, cloud's frame. The path
    is straight, with the grasp's orientation. Ours: without this test the hand pushes tall objects
    over on its path.
    """
    back = palm_position - T_cloud_palm[:3, 3]
    length = float(np.linalg.norm(back))
    if config.way_m == 0.0 or length < 1e-6:
        return True
    places = np.tile(T_cloud_palm, (PATH_STEPS, 1, 1))
    shares = np.minimum(np.arange(1, PATH_STEPS + 1) / PATH_STEPS * config.way_m, length) / length
    places[:, :3, 3] += shares[:, None] * back
    return bool(
        free_of(cloud, places, np.tile(joints, (PATH_STEPS, 1)), support, config.max_overlap).all()
    )


class Feasible:
    """Which candidates a robot could execute; each candidate is tested once, when it is asked for.

    free: rows (k,) -> whether (k,) the hand is free of the cloud there. reaches: row -> whether the
    arm reaches the pose.
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
        """First row of an order (n,) that is free and reachable.

        None if there is none, or after MOST_TRIED free rows that the arm can't reach.
        """
        tried = 0
        rows: list[int] = order.tolist()
        for position, row in enumerate(rows):
            if self._free is not None and row not in self._known_free:
                chunk = order[position : position + CHUNK]
                self._known_free.update(
                    zip(chunk.tolist(), self._free(chunk).tolist(), strict=True)
                )
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

    def refused(self) -> list[int]:
        """Rows that were found not free or not reached."""
        known = (self._known_free, self._known_reached)
        return [row for found in known for row, is_good in found.items() if not is_good]


def evaluate(cloud: EncodedCloud, networks: Networks, T_cloud_palm: Array, joints: Array) -> Array:
    """Scores (n,) of palm poses (n, 4, 4), cloud's frame.

    joints (n, 15) rad matter only to an evaluator that takes them.
    """
    T = T_cloud_palm.copy()
    T[:, :3, 3] -= cloud.mean
    with torch.inference_mode():
        scores = networks.evaluator(cloud.bps, palms_of(T, joints))
    return np.asarray(scores.double().numpy())
