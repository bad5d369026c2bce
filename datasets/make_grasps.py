"""Search grasps for the ten objects and write dgeval/simulation/known_grasps.json (some minutes on two cores)."""

from __future__ import annotations

import json
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from dgeval.determinism import set_thread_variables

set_thread_variables()

from dgeval.geometry import pose_from_matrix  # noqa: E402
from dgeval.physics.objects import ten_objects  # noqa: E402
from dgeval.simulation.grasps import search  # noqa: E402

WANTED, TRIES, SEED = 24, 120_000, 11


def of(name: str) -> tuple[str, list[dict[str, object]]]:
    found = search(ten_objects()[name], WANTED, SEED, TRIES)
    return name, [
        {
            "T_object_palm": [round(float(v), 6) for v in pose_from_matrix(g.T_object_palm)],
            "preshape": [round(float(v), 5) for v in g.preshape],
            "quality": round(g.quality, 3),
        }
        for g in found
    ]


if __name__ == "__main__":
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "dgeval/simulation/known_grasps.json")
    with ProcessPoolExecutor(2) as pool:
        grasps = {}
        for name, found in pool.map(of, ten_objects()):
            print(name, len(found), [g["quality"] for g in found], flush=True)
            grasps[name] = found
    out.write_text(json.dumps(grasps, indent=None, separators=(",", ":")).replace("}],", "}],\n") + "\n")
