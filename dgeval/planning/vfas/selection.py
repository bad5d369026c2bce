"""VFAS-Grasp (docs/papers.md, "VFAS-Grasp"): candidates near a seed grasp, their score, the
adaptive region, pre-grasp.

In one iteration the seed moves with the motion field, candidates are drawn near it and scored, and
the best one, low-passed, becomes the next seed. The goal is the pre-grasp pose until the gripper
has held it; then it is the grasp, open loop.
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
from dgeval.planning.vfas.gripper import Gripper, trained_gripper
from dgeval.planning.vfas.one_euro import PoseFilter

REACH = 0.20  # m; points this near to the seed can lie in a candidate's crop
MOST_POINTS = 12_000  # points of the cloud near the seed that are used
LEAST_POINTS = 30  # points in a crop; with fewer the quality is 0
# m; the Panda's control points in its base frame, of 6-DoF GraspNet (docs/papers.md, "Grasp
# evaluator")
CONTROL_POINTS = np.array(
    [
        [0, 0, 0],
        [0, 0, 0],
        [0.05269, -0.00006, 0.07527],
        [-0.05269, 0.00006, 0.07527],
        [0.05269, -0.00006, 0.10527],
        [-0.05269, 0.00006, 0.10527],
    ]
)
PANDA_BEHIND = 0.0953  # m from that base frame forward to our grasp frame


def perturbed(T_seed: Array, half: Array, angle: float, rng: np.random.Generator) -> Array:
    """T_seed (n, 4, 4) right-multiplied by uniformly drawn motions.

    Position within ±half (3,) m, pitch (about y) and yaw (about z) within ±angle rad. Roll, about
    the closing axis x, stays: R = Rz(yaw) Ry(pitch) (docs/papers.md, "Axes of the perturbation").
    """
    n = len(T_seed)
    moves = np.tile(np.eye(4), (n, 1, 1))
    moves[:, :3, 3] = rng.uniform(-1, 1, (n, 3)) * half
    moves[:, :3, :3] = Rotation.from_euler("ZY", rng.uniform(-angle, angle, (n, 2))).as_matrix()
    return np.asarray(T_seed @ moves)


def distances(T_seed: Array, T: Array) -> tuple[Array, Array]:
    """Translation (n,) m and rotation (n,) rad from a seed (4, 4) to candidates (n, 4, 4).

    T and R of equation 1.
    """
    turned = np.swapaxes(T_seed[:3, :3][None], 1, 2) @ T[:, :3, :3]
    cosine = np.clip((np.trace(turned, axis1=1, axis2=2) - 1) / 2, -1, 1)
    return np.linalg.norm(T[:, :3, 3] - T_seed[:3, 3], axis=1), np.arccos(cosine)


@dataclass(frozen=True)
class Scores:
    """S of equation 1, mean quality and spread of the quality under noise, of candidates (n,).

    The spread is NaN and S is -inf for candidates that were not evaluated with noise.
    """

    score: Array
    quality: Array
    spread: Array


class GraspJudge:
    """Equation 1: the network's quality, its spread over noisy copies, distance from the seed.

    gripper: the one that the network is shown; default: the one of its training. Control points of
    the public weights stay a Panda's.
    """

    def __init__(
        self, network: GraspEvaluator, config: VfasConfig, gripper: Gripper | None = None
    ) -> None:
        self._network, self._config = network, config
        self.gripper = gripper or trained_gripper()
        links = self.gripper.points(network.sizes.gripper, generator(0, "gripper points", 0))
        self._gripper = torch.from_numpy(links.astype(np.float32))[None]

    def quality(self, clouds: Sequence[Array], T_base_grasp: Array) -> Array:
        """Quality (k, n) in 0..1 of grasps (n, 4, 4) in each of k clouds (m, 3) m, base frame.

        0 where fewer than LEAST_POINTS lie in the grasp's crop.
        """
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
        usable = np.flatnonzero(counts >= LEAST_POINTS)
        if len(usable):
            out[usable] = (
                self._network.success(torch.from_numpy(points[usable]), self._gripper)
                .double()
                .numpy()
            )
        return out.reshape(len(clouds), -1)

    def _about_the_mean(self, cloud: Array, T_base_grasp: Array) -> Array:
        """Quality (n,) by the public weights: cloud and control points with the mean subtracted."""
        if len(cloud) < LEAST_POINTS:
            return np.zeros(len(T_base_grasp))
        points = cloud[np.arange(self._network.sizes.scene) % len(cloud)]
        mean = points.mean(axis=0)
        control_points = CONTROL_POINTS - [0, 0, PANDA_BEHIND]
        grippers = (
            control_points @ np.swapaxes(T_base_grasp[:, :3, :3], 1, 2)
            + T_base_grasp[:, None, :3, 3]
            - mean
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
        """Scores of candidates (n, 4, 4).

        noise_candidates `all`: all are evaluated in noisy copies of the cloud, as in the paper;
        `top8`: only the eight that score best without noise and spread.
        """
        c = self._config
        metres, radians = distances(T_seed, T_base_grasp)
        penalty = c.k1 * metres + c.k2 * radians
        n = len(T_base_grasp)
        if c.noise_candidates == "all":
            chosen, quality = np.arange(n), np.zeros(n)
        else:
            quality = self.quality([cloud], T_base_grasp)[0]
            chosen = np.argsort(-(quality - penalty), kind="stable")[:8]
        # the same noise for all candidates, so that they don't differ by its draw
        clouds = [cloud + rng.normal(0, c.noise, cloud.shape) for _ in range(c.copies)]
        noisy = self.quality(clouds, T_base_grasp[chosen])
        spread = np.full(n, np.nan)
        spread[chosen] = np.ptp(noisy, axis=0)
        quality[chosen] = noisy.mean(axis=0)
        # only candidates with a known spread may be chosen
        score = np.where(
            np.isnan(spread), -np.inf, quality - penalty - c.k3 * np.nan_to_num(spread)
        )
        return Scores(score, quality, spread)


@dataclass(frozen=True)
class Selected:
    """Result of one iteration: the seed after it and the goal, T_base_grasp (4, 4).

    score, quality, spread: of the best candidate. factor: scale of the searched region. n: number
    of candidates. tracking: a good grasp has been found. execute: advance to the grasp now.
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
    """The planner and its state in a trial.

    searching: the seed stays where it is until a good grasp is found (handover).
    """

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
        """One iteration, `seconds` after the previous one.

        cloud (m, 3) m of the wrist camera, base frame. velocity (3,) m/s of the motion field, base
        frame, or None. T_base_hand (4, 4): the gripper's grasp frame now, or None.
        """
        c = self._config
        if self._final is not None or not c.refine:
            return self._unchanged(T_base_hand)
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
            self.T_base_seed,
            goal,
            float(scores.score[best]),
            float(scores.quality[best]),
            float(scores.spread[best]),
            factor,
            n,
            self.tracking,
            self._final is not None,
        )

    def _unchanged(self, T_base_hand: Array | None) -> Selected:
        """No sampling: the last, open-loop advance, or the baseline's given seed."""
        nan = float("nan")
        goal = self._goal(T_base_hand, True) if self._final is None else self._final
        return Selected(
            self.T_base_seed, goal, nan, nan, nan, 1.0, 0, True, self._final is not None
        )

    def _goal(self, T_base_hand: Array | None, good: bool) -> Array:
        """T_base_goal (4, 4): the pre-grasp pose; from when it has been held on, the grasp."""
        goal = self.T_base_seed.copy()
        goal[:3, 3] -= self._config.pregrasp * goal[:3, 2]
        asked = good if self._config.hold_needs_score else self.tracking
        if not self._hold(goal, T_base_hand, asked):
            return goal
        self._final = self.T_base_seed
        return self._final

    def _hold(self, T_base_pregrasp: Array, T_base_hand: Array | None, asked: bool) -> bool:
        """Whether the hand was at the pre-grasp pose for hold_iterations in a row.

        Within hold_distance m and hold_angle degrees (docs/papers.md, "Tolerance of the
        pre-grasp"). asked: an iteration counts otherwise; False starts again.
        """
        c = self._config
        within = (
            T_base_hand is not None
            and asked
            and float(np.linalg.norm(T_base_hand[:3, 3] - T_base_pregrasp[:3, 3])) < c.hold_distance
            and rotation_angle(T_base_hand[:3, :3].T @ T_base_pregrasp[:3, :3])
            < np.radians(c.hold_angle)
        )
        self._held = self._held + 1 if within else 0
        return self._held >= c.hold_iterations
