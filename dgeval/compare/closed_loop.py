"""Success of two closed-loop simulations on equal seeds: the only place where success rates may be compared."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from dgeval.compare.paired import ALPHA, mcnemar
from dgeval.errors import Place, UsageError


def compare_campaigns(old: Path, new: Path) -> dict[str, Any]:
    """Paired by trial id; UsageError where seeds or scenarios are not the same."""
    ended = [_ended(folder) for folder in (old, new)]
    trials = sorted(set(ended[0]) & set(ended[1]))
    if not trials:
        raise UsageError(
            f"{old} and {new} have no trial in common",
            hint="simulate the same scenario with the same seed",
        )
    for trial in trials:
        seeds = [side[trial][1] for side in ended]
        if seeds[0] != seeds[1]:
            raise UsageError(
                f"trial {trial} has seed {seeds[0]} in {old} and {seeds[1]} in {new}: they are not "
                "pairs"
            )
    before, after = ([side[t][0] for t in trials] for side in ended)
    lost, gained, p = mcnemar(before, after)
    answer = "inconclusive" if p > ALPHA else "worse" if lost > gained else "better"
    return {
        "trials": len(trials),
        "old": sum(before),
        "new": sum(after),
        "lost": lost,
        "gained": gained,
        "p": p,
        "answer": "same" if lost + gained == 0 else answer,
    }


def _ended(folder: Path) -> dict[str, tuple[bool, int]]:
    path = folder / "simulated.json"
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))["simulated"]
        return {
            r["id"]: (r["verdict"]["outcome"] == "success", int(r["verdict"]["seed"])) for r in rows
        }
    except (ValueError, KeyError, TypeError) as error:
        raise UsageError(
            f"not a campaign's list ({type(error).__name__})", Place(str(path))
        ) from error
