"""VFAS-Grasp (section III): candidates round a seed grasp, their score, the region that adapts, and the pre-grasp logic.

One iteration: the seed moves with what moves near it, candidates are drawn round it and scored, the best one, low-passed,
is the next seed. The goal is the pre-grasp pose until that has been held; then the grasp, open loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from dgeval.config import VfasConfig
from dgeval.determinism import generator
from dgeval.geometry import Array, rotation_angle
from dgeval.networks.point_sets import crop
from dgeval.networks.pointnet2 import CROP_HIGH, CROP_LOW, GraspEvaluator
from dgeval.planning.vfas.one_euro import PoseFilter
from dgeval.robots.hand import hand_for

REACH = 0.20  # m about the seed, of the points that any candidate's crop may hold
MOST_POINTS = 12_000
LEAST_POINTS = 30  # in a crop; fewer are no scene to judge
# of 6-DoF GraspNet: the gripper's control points in its own base frame, which lies this far behind our grasp frame
CONTROL_POINTS = np.array(
    [[0, 0, 0], [0, 0, 0], [0.05269, -0.00006, 0.07527], [-0.05269, 0.00006, 0.07527], [0.05269, -0.00006, 0.10527],
     [-0.05269, 0.00006, 0.10527]]
)  # fmt: skip
PANDA_BEHIND = 0.0953  # m


def perturbed(T_seed: Array, half: Array, angle: float, rng: np.random.Generator) -> Array:
    """T_seed (n, 4, 4) right-multiplied by uniform motions: ±half (3,) m, pitch (about y) and yaw (about z) ±angle rad.

    Roll, about the closing axis x, stays; R = Rz(yaw) Ry(pitch) (PAPERS B4).
    """
    n = len(T_seed)
    moves = np.tile(np.eye(4), (n, 1, 1))
    moves[:, :3, 3] = rng.uniform(-1, 1, (n, 3)) * half
    moves[:, :3, :3] = Rotation.from_euler("ZY", rng.uniform(-angle, angle, (n, 2))).as_matrix()
    return np.asarray(T_seed @ moves)


def distances(T_seed: Array, T: Array) -> tuple[Array, Array]:
    """T (n,) m and R (n,) rad of equation 1: translation and rotation between the seed (4, 4) and candidates (n, 4, 4)."""
    turned = np.swapaxes(T_seed[:3, :3][None], 1, 2) @ T[:, :3, :3]
    cosine = np.clip((np.trace(turned, axis1=1, axis2=2) - 1) / 2, -1, 1)
    return np.linalg.norm(T[:, :3, 3] - T_seed[:3, 3], axis=1), np.arccos(cosine)


@dataclass(frozen=True)
class Scores:
    """Of candidates (n,): S of equation 1, mean quality, spread of the quality under noise (nan where it was not tried)."""

    score: Array
    quality: Array
    spread: Array


def gripper_points(n: int, rng: np.random.Generator) -> Array:
    """Points (n, 3) m on the links of VFAS-Grasp's open gripper, frame of grasps (its section III-B)."""
    points = hand_for("vfas").link_points
    assert points is not None
    return points(n, rng)


class GraspJudge:
    """Equation 1: quality by the network, its spread over noisy copies, and distance from the seed."""

    def __init__(self, network: GraspEvaluator, config: VfasConfig) -> None:
        self._network, self._config = network, config
        links = gripper_points(network.sizes.gripper, generator(0, "gripper points", 0))
        self._gripper = torch.from_numpy(links.astype(np.float32))[None]

    def quality(self, clouds: Sequence[Array], T_base_grasp: Array) -> Array:
        """Quality (k, n) of grasps (n, 4, 4) in each of k clouds (m, 3), base frame; 0 where nothing is near."""
        s = self._network.sizes
        if s.centre == "mean":
            return np.stack([self._about_the_mean(cloud, T_base_grasp) for cloud in clouds])
        T: Array = np.linalg.inv(T_base_grasp).astype(np.float64)
        cropped = [crop(cloud, T, CROP_LOW, CROP_HIGH, s.scene) for cloud in clouds]
        points, counts = (
            np.concatenate([c[0] for c in cropped]),
            np.concatenate([c[1] for c in cropped]),
        )
        out = np.zeros(len(points))
        able = np.flatnonzero(counts >= LEAST_POINTS)
        if len(able):
            out[able] = (
                self._network.success(torch.from_numpy(points[able]), self._gripper)
                .double()
                .numpy()
            )
        return out.reshape(len(clouds), -1)

    def _about_the_mean(self, cloud: Array, T_base_grasp: Array) -> Array:
        """As the public weights want it: one cloud about its mean, the gripper's control points in it."""
        if len(cloud) < LEAST_POINTS:
            return np.zeros(len(T_base_grasp))
        points = cloud[np.arange(self._network.sizes.scene) % len(cloud)]
        mean = points.mean(axis=0)
        tool = CONTROL_POINTS - [0, 0, PANDA_BEHIND]
        grippers = (
            tool @ np.swapaxes(T_base_grasp[:, :3, :3], 1, 2) + T_base_grasp[:, None, :3, 3] - mean
        )
        scene = np.tile((points - mean).astype(np.float32), (len(T_base_grasp), 1, 1))
        return (
            self._network.success(
                torch.from_numpy(scene), torch.from_numpy(grippers.astype(np.float32))
            )
            .double()
            .numpy()
        )

    def scores(
        self, cloud: Array, T_base_grasp: Array, T_seed: Array, rng: np.random.Generator
    ) -> Scores:
        """Scores of candidates. `all`: k noisy copies of every one, as the paper; `top8`: of the eight that lead without."""
        c = self._config
        metres, radians = distances(T_seed, T_base_grasp)
        penalty = c.k1 * metres + c.k2 * radians
        n = len(T_base_grasp)
        if c.noise_candidates == "all":
            chosen, quality = np.arange(n), np.zeros(n)
        else:
            quality = self.quality([cloud], T_base_grasp)[0]
            chosen = np.argsort(-(quality - penalty), kind="stable")[:8]
        # the same noise for all of them, so that what tells them apart is not its draw
        clouds = [cloud + rng.normal(0, c.noise, cloud.shape) for _ in range(c.copies)]
        noisy = self.quality(clouds, T_base_grasp[chosen])
        spread = np.full(n, np.nan)
        spread[chosen] = np.ptp(noisy, axis=0)
        quality[chosen] = noisy.mean(axis=0)
        # only those whose spread is known may be chosen
        score = np.where(
            np.isnan(spread), -np.inf, quality - penalty - c.k3 * np.nan_to_num(spread)
        )
        return Scores(score, quality, spread)


@dataclass(frozen=True)
class Selected:
    """One iteration: the seed after it and the goal, T_base_grasp; the best candidate's score, quality and spread.

    factor: of the region that was searched; n candidates; tracking: a good grasp has been found; execute: advance now.
    """

    T_base_seed: Array
    T_base_goal: Array
    score: float
    quality: float
    spread: float
    factor: float
    n: int
    tracking: bool
    execute: bool


class Vfas:
    """The planner's state through a trial. `searching`: the seed stays until a good grasp is found (handover)."""

    def __init__(
        self,
        judge: GraspJudge,
        config: VfasConfig,
        seed: int,
        T_base_seed: Array,
        searching: bool = False,
    ) -> None:
        self._judge, self._config, self._seed = judge, config, seed
        self.T_base_seed = T_base_seed
        self.tracking = not searching
        self.factor = 1.0
        self._held = 0
        self._final: Array | None = None
        self._filter = PoseFilter(config.filter)

    def step(
        self,
        iteration: int,
        seconds: float,
        cloud: Array,
        velocity: Array | None,
        T_base_hand: Array | None,
    ) -> Selected:
        """One iteration, `seconds` after the one before it.

        cloud (m, 3): what the wrist camera sees, base frame. velocity (3,) m/s: of the motion field, None where it has none.
        T_base_hand: the gripper's grasp frame now.
        """
        c = self._config
        if self._final is not None or not c.refine:
            return self._as_it_is(T_base_hand)
        if velocity is not None and c.motion_field and self.tracking:
            self.T_base_seed = self.T_base_seed.copy()
            self.T_base_seed[:3, 3] += velocity * seconds
            self._filter.shift(velocity * seconds)
        rng = generator(self._seed, "vfas", iteration)
        near = cloud[
            ((cloud - self.T_base_seed[:3, 3]) ** 2).sum(axis=1) < (REACH + 0.02 * self.factor) ** 2
        ]
        near = near[rng.permutation(len(near))[:MOST_POINTS]]
        factor, n = self.factor, round(c.candidates * self.factor)
        half, angle = np.full(3, c.half_width * factor), np.radians(c.half_angle) * factor
        candidates = perturbed(np.tile(self.T_base_seed, (n, 1, 1)), half, angle, rng)
        if c.keep_seed:
            candidates[0] = self.T_base_seed
        scores = self._judge.scores(near, candidates, self.T_base_seed, rng)
        best = int(np.argmax(scores.score))
        good = float(scores.score[best]) > c.good_score
        if c.adaptive:
            self.factor = 1.0 if good else min(c.most_factor, c.factor * factor)
        self.tracking = self.tracking or good
        if self.tracking and len(near) >= LEAST_POINTS:
            T = candidates[best]
            self.T_base_seed = self._filter.step(T, seconds) if c.low_pass else T
        goal = self._goal(T_base_hand, good)
        return Selected(
            self.T_base_seed, goal, float(scores.score[best]), float(scores.quality[best]), float(scores.spread[best]),
            factor, n, self.tracking, self._final is not None,
        )  # fmt: skip

    def _as_it_is(self, T_base_hand: Array | None) -> Selected:
        """No sampling: the last advance, which is open loop, and the baseline, whose seed is executed as it was given."""
        nan = float("nan")
        goal = self._goal(T_base_hand, True) if self._final is None else self._final
        return Selected(
            self.T_base_seed, goal, nan, nan, nan, 1.0, 0, True, self._final is not None
        )

    def _goal(self, T_base_hand: Array | None, good: bool) -> Array:
        """The pre-grasp pose; the grasp, for good, once that has been held."""
        goal = self.T_base_seed.copy()
        goal[:3, 3] -= self._config.pregrasp * goal[:3, 2]
        if not self._hold(goal, T_base_hand, good):
            return goal
        self._final = self.T_base_seed
        return self._final

    def _hold(self, T_base_pregrasp: Array, T_base_hand: Array | None, good: bool) -> bool:
        """Whether the pre-grasp pose of a good grasp has been tracked within tolerance for so many iterations (PAPERS B9)."""
        c = self._config
        within = (
            T_base_hand is not None
            and good
            and float(np.linalg.norm(T_base_hand[:3, 3] - T_base_pregrasp[:3, 3])) < c.hold_distance
            and rotation_angle(T_base_hand[:3, :3].T @ T_base_pregrasp[:3, :3])
            < np.radians(c.hold_angle)
        )
        self._held = self._held + 1 if within else 0
        return self._held >= c.hold_iterations
