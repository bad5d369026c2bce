"""Catches a network that differs from the published one, and seeds that are not its best grasps.

The reference is a second implementation in NumPy, one centre at a time. The last tests are of the
seeds that a planner starts from.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import torch
from dgeval.config import VfasConfig
from dgeval.errors import UsageError
from dgeval.geometry import increment, rotation_vector, transform
from dgeval.networks.contact_graspnet import (
    CENTRES,
    NEIGHBOURS,
    RADII,
    ContactGraspNet,
    load_contact_graspnet,
)
from dgeval.planning.vfas.contacts import seed_from_contacts
from dgeval.planning.vfas.loop import evaluator_of, seed_from_cloud
from dgeval.planning.vfas.selection import GraspJudge
from dgeval.robots.parallel_jaw import OPENING

pytestmark = pytest.mark.slow

N = 2100


def network_with_fixed_weights() -> ContactGraspNet:
    """A network with fixed random weights, and norms with other statistics than 0 and 1."""
    network = ContactGraspNet()
    rng = np.random.default_rng(1)
    state = {}
    for name, tensor in network.state_dict().items():
        shape = tuple(tensor.shape)
        if "num_batches" in name:
            state[name] = torch.tensor(1)
        elif name.endswith("running_var") or (name.endswith("weight") and len(shape) == 1):
            state[name] = torch.from_numpy(rng.uniform(0.5, 2.0, shape).astype(np.float32))
        else:
            wide = 1 / np.sqrt(shape[1]) if len(shape) > 1 else 0.05
            state[name] = torch.from_numpy(rng.normal(0, wide, shape).astype(np.float32))
    state["multihead.3.3.bias"] -= 0.1  # brings widths between the limits of the clipping
    network.load_state_dict(state)
    return network.eval()


def layers(state: dict[str, np.ndarray], name: str, x: np.ndarray) -> np.ndarray:
    """Apply all layers of a name in turn: linear, ReLU, norm."""
    k = 0
    while f"{name}.{k}.0.weight" in state:
        part = f"{name}.{k}"
        x = np.maximum(x @ state[f"{part}.0.weight"].T + state[f"{part}.0.bias"], 0)
        mean, var = state[f"{part}.2.running_mean"], state[f"{part}.2.running_var"]
        x = (x - mean) / np.sqrt(var + 1e-5) * state[f"{part}.2.weight"] + state[f"{part}.2.bias"]
        k += 1
    return x


def farthest(points: np.ndarray, n: int) -> np.ndarray:
    """Farthest point sampling from index 0 on."""
    chosen, nearest = [0], np.full(len(points), np.inf)
    while len(chosen) < n:
        nearest = np.minimum(nearest, ((points - points[chosen[-1]]) ** 2).sum(1))
        chosen.append(int(np.argmax(nearest)))
    return np.array(chosen)


def reference_outputs(state: dict[str, np.ndarray], points: np.ndarray) -> tuple[np.ndarray, ...]:
    """Points and outputs of the four heads, computed as in docs/papers.md, "Contact-GraspNet"."""
    xyz, features = points, np.zeros((len(points), 0))
    levels = []
    for s, count in enumerate(CENTRES):
        centres = xyz[farthest(xyz, count)]
        columns = []
        for r, radius in enumerate(RADII[s]):
            rows = []
            for i, centre in enumerate(centres):
                near = np.flatnonzero(((xyz - centre) ** 2).sum(1) < radius**2)[:NEIGHBOURS]
                near = np.unique([*near, i])  # the original's accident: point i, wherever it lies
                local = np.concatenate([features[near], xyz[near] - centre], axis=1)
                rows.append(layers(state, f"set_abstract_msg.{s}.{r}.conv.local_nn", local).max(0))
            columns.append(rows)
        xyz, features = centres, np.concatenate([np.array(c) for c in columns], axis=1)
        levels.append((xyz, features))
    for step, (fine, skip) in enumerate(reversed(levels)):
        out = []
        for p, beside in zip(fine, skip, strict=True):
            d2 = ((xyz - p) ** 2).sum(1)
            near = np.argsort(d2, kind="stable")[:3]
            w = 1 / np.maximum(d2[near], 1e-16)
            out.append(np.concatenate([(features[near] * w[:, None]).sum(0) / w.sum(), beside]))
        features, xyz = layers(state, f"feat_prop.{step}.nn", np.array(out)), fine
    inputs = np.concatenate([xyz, features], axis=1)
    heads = []
    for h in range(4):
        x = inputs @ state[f"multihead.{h}.0.weight"][:, :, 0].T + state[f"multihead.{h}.0.bias"]
        name = f"multihead.{h}.1"
        x = (x - state[f"{name}.running_mean"]) / np.sqrt(state[f"{name}.running_var"] + 1e-5)
        x = x * state[f"{name}.weight"] + state[f"{name}.bias"]
        heads.append(
            x @ state[f"multihead.{h}.3.weight"][:, :, 0].T + state[f"multihead.{h}.3.bias"]
        )
    return xyz, *heads


def test_network_is_the_published_one() -> None:
    """Catches wrong radii, norm and ReLU swapped, and wrong interpolation or directions.

    It also catches a network without the original's accident, point i as a neighbour of centre i.
    """
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.15, 0.15, (N, 3)).astype(np.float32)
    network = network_with_fixed_weights()
    at, across, approach, width, logit = (v.numpy() for v in network(torch.from_numpy(points)))
    state = {k: v.numpy().astype(np.float64) for k, v in network.state_dict().items()}
    xyz, score, z1, z2, w = reference_outputs(state, points.astype(np.float64))
    assert np.allclose(at, xyz, atol=1e-7)
    unit = z1 / np.linalg.norm(z1, axis=1, keepdims=True)
    second = z2 - (unit * z2).sum(1, keepdims=True) * unit
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    clipped = np.clip(w[:, 0], -0.16, 0.08)
    # the tolerance is relative to the spread over contacts, not to the size
    for got, expected in (
        (logit, score[:, 0]),
        (across, unit),
        (approach, second),
        (width, clipped),
    ):
        assert expected.std(axis=0).min() > 1e-3
        assert np.abs(got - expected).max() < 1e-3 * expected.std(axis=0).min()


def test_grasps_lie_between_the_jaws_whatever_the_origin() -> None:
    """Catches half a width on the wrong side, and a mean that is not added back."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.15, 0.15, (N, 3))
    network = network_with_fixed_weights()
    about_mean = torch.from_numpy((points - points.mean(0)).astype(np.float32))
    at, across, approach, width, _ = (v.double().numpy() for v in network(about_mean))
    far = np.array([0.5, -0.3, 0.1])
    grasps = network.grasps(points + far)
    T = grasps.T_cloud_grasp
    assert np.allclose(
        T[:, :3, 3] - width[:, None] / 2 * across, at + points.mean(0) + far, atol=1e-5
    )
    assert np.allclose(T[:, :3, 2], approach, atol=1e-3)
    assert np.allclose(np.linalg.det(T[:, :3, :3]), 1.0, atol=1e-5)
    assert (grasps.width >= 0).all()
    assert ((grasps.score >= 0) & (grasps.score <= 1)).all()


def test_seed_is_among_the_confident_ones() -> None:
    """Catches another network than the one given, and a crash on a small cloud."""
    cloud = np.random.default_rng(0).uniform(-0.15, 0.15, (N, 3))
    network, judge = network_with_fixed_weights(), GraspJudge(evaluator_of(None), VfasConfig())

    def rank(poses: np.ndarray) -> np.ndarray:
        return judge.quality([cloud], poses)[0]

    T = seed_from_contacts(cloud, None, network, rank, OPENING, 3)
    assert T is not None
    grasps = network.grasps(cloud)
    assert grasps.width.max() < OPENING
    confident = grasps.T_cloud_grasp[np.argsort(-grasps.score)[:270]]
    assert np.abs(confident - T).max(axis=(1, 2)).min() < 1e-3
    quality = judge.quality([cloud], np.concatenate([T[None], confident[:20]]))[0]
    assert quality[0] >= quality[1:].max() - 0.05
    assert seed_from_contacts(cloud[:2000], None, network, rank, OPENING, 3) is None


def test_checkpoint_container_and_its_absence(tmp_path: Path) -> None:
    """Catches a wrong key of the weights in cgn-pytorch's file, and no hint without the package.

    The file holds an optimiser beside the weights.
    """
    torch.save(
        {"state_dict": network_with_fixed_weights().state_dict(), "epoch": 7},
        tmp_path / "current.pth",
    )
    loaded = load_contact_graspnet(tmp_path / "current.pth")
    assert sum(1 for _ in loaded.state_dict()) == 295
    if importlib.util.find_spec("cgn_pytorch") is None:
        with pytest.raises(UsageError, match="not installed"):
            load_contact_graspnet()


def test_installed_weights_find_grasps_on_the_packages_scene() -> None:
    """Catches weights loaded wrongly: the original gives 142 grasps over 0.5, the best of 0.995.

    That is with the same first point and the same order of neighbours.
    """
    package = importlib.util.find_spec("cgn_pytorch")
    if package is None or not package.submodule_search_locations:
        pytest.skip("cgn-pytorch is not installed")
    scene = np.load(
        Path(package.submodule_search_locations[0]) / "scenes" / "002330.npz", allow_pickle=True
    )
    score = load_contact_graspnet().grasps(scene["arr_0"][0].astype(np.float64)).score
    assert int((score > 0.5).sum()) == pytest.approx(142, abs=3)
    assert score.max() == pytest.approx(0.995, abs=0.002)


def test_sampled_seed_holds_what_is_narrow() -> None:
    """Catches a seed beside a thin box, along its wide side, or that does not move with the scene.

    The box stands on a table.
    """
    rng = np.random.default_rng(0)
    n = 3000
    side = np.column_stack(
        [rng.choice([-0.02, 0.02], n), rng.uniform(-0.05, 0.05, n), rng.uniform(0, 0.12, n)]
    )
    top = np.column_stack(
        [rng.uniform(-0.02, 0.02, n), rng.uniform(-0.05, 0.05, n), np.full(n, 0.12)]
    )
    table = np.column_stack([rng.uniform(-0.2, 0.2, (n, 2)), np.zeros(n)])
    cloud = rng.permutation(np.concatenate([side, top, table]))
    judge = GraspJudge(evaluator_of(None), VfasConfig())
    above = np.diag([1.0, -1.0, -1.0, 1.0])
    above[2, 3] = 0.4
    T = seed_from_cloud(cloud, judge, above, 0)
    assert T is not None
    assert np.all(np.abs(T[:3, 3] - [0, 0, 0.09]) < [0.03, 0.06, 0.05])
    assert abs(T[0, 0]) > 0.8  # the jaws close along x
    assert T[2, 2] < -0.3
    move = increment(np.array([0.3, -0.2, 0.1, 0, 0, 0.7]))
    moved = seed_from_cloud(transform(move, cloud), judge, move @ above, 0)
    assert moved is not None
    assert np.allclose(moved[:3, 3], (move @ T)[:3, 3], atol=1e-3)
    assert np.linalg.norm(rotation_vector(moved[:3, :3].T @ (move @ T)[:3, :3])) < 1e-3
    assert seed_from_cloud(np.zeros((1, 3)), judge, above, 0) is None
