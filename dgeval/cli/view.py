"""dgeval view: open a trial's review recording in the Rerun viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgeval.cli.boundary import command, given_path

EXAMPLES = """\b
Examples:
  dgeval view runs/latest apple
  dgeval view runs/latest apple --path
"""


@command
def view(
    run: Annotated[Path, typer.Argument(help="Run folder.", metavar="RUN", parser=given_path)],
    trial: Annotated[str, typer.Argument(help="Trial id.")],
    path: Annotated[
        bool, typer.Option("--path", help="Print where the recording is instead of opening it.")
    ] = False,
) -> None:
    """Open a trial's review recording; it starts at the decisive moment."""
    import subprocess
    import sys

    from dgeval.errors import Place, UsageError
    from dgeval.runs.files import file_name

    name = file_name(trial)
    file = run / "review" / f"{name}.rrd"
    if not file.is_file():
        if not (run / "trials" / f"{name}.json").is_file():
            known = sorted(p.stem for p in (run / "trials").glob("*.json"))
            hint = f"its trials: {', '.join(known)}" if known else "is it a run's folder?"
            raise UsageError(f"no trial {trial!r} in this run", Place(str(run)), hint)
        reviews = sorted(p.stem for p in (run / "review").glob("*.rrd"))
        listed = (
            f"reviews here: {', '.join(reviews)}"
            if reviews
            else "this run was made with --no-review"
        )
        raise UsageError(f"no review of trial {trial!r}", Place(str(run)), listed)
    if path:
        typer.echo(str(file))
        return
    code = subprocess.call([sys.executable, "-m", "rerun", str(file)])
    if code:
        raise UsageError(
            "the Rerun viewer could not start (no display?)",
            Place(str(file)),
            "copy the file to a desktop",
        )
