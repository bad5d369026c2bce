"""dgeval compare: two runs of the same trials."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgeval.cli.boundary import command, given_path, print_json

EXAMPLES = """\b
Examples:
  dgeval compare runs/main runs/branch
  dgeval compare runs/main runs/branch --out compared --json
  dgeval compare simulated/main simulated/branch        \
# folders of `dgeval simulate` with equal seeds: success, exactly

A success that turns into a failure in five of five changed trials is no proof yet (exact McNemar
p = 0.06); six are.
"""


@command
def compare(
    old: Annotated[
        Path, typer.Argument(help="Run folder to compare against.", metavar="A", parser=given_path)
    ],
    new: Annotated[
        Path, typer.Argument(help="Run folder of the change.", metavar="B", parser=given_path)
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder for compare.html, compare.md and compare.json.")
    ] = None,
    json_: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Where two runs first differ, what that led to, and whether the replay is better or worse,
    trial by trial.

    Answers are better, worse, same (by less than matters) or inconclusive, with the number of
    trials that would settle it.
    """
    from dgeval.compare.closed_loop import compare_campaigns
    from dgeval.compare.comparison import compare_runs
    from dgeval.compare.output import as_html, as_json, as_markdown
    from dgeval.runs.files import write_atomically
    from dgeval.runs.results import read_run

    if (old / "simulated.json").is_file() and (new / "simulated.json").is_file():
        result = compare_campaigns(old, new)
        if json_:
            print_json(result)
        else:
            typer.echo(
                f"{result['trials']} closed-loop trials on equal seeds: {result['old']} then "
                f"{result['new']} succeed; {result['lost']} lost, {result['gained']} gained, exact "
                f"McNemar p = {result['p']:.3f}: {result['answer']}"
            )
        return
    comparison = compare_runs(read_run(old), read_run(new))
    if out is not None:
        import json

        write_atomically(out / "compare.html", as_html(comparison))
        write_atomically(out / "compare.md", as_markdown(comparison))
        write_atomically(out / "compare.json", json.dumps(as_json(comparison), indent=1))
    if json_:
        print_json(as_json(comparison))
        return
    typer.echo(as_markdown(comparison).rstrip())
    if out is not None:
        typer.echo(f"\nlook: {out / 'compare.html'}")
