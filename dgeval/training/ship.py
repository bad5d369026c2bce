"""From grasps to weights files: train FFHNet's three networks, calibrate, measure, export.

Calibration and measurement are on objects that trained nothing.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from dgeval.determinism import limit_threads
from dgeval.errors import Place, UsageError
from dgeval.networks.checkpoints import quantised, shipped
from dgeval.networks.ffhnet import (
    FFHEvaluator,
    FFHGenerator,
    Palms,
    load_evaluator,
    load_generator,
    palms_of,
)
from dgeval.parallel import write_all
from dgeval.planning.grasps import Networks
from dgeval.training.ffhnet import Kind, ObjectData, Settings, calibrate, load_objects, train, tune
from dgeval.training.grasp_data import try_selected, write_grasps
from dgeval.worlds.objects import procedural_object

BINS = 10  # of the predicted probability, for the calibration error
SELECTED_VIEWS = 10  # per held-out object, for calibration and measurement


def train_all(
    out: Path,
    objects: int,
    settings: Settings,
    proposals: int,
    jobs: int,
    progress: Callable[[str, int, dict[str, float]], None],
) -> dict[str, Any]:
    """Train on the grasps in OUT/grasps, and measure on objects held out; returns the metrics.

    Writes OUT/ffhnet_*.safetensors and OUT/metrics.json. proposals: how many of the generator's
    proposals are tried in physics per object, for the evaluators. progress(network, step, loss
    terms).
    """
    limit_threads()

    def trained(kind: Kind, data: list[ObjectData]) -> FFHGenerator | FFHEvaluator:
        learning = data[: -settings.held_out]
        return train(
            kind,
            learning,
            settings,
            out / f"{kind}.ckpt",
            lambda step, terms: progress(kind, step, terms),
        )

    generator_file = out / "ffhnet_generator.safetensors"
    export(
        trained("generator", load_objects(out / "grasps", settings, objects, settings.seed)),
        generator_file,
    )
    # the evaluators also learn from this generator's proposals: they must recognise its mistakes
    make = partial(
        write_grasps,
        out=out / "proposed",
        seed=settings.seed,
        tried=proposals,
        weights=generator_file,
    )
    write_all(make, range(objects), jobs, lambda _: None)
    data = load_objects(out / "grasps", settings, objects, settings.seed, out / "proposed")
    learning, held_out = data[: -settings.held_out], data[-settings.held_out :]
    metrics: dict[str, Any] = {
        "settings": asdict(settings),
        "data": _about(learning, held_out),
        "held_out": {},
    }
    kinds: tuple[Kind, ...] = ("evaluator", "evaluator_fingers")
    for kind in kinds:
        network = trained(kind, data)
        assert isinstance(network, FFHEvaluator)
        # and each from its own choices, for its training objects and for as many new ones
        first = out / f"first_{kind}.safetensors"
        export(network, first)
        indices = [*range(len(learning)), *range(objects, objects + len(learning))]
        folders = own_choices(out, kind, generator_file, first, indices, settings.seed, jobs)
        with_own = load_objects(
            out / "grasps", settings, objects, settings.seed, out / "proposed", *folders
        )
        tune_on_own(network, with_own, settings, out / f"{kind}_tuned.ckpt", progress)
        unseen = range(objects - settings.held_out, objects)
        metrics["held_out"][kind] = calibrated(generator_file, network, unseen, settings.seed)
        export(network, out / f"ffhnet_{kind}.safetensors")
    (out / "metrics.json").write_text(json.dumps(metrics, indent=1), encoding="utf-8")
    return metrics


def own_choices(
    out: Path,
    kind: str,
    generator_file: Path,
    evaluator_file: Path,
    indices: Sequence[int],
    seed: int,
    jobs: int,
) -> tuple[Path, Path]:
    """Folders of an evaluator's choices, and of hands short of them, tried in physics."""
    make = partial(
        write_grasps, seed=seed, tried=0, weights=generator_file, evaluator=evaluator_file
    )
    chosen, short = out / f"chosen_by_{kind}", out / f"short_of_{kind}"
    write_all(partial(make, out=chosen), indices, jobs, lambda _: None)
    write_all(partial(make, out=short, chosen=chosen), indices, jobs, lambda _: None)
    return chosen, short


def tune_on_own(
    network: FFHEvaluator,
    objects: list[ObjectData],
    settings: Settings,
    checkpoint: Path,
    progress: Callable[[str, int, dict[str, float]], None],
) -> None:
    """Tune an evaluator, in place, on the objects for which it chose something."""
    own = [o for o in objects if len(o.rows["chosen_held"]) or len(o.rows["chosen_failed"])]
    tune(network, own, settings, checkpoint, lambda step, terms: progress("tuning", step, terms))


def calibrated(
    generator_file: Path, network: FFHEvaluator, unseen: Sequence[int], seed: int
) -> dict[str, float]:
    """Calibrate an evaluator, in place, on every second unseen object; measured on the others."""
    networks = Networks(load_generator(generator_file), network, upright=True)
    factor, offset = calibrate(network, *selected(networks, unseen[::2], seed))
    bps, palms, held = selected(networks, unseen[1::2], seed)
    with torch.no_grad():
        scores = scores_of(network(bps, palms).numpy().astype(float), held.numpy() > 0.5)
    return {**scores, "platt_factor": factor, "platt_offset": offset}


def tune_again(
    out: Path,
    start: Path,
    objects: int,
    settings: Settings,
    proposals: int,
    jobs: int,
    progress: Callable[[str, int, dict[str, float]], None],
) -> dict[str, Any]:
    """Tune an evaluator with fingers further, on its own choices; returns the metrics.

    start: its file. Writes OUT/ffhnet_evaluator_fingers.safetensors and OUT/metrics.json. Its
    choices are for the training objects of `objects` and for half as many new ones; the shipped
    generator's proposals for the training objects, `proposals` of each, are tried too. Raises
    UsageError for an evaluator without joints.
    """
    limit_threads()
    kind = "evaluator_fingers"
    generator_file = shipped("ffhnet_generator.safetensors")
    network = load_evaluator(start)
    if not network.joints:
        raise UsageError("this evaluator takes no joints", Place(str(start)))
    learning = range(objects - settings.held_out)
    make = partial(
        write_grasps,
        out=out / "proposed",
        seed=settings.seed,
        tried=proposals,
        weights=generator_file,
    )
    write_all(make, learning, jobs, lambda _: None)
    indices = [*learning, *range(objects, objects + len(learning) // 2)]
    folders = own_choices(out, kind, generator_file, start, indices, settings.seed, jobs)
    data = load_objects(
        out / "proposed", settings, len(learning), settings.seed, None, *folders, new_from=objects
    )
    tune_on_own(network, data, settings, out / f"{kind}_tuned.ckpt", progress)
    unseen = range(len(learning), objects)
    scores = calibrated(generator_file, network, unseen, settings.seed)
    export(network, out / f"ffhnet_{kind}.safetensors")
    metrics = {
        "settings": asdict(settings),
        "data": _about(data, []),
        "held_out": {kind: scores},
    }
    (out / "metrics.json").write_text(json.dumps(metrics, indent=1), encoding="utf-8")
    return metrics


def selected(networks: Networks, indices: Sequence[int], seed: int) -> tuple[Tensor, Palms, Tensor]:
    """Try the grasps that the networks would choose for procedural objects.

    Returns bps (n, k), palms, and held (n,) 0 or 1. On these a score is calibrated to be the
    probability that a grasp holds which the pipeline might choose.
    """
    bps, poses, joints, held = [], [], [], []
    for index in indices:
        clouds, T, _, q, h = try_selected(
            procedural_object(index, seed), networks, seed, SELECTED_VIEWS
        )
        bps += [c.bps[0] for c in clouds]
        T[:, :3, 3] -= np.array([c.mean for c in clouds])
        poses.append(T)
        joints.append(q)
        held.append(h)
    palms = palms_of(np.concatenate(poses), np.concatenate(joints))
    return torch.stack(bps), palms, torch.from_numpy(np.concatenate(held).astype(np.float32))


def export(network: nn.Module, path: Path) -> None:
    """Write a safetensors file: matrices quantised, which shrinks it; norms and biases as they are.

    The metadata say that the network takes upright clouds, as all networks trained here do, and
    whether it takes joints.
    """
    joints = isinstance(network, FFHEvaluator) and network.joints
    about = {"axes": "upright", "joints": "yes" if joints else "no"}
    save_file(quantised(network.state_dict()), path, about)


def scores_of(p: np.ndarray[Any, Any], held: np.ndarray[Any, Any]) -> dict[str, float]:
    """ROC-AUC, Brier score, expected calibration error, and share that held.

    p (n,): predicted probabilities that a grasp holds. held (n,): bool.
    """
    from scipy.stats import rankdata

    ranks = rankdata(p)
    n, m = int(held.sum()), int((~held).sum())
    auc = (ranks[held].sum() - n * (n + 1) / 2) / max(n * m, 1)
    cell = np.minimum((p * BINS).astype(int), BINS - 1)
    gaps = [
        abs(p[cell == b].mean() - held[cell == b].mean()) * (cell == b).mean()
        for b in range(BINS)
        if (cell == b).any()
    ]
    return {
        "auc": float(auc),
        "brier": float(np.mean((p - held) ** 2)),
        "ece": float(sum(gaps)),
        "held": float(held.mean()),
    }


def _about(learning: list[ObjectData], held_out: list[ObjectData]) -> dict[str, Any]:
    """Names of the objects, and number of grasps of each kind, for training and held out."""
    return {
        name: {kind: sum(len(o.rows[kind]) for o in objects) for kind in objects[0].rows}
        | {"objects": [o.name for o in objects]}
        for name, objects in (("training", learning), ("held_out", held_out))
        if objects
    }
