"""Plots of a trial over time, in the manner of the papers' Figures 4 and 5."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
import pandas as pd

matplotlib.use("Agg")

from matplotlib.figure import Figure

from dgeval.report.summary import Share

COLOURS = ("#1f77b4", "#d95f02", "#2a9d5c", "#7b5ea7")
STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "svg.hashsalt": "dgeval",
}


def trial_figure(
    frames: pd.DataFrame,
    hindsight: pd.DataFrame | None,
    events: dict[str, int | None],
    c_e: float | None = None,
    given_speed: float | None = None,
) -> Figure:
    """Plots of one trial over time, s.

    Rows: servo errors, velocity, scores, and with hindsight the hand's distance to the object.
    Shaded: frames without an accepted registration, and frames in which the target was lost.
    events: name and stamp ns, drawn as lines. c_e: score above which the hand closes. given_speed:
    m/s, of the target, as the manifest says.
    """
    start = int(frames["t_ns"].iloc[0])
    t = (frames["t_ns"] - start).to_numpy() * 1e-9
    with matplotlib.rc_context(STYLE):
        rows = 3 if hindsight is None else 4
        figure = Figure(figsize=(7.2, 0.4 + 1.6 * rows), layout="constrained")
        axes = figure.subplots(rows, 1, sharex=True)
        _lines(
            axes[0],
            t,
            frames,
            {"error_linear": "lin. error [m]", "error_angular": "rot. error [rad]"},
        )
        axes[0].set_ylabel("hand to grasp")
        velocity = {f"velocity_{a}": f"est. velocity {a}" for a in "xyz"}
        _lines(axes[1], t, frames, velocity)
        if frames["velocity_sd"].notna().any():
            speed = np.sqrt((frames[list(velocity)] ** 2).sum(axis=1, skipna=False)).to_numpy()
            axes[1].plot(t, speed, color="#222", lw=1.2, label="speed")
        if given_speed is not None:
            axes[1].axhline(
                given_speed, color="#222", lw=1.0, ls=":", label="speed, by the manifest"
            )
        if axes[1].lines:
            axes[1].legend(loc="upper left", ncols=3)
        axes[1].set_ylabel("m/s, base frame")
        scores = {"hand_score": "success pred. (state)", "grasp_score": "success pred. (grasp)"}
        _lines(axes[2], t, frames, {**scores, "icp_gate_fitness": "gate fitness"})
        if c_e is not None:
            axes[2].axhline(c_e, color="#222", lw=1.0, ls=":", label=r"$c_e$")
            axes[2].legend(loc="best", ncols=4)
        axes[2].set_ylim(-0.03, 1.05)
        axes[2].set_ylabel("score")
        if hindsight is not None:
            _distance(axes[3], start, hindsight)
        axes[-1].set_xlabel("time [s]")
        lost = (frames["tracking"] == "lost").to_numpy()
        blind = frames["predicted"].fillna(False).to_numpy(dtype=bool) & ~lost
        for axis in axes:
            _shade(axis, t, blind, "#f4d9a8")
            _shade(axis, t, lost, "#f0b7b2")
            marks = sorted((at, name) for name, at in events.items() if at is not None)
            for k, (t_ns, name) in enumerate(marks):
                axis.axvline((t_ns - start) * 1e-9, color="#333", lw=0.9, ls="--")
                if axis is axes[0]:  # the words stand apart, however near the lines are
                    axis.annotate(
                        name,
                        ((t_ns - start) * 1e-9, 1.0),
                        xycoords=("data", "axes fraction"),
                        fontsize=8,
                        ha="center" if len(marks) == 1 else "right" if k == 0 else "left",
                    )
    return figure


def shares_figure(title: str, shares: list[Share]) -> Figure:
    """Shares in % as bars with Wilson intervals; the paper's shares as diamonds."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 0.9 + 0.28 * len(shares)), layout="constrained")
        axis = figure.subplots()
        y = np.arange(len(shares))[::-1]
        axis.barh(
            y, [s.percent if s.n else 0 for s in shares], color=COLOURS[0], alpha=0.75, height=0.6
        )
        for at, s in zip(y, shares, strict=True):
            if s.n:
                axis.plot([100 * s.low, 100 * s.high], [at, at], color="#222", lw=1.2)
            if s.published is not None:
                k, n = (int(v) for v in s.published.split("/"))
                axis.plot([100 * k / n], [at], "D", color=COLOURS[1], ms=5)
        axis.set_yticks(y, [f"{s.name}  {s.k}/{s.n}" for s in shares])
        axis.set_xlim(0, 100)
        axis.set_xlabel(
            "%, line: Wilson 95 % interval"
            + (", diamond: paper" if any(s.published for s in shares) else "")
        )
        axis.set_title(title, loc="left", fontsize=9.5)
    return figure


def _lines(axis: Any, t: Any, frames: pd.DataFrame, columns: dict[str, str]) -> None:
    drawn = False
    for colour, (column, label) in zip(COLOURS, columns.items(), strict=False):
        values = frames[column].to_numpy(dtype=float)
        if np.isfinite(values).any():
            axis.plot(t, values, color=colour, lw=1.3, label=label)
            drawn = True
    if drawn:
        axis.legend(loc="best", ncols=len(columns))
    else:
        axis.text(
            0.5,
            0.5,
            "nothing recorded or computed",
            transform=axis.transAxes,
            ha="center",
            va="center",
            color="#888",
        )


def _distance(axis: Any, start: int, hindsight: pd.DataFrame) -> None:
    """Distance of hand and object, mm, by hindsight.

    Thick where the object is on its undisturbed path. Thin where its position is an observation,
    or where it moves with hand or support.
    """
    t = (hindsight["t_ns"].to_numpy() - start) * 1e-9
    mm = 1000 * hindsight["hand_distance"].to_numpy(dtype=float)
    on_path = (hindsight["by"] == "path").to_numpy()
    axis.plot(
        t, np.where(on_path, mm, np.nan), color=COLOURS[0], lw=1.6, label="object on its path"
    )
    axis.plot(
        t,
        np.where(on_path, np.nan, mm),
        color=COLOURS[1],
        lw=1.0,
        label="object as seen, or carried on",
    )
    axis.axhline(0.0, color="#333", lw=0.7)
    axis.set_ylim(
        -30, max(60.0, min(200.0, float(np.nanmax(mm)))) if np.isfinite(mm).any() else 60.0
    )
    axis.set_ylabel("hand to object [mm]")
    axis.legend(loc="upper right")


def _shade(axis: Any, t: Any, mask: Any, colour: str) -> None:
    """Shade the frames of `mask` (n,) at the times t (n,) s, half a frame period to either side."""
    if not len(t):
        return
    half_period_s = float(np.median(np.diff(t))) / 2 if len(t) > 1 else 0.02
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        axis.axvspan(t[a] - half_period_s, t[b - 1] + half_period_s, color=colour, alpha=0.55, lw=0)
