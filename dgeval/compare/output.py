"""A comparison as Markdown, as JSON and as one HTML file that needs no network."""

from __future__ import annotations

import math
from typing import Any

import jinja2
import matplotlib
import numpy as np
import pandas as pd

matplotlib.use("Agg")

from matplotlib.figure import Figure

from dgeval.compare.comparison import Comparison
from dgeval.compare.divergence import TrialDifference
from dgeval.geometry import Array
from dgeval.pages import as_data_uri, template_environment

MOST_DRAWN = 12  # trials with a plot; the others are in the tables only
MOST_LISTED = 10  # changed trials in the list
SIGNIFICANT_TIME = 1.1  # factor of a stage's median time; smaller changes are not reported
# Plots of a changed trial: label of the axis and columns of the frame table
DRAWN = {
    "hand to grasp [m]": ("error_linear",),
    "velocity [m/s]": ("velocity_x", "velocity_y", "velocity_z"),
    "gate fitness": ("icp_gate_fitness",),
    "score": ("hand_score",),
}


def as_json(comparison: Comparison) -> dict[str, Any]:
    """The whole comparison as a JSON document; a value that is not finite becomes null."""
    return {
        "old": str(comparison.old.folder),
        "new": str(comparison.new.folder),
        "conclusion": comparison.conclusion,
        "trials": len(comparison.trials),
        "only_old": list(comparison.only_old),
        "only_new": list(comparison.only_new),
        "config": [{"field": f, "old": a, "new": b} for f, a, b in comparison.config],
        "versions": [{"what": f, "old": a, "new": b} for f, a, b in comparison.versions],
        "first_divergence": None if comparison.first is None else _divergence(comparison.first),
        "changed_trials": [_divergence(d) for d in comparison.differences],
        "facts": [
            {"trial": t, "fact": f, "old": _plain(a), "new": _plain(b)}
            for t, f, a, b in comparison.facts
        ],
        "metrics": [
            {
                "metric": r.metric.name,
                "unit": r.metric.unit,
                "trials": r.n,
                "old": r.old,
                "new": r.new,
                "difference": r.difference,
                "interval": [_plain(r.low), _plain(r.high)],
                "p": r.p,
                "relevant": r.metric.relevant,
                "answer": r.answer,
                "trials_needed": r.needed,
            }
            for r in comparison.results
        ],
        "timings": [{"stage": s, "factor": f, "p": p} for s, f, p in comparison.timings],
    }


def _divergence(d: TrialDifference) -> dict[str, Any]:
    f = d.first
    return {
        "trial": d.trial,
        "frame": f.frame,
        "stage": f.stage,
        "field": f.field,
        "old": _plain(f.old),
        "new": _plain(f.new),
        "within_tolerance": d.within,
        "frames_that_differ": d.stages,
        "frames": list(d.n_frames),
    }


def _plain(value: Any) -> Any:
    if value is None or (isinstance(value, float) and not math.isfinite(value)) or pd.isna(value):
        return None
    return value.item() if isinstance(value, np.generic) else value


def as_markdown(comparison: Comparison) -> str:
    """The comparison as one page of Markdown; pipes in names are escaped."""
    return _environment().get_template("compare.md").render(**_shown(comparison))


def as_html(comparison: Comparison) -> str:
    """The comparison as one HTML file that needs no network.

    It holds the tables and, for the trials that changed most, plots of old and new values.
    """
    return (
        _environment()
        .get_template("compare.html")
        .render(**_shown(comparison), figures=overlays(comparison))
    )


def _environment() -> jinja2.Environment:
    environment = template_environment("compare/templates")
    environment.filters["cell"] = lambda value: str(value).replace("|", "\\|").replace("\n", " ")
    environment.filters["number"] = _number
    return environment


def _number(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.4g}"


def _shown(comparison: Comparison) -> dict[str, Any]:
    slower = [
        (s, f, p)
        for s, f, p in comparison.timings
        if p < 0.01 and not 1 / SIGNIFICANT_TIME < f < SIGNIFICANT_TIME
    ]
    return {
        "c": comparison,
        "first": comparison.first,
        "listed": comparison.differences[:MOST_LISTED],
        "unlisted": max(0, len(comparison.differences) - MOST_LISTED),
        "times": slower,
    }


def overlays(comparison: Comparison) -> list[tuple[str, str]]:
    """(trial, PNG as data URI) of the MOST_DRAWN trials with most differing frames."""
    most = sorted(
        (d for d in comparison.differences if not d.within),
        key=lambda d: (-sum(d.stages.values()), d.trial),
    )[:MOST_DRAWN]
    return [
        (
            d.trial,
            as_data_uri(overlay(comparison.old.frames(d.trial), comparison.new.frames(d.trial), d)),
        )
        for d in most
    ]


def overlay(old: pd.DataFrame, new: pd.DataFrame, d: TrialDifference) -> Figure:
    """Columns of DRAWN over time, s: old thick and pale, new thin.

    A dashed line marks the first difference.
    """
    plots = {
        k: v for k, v in DRAWN.items() if any(t[list(v)].notna().any().any() for t in (old, new))
    }
    figure = Figure(figsize=(7.2, 0.5 + 1.4 * max(1, len(plots))), layout="constrained")
    axes = np.atleast_1d(np.asarray(figure.subplots(max(1, len(plots)), 1, sharex=True)))
    start = int(old["t_ns"].iloc[0])
    at = (
        (int(old.loc[old["frame"] == d.first.frame, "t_ns"].iloc[0]) - start) * 1e-9
        if len(old) > d.first.frame
        else None
    )
    for axis, (label, columns) in zip(axes, plots.items(), strict=False):
        for k, column in enumerate(columns):
            for table, width, alpha, name in ((old, 3.2, 0.35, "old"), (new, 1.1, 1.0, "new")):
                t: Array = (table["t_ns"].to_numpy(dtype=np.int64) - start) * 1e-9
                values = table[column].to_numpy(dtype=float, na_value=np.nan)
                axis.plot(
                    t, values, color=f"C{k}", lw=width, alpha=alpha, label=name if k == 0 else None
                )
        if at is not None:
            axis.axvline(at, color="#b3392f", lw=0.9, ls="--")
        axis.set_ylabel(label, fontsize=8)
        axis.legend(fontsize=8, frameon=False, loc="upper right")
    axes[-1].set_xlabel("time [s]")
    return figure
