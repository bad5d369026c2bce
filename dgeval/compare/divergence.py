"""Where two replays of a trial first differ, and which differences are only rounding."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dgeval.schema import FRAMES, STAGES, Column


@dataclass(frozen=True, slots=True)
class Tolerance:
    """The largest difference that counts as none: max(absolute, relative * |old value|).

    absolute: in the unit of the column. reason: why this size.
    """

    absolute: float
    relative: float
    reason: str


LAST_BITS = (
    "other processors and library versions round differently; sensors are thousands of times "
    "coarser"
)
BORDER = "a point that lies on a threshold may fall on either side of it"
EXACT = Tolerance(0.0, 0.0, "words and flags are equal or not")
# Tolerance of a column by its unit; `absolute` in that unit
BY_UNIT = {
    "m": Tolerance(1e-6, 0.0, LAST_BITS),
    "m/s": Tolerance(1e-6, 0.0, LAST_BITS),
    "rad": Tolerance(1e-6, 0.0, LAST_BITS),
    "rad/s": Tolerance(1e-6, 0.0, LAST_BITS),
    "px": Tolerance(0.5, 0.005, BORDER),
    "points": Tolerance(1.0, 0.005, BORDER),
    "": Tolerance(1e-6, 0.0, LAST_BITS),
}
# Tolerance of columns whose unit alone does not fix it
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
    """The first difference of one trial.

    frame: index in the trial. field: column of the frame table, or n_frames. old, new: the values;
    None is null.
    """

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
    """What differs in one trial.

    stages: number of differing frames by stage. within: all differences are within tolerance.
    n_frames: of the old and of the new replay.
    """

    trial: str
    first: Divergence
    stages: dict[str, int]
    within: bool
    n_frames: tuple[int, int]


def difference(trial: str, old: pd.DataFrame, new: pd.DataFrame) -> TrialDifference | None:
    """Compare two frame tables over the version-1 columns; None where nothing differs.

    The first difference is by frame, then by stage in the order of the pipeline. It is the first
    beyond tolerance, or the first of all where none is beyond it.
    """
    n = min(len(old), len(new))
    unequal, beyond = {}, {}
    for column in FRAMES:
        unequal[column.name], beyond[column.name] = _differs(
            old[column.name].iloc[:n], new[column.name].iloc[:n], column
        )
    within = len(old) == len(new) and not any(v.any() for v in beyond.values())
    differing = unequal if within else beyond
    first: tuple[int, int, int] | None = None
    stages = {}
    for s, stage in enumerate(STAGES):
        columns = [c for c in FRAMES if c.stage == stage]
        frames = np.zeros(n, bool)
        for k, column in enumerate(columns):
            at = differing[column.name]
            frames |= at
            if at.any() and (first is None or (int(np.argmax(at)), s, k) < first):
                first = int(np.argmax(at)), s, k
        if frames.any():
            stages[stage] = int(frames.sum())
    if first is None:
        if len(old) == len(new):
            return None
        divergence = Divergence(trial, n, "input", "n_frames", len(old), len(new))
        return TrialDifference(
            trial, divergence, {"input": abs(len(old) - len(new))}, False, (len(old), len(new))
        )
    row, s, k = first
    name = [c for c in FRAMES if c.stage == STAGES[s]][k].name
    values = [None if pd.isna(v) else v for v in (old[name].iloc[row], new[name].iloc[row])]
    frame = int(old["frame"].iloc[row])
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
    """Per frame (n,): differs at all; differs beyond the tolerance. Null equals null, NaN NaN."""
    null = old.isna().to_numpy(), new.isna().to_numpy()
    both = ~null[0] & ~null[1]
    differs = np.asarray(null[0] != null[1])
    beyond = differs.copy()
    if column.kind in ("bool", "str"):
        unequal = both & np.array([bool(a != b) for a, b in zip(old, new, strict=True)])
        return differs | unequal, beyond | unequal
    a, b = (np.where(both, v.to_numpy(dtype=float, na_value=np.nan), 0.0) for v in (old, new))
    tolerance = tolerance_of(column)
    error = np.abs(a - b)
    return differs | (error > 0), beyond | (
        error > np.maximum(tolerance.absolute, tolerance.relative * np.abs(a))
    )


def _shown(value: Any) -> str:
    if value is None:
        return "null"
    return f"{value:.9g}" if isinstance(value, float) else str(value)
