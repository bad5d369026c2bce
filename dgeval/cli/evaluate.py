"""dgeval evaluate: the papers' experiments in simulation beside their tables, and verdicts beside
what is so.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from dgeval.cli.boundary import command, print_json
from dgeval.cli.simulate import campaign_progress

VERDICT = "verdict"
EXAMPLES = """\b
Examples:
  dgeval evaluate paper-dynamic --jobs 2           (220 trials; goes on where it was stopped)
  dgeval evaluate paper-dynamic --trials 6         (to try; tables of what there is)
  dgeval evaluate paper-vfas --out runs/vfas --json
  dgeval evaluate verdict --trials 20 --jobs 2     (rendered, replayed from the recording, judged)
  dgeval evaluate verdict --hand my_gripper.urdf --meshes scans/ --seed 7
  dgeval evaluate runs/monday                      (verdicts beside `cause` in the manifest)
"""


@command
def evaluate(
    suite: Annotated[
        str,
        typer.Argument(
            help="paper-dynamic, paper-vfas, verdict, or a run folder with people's words."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder; finished trials in it are kept. Default runs/SUITE, or the run's own."
        ),
    ] = None,
    trials: Annotated[
        int | None,
        typer.Option(min=1, help="Trials of each arm; default: the paper's number, 40 of verdict."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another seed, other trials.")] = 0,
    faultless: Annotated[
        bool,
        typer.Option("--faultless", help="Without the faults that the scenarios put in."),
    ] = False,
    hand: Annotated[
        list[Path] | None,
        typer.Option(help="verdict: a hand's URDF or TOML, as of simulate; may be repeated."),
    ] = None,
    meshes: Annotated[
        Path | None,
        typer.Option(help="verdict: folder of meshes (m, z up) in place of the ten objects."),
    ] = None,
    condition: Annotated[
        list[str] | None,
        typer.Option(
            help="verdict: recorded (events and the robot's own values), stranger (nothing of "
            "dgeval's), labelled (a stranger's, with an operator's label); may be repeated. "
            "Default: all three.",
        ),
    ] = None,
    jobs: Annotated[
        int, typer.Option(min=1, help="Worker processes; results don't depend on it.")
    ] = 1,
    json_: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output, nothing else.")
    ] = False,
) -> None:
    """Do a paper's experiments again in simulation, with intervals beside the printed tables; or
    set verdicts against what is so.

    Of a paper: tables.md and tables.json. Of verdicts: verdicts.md and verdicts.json, with every
    trial whose verdict is wrong or missing. A stopped evaluation goes on where it was.
    """
    from dgeval.errors import UsageError
    from dgeval.evaluate.experiments import SUITES, run_arm
    from dgeval.evaluate.tables import paired_notes, success, tables_of
    from dgeval.runs.files import write_atomically

    if (hand or meshes or condition) and suite != VERDICT:
        raise UsageError("--hand, --meshes and --condition go with the suite verdict")
    if suite == VERDICT:
        given = (seed, trials, meshes, out or Path("runs") / VERDICT, jobs)
        _verdicts(hand or [], condition or [], *given, faultless, json_)
        return
    if suite not in SUITES and (Path(suite) / "run.json").is_file():
        _against_words(Path(suite), out or Path(suite), json_)
        return
    if suite not in SUITES:
        there = ", ".join([*SUITES, VERDICT])
        raise UsageError(f"no suite {suite!r}", hint=f"there are {there}; or give a run folder")
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


def _verdicts(
    hands: list[Path],
    conditions: list[str],
    seed: int,
    trials: int | None,
    meshes: Path | None,
    out: Path,
    jobs: int,
    faultless: bool,
    json_: bool,
) -> None:
    from dgeval.errors import UsageError
    from dgeval.evaluate.verdicts import CONDITIONS, TRIALS, arms_of, run_arm

    unknown = [c for c in conditions if c not in CONDITIONS]
    if unknown:
        raise UsageError(f"no condition {unknown[0]!r}", hint=f"there are {', '.join(CONDITIONS)}")
    if faultless:
        raise UsageError(
            "--faultless leaves nothing to judge", hint="the suite verdict is of failures"
        )
    judged = []
    for arm in arms_of(hands):
        if not json_:
            typer.echo(arm.name, err=True)
        with campaign_progress() as progress:
            judged += run_arm(
                arm,
                tuple(conditions) or CONDITIONS,
                seed,
                trials or TRIALS,
                meshes,
                out,
                jobs,
                progress,
            )
    about = (
        f"Seed {seed}. Recordings are rendered and replayed from the recording alone: `recorded` "
        "with events and the robot's own values, `stranger` with nothing of dgeval's, `labelled` "
        "like that with an operator's label. Friction, mass, contacts, links and solver "
        "differ from trial to trial. "
        "Intervals: Wilson, 95 %."
    )
    _write_verdicts(out, about, judged, {"seed": seed}, json_)


def _against_words(run: Path, out: Path, json_: bool) -> None:
    from dgeval.evaluate.words import judged_by_people

    about = (
        f"Verdicts of {run} beside `cause` in its manifest, a person's word. Intervals: Wilson, "
        "95 %."
    )
    _write_verdicts(out, about, judged_by_people(run), {"run": str(run)}, json_)


def _write_verdicts(
    out: Path, about: str, judged: list[Any], given: dict[str, Any], json_: bool
) -> None:
    from dgeval.evaluate.agreement import document_of, groups_of, markdown_of, sentence_of
    from dgeval.runs.files import write_atomically

    groups = groups_of(judged)
    figures = {name: document_of(trials) for name, trials in groups}
    document = {**given, "groups": figures}
    parts = ["# Verdicts", about, *(markdown_of(n, trials, figures[n]) for n, trials in groups)]
    write_atomically(out / "verdicts.md", "\n\n".join(parts) + "\n")
    write_atomically(out / "verdicts.json", json.dumps(document, indent=1))
    if json_:
        print_json(document)
        return
    for name, of_group in figures.items():
        typer.echo(f"{name}: {sentence_of(of_group)}")
    typer.echo(f"tables, and each verdict that is wrong or missing: {out / 'verdicts.md'}")
