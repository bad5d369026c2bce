"""The papers' tables from made-up results.

Catches: counts of one paper beside the other's, a share of failures beside a count of trials, a
label beside the paper that it doesn't count, sums that don't add up, and arms of other trials
compared as if they were the same.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from dgeval.cli import app
from dgeval.evaluate import experiments
from dgeval.evaluate.experiments import SUITES, Arm, Results
from dgeval.evaluate.tables import Count, Table, paired_notes, success, tables_of
from dgeval.simulation.campaign import Campaign
from typer.testing import CliRunner


def trial(outcome: str, thing: str, speed: float = 0.0, seen: str | None = None) -> dict[str, Any]:
    failed = outcome == "failure"
    return {
        "outcome": outcome,
        "object": thing,
        "speed": speed,
        "observed_class": seen,
        "failure_class": "timing" if failed else None,
    }


def results(arm: Arm, *trials: dict[str, Any]) -> Results:
    return Results(arm, arm.made(), trials, tuple(f"t{k}" for k in range(len(trials))))


CONVEYOR = (
    trial("success", "apple", 0.02),
    trial("failure", "apple", -0.02, "collision"),
    trial("no_grasp", "mug", 0.22),
)
HANDOVER = (trial("success", "apple"), trial("failure", "mug", 0.0, "imprecise_pose"))


def dynamic() -> list[Table]:
    arms = SUITES["paper-dynamic"]
    return tables_of("paper-dynamic", [results(arms[0], *CONVEYOR), results(arms[1], *HANDOVER)])


def test_the_dynamic_papers_tables() -> None:
    speed, thing, seen, differed = dynamic()
    assert speed.rows == (
        ("20 mm/s", (Count(1, 2), Count(9, 10))),
        ("220 mm/s", (Count(0, 1), Count(5, 10))),
        ("all", (Count(1, 3), Count(86, 120))),
    )
    rows = dict(thing.rows)
    assert thing.columns == ("conveyor", "handover", "both")
    assert rows["apple"] == (Count(1, 2), Count(12, 12), Count(1, 1), Count(6, 10), Count(2, 3),
                             Count(18, 22))  # fmt: skip
    assert rows["all"][4:] == (Count(2, 5), Count(163, 220))
    assert dict(seen.rows)["collision"] == (
        Count(1, 1), Count(12, 34), Count(0, 1), Count(4, 23), Count(1, 2), Count(16, 57),
    )  # fmt: skip
    assert [c for c in dict(differed.rows)["timing"] if c.n] == [Count(1, 1), Count(1, 1)]
    assert "paper" not in differed.markdown(), "no paper counts that"
    assert "| collision | 1/1 = 100% [21–100] | 12/34 = 35% |" in seen.markdown()


def test_the_other_papers_arms_are_beside_their_own_columns() -> None:
    arms = SUITES["paper-vfas"]
    held, lost = trial("success", "mug", 0.063), trial("failure", "mug", 0.063, "timing")
    made = [results(arm, held, lost) for arm in arms]
    static, turntable, handover, seen, _ = tables_of("paper-vfas", made)
    assert dict(static.rows)["mug"] == (Count(1, 2), Count(8, 15), Count(1, 2), Count(12, 15))
    assert dict(static.rows)["all"][1::2] == (Count(72, 120), Count(101, 120))
    assert dict(turntable.rows)["63 mm/s"][1::2] == (Count(12, 20), Count(17, 20))
    assert handover.rows == (("all", (Count(1, 2), Count(77, 96))),)
    assert not any(c.n for _, counts in seen.rows for c in counts[1::2])


def test_arms_are_paired_by_trial() -> None:
    arms = SUITES["paper-vfas"]
    held, lost = trial("success", "mug"), trial("failure", "mug")
    before, after = results(arms[0], lost, lost, held), results(arms[1], held, held, held)
    fewer = Results(after.arm, after.scenario, after.trials[1:], after.ids[1:])
    made = [before, fewer, before, after, before]
    first, second = paired_notes("paper-vfas", made)
    assert "the same 2 trials: 1 gained, 0 lost" in first
    assert "the same 3 trials: 2 gained, 0 lost" in second


def test_what_is_not_as_in_the_paper_is_said() -> None:
    """Catches a table whose weights, threshold, stand-ins or faults are kept quiet about."""
    belt = results(SUITES["paper-dynamic"][0]).about
    for said in ("0.4", "weights", "TransT-M", "servo.beyond_m = 0.012", "faults"):
        assert said in belt
    arm = SUITES["paper-vfas"][0]
    assert arm.made().pipeline.vfas.refine is False
    assert "Contact-GraspNet" in results(arm).about
    assert "faults" not in results(arm).about


def test_nothing_counted_is_an_empty_cell() -> None:
    assert (success(()).text, success(()).printed) == ("–", "–")


@pytest.mark.parametrize("faultless", [False, True])
def test_the_command_writes_tables_and_says_what_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, faultless: bool
) -> None:
    asked: list[Campaign] = []

    def made(campaign: Campaign, *_: object) -> list[tuple[dict[str, Any], None]]:
        asked.append(campaign)
        of = CONVEYOR if campaign.scenario.name == "conveyor" else HANDOVER
        return [({"id": f"t{k}", "verdict": v}, None) for k, v in enumerate(of)]

    monkeypatch.setattr(experiments, "run_campaign", made)
    monkeypatch.setattr(experiments, "unstable_trials", lambda _: ["t9"])
    arguments = ["evaluate", "paper-dynamic", "--trials", "3", "--out", str(tmp_path)]
    done = CliRunner().invoke(app, arguments + ["--faultless"] * faultless)
    assert done.exit_code == 0, done.output
    assert "conveyor: held 1/3 = 33% [6–79]" in done.output
    text = (tmp_path / "tables.md").read_text(encoding="utf-8")
    assert "left out, unstable: t9" in text
    document = json.loads((tmp_path / "tables.json").read_text(encoding="utf-8"))
    assert document["tables"][0]["rows"][0]["conveyor, paper"] == {"k": 9, "n": 10}
    assert [c.trials for c in asked] == [3, 3]
    assert bool(asked[0].scenario.faults) != faultless
    assert all(c.labels_only and not c.images for c in asked)
    wrong = CliRunner().invoke(app, ["evaluate", "paper"])
    assert wrong.exit_code == 2
