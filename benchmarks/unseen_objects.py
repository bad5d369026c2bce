"""Tracking of objects that nothing was made or tuned for: meshes of random kind, size and texture.

`dgeval simulate` renders the recordings, with the hand in view and its grasp, lift and failures;
the tracker gets the recording alone. About half a minute for each object to render and to replay.

python -m benchmarks.unseen_objects --out FOLDER --seed 7707
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from dgeval import api
from dgeval.config import load_config
from dgeval.geometry import Array, invert, matrix_from_pose, transform
from dgeval.perception.boxes import inside, overlap, visible
from dgeval.recording.contract import TRUTH_OBJECT_TOPIC
from dgeval.recording.manifest import find_trials
from dgeval.recording.trials import open_trial
from dgeval.worlds.objects import drawn_mesh, procedural_object
from scipy.spatial import cKDTree

from benchmarks import result

SCENARIO = Path(__file__).with_suffix(".toml")
SURFACE = 40_000  # points on a mesh, from which a model's distance is measured
IN_VIEW = 0.5  # share of the object's box in the image, from which on it must be tracked
SURE, GOOD, RIGHT = 0.8, 0.7, 0.5  # confidence and overlaps that are counted
NEAR_MM = 5.0
HEAD = (
    "object", "frames", "in view, no box", "box IoU", "registered", "mm median", "mm p95",
    "model mm p95",
)  # fmt: skip


@dataclass(frozen=True)
class Tracked:
    """One object's frames.

    iou: of frames in view, 0 without a box. mm: position error of accepted frames, at the object's
    centre: truth's pose at the first, carried along. surface_mm: of the last model's points.
    said: confidence and box overlap.
    """

    name: str
    frames: int
    iou: Array
    mm: Array
    surface_mm: Array
    said: Array


def write_meshes(folder: Path, seed: int, n: int) -> None:
    """n objects of `procedural_object`, each as a mesh of its own name."""
    folder.mkdir(parents=True, exist_ok=True)
    for index in range(n):
        model = procedural_object(index, seed)
        path = folder / f"{model.name}.ply"
        if not path.exists():
            drawn_mesh(model).export(path)


def tracked(recording: Path, trial_id: str, mesh: trimesh.Trimesh) -> Tracked:
    """Replay one recording and hold it against its truth."""
    config = load_config("dynamic", ("grasps.source=none",))
    spec = next(s for s in find_trials([recording], config.roles.events) if s.id == trial_id)
    trial = open_trial(spec, config)
    poses = trial.scan.poses[TRUTH_OBJECT_TOPIC]
    times = np.array([p.t_ns for p in poses])
    surface = np.asarray(trimesh.sample.sample_surface(mesh, SURFACE, seed=0)[0])
    outline, centre = surface[::20], surface.mean(axis=0)
    iou, mm, said = [], [], []
    T_object_model, model, frames = None, None, 0
    for step in api.replay_trial(trial):
        frame, frames = step.frame, frames + 1
        assert frame.T_base_camera is not None
        T_base_object = matrix_from_pose(poses[int(np.argmin(np.abs(times - frame.t_ns)))].pose)
        T_camera_object = invert(frame.T_base_camera) @ T_base_object
        points = transform(T_camera_object, outline)
        points = points[points[:, 2] > 0.05]
        if len(points) > 0.9 * len(outline):
            pixels = frame.camera.project(points)
            low, high = pixels.min(axis=0), pixels.max(axis=0)
            box = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
            if visible(box, frame.camera) > IN_VIEW:
                seen = step.tracked.box
                value = 0.0 if seen is None else overlap(inside(box, frame.camera), seen)
                iou.append(value)
                if step.tracked.confidence is not None:
                    said.append((step.tracked.confidence, value))
        if step.accepted and step.T_camera_model is not None:
            if T_object_model is None:
                T_object_model = invert(T_camera_object) @ step.T_camera_model
            T_tracked = step.T_camera_model @ invert(T_object_model)
            apart = transform(T_tracked, centre[None]) - transform(T_camera_object, centre[None])
            mm.append(float(np.linalg.norm(apart)) * 1e3)
            model = step.model
    distances = np.zeros(0)
    if model is not None and T_object_model is not None:
        distances = cKDTree(surface).query(transform(T_object_model, model.points))[0] * 1e3
    return Tracked(
        trial_id, frames, np.array(iou), np.array(mm), distances, np.array(said).reshape(-1, 2)
    )


def _row(one: Tracked) -> list[str]:
    n = result.number

    def at(values: Array, q: float) -> str:
        return n(float(np.quantile(values, q))) if len(values) else "–"

    return [
        one.name, str(one.frames), str(int((one.iou == 0).sum())),
        n(float(one.iou.mean()), 2) if len(one.iou) else "–", str(len(one.mm)),
        at(one.mm, 0.5), at(one.mm, 0.95), at(one.surface_mm, 0.95),
    ]  # fmt: skip


def summary(all_of: list[Tracked]) -> str:
    """What holds of all objects together."""
    mm, iou = np.concatenate([o.mm for o in all_of]), np.concatenate([o.iou for o in all_of])
    said = np.concatenate([o.said for o in all_of])
    medians = np.array([np.median(o.mm) for o in all_of if len(o.mm)])
    surfaces = np.array([np.quantile(o.surface_mm, 0.95) for o in all_of if len(o.surface_mm)])
    sure, good = said[said[:, 0] > SURE], said[said[:, 1] > GOOD]
    return (
        f"{len(all_of)} objects. Median position error at most 1.5 mm: {(medians <= 1.5).sum()} of "
        f"them; {(mm <= NEAR_MM).mean():.1%} of {len(mm)} registered frames within {NEAR_MM:g} mm. "
        f"Model to surface at most 3 mm at p95: {(surfaces <= 3.0).sum()}. Box IoU "
        f"{iou.mean():.2f} in {len(iou)} frames in view, {(iou == 0).sum()} without a box. Of "
        f"frames of confidence over {SURE} {(sure[:, 1] > RIGHT).mean():.1%} have IoU over "
        f"{RIGHT}; of IoU over {GOOD} {(good[:, 0] > SURE).mean():.1%} have confidence over {SURE}."
    )


NOTES = (
    "Registered: frames whose registration passed the gate, also after the grasp, when the object "
    "may be thrown or turned in the hand. Position: truth's pose at the first of them, carried "
    "along by the track, against truth, at the object's centre; so what the first frame's noise "
    "moves stays. IoU: against the box of the whole object in the image, also where the hand hides "
    "a part of it."
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, required=True, help="finished recordings in it are kept"
    )
    parser.add_argument("--seed", type=int, default=4321)
    parser.add_argument("--objects", type=int, default=27)
    parser.add_argument("--jobs", default="2")
    parser.add_argument("--name", default="unseen_objects", help="name of the result file")
    args = parser.parse_args()
    meshes, made = args.out / "meshes", args.out / "recordings"
    write_meshes(meshes, args.seed, args.objects)
    command = [
        sys.executable, "-m", "dgeval", "simulate", str(SCENARIO), "--meshes", str(meshes), "--out",
        str(made), "--seed", str(args.seed), "--trials", str(args.objects), "--jobs", args.jobs,
    ]  # fmt: skip
    subprocess.run(command, check=True)
    manifest = next(made.glob("*.toml"))
    config = load_config("dynamic", ())
    all_of = []
    for spec in find_trials([manifest], config.roles.events):
        mesh = trimesh.load(meshes / f"{spec.object}.ply", force="mesh")
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
        all_of.append(tracked(manifest, spec.id, mesh))
        print(*_row(all_of[-1]), flush=True)
    parts = [summary(all_of), result.table(HEAD, [_row(o) for o in all_of]), NOTES]
    told = f"python -m benchmarks.unseen_objects --out FOLDER --seed {args.seed}"
    print(result.write(args.name, "Objects that nothing was tuned on", told, parts))


if __name__ == "__main__":
    main()
