"""VFAS-Grasp's tables in simulation, with Wilson intervals and exact McNemar tests.

Static objects before and after refinement, turntable with and without adaptive sampling, handover.

`python -m benchmarks.vfas [--jobs 2] [--seed 0] [--only static,turntable,handover] [--delay MS]
[--contact-graspnet current.pth]`

Outcomes of finished trials are kept in OUT (default runs/vfas) and not simulated again. The causes
of failures come from `dgeval simulate table-clearing` and so on.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

from dgeval.determinism import limit_threads, set_thread_variables

set_thread_variables()

import numpy as np  # noqa: E402
from dgeval.compare.paired import mcnemar  # noqa: E402
from dgeval.geometry import Array, rotation_angle  # noqa: E402
from dgeval.simulation.campaign import Campaign, plan_of, simulate  # noqa: E402
from dgeval.simulation.scenario import Scenario, load_scenario  # noqa: E402
from dgeval.simulation.trial import Run  # noqa: E402
from dgeval.statistics import wilson  # noqa: E402

from benchmarks.result import number, source_digest, table, write  # noqa: E402

OFF = {"adaptive": False, "motion_field": False}  # the paper's "adaptive sampling disabled"
ARMS: dict[str, tuple[str, dict[str, Any]]] = {
    "static, seed as given": ("table-clearing", {"refine": False}),
    "static, VFAS": ("table-clearing", {}),
    "turntable, adaptive off": ("turntable", OFF),
    "turntable, adaptive on": ("turntable", {}),
    "handover": ("vfas-handover", {}),
}
PAPER = {
    "static, seed as given": (72, 120),
    "static, VFAS": (101, 120),
    "turntable, adaptive off": (38, 60),
    "turntable, adaptive on": (51, 60),
    "handover": (77, 96),
}


ENDS = ("held", "lost", "never closed", "no seed in reach")
STAND_INS = (
    "Seeds are known grasps with a drawn error (15 mm and 6 degrees on each axis, 1 sigma) in "
    "place of Contact-GraspNet's; DIS stands in for GMFlow; the evaluator is dgeval's own; fingers "
    "slide. Intervals: Wilson, 95 %."
)
BY_CONTACTS = (
    "Seeds are Contact-GraspNet's (cgn-pytorch), on the target's true mask in place of Mask "
    "R-CNN's, ranked by the arm's joint limits; DIS stands in for GMFlow; the evaluator is "
    "dgeval's own; fingers slide. Intervals: Wilson, 95 %."
)


def scenario_of(
    name: str, changes: dict[str, Any], delay_ms: int, contact_graspnet: str | None
) -> Scenario:
    """A scenario with other values in its `vfas` section, and a planner that takes delay_ms.

    contact_graspnet: weights of the network that gives the seeds; None: known grasps.
    """
    scenario = load_scenario(name)
    changes = changes | {"contact_graspnet": contact_graspnet}
    vfas = scenario.pipeline.vfas.model_copy(update=changes)
    schedule = scenario.pipeline.schedule.model_copy(
        update={"perception_latency_s": delay_ms / 1000}
    )
    pipeline = scenario.pipeline.model_copy(update={"vfas": vfas, "schedule": schedule})
    return scenario.model_copy(update={"pipeline": pipeline})


def outcome(
    arm: str, seed: int, index: int, out: Path, delay_ms: int, contact_graspnet: str | None
) -> dict[str, Any]:
    """Simulate one trial, or read its kept result.

    ended: one of ENDS. jump_mm, jump_deg: median jump of the selected grasp during the approach.
    """
    limit_threads()
    scenario = scenario_of(*ARMS[arm], delay_ms, contact_graspnet)
    campaign = Campaign(scenario, seed, 1, out)
    plan = plan_of(campaign, index)
    folder = arm.replace(", ", "-").replace(" ", "-") + (f"-{delay_ms}ms" if delay_ms else "")
    folder += "-contact-graspnet" if contact_graspnet else ""
    path = out / folder / f"{plan.id}.json"
    if path.is_file():
        kept: dict[str, Any] = json.loads(path.read_text())
        if kept["sources"] == source_digest():
            return kept
    run, _ = simulate(campaign, plan)
    held = run.finish is not None and run.finish.success
    ended = (
        "held"
        if held
        else "no seed in reach"
        if len(run.ticks) < 2
        else "never closed"
        if run.close is None
        else "lost"
    )
    metres, degrees = jumps(seed_pairs(run))
    result = {
        "id": plan.id,
        "object": plan.object,
        "group": plan.id.split("-")[1] if plan.turn is not None else "",
        "ended": ended,
        "jump_mm": metres,
        "jump_deg": degrees,
        "sources": source_digest(),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(result))
    print(f"{arm}: {plan.id}: {ended}", flush=True)
    return result


def seed_pairs(run: Run) -> list[tuple[Array, Array]]:
    """(T_base_grasp of an iteration, of the next one) for each iteration with a new seed."""
    poses = [run.ticks[f.tick].T_base_grasp for f in run.frames if f.tick < len(run.ticks)]
    return [(a, b) for a, b in pairwise(poses) if a is not None and b is not None and b is not a]


def jumps(pairs: Sequence[tuple[Array, Array]]) -> tuple[float | None, float | None]:
    """Median distance, mm, and angle, degrees, between the poses of each pair; None if no pair."""
    if not pairs:
        return None, None
    metres = [np.linalg.norm(b[:3, 3] - a[:3, 3]) for a, b in pairs]
    angles = [rotation_angle(a[:3, :3].T @ b[:3, :3]) for a, b in pairs]
    return float(1e3 * np.median(metres)), float(np.degrees(np.median(angles)))


def share(held: int, n: int) -> str:
    low, high = wilson(held, n)
    return f"{held}/{n} = {100 * held / max(n, 1):.0f} % [{100 * low:.0f}–{100 * high:.0f}]"


def by(results: dict[str, list[dict[str, Any]]], key: str) -> str:
    """Success of each arm by a column of the results."""
    values = sorted({r[key] for rows in results.values() for r in rows})
    rows = []
    for arm, arm_results in results.items():
        cells = []
        for value in [*values, None]:
            selected = [r for r in arm_results if value is None or r[key] == value]
            cells.append(
                share(sum(r["ended"] == "held" for r in selected), len(selected))
                if selected
                else "–"
            )
        paper = PAPER[arm]
        rows.append([arm, *cells, f"{paper[0]}/{paper[1]} = {100 * paper[0] / paper[1]:.0f} %"])
    return table(["", *[str(v) for v in values], "all", "paper"], rows)


def middle(results: list[dict[str, Any]], key: str) -> str:
    """Median of a column over the trials that have a value, as text."""
    values = [r[key] for r in results if r[key] is not None]
    return number(float(np.median(values)), 2) if values else "–"


def paired(results: dict[str, list[dict[str, Any]]], before: str, after: str) -> str:
    old, new = ([r["ended"] == "held" for r in results[arm]] for arm in (before, after))
    worse, better, p = mcnemar(old, new)
    return (
        f"{before} → {after}, the same {len(old)} trials: {better} won, {worse} lost, exact "
        f"McNemar p = {p:.2g}."
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--trials", type=int, help="of each arm; default: the paper's number")
    parser.add_argument("--only", default="static,turntable,handover")
    parser.add_argument(
        "--delay", type=int, default=0, help="ms from an image to the planner's answer"
    )
    parser.add_argument(
        "--contact-graspnet", help="its weights, for seeds of the static arms; default: known ones"
    )
    parser.add_argument("--out", type=Path, default=Path("runs/vfas"))
    options = parser.parse_args()
    weights: str | None = options.contact_graspnet
    arms = [a for a in ARMS if a.split(",")[0] in options.only.split(",")]
    with ProcessPoolExecutor(options.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        waiting = {
            arm: [
                pool.submit(outcome, arm, options.seed, k, options.out, options.delay, weights)
                for k in range(options.trials or load_scenario(ARMS[arm][0]).trials)
            ]
            for arm in arms
        }
        results = {arm: [w.result() for w in results_of] for arm, results_of in waiting.items()}
    for kind in options.only.split(","):
        results_of = {arm: rows for arm, rows in results.items() if arm.split(",")[0] == kind}
        parts = [STAND_INS if weights is None else BY_CONTACTS, by(results_of, "object")]
        if kind == "turntable":
            parts.append("By nominal speed, mm/s:\n\n" + by(results_of, "group"))
        if len(results_of) == 2:
            parts.append(paired(results_of, *results_of))
        rows = [
            [
                arm,
                *[str(sum(r["ended"] == e for r in arm_results)) for e in ENDS],
                middle(arm_results, "jump_mm"),
                middle(arm_results, "jump_deg"),
            ]
            for arm, arm_results in results_of.items()
        ]
        parts += [
            "How they ended, and the median jump of the seed:",
            table(["", *ENDS, "jump mm", "jump deg"], rows),
        ]
        command = f"python -m benchmarks.vfas --only {kind} --seed {options.seed}"
        command += f" --trials {options.trials}" if options.trials else ""
        name, title = f"vfas-{kind}", f"VFAS-Grasp in closed loop: {kind}"
        if options.delay:
            command += f" --delay {options.delay}"
            name, title = f"{name}-{options.delay}ms", f"{title}, {options.delay} ms late"
        if weights is not None:
            command += f" --contact-graspnet {Path(weights).name}"
            name, title = f"{name}-contact-graspnet", f"{title}, seeds by Contact-GraspNet"
        print(write(name, title, command, parts).read_text())


if __name__ == "__main__":
    main()
