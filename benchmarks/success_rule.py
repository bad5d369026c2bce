"""How many labels of grasps change with the rule of success.

`python -m benchmarks.success_rule --write FILE` tries the shipped grasps, and each of them moved a
little, and keeps which held. `--against FILE` tries them again with the code as it is now, and
counts the labels that differ. The two runs may be of two versions of dgeval.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from dgeval.determinism import generator, limit_threads
from dgeval.geometry import Array, increment, matrix_from_pose
from dgeval.simulation import grasps, jaw_grasps, vfas_trial
from dgeval.worlds.objects import at, eight_objects, ten_objects

from benchmarks.result import table, write

SEED = 3
MOVED_M, MOVED_DEG = 0.008, 6.0  # standard deviations of the moved grasps, each axis


def moved(name: str, k: int) -> Array:
    """T (4, 4), a small motion that follows from a name and a number."""
    rng = generator(SEED, name, k)
    turn = rng.normal(0, np.radians(MOVED_DEG), 3)
    return increment(np.concatenate([rng.normal(0, MOVED_M, 3), turn]))


def labels() -> dict[str, list[bool]]:
    """Which grasps held, by kind; those that touch something before closing are left out."""
    out: dict[str, list[bool]] = {}
    for target in ten_objects().values():
        world = grasps.FlyingHand(target)
        for k, grasp in enumerate(grasps.known_grasps(target)):
            for kind, T in (
                ("five fingers, shipped", grasp.T_object_palm),
                ("five fingers, moved", grasp.T_object_palm @ moved(target.name, k)),
            ):
                for shake in (False, True):
                    world.put_palm(T, grasp.preshape)
                    if kind.endswith("moved") and world.touches():
                        continue
                    held = world.lifts(grasp.preshape, shake=shake)
                    out.setdefault(kind + (", shaken" if shake else ""), []).append(held)
    for name, shipped in _jaw_grasps().items():
        target = eight_objects()[name]
        jaw = jaw_grasps.FlyingJaw(target, target)
        T_base_object = at(0.5, 0.0, target.rest_height())
        for k, T_object_grasp in enumerate(shipped):
            for kind, T in (
                ("jaw, shipped", T_object_grasp),
                ("jaw, moved", T_object_grasp @ moved(name, k)),
            ):
                jaw.put(T_base_object @ T)
                if kind.endswith("moved") and any(jaw.touches()):
                    continue
                out.setdefault(kind + ", shaken", []).append(jaw.lifts())
    return out


def _jaw_grasps() -> dict[str, list[Array]]:
    path = Path(vfas_trial.__file__).parent / "known_jaw_grasps.json"
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return {
        name: [matrix_from_pose(np.array(g)) for g in shipped] for name, shipped in document.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", type=Path)
    parser.add_argument("--against", type=Path)
    options = parser.parse_args()
    limit_threads()
    now = labels()
    if options.write is not None:
        options.write.write_text(json.dumps(now))
    if options.against is None:
        return
    before: dict[str, list[bool]] = json.loads(options.against.read_text())
    rows = []
    for kind, held in now.items():
        pairs = list(zip(before[kind], held, strict=True))
        lost, won = pairs.count((True, False)), pairs.count((False, True))
        rows.append(
            [kind, str(len(held)), str(sum(before[kind])), str(sum(held)), str(lost), str(won)]
        )
    head = ["grasps", "tried", "held before", "hold now", "no longer", "newly"]
    path = write(
        "success-rule",
        "Labels of grasps by the rule of success before and now",
        "python -m benchmarks.success_rule --against FILE",
        [table(head, rows)],
    )
    print(path.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
