"""Write manifests of the scenarios in WHOLE from their plans, without simulating.

`dgeval simulate MANIFEST` makes their recordings. These manifests hold no hashes, because nothing
is rendered.

    python datasets/make_manifests.py
"""

from __future__ import annotations

from pathlib import Path

from dgeval.simulation.campaign import Campaign, plan_of, write_manifest
from dgeval.simulation.scenario import load_scenario

# Scenarios whose manifest holds all their trials
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
