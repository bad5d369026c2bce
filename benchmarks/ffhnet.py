"""FFHNet: time per 1000 candidates, its evaluator on objects held out, and its best grasp tried in physics.

`python -m benchmarks.ffhnet [--views 10]`.
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
from dgeval.networks.ffhnet import FFHEvaluator, FFHGenerator
from dgeval.planning.grasps import Networks, encode_cloud, networks_of, propose
from dgeval.simulation.grasps import FlyingHand, candidate, known_grasps
from dgeval.statistics import wilson
from dgeval.training.grasp_data import free_on_table, holds
from dgeval.training.ship import scores_of, selected
from dgeval.training.views import cloud_of
from dgeval.worlds.objects import ObjectModel, procedural_object, surface_points, ten_objects
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from benchmarks.result import RESULTS, table, write

WAYS = (
    "single view, best",
    "single view, best free",
    "fused, best",
    "fused, best free",
    "random free pose",
    "known grasps",
)
UNSEEN = range(
    200, 209
)  # procedural objects, one of each kind, that no training run with its defaults has seen


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
    cloud = np.random.default_rng(0).normal(0, 0.04, (4096, 3))
    rows = []
    for n in (512, 4096):
        points = basis(n).astype(np.float64)

        ways: dict[str, Callable[[], Any]] = {
            "scipy, balanced tree": lambda p=points: cKDTree(cloud).query(p),  # type: ignore[misc]
            "scipy, plain tree": lambda p=points: cKDTree(
                cloud, 16, False, balanced_tree=False
            ).query(p),  # type: ignore[misc]
            "small_gicp, as used": lambda n=n: encode(cloud, basis(n)),  # type: ignore[misc]
            "torch.cdist": lambda p=points: torch.cdist(
                torch.from_numpy(p).float(), torch.from_numpy(cloud).float()
            ).min(1),  # type: ignore[misc]
        }
        rows += [[str(n), name, f"{milliseconds(way):.1f}"] for name, way in ways.items()]
    return rows


def in_physics(
    things: list[ObjectModel], views: int, networks: Networks
) -> dict[str, list[tuple[str, bool]]]:
    """Whether the best grasp of each view held, by way of choosing it: (object, held)."""
    out: dict[str, list[tuple[str, bool]]] = {k: [] for k in WAYS}
    for thing in things:
        world = FlyingHand(thing)
        surface = surface_points(thing, 12_000, generator(1, f"bench/{thing.name}", 0))
        known = known_grasps(thing) if thing.name in ten_objects() else []
        for k in range(views):
            for name, fused in (("single view", False), ("fused", True)):
                cloud, T_cloud_object = cloud_of(
                    surface, fused, generator(1, f"bench/{thing.name}/{name}", k)
                )
                encoded = encode_cloud(cloud, networks)
                drawn = propose(encoded, networks, 256, 1, k)
                free = free_on_table(thing, T_cloud_object, encoded, drawn)
                for way, scores in (
                    ("best", drawn.scores),
                    ("best free", np.where(free, drawn.scores, -1.0)),
                ):
                    row = int(np.argmax(scores))
                    T = invert(T_cloud_object) @ drawn.T_cloud_palm[row]
                    out[f"{name}, {way}"].append((thing.name, holds(world, T, drawn.joints[row])))
            for draw in range(500):
                T, joints = candidate(generator(2, f"bench/{thing.name}/{k}", draw), thing)
                world.put(T, joints)
                if not world.touches():
                    out["random free pose"].append((thing.name, world.lifts(joints, shake=True)))
                    break
            if known:
                grasp = max(known, key=lambda g: g.quality) if k == 0 else known[k % len(known)]
                out["known grasps"].append(
                    (thing.name, holds(world, grasp.T_object_palm, grasp.preshape))
                )
    return out


def rate(held: list[bool]) -> str:
    low, high = wilson(sum(held), len(held))
    return (
        f"{sum(held)}/{len(held)} = {100 * np.mean(held):.0f} % [{100 * low:.0f}–{100 * high:.0f}]"
    )


def reliability(p: Array, held: Array, path: Path) -> None:
    figure = Figure(figsize=(4.2, 3.6), layout="constrained")
    axis = figure.subplots()
    cell = np.minimum((p * 10).astype(int), 9)
    shown = [b for b in range(10) if (cell == b).sum() >= 5]
    axis.plot([0, 1], [0, 1], color="#999", lw=0.8)
    axis.plot(
        [p[cell == b].mean() for b in shown], [held[cell == b].mean() for b in shown], marker="o"
    )
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
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--views", type=int, default=10)
    options = parser.parse_args()
    limit_threads()
    networks = networks_of(GraspsConfig())
    parts = [
        "Milliseconds for 1000 candidates on one core.",
        table(["network", "cloud's share", "generate", "evaluate", "both"], times()),
        "Encoding a model of 4096 points, ms.",
        table(["basis points", "by", "ms"], neighbours()),
    ]
    groups = {
        "procedural, unseen": [procedural_object(k) for k in UNSEEN],
        "the ten": list(ten_objects().values()),
    }
    rows, by_object = [], []
    for name, things in groups.items():
        found = in_physics(things, options.views, networks)
        rows += [[name, way, rate([h for _, h in held])] for way, held in found.items() if held]
        ways = ("single view, best free", "fused, best free")
        by_object += [
            [t.name, *(rate([h for n, h in found[way] if n == t.name]) for way in ways)]
            for t in things
        ]
    parts += [
        "Best-scored of 256 grasps tried in physics: closed, lifted, shaken with 2 g; one deeper "
        "than 4 mm in object or table counts as failed. `free`: the best of those that are not, as "
        "far as cloud and support tell.",
        table(["objects", "grasp by", "held"], rows),
        table(["object", "single view, best free", "fused, best free"], by_object),
    ]
    bps, palms, held = selected(networks, UNSEEN, 1)
    with torch.inference_mode():
        p = networks.evaluator(bps, palms).numpy().astype(float)
    found_scores = scores_of(p, held.numpy() > 0.5)
    reliability(p, held.numpy(), RESULTS / "ffhnet-reliability.svg")
    parts += [
        f"The evaluator on {len(held)} tried grasps of nine unseen objects: of 256 candidates that "
        "are free, the four best and four at random, of ten views each (plot: "
        "ffhnet-reliability.svg).",
        table(
            ["ROC-AUC", "Brier", "ECE", "share that held"],
            [[f"{found_scores[k]:.3f}" for k in ("auc", "brier", "ece", "held")]],
        ),
    ]
    print(
        write(
            "ffhnet", "FFHNet", f"python -m benchmarks.ffhnet --views {options.views}", parts
        ).read_text(encoding="utf-8")
    )


if __name__ == "__main__":
    main()
