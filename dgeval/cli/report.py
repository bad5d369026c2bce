"""dgeval report: run folders to one offline HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgeval.cli.boundary import command, given_path, print_json

EXAMPLES = """\b
Examples:
  dgeval report runs/latest
  dgeval report runs/monday runs/tuesday --out week
  dgeval report runs/simulated --truth simulated/conveyor.toml
"""


@command
def report(
    runs: Annotated[
        list[Path], typer.Argument(help="Run folders.", metavar="RUN…", parser=given_path)
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder for report.html; default: the first run folder.")
    ] = None,
    truth: Annotated[
        list[Path] | None,
        typer.Option(
            help="Simulated recordings or manifests with /truth to score the verdicts against."
        ),
    ] = None,
    json_: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Success with intervals, causes of failure, pictures and plots of finished runs, in one HTML
    file that needs no network.

    Beside it: report.md, trials.csv, and the figures as PNG and SVG.
    """
    from dgeval.report.html import write_report

    path = write_report(runs, out or runs[0], truth)
    if json_:
        print_json({"report": str(path)})
    else:
        typer.echo(f"report: {path}")
