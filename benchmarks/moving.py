"""Objects that move by a known motion: velocity, lag, prediction over removed frames, pose and box.

The synthetic recordings have exact truth. For real images, a still object of a real recording is
set moving by changing the recorded camera poses (benchmarks.rebase). The real recording is below
the folder that DGEVAL_REAL_DATA names, or is given by --source.

    python -m benchmarks.moving
    python -m benchmarks.moving --source LOG.mcap --bbox 566,221,631,275 --frames 72:96 --passes 3
"""

from __future__ import annotations

import argparse
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from dgeval.config import Config, load_config
from dgeval.geometry import Array, invert
from dgeval.recording.manifest import TrialSpec
from dgeval.recording.trials import Trial, open_trial
from dgeval.runs.files import file_name
from dgeval.runs.trial_job import replay_trial

from benchmarks import moving_measures as measure
from benchmarks import result, synthetic
from benchmarks.depth_to_colour import ColourCamera
from benchmarks.motion import MODES, Motion
from benchmarks.rebase import Written, rebase
from benchmarks.still_floor import apparent_speed

Box = tuple[float, float, float, float]
HEAD = (
    "variant",
    "frames",
    "tracked",
    "lost",
    "predicted",
    "with velocity",
    "RMSE, all",
    "RMSE, after 1 s",
    "median, after 1 s",
    "velocity_sd",
    "within 95 %",
    "lag to 90 %, s",
    "drift p95, mm",
    "gap: predicted / said, mm",
    "accepted again after, s",
)
HEAD_TRUTH = (
    "recording",
    "frames",
    "lost",
    "predicted",
    "mm median",
    "mm p95",
    "deg median",
    "deg p95",
    "IoU median",
    "IoU p5",
)
# Kitchen recording: its depth is not registered to colour (fitted: focal length 525 px, baseline
# 25 mm). The patterned mug is whole in both images from frame 82 on. The chair is a larger target,
# visible over the table's edge. Per target: name, box px, frames, passes, radius m (see Real).
KITCHEN = "kitchen_mug_mcap"
KITCHEN_COLOUR = ColourCamera(525.0, 0.025)
KITCHEN_TARGETS = (
    ("mug", (506.0, 221.0, 562.0, 274.0), (82, 96), 5, 0.09),
    ("chair", (240.0, 193.0, 396.0, 330.0), (48, 96), 1, None),
)


def replayed(path: Path, box: Box, config: Config, folder: Path) -> pd.DataFrame:
    """Replay one recording; returns its frame table."""
    spec = TrialSpec(path.stem, path, bbox=box)
    done = replay_trial(spec, config, folder, None, True)
    if done.row is None:
        raise SystemExit(f"{path.name}: {'; '.join(done.messages)}")
    return pd.read_parquet(folder / "frames" / f"{file_name(path.stem)}.parquet")


def variants(
    source: Trial,
    box: Box,
    config: Config,
    folder: Path,
    passes: int = 1,
    colour_camera: ColourCamera | None = None,
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0),
) -> list[list[str]]:
    """One row of HEAD per variant of a source. The object in the box must stand still in it."""
    rows = []
    pivot = (0.0, 0.0, 0.0)
    plans: list[tuple[str, str, bool, bool]] = [(mode, mode, False, True) for mode in MODES]
    plans += [
        ("200mm/s, 0.5 s removed", "200mm/s", True, True),
        ("still, 0.5 s removed", "still", True, True),
    ]
    plans += [("still, no camera pose", "still", False, False)]
    for label, mode, with_gap, with_pose in plans:
        path = folder / "variant.mcap"
        first_ns = source.pairs[0][0]
        span = (source.pairs[-1][0] - first_ns) * 1e-9 * passes
        drop = (min(1.5, span / 2), 0.5) if with_gap else None
        written = rebase(
            source, path, Motion(mode, direction, pivot), passes, drop, with_pose, colour_camera
        )
        frames = replayed(path, box, config, folder)
        positions = frames[measure.FEATURE].dropna().to_numpy(dtype=float)
        if mode == "still" and with_pose and not with_gap and len(positions):
            pivot = tuple(np.median(positions, axis=0).tolist())
        rows.append(_row(label, frames, written, with_gap, with_pose))
    return rows


def _row(
    label: str, frames: pd.DataFrame, written: Written, with_gap: bool, with_pose: bool
) -> list[str]:
    n = result.number
    truth = (
        measure.rebased_truth(frames, written)
        if with_pose
        else measure.camera_frame_truth(frames, written)
    )
    v = measure.velocity(frames, written, truth)
    tracking = frames["tracking"].value_counts()
    gap, again_s = "–", "–"
    if with_gap:
        predicted_mm, table_mm, wait_s = measure.gap(frames, written)
        gap, again_s = (
            f"{n(predicted_mm)} / {n(table_mm)}",
            n(wait_s, 2) if np.isfinite(wait_s) else "never",
        )
    return [
        label,
        str(len(frames)),
        str(tracking.get("tracked", 0)),
        str(tracking.get("lost", 0)),
        str(frames["predicted"].sum()),
        str(v.known),
        n(v.rmse_all),
        n(v.rmse),
        n(v.median),
        n(v.sd),
        f"{n(100 * v.coverage, 0)} %",
        "not reached" if np.isinf(v.lag_s) else n(v.lag_s, 2),
        n(measure.drift(frames, written)) if with_pose else "–",
        gap,
        again_s,
    ]


def _truth_row(label: str, frames: pd.DataFrame, truth: synthetic.Truth) -> list[str]:
    n = result.number
    T_camera_object = [
        invert(c) @ o for c, o in zip(truth.T_world_camera, truth.T_world_object, strict=True)
    ]
    place, turn = measure.pose_errors(frames, T_camera_object)
    iou = measure.box_iou(frames, truth.boxes)

    def pair(values: Array, q: float, digits: int) -> list[str]:
        return [n(float(np.quantile(values, p)), digits) if len(values) else "–" for p in (0.5, q)]

    lost = int((frames["tracking"] == "lost").sum())
    return [
        label, str(len(frames)), str(lost), str(frames["predicted"].sum()),
        *pair(place, 0.95, 2), *pair(turn, 0.95, 2), *pair(iou, 0.05, 3),
    ]  # fmt: skip


def made_recordings(config: Config, folder: Path, n: int) -> list[str]:
    """Tables of the synthetic recordings: pose and box against truth, and velocity."""
    rows, sections = [], []
    for label, speed in (
        ("still box", 0.0),
        ("box slides over the table, 0.1 m/s stop and go", 0.1),
    ):
        path = folder / f"made_{round(speed * 1000)}.mcap"
        truth = synthetic.write(path, n, speed)
        source = open_trial(TrialSpec("made", path), config)
        for pose in (True, False):
            motion = Motion("stop-and-go" if speed else "still", (0.0, 1.0, 0.0))
            copy = folder / "made_copy.mcap"
            written = rebase(source, copy, Motion("still"), with_pose=pose)
            frames = replayed(copy, truth.boxes[0], config, folder)
            rows.append(
                _truth_row(f"{label}, {'with' if pose else 'without'} camera pose", frames, truth)
            )
            if speed and pose:
                written = Written(
                    written.t_ns,
                    written.seconds,
                    written.M,
                    written.T_source,
                    written.source_frame,
                    motion,
                )
                sliding = _row(label, frames, written, False, True)
                sliding[HEAD.index("drift p95, mm")] = (
                    "–"  # its place in the base frame is not still
                )
        if not speed:
            base_rows = variants(source, truth.boxes[0], config, folder)
    sections.append(
        "## Made recording: pose and box against exact truth\n\n" + result.table(HEAD_TRUTH, rows)
    )
    text = (
        "Velocity errors in mm/s. The still box set moving by changed camera poses, and the box "
        "that really slides:"
    )
    sections.append(
        f"## Made recording: velocity\n\n{text}\n\n{result.table(HEAD, [*base_rows, sliding])}"
    )
    return sections


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--source", type=Path, help="a real recording instead of the one below DGEVAL_REAL_DATA"
    )
    parser.add_argument("--bbox", help="x0,y0,x1,y1 px in the first used frame")
    parser.add_argument("--frames", help="A:B")
    parser.add_argument("--passes", type=int, default=1)
    parser.add_argument(
        "--colour-camera", help="focal px, baseline m, where depth is not registered to colour"
    )
    parser.add_argument(
        "--made-frames", type=int, default=99, help="length of the made recordings; 0: none"
    )
    parser.add_argument(
        "--set", action="append", default=[], help="section.key=value, as for dgeval replay"
    )
    parser.add_argument("--name", default="moving", help="name of the result file")
    args = parser.parse_args()
    config = load_config(assignments=tuple(args.set))
    parts = [NOTES]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if args.made_frames:
            parts += made_recordings(config, folder, args.made_frames)
        sources = _real(args)
        if not sources:
            parts.append(
                "## Real pixels\n\nNot measured: DGEVAL_REAL_DATA names no folder and no --source "
                "was given."
            )
        for real in sources:
            source = open_trial(TrialSpec("real", real.path, frames=real.cut), config)
            rows = variants(source, real.box, config, folder, real.passes, real.colour_camera)
            text = f"Velocity errors in mm/s. {_floor(real, config, folder)}"
            parts.append(f"## Real pixels: {real.title()}\n\n{text}\n\n{result.table(HEAD, rows)}")
    command = "python -m benchmarks.moving" + "".join(f" --set {s}" for s in args.set)
    command += f" --name {args.name}" if args.name != "moving" else ""
    command += (
        f" --source {args.source.name} --bbox {args.bbox} --frames {args.frames}"
        if args.source
        else ""
    )
    path = result.write(args.name, "Moving objects", command, parts)
    print(path.read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Real:
    """A still object of a real recording, and how the recording is used.

    box: px, in the first used frame. cut: frames A:B. radius: m, of a sphere round the target that
    holds nothing else but table; None: the recording's own error is not measured.
    """

    path: Path
    name: str
    box: Box
    cut: tuple[int, int] | None
    passes: int
    colour_camera: ColourCamera | None
    radius: float | None

    def title(self) -> str:
        span = f"frames {self.cut[0]}:{self.cut[1]}" if self.cut else "all frames"
        text = (
            f"{self.name} of {self.path.name}, {span}, {self.passes} pass(es), box "
            f"{','.join(f'{v:g}' for v in self.box)}"
        )
        c = self.colour_camera
        return text + (
            f", depth put into the colour camera ({c.focal:g} px, {c.baseline:g} m)" if c else ""
        )


def _floor(real: Real, config: Config, folder: Path) -> str:
    """A sentence on the apparent motion of the still object in the recording itself."""
    if real.radius is None:
        return ""
    source = open_trial(TrialSpec("real", real.path, frames=real.cut), config)
    path = folder / "floor.mcap"
    rebase(source, path, Motion("still"), 1, None, True, real.colour_camera)
    positions = (
        replayed(path, real.box, config, folder)[measure.FEATURE].dropna().to_numpy(dtype=float)
    )
    if not len(positions):
        return "No feature point, so no floor."
    speed_mm_s, largest_mm = apparent_speed(
        open_trial(TrialSpec("floor", path), config), np.median(positions, axis=0), real.radius
    )
    return (
        "Without any tracker, from raw depth and the recorded poses alone, what stands there "
        f"appears to move at {speed_mm_s:.1f} mm/s (up to {largest_mm:.1f} mm from its place in "
        "the middle frame): the recording's own error."
    )


def _real(args: argparse.Namespace) -> list[Real]:
    if args.source is None:
        folder = os.environ.get("DGEVAL_REAL_DATA")
        path = Path(folder) / KITCHEN if folder else None
        if path is None or not path.exists():
            return []
        return [
            Real(path, name, box, cut, passes, KITCHEN_COLOUR, radius)
            for name, box, cut, passes, radius in KITCHEN_TARGETS
        ]
    x0, y0, x1, y1 = (float(v) for v in args.bbox.split(","))
    cut = [int(v) for v in args.frames.split(":")] if args.frames else None
    camera = (
        ColourCamera(*(float(v) for v in args.colour_camera.split(",")))
        if args.colour_camera
        else None
    )
    return [
        Real(
            args.source,
            "target",
            (x0, y0, x1, y1),
            (cut[0], cut[1]) if cut else None,
            args.passes,
            camera,
            None,
        )
    ]


NOTES = (
    'Columns: RMSE and median of |velocity error| (3-D) at the feature point; "within 95 %": '
    "share of settled frames whose\n|error|² / velocity_sd² is below the 95 % point of "
    "chi-square with 3 degrees of freedom, velocity_sd (the largest axis) taken\nfor every axis, "
    "which flatters; drift: the feature point's distance from its median place, where the object "
    "stood still; gap:\n0.5 s of frames removed, the estimator's prediction from the last frame "
    "before and what the table says in the first frame\nafter, both against the truth. Without "
    "camera pose the base frame is the camera's, and so is the velocity; where a recording\nis "
    "played back and forth, the camera's motion turns round from one frame to the next, which is "
    "unfair to that variant."
)


if __name__ == "__main__":
    main()
