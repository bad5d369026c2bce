"""The papers' experiments, each as one or two arms of simulated trials, and their results.

A finished trial is kept in OUT/<arm>/truth and not simulated again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dgeval.paper_values import CHOICE, CONTROL, departures
from dgeval.planning.grasps import networks_of
from dgeval.simulation.campaign import Campaign, run_campaign, unstable_trials
from dgeval.simulation.scenario import Scenario, load_scenario

# what stands in for parts of the papers that can't be had, by the scenario's kind
STAND_INS = {
    "dynamic": "modelled perception for TransT-M and ICP in the loop; FFHNet with dgeval's own "
    "weights; a simulated hand, arm and belt",
    "vfas": "known grasps with a drawn error (15 mm and 6 degrees on each axis, 1 sigma) for "
    "Contact-GraspNet's seeds; DIS for GMFlow; dgeval's own evaluator; sliding fingers",
}


@dataclass(frozen=True)
class Arm:
    """One way of doing an experiment. changes: values of the scenario's section `vfas`."""

    name: str
    scenario: str
    changes: Mapping[str, bool] = field(default_factory=dict)

    def made(self) -> Scenario:
        """The scenario with the arm's changes."""
        scenario = load_scenario(self.scenario)
        if not self.changes:
            return scenario
        vfas = scenario.pipeline.vfas.model_copy(update=dict(self.changes))
        pipeline = scenario.pipeline.model_copy(update={"vfas": vfas})
        return scenario.model_copy(update={"pipeline": pipeline})


ADAPTIVE_OFF = {"adaptive": False, "motion_field": False}
SUITES: dict[str, tuple[Arm, ...]] = {
    "paper-dynamic": (Arm("conveyor", "conveyor"), Arm("handover", "handover")),
    "paper-vfas": (
        Arm("table, seed as given", "table-clearing", {"refine": False}),
        Arm("table, VFAS", "table-clearing"),
        Arm("turntable, adaptive off", "turntable", ADAPTIVE_OFF),
        Arm("turntable, adaptive on", "turntable"),
        Arm("handover", "vfas-handover"),
    ),
}


@dataclass(frozen=True)
class Results:
    """The trials of one arm, by what is true of them: documents as `/truth/verdict` has them.

    ids: of these trials. unstable: those that are left out, as their physics was unstable.
    """

    arm: Arm
    scenario: Scenario
    trials: tuple[dict[str, Any], ...]
    ids: tuple[str, ...] = ()
    unstable: tuple[str, ...] = ()

    @property
    def about(self) -> str:
        """What this arm is not as the paper's, for a person."""
        vfas = self.scenario.vfas
        stands = STAND_INS["vfas" if vfas else "dynamic"]
        config = self.scenario.pipeline
        sections = ("vfas",) if vfas else (*CHOICE, *CONTROL)
        listed = ", ".join(departures(config, sections)) or "nothing"
        parts = [f"in place of the paper's: {stands}", f"parameters not as in the paper: {listed}"]
        if not vfas:
            own = config.execution.c_e
            c_e = networks_of(config.grasps).c_e if own is None else own
            parts.append(f"closing above a score c_e of {c_e:g}, these weights' own (paper: 0.7)")
        if self.scenario.faults:
            parts.append("faults put in on purpose as the scenario says (the paper: none)")
        return "; ".join(parts)


def run_arm(
    arm: Arm,
    seed: int,
    trials: int | None,
    faultless: bool,
    out: Path,
    jobs: int,
    progress: Callable[[str, int, int, dict[str, Any]], None],
) -> Results:
    """Simulate the trials of an arm, or as many as asked for, without recordings.

    faultless: without the scenario's faults.
    """
    scenario = arm.made()
    if faultless:
        scenario = scenario.model_copy(update={"faults": {}})
    folder = out / arm.name.replace(", ", "-").replace(" ", "-")
    campaign = Campaign(
        scenario, seed, trials or scenario.trials, folder, images=False, labels_only=True
    )
    made = [truth for truth, _ in run_campaign(campaign, jobs, progress)]
    return Results(
        arm,
        scenario,
        tuple(truth["verdict"] for truth in made),
        tuple(truth["id"] for truth in made),
        tuple(unstable_trials(folder)),
    )
