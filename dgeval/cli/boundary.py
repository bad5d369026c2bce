"""Turns every error of a command into one line on standard error and an exit code."""

from __future__ import annotations

import json
import os
import sys
import tempfile
import traceback
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TextIO, TypeVar, cast

import typer

from dgeval.errors import EXIT_INTERNAL, EXIT_USAGE, DgevalError

P = ParamSpec("P")
R = TypeVar("R")
LOG = "log.jsonl"  # file name in a run folder


def command(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator of a command: an error becomes one line on standard error and an exit code.

    With `--json` the error is also the one document on standard output. An unforeseen exception
    gives exit code 4. Its traceback goes to `log.jsonl` in the folder of `--out`, else in the first
    run folder that the command reads, else in a new temporary folder.
    """

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        as_json = bool(kwargs.get("json_"))
        try:
            return function(*args, **kwargs)
        except (typer.Exit, typer.Abort, BrokenPipeError):
            raise
        except DgevalError as error:
            raise _exit(str(error), error.exit_code, as_json) from None
        except PermissionError as error:
            raise _exit(f"no permission ({error.filename})", EXIT_USAGE, as_json) from None
        except Exception as error:  # the boundary of the program
            log = write_traceback(error, function.__name__, _folder(kwargs))
            raise _exit(
                f"internal error: {_one_line(error)}; the traceback is in {log}",
                EXIT_INTERNAL,
                as_json,
            ) from None

    return run


def _exit(message: str, code: int, as_json: bool) -> typer.Exit:
    typer.echo(f"error: {message}", err=True)
    if as_json:
        typer.echo(json.dumps({"error": message, "exit_code": code}))
    return typer.Exit(code)


def _one_line(error: BaseException) -> str:
    """An error in one line: its type, its message, and the line of code that raised it."""
    last = traceback.extract_tb(error.__traceback__)[-1:]
    where = f" at {Path(last[0].filename).name}:{last[0].lineno}" if last else ""
    lines = str(error).splitlines()
    return f"{type(error).__name__}{': ' + lines[0] if lines else ''}{where}"


def _folder(kwargs: dict[str, Any]) -> Path | None:
    """The folder of --out, else the first run folder that the command reads, else None."""
    if isinstance(kwargs.get("out"), Path):
        return cast(Path, kwargs["out"])
    if isinstance(run := kwargs.get("run"), Path) and run.is_dir():
        return run
    runs = kwargs.get("runs")
    return runs[0] if isinstance(runs, list) and runs and runs[0].is_dir() else None


def write_traceback(error: BaseException, name: str, folder: Path | None) -> Path:
    """Append a traceback to `log.jsonl` and return that file.

    It lies in `folder`, or in a new temporary folder where `folder` is None or can't be written.
    """
    line = json.dumps(
        {
            "command": name,
            "error": _one_line(error),
            "traceback": "".join(traceback.format_exception(error)),
        }
    )
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            return _append(folder / LOG, line)
        except OSError:
            pass  # a full disk or a folder that can't be written may be why the command failed
    return _append(Path(tempfile.mkdtemp(prefix="dgeval-")) / LOG, line)


def _append(path: Path, line: str) -> Path:
    with path.open("a", encoding="utf-8") as file:
        file.write(line + "\n")
    return path


class QuietPipe:
    """Standard output that discards what is written after its reader has closed the pipe.

    So `dgeval inspect … | head` ends without a complaint.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            self._discard()
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._discard()

    def _discard(self) -> None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)


def print_json(value: Any) -> None:
    """Write the one JSON document of `--json` to standard output."""
    sys.stdout.write(json.dumps(value, indent=1) + "\n")


def given_path(text: str) -> Path:
    """A path that was given; an empty one, as an unset variable of a shell gives, is refused: it
    would be the working folder with all that is below it.
    """
    if not text:
        raise typer.BadParameter("an empty path was given: is a variable of the shell not set?")
    return Path(text)
