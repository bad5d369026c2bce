"""Manifests of the scenarios whose trials are all wanted, from the plans alone: python datasets/make_manifests.py

`dgeval simulate MANIFEST` then makes their recordings; hashes are in no manifest that wasn't rendered.
"""

from __future__ import annotations

from pathlib import Path

from dgeval.simulation.campaign import Campaign, plan_of, write_manifest
from dgeval.simulation.scenario import load_scenario

WHOLE = ("handover", "table-clearing", "turntable", "vfas-handover")


def main(out: Path = Path(__file__).parent) -> None:
    for name in WHOLE:
        scenario = load_scenario(name)
        campaign = Campaign(scenario, 0, scenario.trials, out)
        plans = [plan_of(campaign, k) for k in range(scenario.trials)]
        about = [
            {
                "id": p.id,
                "index": p.index,
                "verdict": {"object": p.object, "speed": p.nominal_speed},
            }
            for p in plans
        ]
        write_manifest(campaign, [(trial, None) for trial in about])


if __name__ == "__main__":
    main()
