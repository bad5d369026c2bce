"""A consistency check that failed, as every module of checks gives it."""

from __future__ import annotations

from dataclasses import dataclass

PART_CHECK = "parts"  # the name of the check that parts of the recording are missing


@dataclass(frozen=True)
class Check:
    """A check that failed: its name, what is wrong, and what mends it."""

    name: str
    what: str
    mend: str

    def __str__(self) -> str:
        return f"check {self.name}: {self.what}; {self.mend}"
