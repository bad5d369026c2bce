"""Training of FFHNet on grasps tried in physics: published losses, whole objects held out, resumable, the same twice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from dgeval.determinism import generator
from dgeval.errors import UsageError
from dgeval.geometry import Array, invert
from dgeval.networks.ffhnet import FFHEvaluator, FFHGenerator, Palms, palms_of
from dgeval.physics.closing import GRASP_CENTRE
from dgeval.physics.hand import T_hand_palm
from dgeval.physics.objects import procedural_object
from dgeval.training.grasp_data import GraspData, read_grasps
from dgeval.training.loop import optimise
from dgeval.training.views import views_of

Kind = Literal["generator", "evaluator", "evaluator_fingers"]
# weights of the generator's loss (PAPERS section 1.5): translation, rotation, joints, KL
W_T, W_R, W_J, W_KL = 100.0, 1.0, 10.0, 0.005
DROPOUT = 0.05  # the authors' 0.3 leaves networks of this size short of their own training data (AUC 0.78 of 0.94)
CLEARANCE = 0.02  # m above an object's top: a hand whose grasp centre is higher holds nothing
# shares of an evaluator's batch: held, tried and failed, overlapping, the authors' hard negatives, hands that are far off
# and hands on their way to a grasp, drawn back along their fingers
SHARES = {"held": 0.40, "failed": 0.20, "overlapping": 0.15, "hard": 0.08, "retreated": 0.12, "far": 0.05}
RETREAT_M = (0.06, 0.2)  # nearer ones are tried in physics
HARD_M, HARD_RAD = 0.03, 0.6  # hard negatives: every axis of a positive moved by this, signs random


@dataclass(frozen=True)
class Settings:
    """Of a training run; everything its result depends on besides the grasps."""

    n_bps: int = 512
    width: int = 256
    hidden: int = 128
    views: int = 100
    held_out: int = 9  # the last so many objects choose nothing but the calibration
    batch: int = 512
    steps: int = 6500  # of an evaluator
    generator_steps: int = 8000
    learning_rate: float = 1e-3
    weight_decay: float = 1e-4
    seed: int = 0


@dataclass(frozen=True)
class ObjectData:
    """One object: bps (v, n), T_view_object (v, 4, 4); grasps T_object_palm (g, 4, 4), joints (g, 15); rows of each kind."""

    name: str
    bps: Tensor
    T_view_object: Array
    T_object_palm: Array
    joints: Array
    rows: dict[str, NDArray[np.intp]]
    top: float  # m, of the object in its frame


def load_objects(folder: Path, settings: Settings, count: int, seed: int, proposed: Path | None = None) -> list[ObjectData]:
    """Grasps of procedural objects 0 … count - 1 with views of them. UsageError where there are none that held.

    proposed: folder of a generator's proposals for the same objects, added to the sampled grasps.
    """
    out = []
    for index in range(count):
        thing = procedural_object(index, seed)
        path = folder / f"{thing.name}.npz"
        if not path.is_file():
            raise UsageError(f"no grasps of {thing.name} in {folder}", hint="make them: dgeval train ffhnet --out DIR")
        data = read_grasps(path)
        more = read_grasps(proposed / path.name) if proposed is not None else None
        if more is not None:
            parts = (
                np.concatenate([getattr(data, f), getattr(more, f)]) for f in ("T_object_palm", "joints", "held", "overlapping")
            )
            data = GraspData(*parts)
        views = views_of(thing, settings.views, settings.n_bps, settings.seed)
        rows = {
            "held": np.flatnonzero(data.held),
            "failed": np.flatnonzero(~data.held & ~data.overlapping),
            "overlapping": np.flatnonzero(data.overlapping),
        }
        out.append(
            ObjectData(
                thing.name,
                torch.from_numpy(np.stack([v.bps for v in views])),
                np.stack([v.T_view_object for v in views]),
                data.T_object_palm,
                data.joints,
                rows,
                -min(p.lowest(np.array([0.0, 0.0, -1.0])) for p in thing.parts),
            )
        )
    if not any(len(o.rows["held"]) for o in out):
        raise UsageError(f"no grasp held in {folder}")
    return out


def batch_of(
    objects: list[ObjectData], n: int, shares: dict[str, float], rng: np.random.Generator
) -> tuple[Tensor, Palms, Tensor]:
    """n grasps of random objects and views: bps (n, k), palms in the view's frame, label (n,) 1 where it held."""
    kinds = rng.choice(list(shares), n, p=np.array(list(shares.values())))
    source = {"hard": "held", "far": "held", "retreated": "held"}
    able = {k: [o for o in objects if len(o.rows[source.get(k, k)])] for k in shares}
    bps, poses, joints = [], np.empty((n, 4, 4)), np.empty((n, 15))
    for i, kind in enumerate(kinds):
        thing = able[kind][rng.integers(len(able[kind]))]
        view = rng.integers(len(thing.bps))
        row = rng.choice(thing.rows[source.get(kind, kind)])
        T = thing.T_object_palm[row]
        if kind == "far":
            T = _lifted_off(T, thing.top, rng)
        elif kind == "retreated":
            back = np.eye(4)
            back[2, 3] = -rng.uniform(*RETREAT_M)  # the hand's z runs along its fingers
            T = T @ invert(T_hand_palm) @ back @ T_hand_palm
        T = thing.T_view_object[view] @ T
        if kind == "hard":
            T = _hard(T, rng)
        bps.append(thing.bps[view])
        poses[i], joints[i] = T, thing.joints[row]
    return torch.stack(bps), palms_of(poses, joints), torch.from_numpy((kinds == "held").astype(np.float32))


def _lifted_off(T_object_palm: Array, top: float, rng: np.random.Generator) -> Array:
    """The palm raised until the grasp centre is over the object, and up to 20 cm more."""
    T = T_object_palm.copy()
    centre = (T @ invert(T_hand_palm) @ np.append(GRASP_CENTRE, 1.0))[2]
    T[2, 3] += max(top + CLEARANCE - centre, 0.0) + rng.uniform(0, 0.2)
    return T


def _hard(T: Array, rng: np.random.Generator) -> Array:
    """Every translation axis and every Euler angle (fixed axes) moved by a fixed amount, signs random."""
    from scipy.spatial.transform import Rotation

    out = T.copy()
    out[:3, 3] += HARD_M * rng.choice([-1.0, 1.0], 3)
    angles = Rotation.from_matrix(T[:3, :3]).as_euler("xyz") + HARD_RAD * rng.choice([-1.0, 1.0], 3)
    out[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
    return out


def generator_loss(network: FFHGenerator, bps: Tensor, palms: Palms, z: Tensor) -> tuple[Tensor, dict[str, float]]:
    """The published loss, with z (n, 5) standard normal draws for the code; and its parts."""
    mu, logvar = network.encode(bps, palms)
    out = network.decode(mu + z * torch.exp(0.5 * logvar), bps)
    terms = {
        "t": W_T * functional.mse_loss(out.translation, palms.translation),
        "R": W_R * functional.mse_loss(out.rotation, palms.rotation),
        "joints": W_J * functional.mse_loss(out.joints, palms.joints),
        "KL": W_KL * (-0.5 * (1 + logvar - mu**2 - logvar.exp()).sum(dim=1)).mean(),
    }
    return torch.stack(list(terms.values())).sum(), {k: float(v.detach()) for k, v in terms.items()}


def new_network(kind: Kind, settings: Settings) -> FFHGenerator | FFHEvaluator:
    """With weights drawn from the seed."""
    torch.manual_seed(settings.seed)
    size = settings.n_bps, settings.width, settings.hidden
    return FFHGenerator(*size) if kind == "generator" else FFHEvaluator(*size, joints=kind == "evaluator_fingers")


def train(
    kind: Kind,
    objects: list[ObjectData],
    settings: Settings,
    checkpoint: Path,
    progress: Callable[[int, dict[str, float]], None],
) -> FFHGenerator | FFHEvaluator:
    """Train from the start or from the checkpoint that a run of the same settings left; progress(step, loss terms).

    Draws depend on the step alone, so a resumed run ends like an uninterrupted one.
    """
    network = new_network(kind, settings)
    steps = settings.generator_steps if kind == "generator" else settings.steps

    def loss_of(step: int) -> tuple[Tensor, dict[str, float]]:
        rng = generator(settings.seed, f"train/{kind}", step)
        torch.manual_seed(int(rng.integers(2**31)))
        if isinstance(network, FFHGenerator):
            bps, palms, _ = batch_of(objects, settings.batch, {"held": 1.0}, rng)
            return generator_loss(network, bps, palms, torch.randn(settings.batch, 5))
        bps, palms, label = batch_of(objects, settings.batch, SHARES, rng)
        loss = 10 * functional.binary_cross_entropy_with_logits(network.logits(bps, palms, DROPOUT), label)
        return loss, {"BCE": float(loss.detach()) / 10}

    rates = settings.learning_rate, settings.weight_decay
    optimise(network, loss_of, steps, rates, {"kind": kind, **asdict(settings)}, checkpoint, progress)
    return network


def calibrate(network: FFHEvaluator, bps: Tensor, palms: Palms, held: Tensor) -> tuple[float, float]:
    """Platt's scaling, put into the last layer: factor and offset of the logit. Grasps of objects that trained nothing."""
    with torch.no_grad():
        logits = network.logits(bps, palms)
    scale = nn.Parameter(torch.tensor([1.0, 0.0]))
    optimiser = torch.optim.LBFGS([scale], max_iter=100, line_search_fn="strong_wolfe")

    def closure() -> Tensor:
        optimiser.zero_grad()
        loss = functional.binary_cross_entropy_with_logits(scale[0] * logits + scale[1], held)
        loss.backward()  # type: ignore[no-untyped-call]
        return loss

    optimiser.step(closure)  # type: ignore[no-untyped-call]
    a, b = (float(v) for v in scale.detach())
    with torch.no_grad():
        network.out_success.weight *= a
        network.out_success.bias.copy_(a * network.out_success.bias + b)
    return a, b
