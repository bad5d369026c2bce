"""Summaries of a trial's frames and of the stages' times, for the report."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd


def trial_summary(frames: pd.DataFrame) -> dict[str, Any]:
    """Track losses, velocity and registration of one trial. Times in s, velocities in m/s.

    A value is None where nothing was measured.
    """
    t = (frames["t_ns"] - frames["t_ns"].iloc[0]).to_numpy() * 1e-9
    frame_s = np.diff(t, append=t[-1] + (float(np.median(np.diff(t))) if len(t) > 1 else 0.0))
    lost = (frames["tracking"] == "lost").to_numpy()
    predicted = frames["predicted"].fillna(False).to_numpy(dtype=bool) & ~lost
    speed = np.sqrt(
        (frames[["velocity_x", "velocity_y", "velocity_z"]] ** 2).sum(axis=1, skipna=False)
    )
    settled_speed = speed[t > min(1.0, 0.5 * float(t[-1]))].dropna() if len(t) else speed
    gate_fitness = frames["icp_gate_fitness"].dropna()
    refused = frames["icp_reject_reason"].dropna().value_counts()
    loss_rows = np.nonzero(lost & ~np.concatenate([[False], lost[:-1]]))[0]
    return {
        "duration_s": float(t[-1]) if len(t) else 0.0,
        "lost_s": float(frame_s[lost].sum()),
        "lost_from_s": [float(t[i]) for i in loss_rows],
        "blind_s": float(frame_s[predicted].sum()),
        "speed": float(settled_speed.median()) if len(settled_speed) else None,
        "speed_sd": float(settled_speed.std()) if len(settled_speed) > 1 else None,
        "gate_fitness": float(gate_fitness.median()) if len(gate_fitness) else None,
        "n_accepted": int(frames["icp_accepted"].fillna(False).sum()),
        "refused": {str(k): int(v) for k, v in refused.items()},
        "n_model": int(frames["n_model"].dropna().iloc[-1])
        if frames["n_model"].notna().any()
        else None,
    }


def stage_times(timings: pd.DataFrame) -> list[dict[str, Any]]:
    """Median and 95th percentile of the time per frame of each stage, ms, in pipeline order."""
    out = []
    for stage in timings["stage"].drop_duplicates():
        ms = timings.loc[timings["stage"] == stage, "seconds"] * 1e3
        out.append({"stage": stage, "p50": float(ms.median()), "p95": float(ms.quantile(0.95))})
    return out
