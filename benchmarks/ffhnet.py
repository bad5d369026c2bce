"""FFHNet: time per 1000 candidates, its evaluator on objects held out, and its best grasp tried in physics.

`python -m benchmarks.ffhnet [--views 10] [--data DIR]`; DIR is where `dgeval train ffhnet` put its grasps.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from dgeval.config import GraspsConfig
from dgeval.determinism import generator, limit_threads
from dgeval.geometry import Array, invert
from dgeval.networks.bps import basis, encode
from dgeval.networks.ffhnet import FFHEvaluator, FFHGenerator, load_evaluator
from dgeval.physics.hand import T_hand_palm
from dgeval.physics.objects import ObjectModel, at, procedural_object, surface_points, ten_objects
from dgeval.report.statistics import wilson
from dgeval.simulation.grasps import FlyingHand, candidate, known_grasps
from dgeval.stages.grasping import Networks, encode_cloud, networks_of, propose
from dgeval.training.ffhnet import Settings, load_objects, tried
from dgeval.training.ship import scores_of
from dgeval.training.views import cloud_of
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from benchmarks.result import RESULTS, table, write

UNSEEN = range(100, 109)  # procedural objects, one of each kind, that no training run with fewer than 100 has seen


def milliseconds(function: Callable[[], Any], repeats: int = 9) -> float:
    """Median."""
    function()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        taken.append(time.perf_counter() - start)
    return 1e3 * float(np.median(taken))


def times() -> list[list[str]]:
    """1000 candidates on one core: generated, evaluated, both; the cloud's share once or for every candidate."""
    rows = []
    shipped = networks_of(GraspsConfig())
    published = Networks(FFHGenerator().eval(), FFHEvaluator().eval())
    for name, networks in (("shipped", shipped), ("published size", published)):
        bps = torch.rand(1, networks.n_bps) * 0.2
        for how, given in (("factored", bps), ("unfactored", bps.expand(1000, -1).contiguous())):
            z = torch.randn(1000, 5)
            with torch.inference_mode():
                palms = networks.generator.decode(z, given)
                made = milliseconds(lambda n=networks, g=given, z=z: n.generator.decode(z, g))  # type: ignore[misc]
                judged = milliseconds(lambda n=networks, g=given, p=palms: n.evaluator(g, p))  # type: ignore[misc]
            rows.append([name, how, f"{made:.0f}", f"{judged:.0f}", f"{made + judged:.0f}"])
    return rows


def neighbours() -> list[list[str]]:
    """Encoding a model of 4096 points by the basis of each size, by library."""
    import open3d
    import small_gicp

    cloud = np.random.default_rng(0).normal(0, 0.04, (4096, 3))
    rows = []
    for n in (512, 4096):
        points = basis(n).astype(np.float64)
        tensor = open3d.core.Tensor(cloud)

        def by_open3d(tensor: Any = tensor, points: Array = points) -> None:
            search = open3d.core.nns.NearestNeighborSearch(tensor)
            search.knn_index()
            search.knn_search(open3d.core.Tensor(points), 1)

        ways: dict[str, Callable[[], Any]] = {
            "scipy, balanced tree": lambda p=points: cKDTree(cloud).query(p),  # type: ignore[misc]
            "scipy, as used": lambda n=n: encode(cloud, basis(n)),  # type: ignore[misc]
            "small_gicp": lambda p=points: small_gicp.KdTree(cloud).batch_nearest_neighbor_search(p),  # type: ignore[misc]
            "open3d": by_open3d,
            "torch.cdist": lambda p=points: torch.cdist(torch.from_numpy(p).float(), torch.from_numpy(cloud).float()).min(1),  # type: ignore[misc]
        }
        rows += [[str(n), name, f"{milliseconds(way):.1f}"] for name, way in ways.items()]
    return rows


def holds(world: FlyingHand, thing: ObjectModel, T_object_palm: Array, joints: Array) -> bool:
    """Free of contact, lifted, and kept through the shake."""
    T = at(0.5, 0.0, thing.rest_height()) @ T_object_palm @ invert(T_hand_palm)
    world.put(T, joints)
    if world.touches():
        return False
    world.put(T, joints)
    return world.lifts(joints, shake=True)


def in_physics(things: list[ObjectModel], views: int, networks: Networks) -> dict[str, list[tuple[str, bool]]]:
    """Whether the best grasp of each view held, by way of choosing it: (object, held)."""
    out: dict[str, list[tuple[str, bool]]] = {k: [] for k in ("single view", "fused", "random free pose", "known grasps")}
    for thing in things:
        world = FlyingHand(thing)
        surface = surface_points(thing, 12_000, generator(1, f"bench/{thing.name}", 0))
        known = known_grasps(thing) if thing.name in ten_objects() else []
        for k in range(views):
            for name, fused in (("single view", False), ("fused", True)):
                cloud, T_camera_object = cloud_of(surface, fused, generator(1, f"bench/{thing.name}/{name}", k))
                drawn = propose(encode_cloud(cloud, networks), networks, 256, 1, k)
                best = int(np.argmax(drawn.scores))
                T = invert(T_camera_object) @ drawn.T_cloud_palm[best]
                out[name].append((thing.name, holds(world, thing, T, drawn.joints[best])))
            for draw in range(500):
                T, joints = candidate(generator(2, f"bench/{thing.name}/{k}", draw), thing)
                world.put(T, joints)
                if not world.touches():
                    out["random free pose"].append((thing.name, world.lifts(joints, shake=True)))
                    break
            if known:
                grasp = max(known, key=lambda g: g.quality) if k == 0 else known[k % len(known)]
                out["known grasps"].append((thing.name, holds(world, thing, grasp.T_object_palm, grasp.preshape)))
    return out


def rate(held: list[bool]) -> str:
    low, high = wilson(sum(held), len(held))
    return f"{sum(held)}/{len(held)} = {100 * np.mean(held):.0f} % [{100 * low:.0f}–{100 * high:.0f}]"


def reliability(p: Array, held: Array, path: Path) -> None:
    figure = Figure(figsize=(4.2, 3.6), layout="constrained")
    axis = figure.subplots()
    cell = np.minimum((p * 10).astype(int), 9)
    shown = [b for b in range(10) if (cell == b).sum() >= 5]
    axis.plot([0, 1], [0, 1], color="#999", lw=0.8)
    axis.plot([p[cell == b].mean() for b in shown], [held[cell == b].mean() for b in shown], marker="o")
    for b in shown:
        axis.annotate(
            str((cell == b).sum()),
            (p[cell == b].mean(), held[cell == b].mean()),
            fontsize=7,
            xytext=(4, -8),
            textcoords="offset points",
        )
    axis.set_xlabel("score")
    axis.set_ylabel("share that held (numbers: grasps)")
    figure.savefig(path, dpi=110, metadata={"Software": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=10)
    parser.add_argument("--data", type=Path)
    options = parser.parse_args()
    limit_threads()
    networks = networks_of(GraspsConfig())
    parts = [
        "Milliseconds for 1000 candidates on one core.",
        table(["network", "cloud's share", "generate", "evaluate", "both"], times()),
        "Encoding a model of 4096 points, ms.",
        table(["basis points", "by", "ms"], neighbours()),
    ]
    groups = {"procedural, unseen": [procedural_object(k) for k in UNSEEN], "the ten": list(ten_objects().values())}
    rows, by_object = [], []
    for name, things in groups.items():
        found = in_physics(things, options.views, networks)
        rows += [[name, way, rate([h for _, h in held])] for way, held in found.items() if held]
        ways = ("single view", "fused")
        by_object += [[t.name, *(rate([h for n, h in found[way] if n == t.name]) for way in ways)] for t in things]
    parts += [
        "Best-scored of 256 grasps tried in physics: closed, lifted, shaken with 2 g; one that touches anything before it "
        "closes counts as failed.",
        table(["objects", "grasp by", "held"], rows),
        table(["object", "single view", "fused"], by_object),
    ]
    if options.data:
        settings = Settings()
        objects = load_objects(options.data, settings, len(list(options.data.glob("*.npz"))), 0)[-settings.held_out :][1::2]
        bps, palms, held = tried(objects, 400, generator(0, "measure", 0))
        weights = Path(__file__).resolve().parents[1] / "dgeval" / "networks" / "weights"
        rows = []
        for name in ("ffhnet_evaluator", "ffhnet_evaluator_fingers"):
            with torch.inference_mode():
                p = load_evaluator(weights / f"{name}.safetensors")(bps, palms).numpy().astype(float)
            found_scores = scores_of(p, held.numpy() > 0.5)
            rows.append([name, *(f"{found_scores[k]:.3f}" for k in ("auc", "brier", "ece", "held"))])
            if name == "ffhnet_evaluator":
                reliability(p, held.numpy(), RESULTS / "ffhnet-reliability.png")
        parts += [
            f"Evaluators on {len(held)} tried grasps of {len(objects)} objects that neither trained nor calibrated them "
            "(plot: ffhnet-reliability.png).",
            table(["evaluator", "ROC-AUC", "Brier", "ECE", "share that held"], rows),
        ]
    print(write("ffhnet", "FFHNet", f"python -m benchmarks.ffhnet --views {options.views}", parts).read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
