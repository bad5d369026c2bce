"""Where errors become one line on standard error and an exit code."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import typer

from dgeval.errors import EXIT_INTERNAL, EXIT_USAGE, DgevalError

P = ParamSpec("P")
R = TypeVar("R")


def command(function: Callable[P, R]) -> Callable[P, R]:
    """Known errors in one line with their exit code; with json=True also as a document on standard output."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except DgevalError as error:
            typer.echo(f"error: {error}", err=True)
            if kwargs.get("json_"):
                typer.echo(json.dumps({"error": str(error), "exit_code": error.exit_code}))
            raise typer.Exit(error.exit_code) from None
        except PermissionError as error:
            typer.echo(f"error: no permission ({error.filename})", err=True)
            raise typer.Exit(EXIT_USAGE) from None
        except OSError as error:
            typer.echo(f"error: {error.strerror or error} ({error.filename})", err=True)
            raise typer.Exit(EXIT_INTERNAL) from None

    return run


def print_json(value: Any) -> None:
    """The one document on standard output."""
    sys.stdout.write(json.dumps(value, indent=1) + "\n")
