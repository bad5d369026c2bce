"""dgeval show: what is known of one trial, on the terminal and as a figure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgeval.cli.boundary import command, given_path, print_json

EXAMPLES = """\b
Examples:
  dgeval show runs/latest
  dgeval show runs/latest apple
  dgeval show runs/latest apple --figure apple.svg
  dgeval show runs/latest apple --figure apple     (apple.png and apple.svg)
"""


@command
def show(
    run: Annotated[Path, typer.Argument(help="Run folder.", metavar="RUN", parser=given_path)],
    trial: Annotated[
        str | None, typer.Argument(help="Trial id; may be left out where the run holds one.")
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(help="Also draw errors, velocity and scores over time: .png, .svg or both."),
    ] = None,
    json_: Annotated[
        bool, typer.Option("--json", help="The trial's row as one JSON document.")
    ] = False,
) -> None:
    """One trial on one page: outcome, cause, evidence, times, and where to look."""
    import shutil
    import textwrap

    from dgeval.errors import UsageError
    from dgeval.report.one_trial import figure_of, lines_of, only_trial, row_of
    from dgeval.runs.results import read_run

    finished = read_run(run)
    files = [] if figure is None else [figure]
    if figure is not None:
        parents = [folder for folder in figure.parents if folder.exists()]
        if not figure.name or figure.is_dir() or not parents[0].is_dir():
            raise UsageError(f"--figure {figure}: no file can be written there")
        if not figure.suffix:
            files = [figure.with_suffix(".png"), figure.with_suffix(".svg")]
    for file in files:
        if file.suffix.lower() not in (".png", ".svg"):
            raise UsageError(f"--figure {file}: {file.suffix!r}", hint=".png, .svg, or no suffix")
    if trial is None:
        trial = only_trial(finished)
    row = row_of(finished, trial)
    if files:
        drawn = figure_of(finished, trial)
        for file in files:
            about = {"Software": None} if file.suffix.lower() == ".png" else {"Date": None}
            file.parent.mkdir(parents=True, exist_ok=True)
            drawn.savefig(file, dpi=150, metadata=about)
    if json_:
        print_json({**row, "figures": [str(file) for file in files]})
        return
    width = min(shutil.get_terminal_size((80, 24)).columns, 100)
    for line in lines_of(finished, trial):
        typer.echo(textwrap.fill(line, width, subsequent_indent="  ", break_on_hyphens=False))
    for file in files:
        typer.echo(f"figure: {file}")
