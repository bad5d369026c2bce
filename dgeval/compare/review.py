"""A changed trial as a Rerun recording that shows old and new values, from the tables alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import rerun as rr
import rerun.blueprint as rrb

from dgeval.compare.divergence import TrialDifference

OLD, NEW, FIRST = (150, 150, 150), (230, 110, 40), (220, 50, 40)  # RGB
# Plots: title, then legend and column of the frame table of each line
VIEWS = {
    "error hand to grasp": {"linear, m": "error_linear", "angular, rad": "error_angular"},
    "estimated velocity, m-s": {"x": "velocity_x", "y": "velocity_y", "z": "velocity_z"},
    "gate fitness": {"gate fitness": "icp_gate_fitness"},
    "points": {"observed": "n_observed"},
    "score": {"hand": "hand_score", "metric": "grasp_metric"},
}


def write_difference(path: Path, old: pd.DataFrame, new: pd.DataFrame, d: TrialDifference) -> None:
    """Write VIEWS of both runs over one time axis, s, and the feature point's path of each run.

    The paths are in the base frame. A log entry marks the first difference.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    rec = rr.RecordingStream("dgeval compare", recording_id=d.trial)
    rec.save(str(part))
    start = int(old["t_ns"].iloc[0])
    for name, table, colour in (
        ("baseline", old, OLD),
        ("now", new, NEW),
    ):  # drawn in the order of their names
        seconds = (table["t_ns"].to_numpy(dtype=np.int64) - start) * 1e-9
        times = rr.TimeColumn("time", duration=seconds)
        for view, series in VIEWS.items():
            for label, column in series.items():
                values = table[column].to_numpy(dtype=float, na_value=np.nan)
                if np.isfinite(values).any():
                    entity = rr.new_entity_path([view, f"{label}, {name}"])
                    rec.log(
                        entity,
                        rr.SeriesLines(colors=colour, widths=3.0 if name == "baseline" else 1.2),
                        static=True,
                    )
                    rec.send_columns(
                        entity, indexes=[times], columns=rr.Scalars.columns(scalars=values)
                    )
        positions = table[["feature_px", "feature_py", "feature_pz"]].to_numpy(
            dtype=float, na_value=np.nan
        )
        positions = positions[np.isfinite(positions).all(axis=1)]
        if len(positions):
            rec.log(
                ["scene", f"feature point, {name}"],
                rr.LineStrips3D([positions], colors=colour, radii=0.001),
                static=True,
            )
    at = old.loc[old["frame"] == d.first.frame, "t_ns"]
    rec.set_time("time", duration=0.0 if at.empty else (int(at.iloc[0]) - start) * 1e-9)
    rec.log("events", rr.TextLog(f"first difference: {d.first}", level="WARN", color=FIRST))
    views = [rrb.TimeSeriesView(origin=rr.new_entity_path([view]), name=view) for view in VIEWS]
    scene = rrb.Vertical(
        rrb.Spatial3DView(origin="scene", name="feature point, base frame"),
        rrb.TextLogView(origin="events"),
    )
    rec.send_blueprint(
        rrb.Blueprint(rrb.Horizontal(rrb.Vertical(*views), scene), collapse_panels=True)
    )
    rec.flush()
    rec.disconnect()
    part.replace(path)
