"""Search the jaw grasps of the eight objects that the simulator ships: `python datasets/make_jaw_grasps.py [OBJECT…]`."""

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
    things = eight_objects()
    found = json.loads(FILE.read_text()) if FILE.exists() else {}
    for name in sys.argv[1:] or things:
        found[name] = [pose_from_matrix(T).round(5).tolist() for T in search(things[name], 30, 5)]
        print(f"{name}: {len(found[name])}")
        FILE.write_text(json.dumps(found, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
