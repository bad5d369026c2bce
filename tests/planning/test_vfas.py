"""Catches: a filter, network, sampling, motion field or planner that is not VFAS-Grasp's.

Each is tested against closed forms, the authors' numbers or a reference written in numpy.
"""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from dgeval.config import OneEuroConfig, VfasConfig, load_config
from dgeval.errors import DgevalError
from dgeval.geometry import Intrinsics, increment, rotation_angle
from dgeval.networks.checkpoints import read_weights
from dgeval.networks.point_sets import crop, farthest_points, neighbours_in_ball
from dgeval.networks.pointnet2 import VFAS, GraspEvaluator, Sizes, load_evaluator
from dgeval.planning.vfas.loop import VfasLoop, evaluator_of, proportional_twist
from dgeval.planning.vfas.motion_field import MotionField, dis_flow
from dgeval.planning.vfas.one_euro import OneEuroFilter, PoseFilter
from dgeval.planning.vfas.selection import GraspJudge, Vfas, distances, perturbed
from dgeval.robots.parallel_jaw import DISTAL, OPENING, PROXIMAL, link_points

# the 1 euro filter


def test_filter_gives_the_authors_vector() -> None:
    """Catches a speed against the raw value, a wrong alpha, and beta on the signed speed."""
    folder = os.environ.get("DGEVAL_REAL_DATA")
    if not folder or not (Path(folder) / "oneeuro_vector.csv").is_file():
        pytest.skip("the author's vector is not here: DGEVAL_REAL_DATA")
    rows = np.loadtxt(Path(folder) / "oneeuro_vector.csv", delimiter=",", skiprows=1)
    one = OneEuroFilter(1.0, 0.1, 1.0)
    out = []
    for k, (t, _, noisy, _) in enumerate(rows):
        # the author's code takes a stamp of exactly 0 as missing, so the second sample uses the
        # stated 120 Hz
        seconds = 1 / 120 if k < 2 else t - rows[k - 1, 0]
        out.append(float(one.step(np.array(noisy), seconds)))
    assert len(out) == 1200
    assert np.abs(np.array(out) - rows[:, 3]).max() < 5e-5


def test_pose_filter_keeps_a_still_pose_and_lags_a_step() -> None:
    """Catches a slerp in the wrong direction, and a rotation that is not filtered."""
    still = PoseFilter(OneEuroConfig())
    T = increment(np.array([0.1, 0.2, 0.3, 0.2, -0.4, 0.1]))
    for _ in range(5):
        assert np.allclose(still.step(T, 0.05), T, atol=1e-12)
    turned = T @ increment(np.array([0.01, 0, 0, 0, 0, 0.2]))
    after = still.step(turned, 0.05)
    assert 0.01 < rotation_angle(T[:3, :3].T @ after[:3, :3]) < 0.19
    assert 0.001 < np.linalg.norm(after[:3, 3] - T[:3, 3]) < 0.0099


# the network


def test_farthest_points_start_at_zero_and_skip_the_origin() -> None:
    """Catches a random start, and the guard left out or applied to every point."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.1, 0.1, (3, 200, 3)).astype(np.float32)
    chosen = farthest_points(points, 20, 1e-3)
    for p, c in zip(points, chosen, strict=True):
        selectable = (p**2).sum(axis=1) > 1e-3
        assert c[0] == 0
        nearest = np.full(200, np.inf)
        for a, b in pairwise(c):
            nearest = np.minimum(nearest, ((p - p[a]) ** 2).sum(axis=1))
            assert selectable[b]
            assert nearest[b] == pytest.approx(nearest[selectable].max(), rel=1e-4)


def test_neighbours_are_the_first_in_order_and_filled_up() -> None:
    """Catches the nearest points instead of the first, <= instead of <, and an empty ball that
    isn't index 0.
    """
    points = np.array([[[0.0, 0, 0], [0.02, 0, 0], [0.005, 0, 0], [0.001, 0, 0]]], dtype=np.float32)
    centres = np.array([[[0.0, 0, 0], [5.0, 0, 0]]], dtype=np.float32)
    near = neighbours_in_ball(points, centres, 0.02, 2)[0]
    assert near[0].tolist() == [0, 2]
    assert neighbours_in_ball(points, centres, 0.02, 5)[0, 0].tolist() == [0, 2, 3, 0, 0]
    assert near[1].tolist() == [0, 0]


def test_crop_is_in_the_grasp_frame() -> None:
    """Catches an inverted transform, and a box other than the paper's."""
    T = increment(np.array([0.3, -0.1, 0.2, 0.4, 0.2, -1.0]))
    local = np.array(
        [
            [0.09, 0.04, -0.09],
            [0.11, 0, 0],
            [0, 0.06, 0],
            [0, 0, 0.04],
            [0, 0, -0.11],
            [-0.09, -0.04, 0.02],
        ]
    )
    cloud = local @ T[:3, :3].T + T[:3, 3]
    points, counts = crop(
        cloud, np.linalg.inv(T)[None], np.array([-0.1, -0.05, -0.1]), np.array([0.1, 0.05, 0.03]), 4
    )
    assert counts[0] == 2
    assert np.allclose(points[0], local[[0, 5, 0, 5]], atol=1e-6)


def reference(
    network: GraspEvaluator, scene: np.ndarray, gripper: np.ndarray
) -> tuple[float, float]:
    """Logit and confidence of one grasp in plain numpy, from docs/papers.md, "Grasp evaluator".

    Relative coordinates are formed, no layer is factored, and no norm is folded into a layer.
    """
    s = network.sizes
    w = {k: v.double().numpy() for k, v in network.state_dict().items()}

    def normed(x: np.ndarray, key: str) -> np.ndarray:
        scale = w[f"{key}.weight"] / np.sqrt(w[f"{key}.running_var"] + 1e-5)
        return (x - w[f"{key}.running_mean"]) * scale + w[f"{key}.bias"]

    def abstraction(x: np.ndarray, k: int) -> np.ndarray:
        for layer in range(3):
            key = f"evaluator.0.{k}.mlps.0"
            x = np.maximum(
                normed(x @ w[f"{key}.{3 * layer}.weight"][:, :, 0, 0].T, f"{key}.{3 * layer + 1}"),
                0,
            )
        return x.max(axis=-2)

    xyz = np.concatenate([scene, gripper]).astype(np.float32)
    label = (1.0, 0.0) if s.labels == "jsll" else (0.0, 1.0)
    features = np.column_stack([xyz, np.repeat(label, [len(scene), len(gripper)])])
    for k in range(2):
        centres = xyz[farthest_points(xyz[None], s.centres[k], s.skipped)[0]]
        near = neighbours_in_ball(xyz[None], centres[None], s.radii[k], s.neighbours[k])[0]
        grouped = np.concatenate([xyz[near] - centres[:, None], features[near]], axis=2)
        xyz, features = centres, abstraction(grouped, k)
    x = abstraction(np.column_stack([xyz, features]), 2)
    for a, b in ((0, 1), (3, 4)):
        x = np.maximum(
            normed(
                w[f"evaluator.1.{a}.weight"] @ x + w[f"evaluator.1.{a}.bias"], f"evaluator.1.{b}"
            ),
            0,
        )
    logit = w["predictions_logits.weight"] @ x + w["predictions_logits.bias"]
    sure = w["confidence.weight"] @ x + w["confidence.bias"]
    return float(logit[0]), float(1 / (1 + np.exp(-sure[0])))


def with_random_weights(sizes: Sizes | None = None) -> GraspEvaluator:
    """The network with random weights and running statistics, far from their initial values.

    The weights are so large that every input changes the output.
    """
    torch.manual_seed(3)
    network = GraspEvaluator(sizes) if sizes is not None else GraspEvaluator()
    for module in network.evaluator.modules():
        if isinstance(module, torch.nn.Conv2d | torch.nn.Linear):
            torch.nn.init.normal_(module.weight, std=float(2 / module.weight.shape[1] ** 0.5))
        if isinstance(module, torch.nn.BatchNorm1d | torch.nn.BatchNorm2d):
            assert module.running_mean is not None
            assert module.running_var is not None
            module.running_mean.uniform_(-0.1, 0.1)
            module.running_var.uniform_(0.5, 1.5)
            torch.nn.init.uniform_(module.weight, 0.5, 1.5)
            torch.nn.init.uniform_(module.bias, -0.2, 0.2)
    return network.eval()


@pytest.mark.parametrize("sizes", [None, VFAS])
def test_network_is_the_published_one(sizes: Sizes | None) -> None:
    """Catches swapped labels, absolute coordinates, a norm folded wrongly, and a centre subtracted
    twice.
    """
    network = with_random_weights(sizes)
    rng = np.random.default_rng(1)
    scene = rng.uniform(-0.06, 0.06, (2, network.sizes.scene, 3)).astype(np.float32)
    scene[1] *= 0.6
    gripper = rng.uniform(-0.05, 0.05, (2, network.sizes.gripper, 3)).astype(np.float32)
    with torch.no_grad():
        logits, sure = network(torch.from_numpy(scene), torch.from_numpy(gripper))
    # a network with the same output for all inputs would prove nothing
    assert abs(float(logits[0] - logits[1])) > 0.02
    for k in range(2):
        logit, confidence = reference(network, scene[k], gripper[k])
        assert float(logits[k, 0]) == pytest.approx(logit, abs=1e-4)
        assert float(sure[k, 0]) == pytest.approx(confidence, abs=1e-4)


def test_public_checkpoint_loads_strictly(tmp_path: Path) -> None:
    """Catches another number of keys (72) or parameters (1.926 M) than the public network has, and
    a wrong file that is accepted or not named by its first missing key.
    """
    network = with_random_weights()
    state = network.state_dict()
    assert len(state) == 72
    assert sum(p.numel() for p in network.parameters()) == 1_926_210
    path = tmp_path / "latest_net.pth"
    torch.save({"epoch": 3, "model_state_dict": state, "optimizer_state_dict": {"lr": 0.1}}, path)
    loaded = load_evaluator(path)
    assert all(
        torch.equal(a, b) for a, b in zip(loaded.state_dict().values(), state.values(), strict=True)
    )
    del state["evaluator.0.1.mlps.0.3.weight"]
    torch.save({"model_state_dict": state}, path)
    with pytest.raises(DgevalError, match=r"evaluator\.0\.1\.mlps\.0\.3\.weight is missing"):
        load_evaluator(path)


def test_training_and_use_agree() -> None:
    """Catches an eval mode that differs from training mode with frozen norms."""
    network = with_random_weights(VFAS)
    rng = np.random.default_rng(2)
    scene = torch.from_numpy(rng.uniform(-0.05, 0.05, (3, 512, 3)).astype(np.float32))
    gripper = torch.from_numpy(link_points(64, rng).astype(np.float32)).expand(3, -1, -1)
    used = network(scene, gripper)[0]
    for stage in network.evaluator[0]:  # type: ignore[union-attr]
        stage.train()
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.eval()
    assert torch.allclose(network(scene, gripper)[0], used, atol=1e-4)


def test_shipped_weights_are_small_and_say_their_sizes() -> None:
    """Catches shipped weights of over 4 MB, without their sizes, or of another network."""
    path = (
        Path(__file__).parents[2] / "dgeval" / "networks" / "weights" / "vfas_evaluator.safetensors"
    )
    assert path.stat().st_size < 4e6
    assert load_evaluator(path).sizes == VFAS
    assert len(read_weights(path)) == 72


def test_gripper_points_lie_on_its_links() -> None:
    """Catches points inside the links or off them."""
    points = link_points(400, np.random.default_rng(0))
    points[:, 0] = np.abs(points[:, 0]) - OPENING / 2
    faces = np.zeros(400, int)
    for half, centre in (DISTAL, PROXIMAL):
        off = np.abs(points - np.array(centre)) / np.array(half)
        faces += ((off < 1 + 1e-9).all(axis=1) & np.isclose(off.max(axis=1), 1)).astype(int)
    assert (faces > 0).all()


# sampling and score


def test_candidates_keep_roll_and_stay_in_the_region() -> None:
    """Catches a multiplication from the left, a roll that changes, and radians for degrees."""
    T = increment(np.array([0.4, 0.1, 0.3, 1.0, -0.5, 2.0]))
    moved = perturbed(
        np.tile(T, (500, 1, 1)),
        np.array([0.02, 0.02, 0.02]),
        np.radians(5),
        np.random.default_rng(0),
    )
    local = np.linalg.inv(T) @ moved
    assert np.abs(local[:, :3, 3]).max() <= 0.02
    assert np.abs(local[:, :3, 3]).max(axis=0).min() > 0.018
    from scipy.spatial.transform import Rotation

    angles = np.degrees(Rotation.from_matrix(local[:, :3, :3]).as_euler("ZYX"))
    assert np.abs(angles[:, 2]).max() < 1e-6
    assert 4.8 < np.abs(angles[:, :2]).max() <= 5.0


class JudgeByFunction(GraspJudge):
    """A judge whose quality is a function of cloud and grasps, instead of a network's."""

    def __init__(self, config: VfasConfig, quality) -> None:  # type: ignore[no-untyped-def]
        self._config, self._quality = config, quality

    def quality(self, clouds, T_base_grasp):  # type: ignore[no-untyped-def]
        return np.stack([self._quality(cloud, T_base_grasp) for cloud in clouds])


def test_score_is_equation_1() -> None:
    """Catches a wrong sign, degrees for radians, and a spread that is not maximum minus minimum."""
    config = VfasConfig(noise_candidates="all", copies=3, k1=2.0, k2=0.5, k3=0.5)
    calls = iter([0.9, 0.7, 0.8])
    judge = JudgeByFunction(config, lambda _, T: np.full(len(T), next(calls)))
    seed = np.eye(4)
    T = increment(np.array([0.03, 0.04, 0, 0, 0.2, 0]))
    scores = judge.scores(np.zeros((1, 3)), T[None], seed, np.random.default_rng(0))
    assert scores.spread[0] == pytest.approx(0.2)
    assert scores.score[0] == pytest.approx(0.8 - 2.0 * 0.05 - 0.5 * 0.2 - 0.5 * 0.2)
    assert distances(seed, T[None])[1][0] == pytest.approx(0.2)


def test_leading_eight_alone_are_tried_with_noise() -> None:
    """Catches noise on all candidates or on the wrong eight, and a choice of one without spread."""
    config = VfasConfig(copies=2, k1=0.0, k2=0.0)
    tried: list[int] = []

    def quality(_: np.ndarray, T: np.ndarray) -> np.ndarray:
        tried.append(len(T))
        return np.asarray(T[:, 0, 3])

    poses = np.tile(np.eye(4), (64, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 1, 64)
    scores = JudgeByFunction(config, quality).scores(
        np.zeros((1, 3)), poses, np.eye(4), np.random.default_rng(0)
    )
    assert tried == [64, 8, 8]
    assert int(np.argmax(scores.score)) == 63
    assert np.isinf(scores.score[:56]).all()


def test_region_grows_by_30_percent_up_to_three_and_falls_back() -> None:
    """Catches another growth than the paper's (1, 1.3, 1.69, 2.197, 2.856, 3), or N not in step."""
    good = [False]
    relative: list[np.ndarray] = []
    config = VfasConfig(k1=0.0, k2=0.0, low_pass=False)

    def quality(_: np.ndarray, T: np.ndarray) -> np.ndarray:
        if len(T) > 8:
            relative.append(np.linalg.inv(T[0]) @ T)  # the seed is the first of them
        return np.full(len(T), 0.9 if good[0] else 0.1)

    planner = Vfas(JudgeByFunction(config, quality), config, 0, np.eye(4))
    cloud = np.random.default_rng(0).uniform(-0.05, 0.05, (500, 3))
    steps = [planner.step(k, 0.05, cloud, None, None) for k in range(7)]
    assert np.allclose([s.factor for s in steps], [1, 1.3, 1.69, 2.197, 2.8561, 3, 3])
    assert [s.n for s in steps] == [64, 83, 108, 141, 183, 192, 192]
    angle = max(np.degrees(distances(np.eye(4), T)[1]).max() for T in relative)
    assert 15.5 < angle < 15 * 2**0.5 + 0.1  # 5 degrees of pitch and of yaw, three times as far
    good[0] = True
    planner.step(7, 0.05, cloud, None, None)
    assert planner.step(8, 0.05, cloud, None, None).factor == 1.0


def test_seed_waits_for_a_good_grasp_when_searching() -> None:
    """Catches a seed that moves in a handover before a score exceeds 0.5, or stays after it."""
    good = [False]
    config = VfasConfig(k1=0.0, k2=0.0, keep_seed=False)
    judge = JudgeByFunction(config, lambda _, T: np.full(len(T), 0.9 if good[0] else 0.4))
    planner = Vfas(judge, config, 0, np.eye(4), searching=True)
    cloud = np.random.default_rng(0).uniform(-0.05, 0.05, (500, 3))
    for k in range(3):
        assert not planner.step(k, 0.05, cloud, np.array([0.1, 0, 0]), None).tracking
        assert np.array_equal(planner.T_base_seed, np.eye(4))
    good[0] = True
    assert planner.step(3, 0.05, cloud, None, None).tracking
    assert not np.array_equal(planner.T_base_seed, np.eye(4))


def test_seed_is_carried_with_the_motion_and_filter_too() -> None:
    """Catches an offset per frame (0.1 m/s in 50 ms are 5 mm), and a filter that delays it."""
    config = VfasConfig(k1=0.0, k2=0.0, half_width=1e-9, half_angle=0.0)
    planner = Vfas(JudgeByFunction(config, lambda _, T: np.full(len(T), 0.9)), config, 0, np.eye(4))
    cloud = np.random.default_rng(0).uniform(-0.05, 0.15, (500, 3))
    planner.step(0, 0.05, cloud, None, None)
    for k in range(1, 11):
        selected = planner.step(k, 0.05, cloud, np.array([0.1, 0, 0]), None)
    assert selected.T_base_seed[0, 3] == pytest.approx(0.05, abs=1e-6)


def test_pregrasp_is_held_for_five_iterations_before_the_advance() -> None:
    """Catches a count that does not restart at 0, and planning that goes on during the advance."""
    config = VfasConfig(k1=0.0, k2=0.0, half_width=1e-9, half_angle=0.0)
    planner = Vfas(JudgeByFunction(config, lambda _, T: np.full(len(T), 0.9)), config, 0, np.eye(4))
    cloud = np.random.default_rng(0).uniform(-0.05, 0.05, (500, 3))
    at_pregrasp = np.eye(4)
    at_pregrasp[2, 3] = -0.10
    away = at_pregrasp @ increment(np.array([0.006, 0, 0, 0, 0, 0]))
    steps = [planner.step(k, 0.05, cloud, None, away if k == 3 else at_pregrasp) for k in range(10)]
    assert [s.execute for s in steps] == [False] * 8 + [True] * 2
    assert steps[7].T_base_goal[2, 3] == pytest.approx(-0.10)
    assert steps[8].T_base_goal[2, 3] == pytest.approx(0.0, abs=1e-6)
    assert steps[9].n == 0


@pytest.mark.parametrize(("needs_score", "executes"), [(False, True), (True, False)])
def test_the_hold_asks_for_no_score(needs_score: bool, executes: bool) -> None:
    """Fails where a pre-grasp that was held is not left for want of a score, which the paper does
    not ask for; a search that has found nothing never advances.
    """
    config = VfasConfig(half_width=1e-9, half_angle=0.0, hold_needs_score=needs_score)
    cloud = np.random.default_rng(0).uniform(-0.05, 0.05, (500, 3))
    at_pregrasp = np.eye(4)
    at_pregrasp[2, 3] = -0.10
    for searching in (False, True):
        judge = JudgeByFunction(config, lambda _, T: np.full(len(T), 0.4))
        planner = Vfas(judge, config, 0, np.eye(4), searching)
        steps = [planner.step(k, 0.05, cloud, None, at_pregrasp) for k in range(6)]
        assert steps[-1].execute is (executes and not searching)


def test_a_grasp_beyond_the_first_region_is_found() -> None:
    """Fails where the distance from the seed costs so much that the region's growth is for nothing:
    a grasp 5.5 cm away, the only one that is good, with the seed fixed until it is found.
    """

    def quality(_: np.ndarray, T: np.ndarray) -> np.ndarray:
        return np.where(np.linalg.norm(T[:, :3, 3] - [0.055, 0, 0], axis=1) < 0.01, 0.95, 0.05)

    cloud = np.random.default_rng(0).uniform(-0.05, 0.05, (500, 3))
    found = {}
    for k1, k2 in ((VfasConfig().k1, VfasConfig().k2), (10.0, 1.0)):
        config = VfasConfig(k1=k1, k2=k2)
        planners = [
            Vfas(JudgeByFunction(config, quality), config, n, np.eye(4), searching=True)
            for n in range(5)
        ]
        for planner in planners:
            for k in range(60):
                planner.step(k, 0.05, cloud, None, None)
        found[k1] = sum(planner.tracking for planner in planners)
    assert found == {2.0: 5, 10.0: 0}


def test_baseline_executes_the_seed_as_it_was_given() -> None:
    """Catches a baseline that samples, or that never executes."""
    config = VfasConfig(refine=False)
    T = increment(np.array([0.1, 0, 0, 0, 0.2, 0]))
    planner = Vfas(JudgeByFunction(config, None), config, 0, T)
    hand = T.copy()
    hand[:3, 3] -= 0.10 * T[:3, 2]
    steps = [planner.step(k, 0.05, np.zeros((0, 3)), None, hand) for k in range(6)]
    assert steps[-1].execute
    assert np.allclose(steps[-1].T_base_goal, T)


def test_network_prefers_fingers_round_a_box() -> None:
    """Catches shipped weights that don't prefer a grasp across a box's top to one beside it and one
    above it, on a synthetic cloud.
    """
    rng = np.random.default_rng(0)
    top = np.column_stack(
        [rng.uniform(-0.02, 0.02, 4000), rng.uniform(-0.03, 0.03, 4000), np.full(4000, 0.10)]
    )
    table = np.column_stack([rng.uniform(-0.2, 0.2, (8000, 2)), np.zeros(8000)])
    table = table[(np.abs(table[:, :2]) > [0.02, 0.03]).any(axis=1)]
    cloud = rng.permutation(np.concatenate([top, table])) + rng.normal(
        0, 0.002, (4000 + len(table), 3)
    )
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = 0.08
    beside, above = T.copy(), T.copy()
    beside[0, 3], above[2, 3] = 0.045, 0.16
    quality = GraspJudge(evaluator_of(None), VfasConfig()).quality(
        [cloud], np.array([T, beside, above])
    )[0]
    assert quality[0] > 0.7
    assert quality[1:].max() < 0.3


# the motion field

CAMERA = Intrinsics(320, 240, 213.0, 213.0, 159.5, 119.5)


def textured(shift: float) -> np.ndarray:
    """Image (240, 320, 3) uint8 of a printed wall, moved by `shift` px along x."""
    import cv2

    rng = np.random.default_rng(5)
    big = cv2.GaussianBlur(rng.integers(0, 255, (300, 500, 3), dtype=np.uint8), (0, 0), 2.0)
    big = cv2.normalize(big, None, 0, 255, cv2.NORM_MINMAX)  # type: ignore[call-overload]
    M = np.float32([[1, 0, shift - 60], [0, 1, -30]])
    return np.asarray(cv2.warpAffine(big, M, (320, 240)), dtype=np.uint8)  # type: ignore[call-overload]


def test_motion_field_takes_the_cameras_own_motion_out() -> None:
    """Catches a camera's motion taken for the scene's: a wall 0.3 m away (docs/papers.md, "Lifting
    the flow").

    If the wall moves its speed is measured; if the camera moves past it the speed is 0.
    """
    depth = np.full((240, 320), 0.3, np.float32)
    px = 0.005 / 0.3 * CAMERA.fx  # 5 mm
    T_base_camera, centre = np.eye(4), np.array([0.0, 0.0, 0.3])
    moving = MotionField(dis_flow())
    assert moving.step(0, textured(0), depth, CAMERA, T_base_camera, centre, 0.05) is None
    velocity = moving.step(50_000_000, textured(px), depth, CAMERA, T_base_camera, centre, 0.05)
    assert velocity is not None
    assert np.allclose(velocity, [0.1, 0, 0], atol=0.005)
    still = MotionField(dis_flow())
    still.step(0, textured(0), depth, CAMERA, T_base_camera, centre, 0.05)
    beside = np.eye(4)
    beside[0, 3] = -0.005
    velocity = still.step(50_000_000, textured(px), depth, CAMERA, beside, centre, 0.05)
    assert velocity is not None
    assert np.linalg.norm(velocity) < 0.005


def test_public_weights_judge_in_the_loop(tmp_path: Path) -> None:
    """Catches labels or centre of the configuration that don't reach the public network.

    6-DoF GraspNet's checkpoint gets 1024 points with their mean subtracted and control points, with
    its labels or VFAS-Grasp's.
    """
    torch.save(
        {"model_state_dict": with_random_weights().state_dict()}, tmp_path / "latest_net.pth"
    )
    rng = np.random.default_rng(0)
    cloud = rng.uniform(-0.05, 0.05, (2000, 3))
    qualities = []
    for changes in ({}, {"labels": "vfas"}, {"centre": "grasp"}):
        config = load_config("vfas").model_copy(
            update={
                "vfas": VfasConfig(
                    evaluator=str(tmp_path / "latest_net.pth"), candidates=3, **changes
                )
            }  # type: ignore[arg-type]
        )
        judge = VfasLoop(config, np.eye(4))._judge
        qualities.append(judge.quality([cloud], np.tile(np.eye(4), (2, 1, 1)))[0, 0])
    assert len({f"{q:.3e}" for q in qualities}) == 3  # each setting changes the quality


def test_proportional_twist_goes_to_the_goal() -> None:
    """Catches a rotation in the wrong axes: the command, followed once for a time constant and once
    in small steps, ends at the goal.
    """
    T, goal = (
        increment(np.array([0.2, 0.1, 0, 0.5, 0, 1.0])),
        increment(np.array([0, 0.3, 0.1, -0.2, 0.4, 0])),
    )
    whole = proportional_twist(T, goal, 2.0) / 2.0
    assert np.allclose(
        increment(np.concatenate([np.zeros(3), whole[3:]]))[:3, :3] @ T[:3, :3],
        goal[:3, :3],
        atol=1e-9,
    )
    for _ in range(400):
        twist = proportional_twist(T, goal, 2.0) * 0.01
        move = increment(np.concatenate([np.zeros(3), twist[3:]]))
        T = np.block(
            [
                [move[:3, :3] @ T[:3, :3], (T[:3, 3] + twist[:3])[:, None]],
                [np.zeros((1, 3)), np.ones((1, 1))],
            ]
        )
    assert np.allclose(T, goal, atol=1e-3)
