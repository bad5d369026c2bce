"""Files of a run folder: written as `.part` and renamed when complete, so none is incomplete."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from dgeval.schema import Column, arrow_schema, arrow_table, check_keys

ROWS_PER_GROUP = 500  # rows kept in memory before they are written


def file_name(trial: str) -> str:
    """A trial's id as a file name: `~` for separators and what some file systems refuse."""
    return "".join(c if c.isalnum() or c in "-_.#+" else "~" for c in trial)


class TableFile:
    """A Parquet file written in row groups, so that a long trial needs little memory.

    A context manager: the file gets its name when the block ends, and is deleted if it raises.
    """

    def __init__(self, path: Path, columns: tuple[Column, ...]) -> None:
        self._path, self._columns = path, columns
        self._part = path.with_name(path.name + ".part")
        self._rows: list[dict[str, Any]] = []

    def __enter__(self) -> TableFile:
        self._writer = pq.ParquetWriter(self._part, arrow_schema(self._columns), compression="zstd")
        return self

    def add(self, row: dict[str, Any]) -> None:
        """Add one row; KeyError for a key that is no column, so that no row group is lost to it."""
        check_keys(row, self._columns, self._path.name)
        self._rows.append(row)
        if len(self._rows) >= ROWS_PER_GROUP:
            self._flush()

    def _flush(self) -> None:
        if self._rows:
            self._writer.write_table(arrow_table(self._columns, self._rows))
            self._rows = []

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._flush()
        self._writer.close()
        if kind is None:
            self._part.replace(self._path)
        else:
            self._part.unlink(missing_ok=True)


def write_table(path: Path, table: Any) -> None:
    """Write a pyarrow table as Parquet."""
    part = path.with_name(path.name + ".part")
    pq.write_table(table, part, compression="zstd")
    part.replace(path)


def write_atomically(path: Path, text: str) -> None:
    """Write a text file in UTF-8; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def write_ply(path: Path, points: Any, normals: Any) -> None:
    """Write points (n, 3) m and normals (n, 3), model frame, as binary PLY of float32."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += (
        "".join(f"property float {n}\n" for n in ("x", "y", "z", "nx", "ny", "nz")) + "end_header\n"
    )
    part = path.with_name(path.name + ".part")
    part.write_bytes(head.encode() + np.hstack([points, normals]).astype("<f4").tobytes())
    part.replace(path)
