"""Tables of a simulated campaign.

Success by speed and object beside the paper's, shares of the failure classes, computing times, and
how stable the class is.

dgeval simulate conveyor --no-images --out runs/conveyor
python -m benchmarks.simulation runs/conveyor/simulated.json [--stability N]
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from dgeval.statistics import wilson

from benchmarks.result import table, write

PUBLISHED = json.loads(
    (resources.files("dgeval.report") / "published" / "papers.json").read_text(encoding="utf-8")
)
KINDS = ("success", "imprecise_pose", "collision", "timing")


def kind(result: dict[str, Any]) -> str:
    return result["verdict"]["failure_class"] or "success"


def rates(results: list[dict[str, Any]], paper: dict[str, Any], by: str) -> str:
    """Success by `speed` (belt mm/s) or `object`, beside the paper's counts."""

    def group(r: dict[str, Any]) -> str:
        v = r["verdict"]
        return str(round(abs(v["speed"]) * 1000)) if by == "speed" else str(v["object"])

    key, each = ("speed_mm_s", "n_per_speed") if by == "speed" else ("object", "n_per_object")
    counts = paper.get(key, {})
    names = list(dict.fromkeys(group(r) for r in results))
    if by == "speed":
        names.sort(key=int)
    rows = []
    for name in [*names, None]:
        group_results = [r for r in results if name is None or group(r) == name]
        k = sum(kind(r) == "success" for r in group_results)
        low, high = wilson(k, len(group_results))
        printed = "–"
        if name is None:
            printed = f"{paper['printed']['overall']} %" if paper else "–"
        elif name in counts:
            printed = f"{100 * counts[name] / paper[each]:.0f} %"
        rows.append(
            [
                name or "all",
                f"{k}/{len(group_results)}",
                f"{100 * low:.0f}–{100 * high:.0f} %",
                printed,
            ]
        )
    return table(["belt mm/s" if by == "speed" else by, "succeeded", "95 % Wilson", "paper"], rows)


def shares(results: list[dict[str, Any]]) -> str:
    counts = Counter(kind(r) for r in results)
    failures = len(results) - counts["success"]
    near_threshold = Counter(kind(r) for r in results if r["verdict"]["near_threshold"])
    rows = [
        [
            k,
            str(counts[k]),
            "–" if k == "success" else f"{100 * counts[k] / max(failures, 1):.0f} %",
            str(near_threshold[k]),
        ]
        for k in KINDS
    ]
    return table(
        ["kind", "trials", "share of failures", "class changes when a threshold moves by 20 %"],
        rows,
    )


def seconds(results: list[dict[str, Any]]) -> str:
    parts = sorted({p for r in results for p in r["seconds"]})
    rows = [
        [
            p,
            *(
                f"{f([r['seconds'].get(p, 0.0) for r in results]):.1f}"
                for f in (np.mean, np.median, np.max)
            ),
        ]
        for p in parts
    ]
    return table(["part", "mean s", "median s", "largest s"], rows)


def stability(results: list[dict[str, Any]], n: int, name: str) -> str:
    """Classes of re-runs of the first n failures of each class.

    Each is simulated three times with its start changed by ±1 mm, ±3 mm/s, ±10 ms. name: of the
    simulated scenario, as its file is named; the recorded name is that of the scenario whose plans
    it uses.
    """
    from dgeval.simulation.blame import jittered
    from dgeval.simulation.campaign import Campaign, simulate
    from dgeval.simulation.scenario import load_scenario, plan_trial
    from dgeval.simulation.truth import prove
    from dgeval.worlds.objects import ten_objects

    rows = []
    for failure_class in KINDS[1:]:
        failures = [r for r in results if kind(r) == failure_class][:n]
        classes: Counter[str] = Counter()
        for r in failures:
            v = r["verdict"]
            scenario = load_scenario(name)
            campaign = Campaign(scenario, v["seed"], 1, Path("unused"))
            plan = plan_trial(scenario, ten_objects(), v["seed"], v["index"])
            for k in range(3):
                run, world = simulate(campaign, jittered(plan, k))
                truth = prove(run, world, labels_only=True)
                classes[truth.failure_class or "success"] += 1
        rows.append([failure_class, str(3 * len(failures)), *(str(classes[k]) for k in KINDS)])
    return table(["class", "re-runs", *KINDS], rows)


def main() -> None:
    path = Path(sys.argv[1])
    results = json.loads(path.read_text())["simulated"]
    verdict = results[0]["verdict"]
    name, grasps = verdict["scenario"], verdict.get("grasps", "analytic")
    paper = PUBLISHED.get(name, {})
    stand_in = (
        "an analytic sampler and score for FFHNet"
        if grasps == "analytic"
        else "nothing for FFHNet, whose weights are ours"
    )
    notes = (
        f"Stood in: modelled perception for TransT-M and ICP in the loop, {stand_in}; "
        "faults as in the scenario."
    )
    clean = [r for r in results if not r["verdict"]["faults_present"]]
    parts = [notes, rates(results, paper, "speed"), rates(results, paper, "object")]
    parts += (
        [f"Of the {len(clean)} trials without an injected fault:", rates(clean, paper, "object")]
        if clean
        else []
    )
    parts += [shares(results), seconds(results)]
    suffix = "" if grasps == "analytic" else f"-{grasps}"
    command = f"python -m benchmarks.simulation {path.name}"
    if "--stability" in sys.argv:
        n = int(sys.argv[sys.argv.index("--stability") + 1])
        parts += [
            f"Class of re-runs with ±1 mm, ±3 mm/s, ±10 ms, the first {n} failures of each class:",
            stability(results, n, next(path.parent.glob("*.toml")).stem),
        ]
        command += f" --stability {n}"
    print(
        write(
            f"simulation-{name}{suffix}", f"Simulated campaign: {name}", command, parts
        ).read_text()
    )


if __name__ == "__main__":
    main()
