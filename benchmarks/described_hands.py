"""The known hands by their descriptions alone: `python -m benchmarks.described_hands`.

Simulated failures, physics first (see `benchmarks.verdict`), are judged three times: with the hand
that dgeval knows, with it and other draws, and with the hand that the recorded description gives.
What two seeds of draws differ by is what an equal hand may differ by.
"""

from __future__ import annotations

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import dgeval.worlds  # noqa: F401  # isort: skip  (it chooses how images are drawn before mujoco is imported)
from dgeval.config import VerdictConfig
from dgeval.determinism import limit_threads
from dgeval.failure_rule import CLASSES, Thresholds, Unknown
from dgeval.simulation.campaign import Campaign, grasps_of, plan_of, simulate, world_of
from dgeval.simulation.perception import ModelledPerception
from dgeval.simulation.scenario import load_scenario
from dgeval.simulation.trial import run_trial
from dgeval.simulation.truth import prove
from dgeval.statistics import confusion, macro_f1, wilson
from dgeval.verdict.draws import decide_scene
from dgeval.verdict.evidence import scene_of

from benchmarks.modelled import hindsight_of_run, log_of_run
from benchmarks.result import RESULTS, table, write
from benchmarks.verdict import MIN_TICKS

WAYS = ("by name", "by name, other draws", "by description")


def judge(job: tuple[str, int, int]) -> dict[str, Any]:
    """One trial: the truth, and the class by each of WAYS if it failed."""
    limit_threads()
    name, seed, index = job
    scenario = load_scenario(name).model_copy(update={"choose": None})
    campaign = Campaign(scenario, seed, 1, Path("unused"))
    plan = plan_of(campaign, index)
    if scenario.vfas:
        run, world = simulate(campaign, plan)
    else:
        world = world_of(campaign, plan)
        perceiver = ModelledPerception(scenario, plan, world)
        run = run_trial(plan, scenario, world, grasps_of(campaign, plan), perceiver)
    out: dict[str, Any] = {"scenario": name, "seed": seed, "index": index}
    if (run.finish is not None and run.finish.success) or len(run.ticks) < MIN_TICKS:
        return out
    truth = prove(run, world, Thresholds())
    if truth.outcome != "failure":
        return out
    out["truth"] = truth.failure_class
    for way in WAYS:
        log = log_of_run(run, world, scenario.pipeline)
        if way == "by description":
            log.robot.__dict__["hand_found"] = log.robot.hand_by_description
        hindsight = hindsight_of_run(run, world, log, seed)
        start = time.process_time()
        scene = Unknown("never tracked") if hindsight is None else scene_of(log, hindsight)
        answer: Any = scene
        if not isinstance(scene, Unknown):
            of_draws = 1 if way == "by name, other draws" else 0
            least = VerdictConfig().least
            answer = decide_scene(scene, "twin", VerdictConfig().draws, of_draws, least)
            answer = answer if isinstance(answer, Unknown) else answer.answer
        out[way] = {
            "class": "unknown" if isinstance(answer, Unknown) else answer.failure_class,
            "why": answer.reason if isinstance(answer, Unknown) else None,
            "seconds": time.process_time() - start,
        }
    return out


def tables(rows: list[dict[str, Any]]) -> str:
    """Markdown of one scenario's failures."""
    failed = [r for r in rows if "truth" in r]
    truth = [r["truth"] for r in failed]
    lines = []
    for way in WAYS:
        said = [r[way]["class"] for r in failed]
        f1, low, high = macro_f1(truth, said, CLASSES)
        same = sum(a == r["by name"]["class"] for a, r in zip(said, failed, strict=True))
        share = wilson(same, len(failed))
        lines.append([
            way, str(len(failed)), str(said.count("unknown")),
            f"{f1:.2f} [{low:.2f}, {high:.2f}]",
            f"{same / len(failed):.2f} [{share[0]:.2f}, {share[1]:.2f}]",
            f"{sum(r[way]['seconds'] for r in failed) / len(failed):.1f}",
        ])  # fmt: skip
    head = ["hand", "failures", "unknown", "macro-F1", "as by name", "CPU s"]
    parts = [table(head, lines)]
    for way in ("by name", "by description"):
        said = [r[way]["class"] for r in failed]
        parts.append(f"{way}, truth in rows:")
        classes = [*CLASSES, "unknown"]
        matrix = confusion(truth, said, classes)[:3]
        parts.append(
            table(
                ["", *classes],
                [[c, *map(str, row)] for c, row in zip(CLASSES, matrix, strict=True)],
            )
        )
    return "\n\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenario", action="append", help="default: failures, turntable")
    parser.add_argument("--seed", type=int, default=5100)
    parser.add_argument("--trials", type=int, default=60)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=RESULTS / "described_hands.md")
    options = parser.parse_args()
    scenarios = options.scenario or ["failures", "turntable"]
    parts = []
    with (
        ProcessPoolExecutor(options.jobs) as pool,
        options.out.with_suffix(".jsonl").open("w") as file,
    ):
        for scenario in scenarios:
            rows = []
            for row in pool.map(
                judge, [(scenario, options.seed, k) for k in range(options.trials)]
            ):
                rows.append(row)
                file.write(json.dumps(row) + "\n")
                file.flush()
            parts.append(f"## {scenario}\n\n{tables(rows)}")
    command = f"python -m benchmarks.described_hands --seed {options.seed}"
    command += f" --trials {options.trials}"
    command += "".join(f" --scenario {s}" for s in options.scenario or ())
    title = "The known hands by their descriptions alone"
    print(write(options.out.stem, title, command, parts, options.out.parent).read_text("utf-8"))


if __name__ == "__main__":
    main()
