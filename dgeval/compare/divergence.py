"""Where two replays of a trial first differ, and which differences are only the last bits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dgeval.schema import FRAMES, STAGES, Column


@dataclass(frozen=True, slots=True)
class Tolerance:
    """A difference up to max(absolute, relative of the old value) is not one. `reason`: why that much."""

    absolute: float
    relative: float
    reason: str


LAST_BITS = (
    "other processors and library versions round differently; sensors are thousands of times "
    "coarser"
)
BORDER = "a point that lies on a threshold may fall on either side of it"
EXACT = Tolerance(0.0, 0.0, "words and flags are equal or not")
BY_UNIT = {
    "m": Tolerance(1e-6, 0.0, LAST_BITS),
    "m/s": Tolerance(1e-6, 0.0, LAST_BITS),
    "rad": Tolerance(1e-6, 0.0, LAST_BITS),
    "rad/s": Tolerance(1e-6, 0.0, LAST_BITS),
    "px": Tolerance(0.5, 0.005, BORDER),
    "points": Tolerance(1.0, 0.005, BORDER),
    "": Tolerance(1e-6, 0.0, LAST_BITS),
}
BY_NAME = {
    "frame": EXACT,
    "n_grasps": EXACT,
    "icp_fitness": Tolerance(0.005, 0.0, BORDER),
    "icp_gate_fitness": Tolerance(0.005, 0.0, BORDER),
}


def tolerance_of(column: Column) -> Tolerance:
    """The tolerance of a frame column."""
    if column.kind in ("bool", "str") or column.unit == "ns":
        return EXACT
    return BY_NAME.get(column.name, BY_UNIT[column.unit])


@dataclass(frozen=True, slots=True)
class Divergence:
    """The first difference of one trial: in which frame, stage and field, and both values (None: null)."""

    trial: str
    frame: int
    stage: str
    field: str
    old: Any
    new: Any

    def __str__(self) -> str:
        return (
            f"{self.trial}: frame {self.frame}, stage {self.stage}, {self.field}: "
            f"{_shown(self.old)} -> {_shown(self.new)}"
        )


@dataclass(frozen=True)
class TrialDifference:
    """What differs in one trial. stages: differing frames by stage; within: all differences are within tolerance."""

    trial: str
    first: Divergence
    stages: dict[str, int]
    within: bool
    n_frames: tuple[int, int]


def difference(trial: str, old: pd.DataFrame, new: pd.DataFrame) -> TrialDifference | None:
    """Frame by frame over the version-1 columns, stages in the order of the pipeline; None where nothing differs.

    The first difference beyond tolerance is given, or the first of all where none is beyond it.
    """
    n = min(len(old), len(new))
    any_, beyond = {}, {}
    for column in FRAMES:
        any_[column.name], beyond[column.name] = _differs(
            old[column.name].iloc[:n], new[column.name].iloc[:n], column
        )
    within = len(old) == len(new) and not any(v.any() for v in beyond.values())
    told = any_ if within else beyond
    first: tuple[int, int, int] | None = None
    stages = {}
    for s, stage in enumerate(STAGES):
        columns = [c for c in FRAMES if c.stage == stage]
        frames = np.zeros(n, bool)
        for k, column in enumerate(columns):
            at = told[column.name]
            frames |= at
            if at.any() and (first is None or (int(np.argmax(at)), s, k) < first):
                first = int(np.argmax(at)), s, k
        if frames.any():
            stages[stage] = int(frames.sum())
    if first is None:
        if len(old) == len(new):
            return None
        ends = Divergence(trial, n, "input", "n_frames", len(old), len(new))
        return TrialDifference(
            trial, ends, {"input": abs(len(old) - len(new))}, False, (len(old), len(new))
        )
    where, s, k = first
    name = [c for c in FRAMES if c.stage == STAGES[s]][k].name
    values = [None if pd.isna(v) else v for v in (old[name].iloc[where], new[name].iloc[where])]
    frame = int(old["frame"].iloc[where])
    return TrialDifference(
        trial,
        Divergence(trial, frame, STAGES[s], name, *values),
        stages,
        within,
        (len(old), len(new)),
    )


def _differs(
    old: pd.Series[Any], new: pd.Series[Any], column: Column
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Per frame: differs at all, differs beyond the tolerance. Null equals null, NaN equals NaN."""
    null = old.isna().to_numpy(), new.isna().to_numpy()
    both = ~null[0] & ~null[1]
    out = np.asarray(null[0] != null[1])
    beyond = out.copy()
    if column.kind in ("bool", "str"):
        unequal = both & np.array([bool(a != b) for a, b in zip(old, new, strict=True)])
        return out | unequal, beyond | unequal
    a, b = (np.where(both, v.to_numpy(dtype=float, na_value=np.nan), 0.0) for v in (old, new))
    tolerance = tolerance_of(column)
    off = np.abs(a - b)
    return out | (off > 0), beyond | (
        off > np.maximum(tolerance.absolute, tolerance.relative * np.abs(a))
    )


def _shown(value: Any) -> str:
    if value is None:
        return "null"
    return f"{value:.9g}" if isinstance(value, float) else str(value)
