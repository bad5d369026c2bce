"""FFHNet: time per 1000 candidates, evaluator on unseen objects, best grasp tried in physics.

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

# How the tried grasp is chosen: cloud of the object, and the best of all or of the free candidates
CHOICES = (
    "single view, best",
    "single view, best free",
    "fused, best",
    "fused, best free",
    "random free pose",
    "known grasps",
)
# Procedural objects, one of each kind, that no training run with default options uses
UNSEEN = range(200, 209)


def milliseconds(function: Callable[[], Any], repeats: int = 9) -> float:
    """Median time of a call, ms, after one call to warm up."""
    function()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        taken.append(time.perf_counter() - start)
    return 1e3 * float(np.median(taken))


def times() -> list[list[str]]:
    """Rows of times for 1000 candidates on one core, ms: generated, evaluated, both.

    The cloud's part of the first layer is computed once (factored) or for every candidate.
    """
    rows = []
    shipped = networks_of(GraspsConfig())
    published = Networks(FFHGenerator().eval(), FFHEvaluator().eval())
    for name, networks in (("shipped", shipped), ("published size", published)):
        bps = torch.rand(1, networks.n_bps) * 0.2
        for layer, encoded in (
            ("factored", bps),
            ("unfactored", bps.expand(1000, -1).contiguous()),
        ):
            z = torch.randn(1000, 5)
            with torch.inference_mode():
                palms = networks.generator.decode(z, encoded)
                generated = milliseconds(
                    lambda n=networks, g=encoded, z=z: n.generator.decode(z, g)
                )  # type: ignore[misc]
                evaluated = milliseconds(lambda n=networks, g=encoded, p=palms: n.evaluator(g, p))  # type: ignore[misc]
            rows.append(
                [
                    name,
                    layer,
                    f"{generated:.0f}",
                    f"{evaluated:.0f}",
                    f"{generated + evaluated:.0f}",
                ]
            )
    return rows


def neighbours() -> list[list[str]]:
    """Rows of times to encode a model of 4096 points, ms, by size of the basis and by library."""
    cloud = np.random.default_rng(0).normal(0, 0.04, (4096, 3))
    rows = []
    for n in (512, 4096):
        points = basis(n).astype(np.float64)

        searches: dict[str, Callable[[], Any]] = {
            "scipy, balanced tree": lambda p=points: cKDTree(cloud).query(p),  # type: ignore[misc]
            "scipy, plain tree": lambda p=points: cKDTree(
                cloud, 16, False, balanced_tree=False
            ).query(p),  # type: ignore[misc]
            "small_gicp, as used": lambda n=n: encode(cloud, basis(n)),  # type: ignore[misc]
            "torch.cdist": lambda p=points: torch.cdist(
                torch.from_numpy(p).float(), torch.from_numpy(cloud).float()
            ).min(1),  # type: ignore[misc]
        }
        rows += [[str(n), name, f"{milliseconds(search):.1f}"] for name, search in searches.items()]
    return rows


def in_physics(
    models: list[ObjectModel], views: int, networks: Networks
) -> dict[str, list[tuple[str, bool]]]:
    """By choice: (object, whether the grasp held in physics) for each view of each object."""
    out: dict[str, list[tuple[str, bool]]] = {k: [] for k in CHOICES}
    for model in models:
        world = FlyingHand(model)
        surface = surface_points(model, 12_000, generator(1, f"bench/{model.name}", 0))
        known_of_model = known_grasps(model) if model.name in ten_objects() else []
        for k in range(views):
            for name, fused in (("single view", False), ("fused", True)):
                cloud, T_cloud_object = cloud_of(
                    surface, fused, generator(1, f"bench/{model.name}/{name}", k)
                )
                encoded = encode_cloud(cloud, networks)
                drawn = propose(encoded, networks, 256, 1, k)
                free = free_on_table(model, T_cloud_object, encoded, drawn)
                for choice, scores in (
                    ("best", drawn.scores),
                    ("best free", np.where(free, drawn.scores, -1.0)),
                ):
                    best = int(np.argmax(scores))
                    T = invert(T_cloud_object) @ drawn.T_cloud_palm[best]
                    out[f"{name}, {choice}"].append(
                        (model.name, holds(world, T, drawn.joints[best]))
                    )
            for draw in range(500):
                T, joints = candidate(generator(2, f"bench/{model.name}/{k}", draw), model)
                world.put(T, joints)
                if not world.touches():
                    out["random free pose"].append((model.name, world.lifts(joints, shake=True)))
                    break
            if known_of_model:
                grasp = (
                    max(known_of_model, key=lambda g: g.quality)
                    if k == 0
                    else known_of_model[k % len(known_of_model)]
                )
                out["known grasps"].append(
                    (model.name, holds(world, grasp.T_object_palm, grasp.preshape))
                )
    return out


def rate(held: list[bool]) -> str:
    """Share that held, with its Wilson 95 % interval, as text."""
    low, high = wilson(sum(held), len(held))
    return (
        f"{sum(held)}/{len(held)} = {100 * np.mean(held):.0f} % [{100 * low:.0f}–{100 * high:.0f}]"
    )


def reliability(p: Array, held: Array, path: Path) -> None:
    """Reliability plot of scores p (n,) against `held` (n,), ten bins, as SVG."""
    figure = Figure(figsize=(4.2, 3.6), layout="constrained")
    axis = figure.subplots()
    bin_of = np.minimum((p * 10).astype(int), 9)
    bins = [b for b in range(10) if (bin_of == b).sum() >= 5]
    axis.plot([0, 1], [0, 1], color="#999", lw=0.8)
    axis.plot(
        [p[bin_of == b].mean() for b in bins], [held[bin_of == b].mean() for b in bins], marker="o"
    )
    for b in bins:
        axis.annotate(
            str((bin_of == b).sum()),
            (p[bin_of == b].mean(), held[bin_of == b].mean()),
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
    for name, models in groups.items():
        held_by_choice = in_physics(models, options.views, networks)
        rows += [
            [name, choice, rate([h for _, h in held])]
            for choice, held in held_by_choice.items()
            if held
        ]
        choices = ("single view, best free", "fused, best free")
        by_object += [
            [
                t.name,
                *(
                    rate([h for n, h in held_by_choice[choice] if n == t.name])
                    for choice in choices
                ),
            ]
            for t in models
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
    scores = scores_of(p, held.numpy() > 0.5)
    reliability(p, held.numpy(), RESULTS / "ffhnet-reliability.svg")
    parts += [
        f"The evaluator on {len(held)} tried grasps of nine unseen objects: of 256 candidates that "
        "are free, the four best and four at random, of ten views each (plot: "
        "ffhnet-reliability.svg).",
        table(
            ["ROC-AUC", "Brier", "ECE", "share that held"],
            [[f"{scores[k]:.3f}" for k in ("auc", "brier", "ece", "held")]],
        ),
    ]
    print(
        write(
            "ffhnet", "FFHNet", f"python -m benchmarks.ffhnet --views {options.views}", parts
        ).read_text(encoding="utf-8")
    )


if __name__ == "__main__":
    main()
