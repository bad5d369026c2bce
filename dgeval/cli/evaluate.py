"""dgeval evaluate: the papers' experiments in simulation, beside the papers' tables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from dgeval.cli.boundary import command, print_json
from dgeval.cli.simulate import campaign_progress

EXAMPLES = """\b
Examples:
  dgeval evaluate paper-dynamic --jobs 2           (220 trials; goes on where it was stopped)
  dgeval evaluate paper-dynamic --trials 6         (to try; tables of what there is)
  dgeval evaluate paper-vfas --out runs/vfas --json
"""


@command
def evaluate(
    suite: Annotated[str, typer.Argument(help="paper-dynamic or paper-vfas.")],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder; finished trials in it are kept. Default runs/SUITE."),
    ] = None,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Trials of each arm; default: the paper's number.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another seed, other trials.")] = 0,
    faultless: Annotated[
        bool,
        typer.Option("--faultless", help="Without the faults that the scenarios put in."),
    ] = False,
    jobs: Annotated[
        int, typer.Option(min=1, help="Worker processes; results don't depend on it.")
    ] = 1,
    json_: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output, nothing else.")
    ] = False,
) -> None:
    """Do a paper's experiments again in simulation: tables with intervals beside the printed ones.

    Writes tables.md and tables.json. A stopped evaluation goes on where it was.
    """
    from dgeval.errors import UsageError
    from dgeval.evaluate.experiments import SUITES, run_arm
    from dgeval.evaluate.tables import paired_notes, success, tables_of
    from dgeval.runs.files import write_atomically

    if suite not in SUITES:
        raise UsageError(f"no suite {suite!r}", hint=f"there are {', '.join(SUITES)}")
    folder = out or Path("runs") / suite
    results = []
    for arm in SUITES[suite]:
        if not json_:
            typer.echo(f"{arm.name}", err=True)
        with campaign_progress() as progress:
            results.append(run_arm(arm, seed, trials, faultless, folder, jobs, progress))
    tables = tables_of(suite, results)
    notes = [f"{r.arm.name}: {r.about}" for r in results]
    notes += [f"{r.arm.name}: left out, unstable: {', '.join(r.unstable)}" for r in results
              if r.unstable]  # fmt: skip
    notes += paired_notes(suite, results)
    document: dict[str, Any] = {
        "suite": suite,
        "seed": seed,
        "faultless": faultless,
        "trials": {r.arm.name: len(r.trials) for r in results},
        "tables": [table.document() for table in tables],
        "notes": notes,
    }
    text = "\n\n".join([
        f"# {suite}",
        f"Seed {seed}; the scenarios' faults are {'left out' if faultless else 'put in'}.",
        "Success is held of all trials. Intervals: Wilson, 95 %. The paper's counts have none.",
        *(table.markdown() for table in tables),
        "\n".join(f"- {note}" for note in notes),
    ])  # fmt: skip
    write_atomically(folder / "tables.md", text + "\n")
    write_atomically(folder / "tables.json", json.dumps(document, indent=1))
    if json_:
        print_json(document)
        return
    for result in results:
        typer.echo(f"{result.arm.name}: held {success(result.trials).text}")
    typer.echo(f"tables, beside the paper's: {folder / 'tables.md'}")
