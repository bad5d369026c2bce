"""A slice of the damage campaign (soak/damage_campaign.py), small enough for every run.

Catches a reader that gives wrong or fewer messages in silence, lets a foreign exception out, or loses the file's name;
and a command line that ends in a traceback or an internal error over contents that are wrong.
"""

from __future__ import annotations

from pathlib import Path

import pytest

import damage as d

SEEDS = 36  # single flips per container; the campaign takes hundreds
KINDS = {k.name: k for k in d.KINDS}
CONTENTS = {c.name: c for c in d.SEMANTIC}

# What the campaign found and the reader does not yet do right. A case here must fail: strict, so that a mended one is
# taken off the list.
OPEN: dict[tuple[str, str], str] = {}


@pytest.fixture(scope="module", autouse=True)
def quick() -> None:
    d.parse_definitions_once()


@pytest.mark.parametrize("name", KINDS)
def test_damaged_bytes(name: str, tmp_path: Path) -> None:
    """Every mutation: an exact prefix with the fault said, or an error that names the file."""
    kind = KINDS[name]
    good = d.make_good(kind, tmp_path)
    wrong: dict[str, list[str]] = {}
    for i, case in enumerate(d.cases(good, SEEDS, boundaries=8)):
        folder = tmp_path / f"case{i}"
        folder.mkdir()
        outcome = d.read_outcome(d.place_case(good, case, folder), good.messages, kind.checked)
        if outcome.kind == d.VIOLATION:
            wrong.setdefault(case.mutation, []).append(f"{case.detail}: {outcome.detail}")
    known = {mutation for container, mutation in OPEN if container == name}
    assert not (set(wrong) - known), "\n".join(f"{m}: {w[0]}" for m, w in wrong.items() if m not in known)
    assert known <= set(wrong), f"mended, take off the list: {known - set(wrong)}"


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_bomb(compression: str, tmp_path: Path) -> None:
    """A chunk that expands to far more than it claims costs that chunk, not the machine's memory."""
    path = tmp_path / "bomb.mcap"
    path.write_bytes(d.bomb(compression, 1 << 28))
    outcome = d.in_child(lambda: d.read_outcome(path, [], "chunk"), seconds=20, extra_mb=4000)
    assert outcome.kind == d.COMPLETE_SAID, outcome
    assert outcome.peak_mb < 250 + d.in_child(lambda: d.Outcome("nothing")).peak_mb


@pytest.mark.parametrize("command", ["inspect", "replay"])
@pytest.mark.parametrize(
    "name", ["control: nothing wrong", "stamps all zero", "no camera_info", "camera_info of another size", "K zero",
             "depth all zero", "quaternion norm 0", "tf cycle", "box outside the image"],
)  # fmt: skip
def test_wrong_contents(name: str, command: str, tmp_path: Path) -> None:
    """Exit code 0, 2 or 3 with the file named and no traceback."""
    case = CONTENTS[name]
    path = d.write_semantic(case, "mcap", tmp_path)
    outcome = d.in_child(lambda: d.semantic_outcome(case, path, command, tmp_path / "run"), seconds=60, extra_mb=4000)
    assert outcome.kind != d.VIOLATION, outcome.detail
