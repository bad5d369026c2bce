"""Parts of VFAS-Grasp alone.

The evaluator on unseen objects, its spread against true robustness, its time, and the jumps of the
seed with each part left out.

`python -m benchmarks.vfas_parts [--seeds 6] [--trials 4]`
"""

from __future__ import annotations

import argparse
import time
from typing import Any

from dgeval.determinism import generator, limit_threads, set_thread_variables

set_thread_variables()

from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402
import torch  # noqa: E402
from dgeval.geometry import increment, invert  # noqa: E402
from dgeval.networks.pointnet2 import PUBLIC, VFAS, GraspEvaluator  # noqa: E402
from dgeval.planning.vfas.loop import evaluator_of  # noqa: E402
from dgeval.planning.vfas.selection import GraspJudge, perturbed  # noqa: E402
from dgeval.robots.parallel_jaw import link_points  # noqa: E402
from dgeval.simulation.campaign import Campaign, plan_of, simulate  # noqa: E402
from dgeval.simulation.jaw_grasps import FlyingJaw, between_fingers, seed_pose  # noqa: E402
from dgeval.simulation.render import Renderer  # noqa: E402
from dgeval.simulation.scenario import load_scenario  # noqa: E402
from dgeval.simulation.sensors import D405  # noqa: E402
from dgeval.training.jaw_data import CAMERAS, scenes_of, view  # noqa: E402
from dgeval.training.vfas import measure  # noqa: E402
from dgeval.worlds.objects import at, eight_objects, procedural_object, surface_points  # noqa: E402
from scipy.stats import spearmanr  # noqa: E402

from benchmarks.result import number, table, write  # noqa: E402
from benchmarks.vfas import jumps, scenario_of, seed_pairs  # noqa: E402

UNSEEN = range(63, 72)  # procedural objects that no network was trained on
REPETITIONS = 8  # tries of each grasp in physics
WITHOUT: dict[str, dict[str, Any]] = {
    "as shipped": {},
    "no penalty": {"k1": 0.0, "k2": 0.0},
    "no filter": {"low_pass": False},
    "no motion field": {"motion_field": False},
    "the seed no candidate (as the paper writes it)": {"keep_seed": False},
}


def quality_by_set(seeds: int) -> str:
    """Table of the evaluator's quality on each set of objects."""
    rows = []
    network = evaluator_of(None)
    sets = {
        "nine procedural objects that trained nothing": [procedural_object(i, 0) for i in UNSEEN],
        "the paper's eight": list(eight_objects().values()),
    }
    for name, models in sets.items():
        scenes = [s for t in models for s in scenes_of(t, procedural_object(1003, 0), 7, seeds)]
        scores = measure(network, scenes, 1500, 1)
        poses = str(sum(len(s.held) for s in scenes))
        rows.append([name, poses, *(number(scores[k], 3) for k in ("held", "auc", "brier", "ece"))])
    return table(["", "poses", "held", "ROC-AUC", "Brier", "ECE"], rows)


def spread_against_robustness(per_object: int) -> str:
    """Text on free grasps of unseen objects: spread of the score against robustness.

    spread: of the score over noisy clouds. robustness: share of slightly moved repetitions that
    hold.
    """
    config = load_scenario("table-clearing").pipeline.vfas
    judge = GraspJudge(evaluator_of(None), config)
    spread, quality, robust = [], [], []
    for index in UNSEEN:
        model = procedural_object(index, 0)
        world = FlyingJaw(model, procedural_object(index + 1000, 0), CAMERAS)
        surface = surface_points(model, 6000, generator(7, "surface", index))
        T_base_object = at(0.5, 0, model.rest_height())
        with Renderer(world, (CAMERAS[0], CAMERAS[1]), D405, 7, 0) as renderer:
            tried = 0
            for k in range(400):
                rng = generator(7, f"robust/{model.name}", k)
                T_object_seed = seed_pose(surface, rng)
                if tried == per_object or T_object_seed is None:
                    continue
                T = perturbed(
                    (T_base_object @ T_object_seed)[None], np.full(3, 0.01), np.radians(5), rng
                )[0]
                if (
                    not all(world.approach_free(T))
                    or between_fingers(surface, invert(T) @ T_base_object) < 4
                ):
                    continue
                tried += 1
                points, grazing, _ = view(world, renderer, T, rng)
                cloud = rng.permutation(points[~grazing])
                copies = [cloud + rng.normal(0, config.noise, cloud.shape) for _ in range(5)]
                noisy = judge.quality(copies, np.eye(4)[None])
                held = 0
                for _ in range(REPETITIONS):
                    world.put(
                        T
                        @ increment(
                            np.concatenate(
                                [rng.normal(0, 0.004, 3), rng.normal(0, np.radians(3), 3)]
                            )
                        )
                    )
                    held += not any(world.touches()) and world.lifts()
                spread.append(float(np.ptp(noisy)))
                quality.append(float(noisy.mean()))
                robust.append(held / REPETITIONS)
    s, q, r = np.array(spread), np.array(quality), np.array(robust)
    certain = np.abs(r - 0.5) > 0.4  # nearly all repetitions hold, or nearly none
    lines = [
        f"{len(r)} free grasps of the nine, each tried {REPETITIONS} times 4 mm and 3 degrees off "
        "(1 sigma); robustness is the share that held. Spearman's correlation of quality with it "
        f"{spearmanr(q, r)[0]:.2f}; of the spread with how undecided it is (1 - |2 r - 1|) "
        f"{spearmanr(s, 1 - np.abs(2 * r - 1))[0]:.2f}. Mean spread where all or none hold "
        f"{s[certain].mean():.2f}, in between {s[~certain].mean():.2f}."
    ]
    return "\n".join(lines)


def times() -> str:
    """Table of the evaluator's time per batch of grasps."""
    rows = []
    rng = np.random.default_rng(0)
    for name, sizes, n in (
        ("shipped", VFAS, 104),
        ("shipped", VFAS, 320),
        ("public size", PUBLIC, 32),
    ):
        network = evaluator_of(None) if sizes is VFAS else GraspEvaluator(sizes).eval()
        scene = torch.from_numpy(
            (rng.uniform(-1, 1, (n, sizes.scene, 3)) * [0.1, 0.05, 0.06]).astype(np.float32)
        )
        gripper = torch.from_numpy(link_points(sizes.gripper, rng).astype(np.float32))[None]
        network.success(scene, gripper)
        seconds = []
        for _ in range(9):
            start = time.perf_counter()
            network.success(scene, gripper)
            seconds.append(time.perf_counter() - start)
        batch = {104: "64 + 8 x 5 (`top8`)", 320: "64 x 5 (`all`)", 32: "32"}[n]
        rows.append(
            [
                name,
                batch,
                number(1e3 * float(np.median(seconds)), 0),
                number(1 / float(np.median(seconds)), 1),
            ]
        )
    return table(["network", "grasps", "ms, one core", "per second"], rows)


def left_out(trials: int) -> str:
    """Table of the seed's jump per iteration in closed loop, and of the trials that held."""
    rows = []
    for name in ("table-clearing", "turntable"):
        for variant, changes in WITHOUT.items():
            changed = scenario_of(name, changes)
            held, metres, degrees = 0, [], []
            for k in range(trials):
                campaign = Campaign(changed, 1, 1, Path("unused"))
                run, _ = simulate(
                    campaign, plan_of(campaign, k + (8 if name == "turntable" else 0))
                )
                held += run.finish is not None and run.finish.success
                each = [jumps([pair]) for pair in seed_pairs(run)]
                metres += [m for m, _ in each if m is not None]
                degrees += [d for _, d in each if d is not None]
            quantiles = [
                np.median(metres),
                np.quantile(metres, 0.95),
                np.median(degrees),
                np.quantile(degrees, 0.95),
            ]
            rows.append(
                [name, variant, *(number(float(v), 2) for v in quantiles), f"{held}/{trials}"]
            )
            print(rows[-1], flush=True)
    return table(["", "", "jump mm", "95 %", "jump deg", "95 %", "held"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=6, help="views per object, each with 24 poses")
    parser.add_argument(
        "--trials", type=int, default=4, help="of each scenario with each part left out"
    )
    options = parser.parse_args()
    limit_threads()
    parts = [
        "## Evaluator",
        "Random poses round seeds, labels from physics, clouds of exact depth with the training's "
        "noise.",
        quality_by_set(options.seeds),
        "## Spread and robustness",
        spread_against_robustness(4 * options.seeds),
        "## Time",
        times(),
        "## Jump of the selected grasp from iteration to iteration, closed loop, seed 1",
        left_out(options.trials),
    ]
    command = f"python -m benchmarks.vfas_parts --seeds {options.seeds} --trials {options.trials}"
    print(write("vfas-parts", "VFAS-Grasp's parts", command, parts).read_text())


if __name__ == "__main__":
    main()
