"""Training of VFAS-Grasp's evaluator on jaw grasps tried in physics, with both augmentations of the paper."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from dgeval.determinism import generator, limit_threads
from dgeval.errors import UsageError
from dgeval.geometry import Array, invert
from dgeval.networks.point_sets import crop
from dgeval.networks.pointnet2 import CROP_HIGH, CROP_LOW, VFAS, GraspEvaluator, save_evaluator
from dgeval.parallel import write_all
from dgeval.planning.vfas.selection import LEAST_POINTS, gripper_points
from dgeval.training.jaw_data import Scene, read_scenes, write_scenes
from dgeval.training.loop import optimise
from dgeval.training.ship import scores_of
from dgeval.worlds.objects import procedural_object

NOISE, GRAZING_DROP = 0.002, 0.7  # m on each axis; probability (VFAS section III-B)
FLOATING = 0.3  # share of scenes shown without their table, as in a handover (ours)
MIRRORS = np.array(
    [[1, 1, 1], [-1, 1, 1], [1, -1, 1], [-1, -1, 1]], dtype=np.float32
)  # the gripper looks the same in each


@dataclass(frozen=True)
class Settings:
    steps: int = 4000
    batch: int = 64
    positive: float = 0.35  # share of a batch that held
    learning_rate: float = 1e-3
    weight_decay: float = 1e-4
    held_out: int = 9  # the last objects
    seed: int = 0


def load_scenes(folder: Path, objects: int, seed: int) -> list[list[Scene]]:
    """Scenes of procedural objects 0 … objects - 1, by object. UsageError where a file is missing."""
    out = []
    for index in range(objects):
        path = folder / f"{procedural_object(index, seed).name}.npz"
        if not path.is_file():
            raise UsageError(f"no {path.name} in {folder}", hint="make the scenes first")
        out.append(read_scenes(path))
    return out


def example(
    scene: Scene, row: int, floating: bool, rng: np.random.Generator
) -> NDArray[np.float32] | None:
    """Cropped, augmented points (n, 3) of one pose; None where too few are near."""
    kept = ~scene.grazing | (rng.random(len(scene.grazing)) > GRAZING_DROP)
    if floating:
        kept &= ~scene.table
    points: Array = rng.permutation(scene.points[kept]).astype(np.float64)
    cropped, counts = crop(
        points, invert(scene.T_seed_grasp[row])[None], CROP_LOW, CROP_HIGH, VFAS.scene
    )
    if counts[0] < LEAST_POINTS:
        return None
    noisy = cropped[0] + rng.normal(0, NOISE, cropped[0].shape).astype(np.float32)
    return np.asarray(noisy * MIRRORS[rng.integers(4)])


def batch_of(
    scenes: list[Scene], settings: Settings, rng: np.random.Generator
) -> tuple[Tensor, Tensor]:
    """Points (batch, n, 3) and whether each held (batch,)."""
    points: list[NDArray[np.float32]] = []
    held: list[bool] = []
    while len(points) < settings.batch:
        scene = scenes[rng.integers(len(scenes))]
        floating = bool(rng.random() < FLOATING and not scene.table.all())
        wanted = bool(rng.random() < settings.positive)
        rows = np.flatnonzero((scene.held == wanted) & ~(floating & scene.table_hit))
        if not len(rows):
            continue
        found = example(scene, int(rng.choice(rows)), floating, rng)
        if found is not None:
            points.append(found)
            held.append(wanted)
    return torch.from_numpy(np.array(points, dtype=np.float32)), torch.tensor(
        held, dtype=torch.float32
    )


def train(
    scenes: list[Scene],
    settings: Settings,
    checkpoint: Path,
    progress: Callable[[int, dict[str, float]], None],
) -> GraspEvaluator:
    """The evaluator trained on scenes; resumes from the checkpoint of the same settings."""
    torch.manual_seed(settings.seed)
    network = GraspEvaluator(VFAS)
    gripper = torch.from_numpy(
        gripper_points(VFAS.gripper, generator(0, "gripper points", 0)).astype(np.float32)
    )[None]

    def loss_of(step: int) -> tuple[Tensor, dict[str, float]]:
        points, held = batch_of(scenes, settings, generator(settings.seed, "train/vfas", step))
        logits = network(points, gripper.expand(len(points), -1, -1))[0][:, 0]
        loss = functional.binary_cross_entropy_with_logits(logits, held)
        right = float(((logits.detach() > 0) == (held > 0.5)).float().mean())
        return loss, {"BCE": float(loss.detach()), "right": right}

    rates = settings.learning_rate, settings.weight_decay
    optimise(
        network,
        loss_of,
        settings.steps,
        rates,
        {"kind": "vfas", **asdict(settings)},
        checkpoint,
        progress,
    )
    return network


def measure(network: GraspEvaluator, scenes: list[Scene], n: int, seed: int) -> dict[str, float]:
    """ROC-AUC, Brier, calibration error over n random poses of scenes, as they are drawn."""
    gripper = torch.from_numpy(
        gripper_points(VFAS.gripper, generator(0, "gripper points", 0)).astype(np.float32)
    )[None]
    points: list[NDArray[np.float32]] = []
    held: list[bool] = []
    rng = generator(seed, "measure/vfas", 0)
    while len(points) < n:
        scene = scenes[rng.integers(len(scenes))]
        row = int(rng.integers(len(scene.held)))
        found = example(scene, row, False, rng)
        if found is not None:
            points.append(found)
            held.append(bool(scene.held[row]))
    p = network.success(torch.from_numpy(np.array(points)), gripper).double().numpy()
    return scores_of(p, np.array(held))


def train_all(
    out: Path,
    objects: int,
    settings: Settings,
    seeds: int,
    jobs: int,
    progress: Callable[[str, int, dict[str, float]], None],
) -> dict[str, Any]:
    """Scenes in OUT/scenes, training, OUT/vfas_evaluator.safetensors and OUT/metrics.json. progress(phase, step, terms)."""
    limit_threads()
    made = iter(range(1, objects + 1))
    make = partial(write_scenes, out=out / "scenes", seed=settings.seed, seeds=seeds)
    write_all(make, range(objects), jobs, lambda _: progress("scenes", next(made), {}))
    data = load_scenes(out / "scenes", objects, settings.seed)
    learning, unseen = (
        [s for thing in part for s in thing]
        for part in (data[: -settings.held_out], data[-settings.held_out :])
    )
    network = train(
        learning,
        settings,
        out / "vfas_evaluator.ckpt",
        lambda step, terms: progress("evaluator", step, terms),
    )
    save_evaluator(network, out / "vfas_evaluator.safetensors")
    metrics = {
        "settings": asdict(settings),
        "poses": {
            "training": sum(len(s.held) for s in learning),
            "held_out": sum(len(s.held) for s in unseen),
        },
        "held_out": {"vfas_evaluator": measure(network, unseen, 1500, settings.seed)},
    }
    (out / "metrics.json").write_text(json.dumps(metrics, indent=1), encoding="utf-8")
    return metrics
