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
from dgeval.networks.checkpoints import quantised
from dgeval.networks.ffhnet import FFHEvaluator, FFHGenerator, Palms, load_generator, palms_of
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
        chosen, first = out / f"chosen_by_{kind}", out / f"first_{kind}.safetensors"
        export(network, first)
        make = partial(
            write_grasps,
            out=chosen,
            seed=settings.seed,
            tried=0,
            weights=generator_file,
            evaluator=first,
        )
        indices = [*range(len(learning)), *range(objects, objects + len(learning))]
        write_all(make, indices, jobs, lambda _: None)
        with_own = load_objects(
            out / "grasps", settings, objects, settings.seed, out / "proposed", chosen
        )
        own = [o for o in with_own if len(o.rows["chosen_held"]) or len(o.rows["chosen_failed"])]
        tune(
            network,
            own,
            settings,
            out / f"{kind}_tuned.ckpt",
            lambda step, terms: progress("tuning", step, terms),
        )
        # every second held-out object calibrates, the others measure
        networks = Networks(load_generator(generator_file), network, upright=True)
        unseen = range(objects - settings.held_out, objects)
        factor, offset = calibrate(network, *selected(networks, unseen[::2], settings.seed))
        bps, palms, held = selected(networks, unseen[1::2], settings.seed)
        with torch.no_grad():
            scores = scores_of(network(bps, palms).numpy().astype(float), held.numpy() > 0.5)
        metrics["held_out"][kind] = {**scores, "platt_factor": factor, "platt_offset": offset}
        export(network, out / f"ffhnet_{kind}.safetensors")
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

    The metadata say that the network takes upright clouds, as all networks trained here do.
    """
    save_file(quantised(network.state_dict()), path, {"axes": "upright"})


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
        name: {
            kind: sum(len(o.rows[kind]) for o in objects)
            for kind in ("held", "failed", "overlapping")
        }
        | {"objects": [o.name for o in objects]}
        for name, objects in (("training", learning), ("held_out", held_out))
    }
