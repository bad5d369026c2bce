"""The command line. Only this package prints and exits.

Each command imports what it needs when it runs, so that `dgeval --help` starts fast.
"""

from __future__ import annotations

import sys
from typing import TextIO, cast

from dgeval.determinism import set_thread_variables

set_thread_variables()  # before numpy is imported anywhere

import typer  # noqa: E402

from dgeval.cli import (  # noqa: E402
    compare,
    config_show,
    evaluate,
    inspect,
    regress,
    replay,
    report,
    show,
    simulate,
    train,
    view,
)
from dgeval.cli.boundary import QuietPipe  # noqa: E402
from dgeval.errors import EXIT_CODES  # noqa: E402

app = typer.Typer(
    name="dgeval",
    help="Why did a dynamic grasp fail? Answers from the log alone.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain help: importing rich takes longer than all the rest of --help
)
app.command("replay", epilog=replay.EXAMPLES)(replay.replay)
app.command("report", epilog=report.EXAMPLES)(report.report)
app.command("inspect", epilog=inspect.EXAMPLES)(inspect.inspect)
app.command("show", epilog=show.EXAMPLES)(show.show)
app.command("view", epilog=view.EXAMPLES)(view.view)
app.command("simulate", epilog=simulate.EXAMPLES)(simulate.simulate)
app.command("compare", epilog=compare.EXAMPLES)(compare.compare)
app.command("regress", epilog=regress.EXAMPLES)(regress.regress)
app.command("evaluate", epilog=evaluate.EXAMPLES)(evaluate.evaluate)
app.command("train", epilog=train.EXAMPLES)(train.train)
app.add_typer(config_show.app, name="config")


def _version(wanted: bool) -> None:
    if wanted:
        from dgeval import __version__

        typer.echo(__version__)
        raise typer.Exit


@app.callback(
    help="Exit codes: "
    + " · ".join(f"{code} {meaning}" for code, meaning in EXIT_CODES.items())
    + "."
)
def options(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version."
    ),
) -> None:
    pass


def main() -> None:
    """Entry point of the script `dgeval` and of `python -m dgeval`."""
    sys.stdout = cast(TextIO, QuietPipe(sys.stdout))
    app(prog_name="dgeval")
