"""Tables about simulated campaigns: success by speed beside the paper, shares of classes, seconds, stability of the class.

dgeval simulate conveyor --no-images --out runs/conveyor
python -m benchmarks.simulation runs/conveyor/simulated.json [--stability N]
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from dgeval.report.statistics import wilson

from benchmarks.result import table, write

# success rates of the paper's Table II (conveyor), by belt speed mm/s, ten objects each
PAPER = {0: 90, 20: 90, 40: 70, 60: 50, 80: 60, 100: 50, 120: 70, 140: 80, 160: 80, 180: 90, 200: 80, 220: 50}
KINDS = ("success", "imprecise_pose", "collision", "timing")


def kind(result: dict[str, Any]) -> str:
    return result["verdict"]["failure_class"] or "success"


def by_speed(results: list[dict[str, Any]]) -> str:
    rows = []
    speeds = sorted({round(abs(r["verdict"]["speed"]) * 1000) for r in results})
    for speed in [*speeds, None]:
        some = [r for r in results if speed is None or round(abs(r["verdict"]["speed"]) * 1000) == speed]
        k = sum(kind(r) == "success" for r in some)
        low, high = wilson(k, len(some))
        interval = f"{100 * low:.0f}–{100 * high:.0f} %"
        printed = f"{PAPER[speed]} %" if speed in PAPER else ("71.7 %" if speed is None else "–")
        rows.append([str(speed) if speed is not None else "all", f"{k}/{len(some)}", interval, printed])
    return table(["belt mm/s", "succeeded", "95 % Wilson", "paper, Table II"], rows)


def shares(results: list[dict[str, Any]]) -> str:
    counts = Counter(kind(r) for r in results)
    failures = len(results) - counts["success"]
    near = Counter(kind(r) for r in results if r["verdict"]["near_threshold"])
    rows = [
        [k, str(counts[k]), "–" if k == "success" else f"{100 * counts[k] / max(failures, 1):.0f} %", str(near[k])]
        for k in KINDS
    ]
    return table(["kind", "trials", "share of failures", "class changes when a threshold moves by 20 %"], rows)


def seconds(results: list[dict[str, Any]]) -> str:
    parts = sorted({p for r in results for p in r["seconds"]})
    rows = [
        [p, *(f"{f([r['seconds'].get(p, 0.0) for r in results]):.1f}" for f in (np.mean, np.median, np.max))] for p in parts
    ]
    return table(["part", "mean s", "median s", "largest s"], rows)


def stability(results: list[dict[str, Any]], n: int) -> str:
    """The class of the first n failures of each kind again, from starts different by ±1 mm, ±3 mm/s, ±10 ms, three times."""
    from dgeval.physics.objects import ten_objects
    from dgeval.simulation.blame import jittered
    from dgeval.simulation.campaign import Campaign, simulate
    from dgeval.simulation.scenario import load_scenario, plan_trial
    from dgeval.simulation.truth import prove

    rows = []
    for wanted in KINDS[1:]:
        some = [r for r in results if kind(r) == wanted][:n]
        found: Counter[str] = Counter()
        for r in some:
            v = r["verdict"]
            scenario = load_scenario(v["scenario"])
            campaign = Campaign(scenario, v["seed"], 1, Path("unused"))
            plan = plan_trial(scenario, ten_objects(), v["seed"], v["index"])
            for k in range(3):
                run, world = simulate(campaign, jittered(plan, k))
                truth = prove(run, world, near=False)
                found[truth.failure_class or "success"] += 1
        rows.append([wanted, str(3 * len(some)), *(str(found[k]) for k in KINDS)])
    return table(["class", "re-runs", *KINDS], rows)


def main() -> None:
    path = Path(sys.argv[1])
    results = json.loads(path.read_text())["simulated"]
    name = results[0]["verdict"]["scenario"]
    notes = (
        "Stood in: modelled perception for TransT-M and ICP in the loop, an analytic sampler and score for FFHNet; "
        f"servo gains {results[0]['verdict']['gains']}; faults as in the scenario."
    )
    parts = [notes, by_speed(results), shares(results), seconds(results)]
    command = f"python -m benchmarks.simulation {path.name}"
    if "--stability" in sys.argv:
        n = int(sys.argv[sys.argv.index("--stability") + 1])
        parts += [f"Class of re-runs with ±1 mm, ±3 mm/s, ±10 ms, the first {n} failures of each class:", stability(results, n)]
        command += f" --stability {n}"
    print(write(f"simulation-{name}", f"Simulated campaign: {name}", command, parts).read_text())


if __name__ == "__main__":
    main()
