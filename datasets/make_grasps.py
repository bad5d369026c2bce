"""Search grasps for the ten objects, or those named, and put them into dgeval/simulation/known_grasps.json.

python datasets/make_grasps.py [OBJECT...]      # all: some 25 minutes on two cores
"""

from __future__ import annotations

import json
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from dgeval.determinism import set_thread_variables

set_thread_variables()

from dgeval.geometry import pose_from_matrix
from dgeval.simulation.grasps import search
from dgeval.worlds.objects import ten_objects

WANTED, TRIES, SEED = 24, 200_000, 11


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
    out = Path("dgeval/simulation/known_grasps.json")
    known = json.loads(out.read_text()) if out.exists() else {}
    names = sys.argv[1:] or list(ten_objects())
    with ProcessPoolExecutor(2) as pool:
        for name, found in pool.map(of, names):
            print(name, len(found), [g["quality"] for g in found], flush=True)
            known[name] = found
    ordered = {name: known[name] for name in ten_objects() if name in known}
    out.write_text(json.dumps(ordered, separators=(",", ":")).replace("}],", "}],\n") + "\n")
