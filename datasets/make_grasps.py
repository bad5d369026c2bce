"""Search grasps for the ten objects, or the named ones, for dgeval/simulation/known_grasps.json.

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

WANTED, TRIES, SEED = 24, 200_000, 11  # grasps per object, most candidates, seed


def searched(name: str) -> tuple[str, list[dict[str, object]]]:
    """The object's name, and its grasps as entries of the file."""
    grasps = search(ten_objects()[name], WANTED, SEED, TRIES)
    return name, [
        {
            "T_object_palm": [round(float(v), 6) for v in pose_from_matrix(g.T_object_palm)],
            "preshape": [round(float(v), 5) for v in g.preshape],
            "quality": round(g.quality, 3),
        }
        for g in grasps
    ]


if __name__ == "__main__":
    out = Path("dgeval/simulation/known_grasps.json")
    known = json.loads(out.read_text()) if out.exists() else {}
    names = sys.argv[1:] or list(ten_objects())
    with ProcessPoolExecutor(2) as pool:
        for name, grasps in pool.map(searched, names):
            print(name, len(grasps), [g["quality"] for g in grasps], flush=True)
            known[name] = grasps
    ordered = {name: known[name] for name in ten_objects() if name in known}
    out.write_text(json.dumps(ordered, separators=(",", ":")).replace("}],", "}],\n") + "\n")
