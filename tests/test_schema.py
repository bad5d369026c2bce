"""Catches a mistyped or undeclared column: a null in a table, or a value in no digest."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest
from dgeval.runs.files import TableFile
from dgeval.schema import FRAMES, FRAMES_ADDED, TIMINGS, StageDigests, arrow_table

ROW = {"trial": "a", "frame": 3, "stage": "tracking", "seconds": 0.25}


def test_a_table_refuses_a_key_that_is_no_column() -> None:
    """Catches the value under a mistyped key lost in silence, in whichever row it stands."""
    with pytest.raises(KeyError, match="second"):
        arrow_table(TIMINGS, [ROW, {**ROW, "second": 0.5}])


def test_all_unknown_keys_are_named() -> None:
    """Catches a message that names one of two mistyped keys, so that the second costs a run."""
    with pytest.raises(KeyError, match="secnds, stge"):
        arrow_table(TIMINGS, [{"secnds": 0.5, "stge": "tracking"}])


def test_a_missing_key_of_a_table_is_a_null() -> None:
    """Catches a check that asks for every column: most frames have no grasp."""
    table = arrow_table(TIMINGS, [{"trial": "a", "frame": 3}])
    expected = {"trial": "a", "frame": 3, "stage": None, "seconds": None}
    assert table.to_pylist() == [expected]


def test_digests_refuse_a_key_that_is_no_column() -> None:
    """Catches a renamed column that leaves its stage's digest in silence."""
    with pytest.raises(KeyError, match="velocity_w"):
        StageDigests().add({"frame": 0, "velocity_w": 0.1})


def test_digests_take_every_frame_column() -> None:
    """Catches a check against the version-1 columns alone: added ones are logged beside them."""
    StageDigests().add({c.name: None for c in (*FRAMES, *FRAMES_ADDED)})


def test_a_refused_row_leaves_no_table_file(tmp_path: Path) -> None:
    """Catches a key refused only when the row group is written, and a file left incomplete."""
    path = tmp_path / "timings.parquet"

    def write() -> None:
        with TableFile(path, TIMINGS) as table:
            table.add(ROW)
            table.add({**ROW, "second": 0.5})

    with pytest.raises(KeyError, match="second"):
        write()
    assert list(tmp_path.iterdir()) == []


def test_a_table_file_keeps_the_rows_it_was_given(tmp_path: Path) -> None:
    """Catches a check that takes rows apart."""
    path = tmp_path / "timings.parquet"
    with TableFile(path, TIMINGS) as table:
        table.add(ROW)
        table.add({**ROW, "frame": 4})
    assert pq.read_table(path).to_pylist() == [ROW, {**ROW, "frame": 4}]
