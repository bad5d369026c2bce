"""A slice of the damage campaign (soak/damage_campaign.py), small enough for every run.

Catches: a reader that gives wrong or fewer messages without an error, lets another library's
exception out, or doesn't name the file; and a command line that ends in a traceback or an internal
error over damaged contents.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import damage as d
import dgeval.recording.inspection
import dgeval.runs.trial_job
import dgeval.runs.workers  # noqa: F401  # imported here once, not in every forked child
import pytest

KINDS = {
    k.name: k
    for k in d.KINDS
    if k.name
    not in ("bag bz2", "bag lz4", "db3 folder", "mcap lz4", "mcap no CRC", "mcap ros1 zstd")
}
CONTENTS = {c.name: c for c in d.SEMANTIC}
SEEDS = 40
FEW = {
    "mcap": 3,
    "bag": 1,
    "db3": 1,
}  # cases per mutation: opening a bag or a database costs ten times an MCAP
# A bare database from which rows were deleted properly is a shorter recording: only a SHA-256 of a
# manifest can tell.
UNKNOWABLE = {("db3 bare", "DELETE FROM messages WHERE id > 40")}
ALL_OF = ("count field", "SQL", "record opcode flip")


@pytest.fixture(scope="module", autouse=True)
def quick() -> None:
    d.parse_definitions_once()


def slice_of(good: d.Good) -> list[d.Case]:
    """Cases spread over each mutation; all of those that aim at one field."""
    rows: dict[str, list[d.Case]] = defaultdict(list)
    for case in d.cases(good, SEEDS, boundaries=8):
        rows[case.mutation].append(case)
    few = FEW[good.kind.layout]
    return [
        case
        for mutation, row in rows.items()
        for case in (row if mutation in ALL_OF or len(row) <= few else row[:: -(-len(row) // few)])
    ]


@pytest.mark.parametrize("name", KINDS)
def test_damaged_bytes(name: str, tmp_path: Path) -> None:
    """An exact prefix with the fault said, or an error that names the file."""
    kind = KINDS[name]
    good = d.make_good(kind, tmp_path)
    wrong = []
    for i, case in enumerate(slice_of(good)):
        folder = tmp_path / f"case{i}"
        folder.mkdir()
        outcome = d.read_outcome(d.place_case(good, case, folder), good.messages, kind.checked)
        if outcome.kind == d.VIOLATION and (name, case.detail) not in UNKNOWABLE:
            wrong.append(f"{case.mutation}, {case.detail}: {outcome.detail}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_bomb(compression: str, tmp_path: Path) -> None:
    """A chunk that expands to more than it claims costs that chunk, not the machine's memory."""
    path = tmp_path / "bomb.mcap"
    path.write_bytes(d.bomb(compression, 1 << 28))
    idle = d.in_child(lambda: d.Outcome("nothing")).peak_mb
    outcome = d.in_child(lambda: d.read_outcome(path, [], "chunk"), seconds=20, extra_mb=4000)
    assert outcome.kind == d.COMPLETE_REPORTED, outcome
    assert outcome.peak_mb < idle + 100


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("control: nothing wrong", "inspect"),
        ("control: nothing wrong", "replay"),
        ("K zero", "replay"),
        ("quaternion norm 0", "inspect"),
        ("quaternion norm 0", "replay"),
        ("box NaN", "replay"),
        ("joints 1e300", "replay"),
        ("event JSON nested 100000 deep", "inspect"),
    ],
)
def test_wrong_contents(name: str, command: str, tmp_path: Path) -> None:
    """Exit code 0, 2 or 3 with the file named and no traceback."""
    case = CONTENTS[name]
    path = d.write_semantic(case, "mcap", tmp_path)
    outcome = d.in_child(
        lambda: d.semantic_outcome(case, path, command, tmp_path / "run"), seconds=60, extra_mb=4000
    )
    assert outcome.kind != d.VIOLATION, outcome.detail
