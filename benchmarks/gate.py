"""False alarms and power of the regression gate.

`python -m benchmarks.gate [--runs 1000] [--replays RUN RUN …]`

A/A: the same system twice, so every difference is chance. RUNs are replays of one data set that
differ only in their seed. Each resampling draws trials with replacement and two replays of each
trial, and asks the gate for its answers. A second table uses synthetic noise: heavy-tailed, with a
share of the trials unchanged.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from dgeval.compare.paired import ALPHA, METRICS, answers, trial_metrics
from dgeval.determinism import generator
from dgeval.geometry import Array
from dgeval.runs.results import read_run
from dgeval.statistics import wilson
from matplotlib.figure import Figure

from benchmarks.result import RESULTS, table, write

UNCHANGED = 0.2  # share of trials in which a metric does not change at all
TAILS = 3.0  # degrees of freedom of Student's t, from which the noise is drawn
SIZES = (6, 20, 60, 120)  # trials


def noise(rng: np.random.Generator, n: int, scale: float) -> Array:
    """Differences of an A/A pair (n,), standard deviation `scale` where they are not zero."""
    d = rng.standard_t(TAILS, n) * scale / np.sqrt(TAILS / (TAILS - 2))
    d[rng.random(n) < UNCHANGED] = 0.0
    return d


def answers_of(
    rng: np.random.Generator, n: int, scale: float, effect: float, metric: int
) -> list[str]:
    """Answers of the gate for each metric of n trials under noise.

    scale: of the noise. effect: by which `metric` (index in METRICS) gets worse. Both in units of
    the relevant difference.
    """
    old = {m.name: rng.normal(0.5, 0.1, n) for m in METRICS}
    new = {m.name: old[m.name] + noise(rng, n, scale * m.relevant) for m in METRICS}
    sign = 1 if METRICS[metric].lower_is_better else -1
    new[METRICS[metric].name] += sign * effect * METRICS[metric].relevant
    return [str(r.answer) for r in answers(old, new)]


def false_alarms(runs: int, n: int, seed: int, scale: float = 5.0) -> tuple[int, int]:
    """(A/A resamplings in which any metric is called worse or better, resamplings)."""
    rng = generator(seed, "A/A", n)
    wrong = sum(
        bool({"worse", "better"} & set(answers_of(rng, n, scale, 0.0, 0))) for _ in range(runs)
    )
    return wrong, runs


def replayed(folders: list[Path]) -> Array:
    """Metrics (runs, trials, metrics) of replays of the same recordings.

    Hindsight is the first run's, as in the gate.
    """
    runs = [read_run(folder) for folder in folders]
    trials = runs[0].trials.set_index("trial").sort_index()
    for a, b in pairwise(runs):
        assert a.about["inputs"] == b.about["inputs"], "replays of other recordings"
    out = np.full((len(runs), len(trials), len(METRICS)), np.nan)
    for k, trial in enumerate(trials.index):
        close_ns = trials["t_close_ns"].loc[trial]
        for r, run in enumerate(runs):
            metrics = trial_metrics(
                run.frames(trial),
                runs[0].hindsight(trial),
                None if pd.isna(close_ns) else int(close_ns),
            )
            out[r, k] = [metrics[m.name] for m in METRICS]
    return out


def resampled(pool: Array, rng: np.random.Generator, n: int, effect: Array) -> list[str]:
    """Answers of the gate for each metric of n trials drawn from `pool`.

    pool: of `replayed`. Each trial comes with two of its runs. effect: (metrics,), added to the
    second.
    """
    runs, trials, _ = pool.shape
    chosen = rng.integers(trials, size=n)
    first = rng.integers(runs, size=n)
    second = (first + rng.integers(1, runs, size=n)) % runs
    old, new = pool[first, chosen], pool[second, chosen] + effect
    names = [m.name for m in METRICS]
    results = answers(dict(zip(names, old.T, strict=True)), dict(zip(names, new.T, strict=True)))
    by_name = {r.metric.name: str(r.answer) for r in results}
    return [by_name.get(name, "nothing to measure") for name in names]


def of_replays(folders: list[Path], runs: int) -> list[str]:
    """Tables of real replays: size of their noise, false alarms under it, power by effect."""
    pool = replayed(folders)
    noises = []
    for k, m in enumerate(METRICS):
        of_metric = pool[:, np.isfinite(pool[:, :, k]).all(axis=0), k]
        if of_metric.size == 0:
            noises.append([m.name, "never measured", "–"])
            continue
        # median over trials of the standard deviation between seeds, in relevant differences
        spread = float(np.median(np.std(of_metric, axis=0))) / m.relevant
        noises.append(
            [m.name, f"{spread:.2g}", f"{100 * np.mean(np.diff(of_metric, axis=0) != 0):.0f} %"]
        )
    none = np.zeros(len(METRICS))
    alarms, powers = [], []
    for n in SIZES:
        rng = generator(1, "A/A of replays", n)
        answers_by_run = [resampled(pool, rng, n, none) for _ in range(runs)]
        wrong = sum(bool({"worse", "better"} & set(s)) for s in answers_by_run)
        low, high = wilson(wrong, runs)
        conclusive = sum("inconclusive" not in s for s in answers_by_run)
        interval = f"{100 * low:.1f}–{100 * high:.1f} %"
        alarms.append([str(n), f"{wrong}/{runs}", interval, f"{100 * conclusive / runs:.0f} %"])
    for k, m in enumerate(METRICS):
        if noises[k][1] == "never measured":
            continue
        effect = none.copy()
        effect[k] = 2 * m.relevant * (1 if m.lower_is_better else -1)
        row = [m.name]
        for n in SIZES:
            rng = generator(1, "power of replays", n)
            called_worse = [resampled(pool, rng, n, effect)[k] == "worse" for _ in range(runs // 5)]
            row.append(f"{100 * np.mean(called_worse):.0f} %")
        powers.append(row)
    return [
        f"Real replays: {pool.shape[1]} recordings, each with {pool.shape[0]} seeds. Spread "
        "between seeds in units of what is relevant, and how often two seeds differ at all.",
        table(["metric", "spread", "differs"], noises),
        "A/A resamplings of these replays: false alarms, and how often no metric was left "
        "inconclusive.",
        table(["trials", "false alarms", "95 % interval", "conclusive"], alarms),
        "Called worse where a metric gets worse by twice what is relevant, under the replays' "
        "noise.",
        table(["metric", *(f"{n} trials" for n in SIZES)], powers),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument(
        "--replays",
        type=Path,
        nargs="+",
        default=[],
        help="runs of one data set with different seeds",
    )
    options = parser.parse_args()
    rows = []
    for scale in (1.0, 5.0, 20.0):
        for n in SIZES:
            wrong, runs = false_alarms(options.runs, n, 0, scale)
            low, high = wilson(wrong, runs)
            rows.append(
                [f"{scale:g}", str(n), f"{wrong}/{runs}", f"{100 * low:.1f}–{100 * high:.1f} %"]
            )
    figure = Figure(figsize=(6.0, 3.4), layout="constrained")
    axis = figure.subplots()
    effects = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0])
    powers = []
    for n in SIZES:
        rng = generator(0, "power", n)
        power = [
            np.mean(
                [
                    answers_of(rng, n, 3.0, float(e), 3)[3] == "worse"
                    for _ in range(options.runs // 5)
                ]
            )
            for e in effects
        ]
        powers.append([str(n), *(f"{100 * p:.0f} %" for p in power)])
        axis.plot(effects, power, marker="o", ms=3, label=f"{n} trials")
    axis.axhline(ALPHA, color="#888", lw=0.8, ls=":")
    axis.set_xlabel("effect, in units of the smallest that matters (sd between trials: 3)")
    axis.set_ylabel("called worse")
    axis.legend(fontsize=8, frameon=False)
    RESULTS.mkdir(exist_ok=True)
    figure.savefig(RESULTS / "gate-power.png", dpi=110, metadata={"Software": None})
    parts = [
        f"A/A resamplings in which any of {len(METRICS)} metrics is called worse or better; stated "
        f"level {100 * ALPHA:.0f} %. Noise in units of what is relevant.",
        table(["noise", "trials", "false alarms", "95 % interval"], rows),
        "Share of resamplings in which the metric that got worse is called worse, by effect (noise "
        "3). Plot: gate-power.png.",
        table(["trials", *(f"{e:g}" for e in effects)], powers),
    ]
    command = f"python -m benchmarks.gate --runs {options.runs}"
    if options.replays:
        parts = of_replays(options.replays, options.runs) + parts
        command += (
            f" --replays …  ({len(options.replays)} × dgeval replay "
            "datasets/ci-smoke/ci-smoke.toml --set seed=K)"
        )
    print(
        write("gate", "False alarms and power of the gate", command, parts).read_text(
            encoding="utf-8"
        )
    )


if __name__ == "__main__":
    main()
