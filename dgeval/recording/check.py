"""What the consistency checks find, as every module of checks gives it."""

from __future__ import annotations

from dataclasses import dataclass, field

PART_CHECK = "parts"  # the name of the check that parts of the recording are missing


@dataclass(frozen=True)
class Check:
    """A check that failed: its name, what is wrong, and what mends it."""

    name: str
    what: str
    mend: str

    def __str__(self) -> str:
        return f"check {self.name}: {self.what}; {self.mend}"


@dataclass(frozen=True)
class Findings:
    """Of several checks: those that failed, notes on what is near to failing, and, in words, what
    the recording shows nothing to check by.
    """

    failed: list[Check]
    notes: list[str] = field(default_factory=list)
    untested: list[str] = field(default_factory=list)
