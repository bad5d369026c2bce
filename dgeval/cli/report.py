"""dgeval report: run folders to one offline HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgeval.cli.boundary import command, print_json

EXAMPLES = """\b
Examples:
  dgeval report runs/latest
  dgeval report runs/monday runs/tuesday --out week
"""


@command
def report(
    runs: Annotated[list[Path], typer.Argument(help="Run folders.", metavar="RUN…")],
    out: Annotated[Path | None, typer.Option(help="Folder for report.html; default: the first run folder.")] = None,
    json_: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """Trials, losses, velocities and plots of finished runs in one HTML file that needs no network."""
    from dgeval.report.html import write_report

    path = write_report(runs, out or runs[0])
    if json_:
        print_json({"report": str(path)})
    else:
        typer.echo(f"report: {path}")
