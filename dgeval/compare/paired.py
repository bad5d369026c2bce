"""Is a change better or worse: tests paired over trials, corrected for the number of metrics.

Where the trials don't decide it, the answer is `inconclusive`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
from scipy.stats import binomtest, mannwhitneyu, norm, rankdata, wilcoxon

from dgeval.geometry import Array

# Level of the whole gate: probability of any false "worse" or "better" where nothing changed
ALPHA = 0.05
EXACT = 13  # pairs; up to so many, the signed-rank test goes through all 2^n signs
POWER = 0.8  # probability with which trials_needed plans to find a relevant difference
Answer = Literal["better", "worse", "same", "inconclusive"]


@dataclass(frozen=True, slots=True)
class Metric:
    """A number per trial.

    relevant: the smallest difference that matters, in `unit`; a smaller one is `same`.
    """

    name: str
    unit: str
    lower_is_better: bool
    relevant: float
    meaning: str


# Replay quality. Both runs are measured against the hindsight of the baseline,
# which is a fact of the log.
METRICS = (
    Metric("lost", "", True, 0.02, "share of frames in which the tracker had lost the target"),
    Metric("predicted", "", True, 0.02, "share of frames without an accepted registration"),
    Metric(
        "position_error",
        "m",
        True,
        0.001,
        "median distance of the feature point from where hindsight has it",
    ),
    Metric(
        "velocity_error",
        "m/s",
        True,
        0.003,
        "median error of the estimated velocity against hindsight's path",
    ),
    Metric("gate_fitness", "", False, 0.02, "median fitness of registrations at the gate"),
    Metric(
        "close_time",
        "s",
        True,
        0.05,
        "from the moment the replay would have closed to the recorded close",
    ),
)


def trial_metrics(
    frames: pd.DataFrame,
    hindsight: pd.DataFrame | None,
    close_ns: int | None,
    execute_ns: int | None,
) -> dict[str, float]:
    """METRICS of one trial by name, in their units; NaN where there is nothing to measure.

    frames, hindsight: tables of that trial. close_ns, execute_ns: stamps of the recorded close and
    of the replay's, or None.
    """
    out = dict.fromkeys((m.name for m in METRICS), math.nan)
    out["lost"] = float((frames["tracking"] == "lost").mean())
    out["predicted"] = float(frames["predicted"].fillna(True).astype(bool).mean())
    fitness = frames["icp_gate_fitness"].dropna()
    if len(fitness):
        out["gate_fitness"] = float(fitness.median())
    if close_ns is not None and execute_ns is not None:
        out["close_time"] = abs(execute_ns - close_ns) * 1e-9
    path = None if hindsight is None else hindsight[hindsight["by"] == "path"]
    if path is None or len(path) < 10:
        return out
    t = path["t_ns"].to_numpy(dtype=np.int64)
    t_s = (t - t[0]) * 1e-9
    positions = path[["object_px", "object_py", "object_pz"]].to_numpy(dtype=float)
    velocity = np.polyfit(t_s, positions, 1)[0]
    joined = frames.set_index("frame").loc[path["frame"]]
    estimated = joined[["velocity_x", "velocity_y", "velocity_z"]].to_numpy(
        dtype=float, na_value=np.nan
    )
    if np.isfinite(estimated).any():
        out["velocity_error"] = float(np.nanmedian(np.linalg.norm(estimated - velocity, axis=1)))
    # the path has no rotation: the offset of the feature point from the model's origin is constant
    offset = (
        joined[["feature_px", "feature_py", "feature_pz"]].to_numpy(dtype=float, na_value=np.nan)
        - positions
    )
    if np.isfinite(offset).any():
        out["position_error"] = float(
            np.nanmedian(np.linalg.norm(offset - np.nanmedian(offset, axis=0), axis=1))
        )
    return out


@dataclass(frozen=True, slots=True)
class Result:
    """Answer for one metric over n trials, in the unit of the metric.

    old, new: medians over trials. difference: median of the paired differences new - old, with its
    interval low to high. p: of the signed-rank test, corrected by Holm. needed: number of trials
    that would decide it; None where it is decided or no number would.
    """

    metric: Metric
    n: int
    old: float
    new: float
    difference: float
    low: float
    high: float
    p: float
    answer: Answer
    needed: int | None


def answers(old: dict[str, Array], new: dict[str, Array], alpha: float = ALPHA) -> list[Result]:
    """Answer for each metric of METRICS that at least one trial has in both runs.

    old, new: (n,) values by name of the metric, in the same order of trials; NaN is left out.
    Wilcoxon's signed-rank test with Holm's correction decides better or worse. Where the interval
    of the median difference (the test's own, by Walsh averages) lies within the relevant
    difference, the answer is same. Else it is inconclusive.
    """
    measured = []
    for metric in METRICS:
        a, b = old[metric.name], new[metric.name]
        both = np.isfinite(a) & np.isfinite(b)
        if both.any():
            measured.append((metric, a[both], b[both]))
    p_values = [signed_rank(b - a) for _, a, b in measured]
    corrected = holm(p_values)
    out = []
    for (metric, a, b), p in zip(measured, corrected, strict=True):
        d = b - a
        low, high = walsh_interval(d, alpha)
        median = float(np.median(d))
        needed = None
        answer: Answer = "inconclusive"
        if not d.any():
            answer = "same"
        elif p <= alpha and not -metric.relevant < median < metric.relevant:
            answer = "worse" if (median > 0) == metric.lower_is_better else "better"
        elif -metric.relevant < low and high < metric.relevant:
            answer = "same"
        else:
            needed = trials_needed(
                float(np.std(d, ddof=1)) if len(d) > 1 else math.nan, metric.relevant, alpha, len(d)
            )
        out.append(
            Result(
                metric,
                len(d),
                float(np.median(a)),
                float(np.median(b)),
                median,
                low,
                high,
                p,
                answer,
                needed,
            )
        )
    return out


def signed_rank(d: Array) -> float:
    """Two-sided p of Wilcoxon's signed-rank test over the pairs that differ; 1 where none does.

    d: differences (n,). Up to EXACT pairs the p is exact, also with ties: all signs are tried in
    one array (scipy tries them one by one, a hundred times slower).
    """
    differing = d[d != 0]
    n = len(differing)
    if n == 0:
        return 1.0
    if n > EXACT:
        return float(wilcoxon(differing).pvalue)
    ranks = rankdata(np.abs(differing))
    signs = (np.arange(2**n)[:, None] >> np.arange(n)) & 1
    distance = np.abs(signs @ ranks - ranks.sum() / 2)
    # rank sums are multiples of a half, so the comparison is exact
    return float(np.mean(distance >= abs(ranks[differing > 0].sum() - ranks.sum() / 2)))


def holm(p: Sequence[float]) -> list[float]:
    """Holm's step-down correction: family-wise p values, in the order given."""
    order = np.argsort(p, kind="stable")
    out = np.empty(len(p))
    worst = 0.0
    for rank, k in enumerate(order):
        worst = max(worst, min(1.0, (len(p) - rank) * p[k]))
        out[k] = worst
    return [float(v) for v in out]


def walsh_interval(d: Array, alpha: float) -> tuple[float, float]:
    """Confidence interval of the median difference that belongs to the signed-rank test.

    d: differences (n,). (-inf, inf) where there are too few pairs for an interval at `alpha`.
    """
    n = len(d)
    walsh = np.sort(((d[:, None] + d[None]) / 2)[np.triu_indices(n)])
    # normal approximation of the rank sum's quantile, rounded to the safe side
    cut = math.floor(
        n * (n + 1) / 4 - norm.ppf(1 - alpha / 2) * math.sqrt(n * (n + 1) * (2 * n + 1) / 24)
    )
    if cut < 1 or 2.0 ** (1 - n) > alpha:
        return -math.inf, math.inf
    return float(walsh[cut - 1]), float(walsh[-cut])


def trials_needed(sd: float, relevant: float, alpha: float, n: int) -> int | None:
    """Number of paired trials that finds the relevant difference with probability POWER.

    sd: standard deviation of the differences over the n trials there are, in the unit of
    `relevant`. Always more than n; None where sd is not finite.
    """
    if not math.isfinite(sd):
        return None
    # with normal differences the signed-rank test needs about 5 % more trials than the t test
    z = norm.ppf(1 - alpha / (2 * len(METRICS))) + norm.ppf(POWER)
    return max(n + 1, 6, math.ceil(1.05 * (z * sd / relevant) ** 2))


def mcnemar(old: Sequence[bool], new: Sequence[bool]) -> tuple[int, int, float]:
    """Exact McNemar test: (successes lost, successes gained, two-sided p).

    Only for closed-loop simulations on equal seeds.
    """
    lost = sum(a and not b for a, b in zip(old, new, strict=True))
    gained = sum(b and not a for a, b in zip(old, new, strict=True))
    return lost, gained, float(binomtest(lost, lost + gained).pvalue) if lost + gained else 1.0


def timing(old: Array, new: Array) -> tuple[float, float]:
    """Median time new over old, and two-sided p of the Mann-Whitney test. Times (n,) s."""
    return float(np.median(new) / max(np.median(old), 1e-12)), float(mannwhitneyu(old, new).pvalue)
