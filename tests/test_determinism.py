"""Catches: draws that depend on their order or on other frames.

Also digests that depend on NaN payloads, the sign of zero, or joined texts.
"""

from __future__ import annotations

import math
import struct

import numpy as np
from dgeval.determinism import ColumnDigest, fingerprint, generator
from dgeval.schema import FRAMES, FRAMES_ADDED, STAGES, StageDigests


def digest(rows: list[dict[str, object]], columns: dict[str, str]) -> str:
    d = ColumnDigest(columns)
    for row in rows:
        d.add(row)
    return d.hexdigest()


def test_draws_are_keyed_by_seed_stage_and_frame_alone() -> None:
    first = generator(0, "fusion", 7).random(4)
    generator(0, "fusion", 6).random(100)
    assert np.array_equal(generator(0, "fusion", 7).random(4), first)
    for other in (generator(1, "fusion", 7), generator(0, "plane", 7), generator(0, "fusion", 8)):
        assert not np.array_equal(other.random(4), first)


def test_neighbouring_frames_do_not_share_draws() -> None:
    a = generator(0, "x", 1).random(4000)
    b = generator(0, "x", 2).random(4000)
    assert not np.intersect1d(a, b).size


def test_zero_sign_and_nan_payload_do_not_matter() -> None:
    other_nan = struct.unpack("<d", struct.pack("<Q", 0x7FF8000000000123))[0]
    columns = {"a": "float"}
    assert digest([{"a": 0.0}, {"a": math.nan}], columns) == digest(
        [{"a": -0.0}, {"a": other_nan}], columns
    )


def test_null_is_neither_zero_nor_empty_text() -> None:
    assert digest([{"a": None}], {"a": "float"}) != digest([{"a": 0.0}], {"a": "float"})
    assert digest([{"a": None}], {"a": "str"}) != digest([{"a": ""}], {"a": "str"})
    assert digest([{}], {"a": "int"}) == digest([{"a": None}], {"a": "int"})


def test_texts_do_not_run_together() -> None:
    columns = {"a": "str"}
    assert digest([{"a": "ab"}, {"a": "c"}], columns) != digest([{"a": "a"}, {"a": "bc"}], columns)


def test_values_in_another_column_or_row_count_differ() -> None:
    columns = {"a": "int", "b": "int"}
    assert digest([{"a": 1, "b": 2}], columns) != digest([{"a": 2, "b": 1}], columns)
    assert digest([{"a": 1}], {"a": "int"}) != digest([{"a": 1}, {"a": None}], {"a": "int"})


def test_a_change_shows_in_its_own_stage_only() -> None:
    def stages(row: dict[str, object]) -> dict[str, str]:
        d = StageDigests()
        d.add(row)
        return d.hexdigests()

    before, after = (
        stages({"frame": 0, "velocity_x": 0.1}),
        stages({"frame": 0, "velocity_x": 0.1 + 1e-15}),
    )
    assert {s for s in STAGES if before[s] != after[s]} == {"estimation"}
    added = {"frame": 0, "velocity_x": 0.1, **{c.name: 1 for c in FRAMES_ADDED}}
    assert stages(added) == before


def test_every_column_belongs_to_a_known_stage_once() -> None:
    names = [c.name for c in (*FRAMES, *FRAMES_ADDED)]
    assert len(names) == len(set(names))
    assert {c.stage for c in FRAMES} <= set(STAGES)


def test_fingerprint_names_what_changes_last_bits() -> None:
    assert {"machine", "python", "cpu_features", "numpy", "small_gicp"} <= set(fingerprint())
