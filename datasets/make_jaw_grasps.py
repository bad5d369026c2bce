"""Search the jaw grasps of the eight objects for dgeval/simulation/known_jaw_grasps.json.

python datasets/make_jaw_grasps.py [OBJECT…]
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from dgeval.determinism import set_thread_variables

set_thread_variables()

from dgeval.determinism import limit_threads
from dgeval.geometry import pose_from_matrix
from dgeval.simulation.jaw_grasps import search
from dgeval.worlds.objects import eight_objects

FILE = Path(__file__).parents[1] / "dgeval" / "simulation" / "known_jaw_grasps.json"


def main() -> None:
    limit_threads()
    models = eight_objects()
    grasps = json.loads(FILE.read_text()) if FILE.exists() else {}
    for name in sys.argv[1:] or models:
        grasps[name] = [pose_from_matrix(T).round(5).tolist() for T in search(models[name], 30, 5)]
        print(f"{name}: {len(grasps[name])}")
        FILE.write_text(json.dumps(grasps, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
