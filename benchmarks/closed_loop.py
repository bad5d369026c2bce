"""Success in closed loop by speed and object, beside the paper's, with Wilson intervals.

`python -m benchmarks.closed_loop conveyor [--jobs 2] [--trials N] [--seed 0] [--faultless]
[--table-v]`

Only outcomes are simulated, no causes. `dgeval simulate` and benchmarks.simulation give the causes
and take three times as long.
"""

from __future__ import annotations

import argparse
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from dgeval.determinism import limit_threads, set_thread_variables

set_thread_variables()

from dgeval.paper_values import CHOICE, CONTROL, OURS, departures  # noqa: E402
from dgeval.simulation.campaign import Campaign, plan_of, simulate  # noqa: E402
from dgeval.simulation.faults import Faults  # noqa: E402
from dgeval.simulation.scenario import Scenario, load_scenario  # noqa: E402

from benchmarks.result import table, write  # noqa: E402
from benchmarks.simulation import PUBLISHED, rates  # noqa: E402


def without_ours(scenario: Scenario) -> Scenario:
    """The scenario without the rules of ours of choice and control: Table V itself, but for c_e."""
    changed: dict[str, Any] = {}
    for name, inert in OURS.items():
        section, key = name.split(".")
        if section in (*CHOICE, *CONTROL):
            part = changed.get(section, getattr(scenario.pipeline, section))
            changed[section] = part.model_copy(update={key: inert})
    return scenario.model_copy(update={"pipeline": scenario.pipeline.model_copy(update=changed)})


def outcome(name: str, seed: int, index: int, faultless: bool, table_v: bool) -> dict[str, Any]:
    """Simulate one trial; returns its outcome as benchmarks.simulation.rates takes it."""
    limit_threads()
    scenario = without_ours(load_scenario(name)) if table_v else load_scenario(name)
    campaign = Campaign(scenario, seed, 1, Path("unused"))
    plan = plan_of(campaign, index)
    if faultless:
        plan = replace(plan, faults=Faults())
    run, _ = simulate(campaign, plan)
    held = run.finish is not None and run.finish.success
    ended = "held" if held else "never closed" if run.close is None else "closed and lost"
    best = max((t.score or 0.0 for t in run.ticks), default=0.0)
    print(f"{plan.id}: {ended}, best score {best:.2f}", flush=True)
    verdict = {"failure_class": None if held else ended, "speed": plan.speed, "object": plan.object}
    return {"verdict": {**verdict, "faults_present": plan.faults.present()}}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenario")
    parser.add_argument("--trials", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--faultless", action="store_true", help="no injected faults, as in the paper"
    )
    parser.add_argument(
        "--table-v",
        action="store_true",
        help="without the rules of ours of choice and control: Table V itself, but for c_e",
    )
    options = parser.parse_args()
    scenario = load_scenario(options.scenario)
    scenario = without_ours(scenario) if options.table_v else scenario
    trials = options.trials or scenario.trials
    with ProcessPoolExecutor(options.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        waiting = [
            pool.submit(
                outcome, options.scenario, options.seed, k, options.faultless, options.table_v
            )
            for k in range(trials)
        ]
        results = [w.result() for w in waiting]
    paper = PUBLISHED.get(scenario.plans_of or scenario.name, {})
    clean = [r for r in results if not r["verdict"]["faults_present"]]
    endings = [r["verdict"]["failure_class"] or "held" for r in results]
    rows = [[end, str(endings.count(end))] for end in ("held", "closed and lost", "never closed")]
    parts = [
        "Modelled perception stands in for TransT-M and ICP in the loop"
        + ("" if scenario.grasps == "ffhnet" else ", an analytic sampler and score for FFHNet")
        + f"; executed above a score of {scenario.pipeline.execution.c_e}; "
        + ("no injected faults" if options.faultless else "faults as in the scenario")
        + "; not as in the paper: "
        + (", ".join(departures(scenario.pipeline, (*CHOICE, *CONTROL))) or "nothing else")
        + ".",
        *([rates(results, paper, "speed")] if len(scenario.speeds) > 1 else []),
        rates(results, paper, "object"),
        table(["ended", "trials"], rows),
    ]
    if len(clean) < len(results):
        parts += [
            f"The {len(clean)} trials without an injected fault:",
            rates(clean, paper, "object"),
        ]
    command = (
        f"python -m benchmarks.closed_loop {options.scenario} --trials {trials} --seed "
        f"{options.seed}"
    )
    name = f"closed-loop-{options.scenario}"
    if options.faultless:
        name, command = f"{name}-faultless", f"{command} --faultless"
    if options.table_v:
        name, command = f"{name}-table-v", f"{command} --table-v"
    print(write(name, f"Closed loop: {options.scenario}", command, parts).read_text())


if __name__ == "__main__":
    main()
