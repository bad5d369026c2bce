"""Grasps of a user's hand, kept on disk: finding them takes seconds to a minute an object."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from dgeval.determinism import fingerprint
from dgeval.geometry import matrix_from_pose, pose_from_matrix
from dgeval.simulation.grasps import KnownGrasp, search
from dgeval.simulation.imported_hand import ImportedHand
from dgeval.worlds.objects import ObjectModel

WANTED, SEED, TRIES = 8, 11, 3000  # grasps an object; of their search; ours


def without_grasps(folder: Path) -> list[str]:
    """The objects that the hand was found not to hold."""
    kept = {
        path.stem: json.loads(path.read_text(encoding="utf-8")) for path in folder.glob("*.json")
    }
    return sorted(name for name, found in kept.items() if not found["grasps"])


def kept_grasps(hand: ImportedHand, target: ObjectModel, folder: Path) -> list[KnownGrasp]:
    """The hand's grasps of an object, from a file in the folder, or found and written there.

    They are the same each time on one platform.
    """
    key = [hand.sha256, target.name, [float(v) for v in target.extent()], fingerprint()]
    path = folder / f"{target.name}.json"
    if path.is_file():
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept["key"] == key:
            return [
                KnownGrasp(matrix_from_pose(np.array(T)), np.array(preshape), quality)
                for T, preshape, quality in kept["grasps"]
            ]
    found = search(target, WANTED, SEED, TRIES, hand)
    # rounded by writing: a second run must start from the same numbers as the first
    rows = [
        [pose_from_matrix(g.T_object_palm).tolist(), g.preshape.tolist(), g.quality] for g in found
    ]
    folder.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps({"key": key, "grasps": rows}), encoding="utf-8")
    part.rename(path)
    return kept_grasps(hand, target, folder)
