"""Intervals and scores for reports and benchmarks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from dgeval.determinism import generator
from dgeval.geometry import Array

BOOTSTRAPS = 1000  # resamplings of the trials


def wilson(successes: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson score interval of a share; (0, 1) without trials."""
    if n == 0:
        return 0.0, 1.0
    interval = binomtest(successes, n).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


def confusion(
    truth: Sequence[str], predicted: Sequence[str], classes: Sequence[str]
) -> NDArray[np.int64]:
    """Counts (n, n): rows truth, columns predicted class. Labels outside `classes` are left out."""
    out = np.zeros((len(classes), len(classes)), dtype=np.int64)
    for a, b in zip(truth, predicted, strict=True):
        if a in classes and b in classes:
            out[classes.index(a), classes.index(b)] += 1
    return out


def macro_f1(
    truth: Sequence[str], predicted: Sequence[str], classes: Sequence[str], seed: int = 0
) -> tuple[float, float, float]:
    """Mean F1 over the classes that occur in truth, and its 95 % bootstrap interval over trials.

    An abstention counts as wrong.
    """
    a, b = np.array(truth), np.array(predicted)
    rng = generator(seed, "bootstrap", 0)
    resampled = []
    for _ in range(BOOTSTRAPS):
        k = rng.integers(0, len(a), len(a))
        resampled.append(_f1(a[k], b[k], classes))
    return (
        _f1(a, b, classes),
        float(np.quantile(resampled, 0.025)),
        float(np.quantile(resampled, 0.975)),
    )


def _f1(truth: NDArray[np.str_], predicted: NDArray[np.str_], classes: Sequence[str]) -> float:
    scores = []
    for c in classes:
        hit = int(((truth == c) & (predicted == c)).sum())
        either = int((truth == c).sum() + (predicted == c).sum())
        if (truth == c).any():
            scores.append(2 * hit / either)
    return float(np.mean(scores)) if scores else 0.0


def calibration_error(p: Array, correct: NDArray[np.bool_], bins: int = 10) -> float:
    """Expected calibration error in bins of equal width.

    p: stated probabilities (n,) of being right. correct: whether each was right (n,).
    """
    k = np.minimum((p * bins).astype(int), bins - 1)
    return float(
        sum(
            abs(p[k == b].mean() - correct[k == b].mean()) * (k == b).mean()
            for b in range(bins)
            if (k == b).any()
        )
    )
