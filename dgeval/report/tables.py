"""The numbers of a report."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd


def trial_summary(frames: pd.DataFrame) -> dict[str, Any]:
    """Losses, velocity and fit of one trial. Times in s, velocities in m/s; None where there is nothing to say."""
    t = (frames["t_ns"] - frames["t_ns"].iloc[0]).to_numpy() * 1e-9
    step = np.diff(t, append=t[-1] + (float(np.median(np.diff(t))) if len(t) > 1 else 0.0))
    lost = (frames["tracking"] == "lost").to_numpy()
    blind = frames["predicted"].fillna(False).to_numpy(dtype=bool) & ~lost
    speed = np.sqrt(
        (frames[["velocity_x", "velocity_y", "velocity_z"]] ** 2).sum(axis=1, skipna=False)
    )
    settled = speed[t > min(1.0, 0.5 * float(t[-1]))].dropna() if len(t) else speed
    fit = frames["icp_gate_fitness"].dropna()
    refused = frames["icp_reject_reason"].dropna().value_counts()
    starts = np.nonzero(lost & ~np.concatenate([[False], lost[:-1]]))[0]
    return {
        "duration_s": float(t[-1]) if len(t) else 0.0,
        "lost_s": float(step[lost].sum()),
        "lost_from_s": [float(t[i]) for i in starts],
        "blind_s": float(step[blind].sum()),
        "speed": float(settled.median()) if len(settled) else None,
        "speed_sd": float(settled.std()) if len(settled) > 1 else None,
        "gate_fitness": float(fit.median()) if len(fit) else None,
        "n_accepted": int(frames["icp_accepted"].fillna(False).sum()),
        "refused": {str(k): int(v) for k, v in refused.items()},
        "n_model": int(frames["n_model"].dropna().iloc[-1])
        if frames["n_model"].notna().any()
        else None,
    }


def stage_times(timings: pd.DataFrame) -> list[dict[str, Any]]:
    """Median and 95th percentile per stage, ms, in the order of the pipeline."""
    out = []
    for stage in timings["stage"].drop_duplicates():
        ms = timings.loc[timings["stage"] == stage, "seconds"] * 1e3
        out.append({"stage": stage, "p50": float(ms.median()), "p95": float(ms.quantile(0.95))})
    return out
