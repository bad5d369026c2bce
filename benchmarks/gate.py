"""False alarms and power of the regression gate: `python -m benchmarks.gate [--runs 1000]`.

A/A: the same system twice, so every difference is chance. Differences of the metrics are heavy-tailed and many are zero, as
replays with another seed give them; each resampling draws trials anew and asks the gate for its conclusion.
"""

from __future__ import annotations

import argparse

import numpy as np
from dgeval.compare.paired import ALPHA, METRICS, answers
from dgeval.determinism import generator
from dgeval.geometry import Array
from dgeval.report.statistics import wilson
from matplotlib.figure import Figure

from benchmarks.result import RESULTS, table, write

UNCHANGED = 0.2  # share of trials in which a metric does not change at all
TAILS = 3.0  # degrees of freedom of Student's t
SIZES = (6, 20, 60, 120)  # trials


def noise(rng: np.random.Generator, n: int, scale: float) -> Array:
    """Differences of an A/A pair (n,): none in some trials, heavy tails in the others."""
    d = rng.standard_t(TAILS, n) * scale / np.sqrt(TAILS / (TAILS - 2))
    d[rng.random(n) < UNCHANGED] = 0.0
    return d


def answers_of(rng: np.random.Generator, n: int, scale: float, effect: float, metric: int) -> list[str]:
    """What the gate says of each metric; `effect` and `scale` in units of what is relevant, the effect in one metric."""
    old = {m.name: rng.normal(0.5, 0.1, n) for m in METRICS}
    new = {m.name: old[m.name] + noise(rng, n, scale * m.relevant) for m in METRICS}
    sign = 1 if METRICS[metric].lower_is_better else -1
    new[METRICS[metric].name] += sign * effect * METRICS[metric].relevant
    return [str(r.answer) for r in answers(old, new)]


def false_alarms(runs: int, n: int, seed: int, scale: float = 5.0) -> tuple[int, int]:
    """A/A resamplings in which any metric is called worse or better, and how many there were."""
    rng = generator(seed, "A/A", n)
    wrong = sum(bool({"worse", "better"} & set(answers_of(rng, n, scale, 0.0, 0))) for _ in range(runs))
    return wrong, runs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000)
    options = parser.parse_args()
    rows = []
    for scale in (1.0, 5.0, 20.0):
        for n in SIZES:
            wrong, runs = false_alarms(options.runs, n, 0, scale)
            low, high = wilson(wrong, runs)
            rows.append([f"{scale:g}", str(n), f"{wrong}/{runs}", f"{100 * low:.1f}–{100 * high:.1f} %"])
    figure = Figure(figsize=(6.0, 3.4), layout="constrained")
    axis = figure.subplots()
    effects = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0])
    powers = []
    for n in SIZES:
        rng = generator(0, "power", n)
        power = [
            np.mean([answers_of(rng, n, 3.0, float(e), 3)[3] == "worse" for _ in range(options.runs // 5)]) for e in effects
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
        f"A/A resamplings in which any of {len(METRICS)} metrics is called worse or better; stated level {100 * ALPHA:.0f} %. "
        "Noise in units of what is relevant.",
        table(["noise", "trials", "false alarms", "95 % interval"], rows),
        "Share of resamplings in which the metric that got worse is called worse, by effect (noise 3). Plot: gate-power.png.",
        table(["trials", *(f"{e:g}" for e in effects)], powers),
    ]
    command = f"python -m benchmarks.gate --runs {options.runs}"
    print(write("gate", "False alarms and power of the gate", command, parts).read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
