"""Errors of pose and velocity in replays of simulated recordings, by object and speed.

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
from dgeval.recording.manifest import TrialSpec, find_trials
from dgeval.recording.messages import poses_of
from dgeval.recording.trials import open_trial
from dgeval.replay.row import POSE as POSE_NAMES
from dgeval.runs.files import file_name
from matplotlib import rc_context
from matplotlib.figure import Figure

from benchmarks.result import RESULTS, number, table, write

POSE, OBJECT = ([f"{of}_{n}" for n in POSE_NAMES] for of in ("model", "object"))
BINS = np.array([-2.0, -1.5, -1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0, 1.5])  # s from the close


def errors_against_truth(spec: TrialSpec, run: Path) -> pd.DataFrame:
    """Errors of one trial, a row per frame with a pose.

    t_s: since the first truth. accepted: the registration. position_m, angle_deg, velocity_m_s:
    errors of the causal pass. true_m_s: true speed of the object's origin. hindsight_m, by:
    position error and source of the second pass, null where it has no pose. t_close_s: of the
    close. t_sight_s: when the simulated camera first lost the object for 0.25 s (no belief mask),
    at the latest the close.

    The model frame is arbitrary: T_model_object is taken from the first frame with a pose.
    """
    trial = open_trial(spec, load_config())
    truth: dict[int, Any] = {}
    masks: list[int] = []
    verdict: dict[str, Any] = {}
    topics = frozenset({"/truth/object_pose", "/truth/verdict", "/dgeval/belief/mask"})
    for message in trial.opened.messages(topics):
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
    close_s = (
        verdict["t_close_s"] if verdict["t_close_s"] is not None else (max(truth) - start) * 1e-9
    )
    gaps = [a for a, b in pairwise(masks) if b - a > 250_000_000] or masks[-1:] or [start]
    sight_s = min((gaps[0] - start) * 1e-9, close_s)
    frames = pd.read_parquet(run / "frames" / f"{file_name(spec.id)}.parquet")
    path = run / "hindsight" / f"{file_name(spec.id)}.parquet"
    hindsight = pd.read_parquet(path).set_index("frame") if path.is_file() else pd.DataFrame()
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
        hindsight_m, by = np.nan, None
        if row["frame"] in hindsight.index:
            entry = hindsight.loc[row["frame"]]
            T_hindsight = matrix_from_pose(entry[OBJECT].to_numpy(dtype=float)) @ T_model_object
            hindsight_m, by = float(np.linalg.norm(T_hindsight[:3, 3] - T_true[:3, 3])), entry["by"]
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
                "true_m_s": float(np.linalg.norm(v_true)),
                "hindsight_m": hindsight_m,
                "by": by,
            }
        )
    columns = ["t_s", "accepted", "position_m", "angle_deg", "velocity_m_s", "true_m_s"]
    columns += ["hindsight_m", "by"]
    out = pd.DataFrame(rows, columns=columns)
    return out.assign(t_sight_s=sight_s, t_close_s=close_s)


def main() -> None:
    run, manifest = Path(sys.argv[1]), Path(sys.argv[2])
    rows, closes = [], []
    done = set(pd.read_parquet(run / "trials.parquet")["trial"])
    for spec in [s for s in find_trials([manifest]) if s.id in done]:
        errors = errors_against_truth(spec, run)
        closes.append(errors.assign(trial=spec.id))
        in_sight = errors[
            errors["accepted"] & (errors["t_s"] > 1.0) & (errors["t_s"] < errors["t_sight_s"])
        ]
        rows.append(
            {
                "object": spec.object,
                "speed": spec.speed,
                "n": len(in_sight),
                **in_sight.median(numeric_only=True).to_dict(),
            }
        )
    everything = pd.DataFrame(rows)
    lines = []
    for by in ("object", "speed"):
        cells = [
            [
                str(name),
                str(len(g)),
                str(int(g["n"].sum())),
                *(number(g[c].median() * s) for c, s in MEASURES),
                worst(g),
            ]
            for name, g in everything.groupby(by)
        ]
        head = [
            by,
            "trials",
            "frames",
            "position mm",
            "angle deg",
            "velocity mm/s",
            "worst trial, mm",
        ]
        lines += [
            f"By {by}, medians over trials of each trial's median while in sight, after 1 s:",
            table(head, cells),
        ]
    command = f"python -m benchmarks.truth RUN {manifest.name}"
    write("truth", "Replay of simulated recordings against the truth", command, lines)
    write(
        "gap",
        "Causal pass and hindsight through the close",
        command,
        through_the_close(pd.concat(closes), run),
    )


def through_the_close(frames: pd.DataFrame, run: Path) -> list[str]:
    """Table of the causal pass and of hindsight around the close; plotted in results/gap.svg."""
    trials = pd.read_parquet(run / "trials.parquet").set_index("trial")
    closed = frames[frames["trial"].map(trials["t_close_ns"].notna())]
    since = closed["t_s"] - closed["t_close_s"]
    cells, drawn = [], []
    for a, b in pairwise(BINS):
        part = closed[(since >= a) & (since < b)]
        both = [part["position_m"] * 1e3, part["hindsight_m"] * 1e3]
        registered = f"{part['accepted'].mean():.0%}" if len(part) else "–"
        cells.append([f"{a:+.2f} to {b:+.2f}", str(len(part)), registered])
        quantiles = [
            float(v.quantile(q)) if v.notna().any() else np.nan for v in both for q in (0.5, 0.9)
        ]
        cells[-1] += [number(v) for v in quantiles]
        drawn.append(((a + b) / 2, *quantiles))
    gaps = trials[trials["t_close_ns"].notna()]
    sided = ", ".join(f"{side}: {n}" for side, n in gaps["gap_sided"].value_counts().items())
    figure = Figure(figsize=(6.4, 3.0), layout="constrained")
    axis = figure.subplots()
    t, causal, causal90, hindsight, hindsight90 = np.array(drawn).T
    for name, colour, middle, high in (
        ("causal pass", "#d95f02", causal, causal90),
        ("hindsight", "#1f77b4", hindsight, hindsight90),
    ):
        axis.plot(t, middle, color=colour, label=f"{name}, median")
        axis.plot(t, high, color=colour, ls=":", label=f"{name}, 90 %")
    axis.set_yscale("log")
    axis.axvline(0.0, color="#333", lw=0.8, ls="--")
    axis.set_xlabel("time from the close [s]")
    axis.set_ylabel("position error [mm]")
    axis.legend(fontsize=8, frameon=False)
    RESULTS.mkdir(exist_ok=True)
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "gap"}):
        figure.savefig(RESULTS / "gap.svg", metadata={"Date": None})
    head = ["s from the close", "frames", "registered", "causal mm", "90 %", "hindsight mm", "90 %"]
    return [
        f"Through the close of {len(gaps)} trials, against where the object really was (gap sided "
        f"{sided}; the median gap is {gaps['gap_s'].median():.2f} s, the longest "
        f"{gaps['gap_s'].max():.2f} s). Plot: gap.svg.",
        table(head, cells),
    ]


MEASURES = (("position_m", 1e3), ("angle_deg", 1.0), ("velocity_m_s", 1e3))


def worst(group: pd.DataFrame) -> str:
    return number(group["position_m"].max() * 1e3)


if __name__ == "__main__":
    main()
