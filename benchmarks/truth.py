"""Replay of simulated recordings against their ground truth: pose and velocity error by object and speed.

python -m benchmarks.truth RUN MANIFEST      (a run made by `dgeval replay MANIFEST --out RUN`)
"""

from __future__ import annotations

import json
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from dgeval.config import load_config
from dgeval.geometry import invert, matrix_from_pose, rotation_angle
from dgeval.recording.messages import poses_of
from dgeval.recording.trials import TrialSpec, find_trials, open_trial
from dgeval.run import file_name

from benchmarks.result import number, table, write

POSE = [f"model_{n}" for n in ("px", "py", "pz", "qx", "qy", "qz", "qw")]


def errors_against_truth(spec: TrialSpec, run: Path) -> pd.DataFrame:
    """One row per frame with a pose: t_s, accepted, position_m, angle_deg, velocity_m_s; t_sight_s and t_close_s of the trial.

    The model's frame is arbitrary: its pose on the object is taken from the first frame that has one. t_sight_s: when the
    simulated camera first lost the object for a quarter of a second (no belief mask), at the latest the close.
    """
    trial = open_trial(spec, load_config())
    truth: dict[int, Any] = {}
    masks: list[int] = []
    verdict: dict[str, Any] = {}
    wanted = frozenset({"/truth/object_pose", "/truth/verdict", "/dgeval/belief/mask"})
    for message in trial.opened.messages(wanted):
        if message.topic == "/dgeval/belief/mask":
            masks.append(message.log_ns)
            continue
        value = trial.opened.decode(message)
        if message.topic == "/truth/verdict":
            verdict = json.loads(value.data)
        else:
            truth[message.log_ns] = matrix_from_pose(poses_of(value)[0].pose)
    assert spec.start_ns is None or spec.start_ns >= 0
    start = min(truth)
    close = verdict["t_close_s"] if verdict["t_close_s"] is not None else (max(truth) - start) * 1e-9
    gaps = [a for a, b in pairwise(masks) if b - a > 250_000_000] or masks[-1:] or [start]
    sight = min((gaps[0] - start) * 1e-9, close)
    frames = pd.read_parquet(run / "frames" / f"{file_name(spec.id)}.parquet")
    rows, T_model_object = [], None
    times = sorted(truth)
    for _, row in frames[frames["model_px"].notna()].iterrows():
        t_ns = int(row["t_ns"])
        T_base_camera = trial.robot.T_base_camera(t_ns)
        k = int(np.searchsorted(times, t_ns))
        if T_base_camera is None or t_ns not in truth or not 5 <= k < len(times) - 5:
            continue
        T_base_model = T_base_camera @ matrix_from_pose(row[POSE].to_numpy(dtype=float))
        if T_model_object is None:
            T_model_object = invert(T_base_model) @ truth[t_ns]
        T, T_true = T_base_model @ T_model_object, truth[t_ns]
        moved = truth[times[k + 5]][:3, 3] - truth[times[k - 5]][:3, 3]
        v_true = moved / ((times[k + 5] - times[k - 5]) * 1e-9)
        v = row[["velocity_x", "velocity_y", "velocity_z"]].to_numpy(dtype=float)
        rows.append(
            {
                "t_s": (t_ns - start) * 1e-9,
                "accepted": not row["predicted"],
                "position_m": float(np.linalg.norm(T[:3, 3] - T_true[:3, 3])),
                "angle_deg": float(np.degrees(rotation_angle(T[:3, :3].T @ T_true[:3, :3]))),
                "velocity_m_s": float(np.linalg.norm(v - v_true)),
            }
        )
    columns = ["t_s", "accepted", "position_m", "angle_deg", "velocity_m_s"]
    out = pd.DataFrame(rows, columns=columns)
    return out.assign(t_sight_s=sight, t_close_s=close)


def main() -> None:
    run, manifest = Path(sys.argv[1]), Path(sys.argv[2])
    rows = []
    for spec in find_trials([manifest]):
        found = errors_against_truth(spec, run)
        seen = found[found["accepted"] & (found["t_s"] > 1.0) & (found["t_s"] < found["t_sight_s"])]
        rows.append({"object": spec.object, "speed": spec.speed, "n": len(seen), **seen.median(numeric_only=True).to_dict()})
    everything = pd.DataFrame(rows)
    lines = []
    for by in ("object", "speed"):
        cells = [
            [str(name), str(len(g)), str(int(g["n"].sum())), *(number(g[c].median() * s) for c, s in MEASURES), worst(g)]
            for name, g in everything.groupby(by)
        ]
        head = [by, "trials", "frames", "position mm", "angle deg", "velocity mm/s", "worst trial, mm"]
        lines += [f"By {by}, medians over trials of each trial's median while in sight, after 1 s:", table(head, cells)]
    command = f"python -m benchmarks.truth RUN {manifest.name}"
    write("truth", "Replay of simulated recordings against the truth", command, lines)


MEASURES = (("position_m", 1e3), ("angle_deg", 1.0), ("velocity_m_s", 1e3))


def worst(group: pd.DataFrame) -> str:
    return number(group["position_m"].max() * 1e3)


if __name__ == "__main__":
    main()
