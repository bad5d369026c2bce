"""The errors that dgeval raises on purpose, the exit codes, and the damage of a recording.

A message says what is wrong, what to do, where (topic, time or byte offset), and the file last.
"""

from __future__ import annotations

from dataclasses import dataclass

EXIT_OK = 0
EXIT_WORSE = 1
EXIT_USAGE = 2
EXIT_DATA_LOST = 3
EXIT_INTERNAL = 4
EXIT_INTERRUPTED = 130
EXIT_CODES: dict[int, str] = {
    EXIT_OK: "done",
    EXIT_WORSE: "a finished comparison found a regression",
    EXIT_USAGE: "usage, configuration, or nothing could be read: there is no result",
    EXIT_DATA_LOST: "results are there, but data were lost or a recording was not read",
    EXIT_INTERNAL: "an internal error; the traceback is in log.jsonl",
    EXIT_INTERRUPTED: "interrupted; finished trials are kept",
}


@dataclass(frozen=True, slots=True)
class Place:
    """Where in an input the fault is. Unknown parts are None.

    t_ns: time, ns. offset: byte in the file.
    """

    file: str
    topic: str | None = None
    t_ns: int | None = None
    offset: int | None = None

    def __str__(self) -> str:
        parts = []
        if self.topic is not None:
            parts.append(f"topic {self.topic}")
        if self.t_ns is not None:
            parts.append(f"t = {self.t_ns} ns")
        if self.offset is not None:
            parts.append(f"byte {self.offset}")
        return ", ".join([*parts, f"file {self.file}"])


class DgevalError(Exception):
    """Base of all errors that dgeval raises on purpose.

    exit_code: of the command line. The message is `what; hint [place]`.
    """

    exit_code = EXIT_INTERNAL

    def __init__(self, what: str, place: Place | None = None, hint: str | None = None) -> None:
        self.what = what
        self.place = place
        self.hint = hint
        text = what
        if hint:
            text += f"; {hint}"
        if place is not None:
            text += f" [{place}]"
        super().__init__(text)


class UsageError(DgevalError):
    """The call, the configuration or the manifest is wrong."""

    exit_code = EXIT_USAGE


class UnreadableError(DgevalError):
    """An input from which nothing can be used."""

    exit_code = EXIT_USAGE


class UndecodableError(DgevalError):
    """The bytes of one message are no value of its type. Only that message is lost."""

    exit_code = EXIT_DATA_LOST


class MissingDependencyError(DgevalError):
    """A library that the chosen option needs can't be imported."""

    exit_code = EXIT_USAGE


class OtherRecordingsError(DgevalError):
    """A recording is not the one that the baseline was made from."""

    exit_code = EXIT_DATA_LOST


class NotDeterministicError(DgevalError):
    """Two replays of the same recording, configuration and version differ."""

    exit_code = EXIT_INTERNAL


@dataclass(frozen=True, slots=True)
class Damage:
    """Data lost from an input: what happened, and where.

    lost_from_ns, lost_to_ns: log times, ns, between which nothing was used; lost_to_ns None: up to
    the end.
    """

    what: str
    place: Place
    lost_from_ns: int | None = None
    lost_to_ns: int | None = None

    def __str__(self) -> str:
        text = self.what
        if self.lost_from_ns is not None:
            to = "the end" if self.lost_to_ns is None else f"{self.lost_to_ns} ns"
            text += f"; lost from {self.lost_from_ns} ns to {to}"
        return f"{text} [{self.place}]"


def describe(error: BaseException) -> str:
    """An exception of another library in one line: its class, and its text where it has one."""
    text = " ".join(str(error).split())[:160]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
