"""Training of VFAS-Grasp's evaluator on jaw grasps tried in physics, augmented as in the paper."""

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
from dgeval.planning.vfas.gripper import trained_gripper
from dgeval.planning.vfas.selection import LEAST_POINTS
from dgeval.training.jaw_data import Scene, read_scenes, write_scenes
from dgeval.training.loop import optimise
from dgeval.training.ship import scores_of
from dgeval.worlds.objects import procedural_object

NOISE = 0.002  # m, standard deviation on each axis (docs/papers.md, "Grasp evaluator")
# probability that a grazing point is dropped (docs/papers.md, "Grasp evaluator")
GRAZING_DROP = 0.7
FLOATING = 0.3  # share of examples without the points of their table, as in a handover (ours)
# factors on the axes; the gripper looks the same in each of these mirror images
MIRRORS = np.array([[1, 1, 1], [-1, 1, 1], [1, -1, 1], [-1, -1, 1]], dtype=np.float32)


@dataclass(frozen=True)
class Settings:
    """Settings of a training run, everything that its result depends on besides the scenes."""

    steps: int = 4000
    batch: int = 64
    positive: float = 0.35  # share of examples that are to be of poses that held
    learning_rate: float = 1e-3
    weight_decay: float = 1e-4
    held_out: int = 9  # objects, the last ones, that are not trained on
    seed: int = 0


def load_scenes(folder: Path, objects: int, seed: int) -> list[list[Scene]]:
    """Scenes of procedural objects 0 to objects - 1, one list per object.

    Raises UsageError if a file is missing.
    """
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
    """Cropped and augmented points (n, 3) float32 of one pose of a scene, m, in its grasp frame.

    row: of the pose in the scene. floating: leave the table's points out. None if fewer than
    LEAST_POINTS lie in the crop.
    """
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
    """Points (batch, n, 3) of random poses, and whether each pose held (batch,), 0 or 1."""
    points: list[NDArray[np.float32]] = []
    held: list[bool] = []
    while len(points) < settings.batch:
        scene = scenes[rng.integers(len(scenes))]
        floating = bool(rng.random() < FLOATING and not scene.table.all())
        held_wanted = bool(rng.random() < settings.positive)
        rows = np.flatnonzero((scene.held == held_wanted) & ~(floating & scene.table_hit))
        if not len(rows):
            continue
        cropped_points = example(scene, int(rng.choice(rows)), floating, rng)
        if cropped_points is not None:
            points.append(cropped_points)
            held.append(held_wanted)
    return torch.from_numpy(np.array(points, dtype=np.float32)), torch.tensor(
        held, dtype=torch.float32
    )


def train(
    scenes: list[Scene],
    settings: Settings,
    checkpoint: Path,
    progress: Callable[[int, dict[str, float]], None],
) -> GraspEvaluator:
    """Train an evaluator on scenes, and return it.

    Training resumes from `checkpoint` if it is of the same settings. progress(step, loss terms).
    """
    torch.manual_seed(settings.seed)
    network = GraspEvaluator(VFAS)
    gripper = torch.from_numpy(
        trained_gripper().points(VFAS.gripper, generator(0, "gripper points", 0)).astype(np.float32)
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
    """`scores_of` an evaluator over n random poses of scenes, held or failed as they come."""
    gripper = torch.from_numpy(
        trained_gripper().points(VFAS.gripper, generator(0, "gripper points", 0)).astype(np.float32)
    )[None]
    points: list[NDArray[np.float32]] = []
    held: list[bool] = []
    rng = generator(seed, "measure/vfas", 0)
    while len(points) < n:
        scene = scenes[rng.integers(len(scenes))]
        row = int(rng.integers(len(scene.held)))
        cropped_points = example(scene, row, False, rng)
        if cropped_points is not None:
            points.append(cropped_points)
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
    """Make scenes of procedural objects, train on them, and measure on objects held out.

    Writes OUT/scenes, OUT/vfas_evaluator.safetensors and OUT/metrics.json; returns the metrics.
    seeds: scenes per object. progress(phase, step, loss terms).
    """
    limit_threads()
    made = iter(range(1, objects + 1))
    make = partial(write_scenes, out=out / "scenes", seed=settings.seed, seeds=seeds)
    write_all(make, range(objects), jobs, lambda _: progress("scenes", next(made), {}))
    data = load_scenes(out / "scenes", objects, settings.seed)
    learning, held_out = (
        [scene for scenes in part for scene in scenes]
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
            "held_out": sum(len(s.held) for s in held_out),
        },
        "held_out": {"vfas_evaluator": measure(network, held_out, 1500, settings.seed)},
    }
    (out / "metrics.json").write_text(json.dumps(metrics, indent=1), encoding="utf-8")
    return metrics
