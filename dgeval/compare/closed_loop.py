"""Success of two closed-loop simulations on equal seeds.

Only here are success rates compared: an offline replay can't change whether a grasp succeeded.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from dgeval.compare.paired import ALPHA, mcnemar
from dgeval.errors import Place, UsageError


def compare_campaigns(old: Path, new: Path) -> dict[str, Any]:
    """Compare the outcomes of two folders of `dgeval simulate`, paired by trial id.

    Returns the numbers of trials, of successes, of lost and gained trials, McNemar's p and the
    answer. UsageError where no trial is in both, or a trial has another seed.
    """
    outcomes = [_outcomes(folder) for folder in (old, new)]
    trials = sorted(set(outcomes[0]) & set(outcomes[1]))
    if not trials:
        raise UsageError(
            f"{old} and {new} have no trial in common",
            hint="simulate the same scenario with the same seed",
        )
    for trial in trials:
        seeds = [side[trial][1] for side in outcomes]
        if seeds[0] != seeds[1]:
            raise UsageError(
                f"trial {trial} has seed {seeds[0]} in {old} and {seeds[1]} in {new}: they are not "
                "pairs"
            )
    before, after = ([side[t][0] for t in trials] for side in outcomes)
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


def _outcomes(folder: Path) -> dict[str, tuple[bool, int]]:
    """By trial id: whether the trial ended in success, and its seed."""
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
