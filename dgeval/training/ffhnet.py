"""Training of FFHNet on grasps tried in physics, with the published losses.

Whole objects are held out. A run can be resumed, and two runs of the same settings give the same
weights.
"""

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
from dgeval.robots.hand import hand_for
from dgeval.training.grasp_data import GraspData, read_grasps
from dgeval.training.loop import optimise
from dgeval.training.views import views_of
from dgeval.worlds.objects import procedural_object

HAND = hand_for("ffhnet")

Kind = Literal["generator", "evaluator", "evaluator_fingers"]
# weights of the generator's loss (docs/papers.md, "FFHNet training"): translation, rotation,
# joints, KL
W_T, W_R, W_J, W_KL = 100.0, 1.0, 10.0, 0.005
# With the authors' 0.3, networks of this size fit their own training data badly: AUC 0.78, not
# 0.94.
DROPOUT = 0.05
CLEARANCE = 0.02  # m above an object's top; a hand whose grasp centre is higher holds nothing
# Shares of an evaluator's batch. held, failed: tried in physics; overlapping: not tried, the hand
# lay in the object; hard: the authors' hard negatives; retreated: hands on their way to a grasp,
# moved back along their fingers; far: hands above the object.
SHARES = {
    "held": 0.40,
    "failed": 0.20,
    "overlapping": 0.15,
    "hard": 0.08,
    "retreated": 0.12,
    "far": 0.05,
}
# The same for tuning, when the data also hold the evaluator's own choices, and hands short of them,
# all tried in physics: chosen_held, chosen_failed, short_held, short_failed.
TUNE_SHARES = {
    "held": 0.16,
    "chosen_held": 0.20,
    "short_held": 0.06,
    "failed": 0.10,
    "chosen_failed": 0.16,
    "short_failed": 0.16,
    "overlapping": 0.08,
    "hard": 0.03,
    "retreated": 0.03,
    "far": 0.02,
}
# m, least and greatest retreat; hands nearer to a grasp are tried in physics
RETREAT_M = (0.06, 0.2)
# Hard negatives are held grasps moved by this on every axis, m and rad, signs random
# (docs/papers.md, "FFHNet training").
HARD_M, HARD_RAD = 0.03, 0.6


@dataclass(frozen=True)
class Settings:
    """Settings of a training run, everything that its result depends on besides the grasps."""

    n_bps: int = 512  # basis points
    width: int = 256
    hidden: int = 128
    views: int = 100  # per object
    held_out: int = 9  # objects, the last ones, for calibration and measurement only
    batch: int = 512
    steps: int = 6500  # of an evaluator, before tuning
    generator_steps: int = 8000
    tune_steps: int = 2500
    tune_rate: float = 5e-4
    learning_rate: float = 1e-3
    weight_decay: float = 1e-4
    seed: int = 0


@dataclass(frozen=True)
class ObjectData:
    """Views and grasps of one object.

    - bps (v, n), T_view_object (v, 4, 4): of v views, as in `View`.
    - T_object_palm (g, 4, 4) m, joints (g, 15) rad: of g grasps.
    - rows: indices of the grasps that held, failed, overlapping, chosen_held, chosen_failed,
      short_held, short_failed.
    - top: z of the object's highest point in its frame, m.
    """

    name: str
    bps: Tensor
    T_view_object: Array
    T_object_palm: Array
    joints: Array
    rows: dict[str, NDArray[np.intp]]
    top: float


def load_objects(
    folder: Path,
    settings: Settings,
    count: int,
    seed: int,
    proposed: Path | None = None,
    chosen: Path | None = None,
    short: Path | None = None,
    new_from: int | None = None,
) -> list[ObjectData]:
    """Grasps and views of procedural objects 0 to count - 1.

    - folder: of files with sampled grasps, one per object.
    - proposed: folder of a generator's proposals for the same objects, added to the sampled grasps.
    - chosen: folder of an evaluator's choices. Objects from `new_from` (default `count`) on that
      have a file there follow in the result. short: folder of hands short of them, added to the
      choices.

    Raises UsageError if a file is missing in `folder`, or if no grasp held.
    """
    out = []
    first = count if new_from is None else new_from
    others = (
        []
        if chosen is None
        else sorted(k for k in map(_index_of, chosen.glob("*.npz")) if k >= first)
    )
    for index in [*range(count), *others]:
        object_model = procedural_object(index, seed)
        path = folder / f"{object_model.name}.npz"
        if index < count and not path.is_file():
            raise UsageError(
                f"no grasps of {object_model.name} in {folder}",
                hint="make them: dgeval train ffhnet --out DIR",
            )
        files = (
            [] if index >= count else [path] if proposed is None else [path, proposed / path.name]
        )
        kinds = [""] * len(files)
        for kind, more in (("chosen_", chosen), ("short_", short)):
            if more is not None and (more / path.name).is_file():
                files.append(more / path.name)
                kinds.append(kind)
        grasps = [read_grasps(file) for file in files]
        fields = ("T_object_palm", "joints", "held", "overlapping")
        data = GraspData(*(np.concatenate([getattr(g, f) for g in grasps]) for f in fields))
        kind_of = np.repeat(kinds, [len(g.held) for g in grasps])
        views = views_of(object_model, settings.views, settings.n_bps, settings.seed)
        failed = ~data.held & ~data.overlapping
        rows = {"overlapping": np.flatnonzero(data.overlapping)}
        for kind in ("", "chosen_", "short_"):
            rows[f"{kind}held"] = np.flatnonzero(data.held & (kind_of == kind))
            rows[f"{kind}failed"] = np.flatnonzero(failed & (kind_of == kind))
        out.append(
            ObjectData(
                object_model.name,
                torch.from_numpy(np.stack([v.bps for v in views])),
                np.stack([v.T_view_object for v in views]),
                data.T_object_palm,
                data.joints,
                rows,
                -min(p.lowest(np.array([0.0, 0.0, -1.0])) for p in object_model.parts),
            )
        )
    if not any(len(o.rows["held"]) for o in out):
        raise UsageError(f"no grasp held in {folder}")
    return out


def _index_of(path: Path) -> int:
    """Index of the procedural object that a file is named after."""
    return int(path.stem.rsplit("_", 1)[1])


def batch_of(
    objects: list[ObjectData], n: int, shares: dict[str, float], rng: np.random.Generator
) -> tuple[Tensor, Palms, Tensor]:
    """n grasps of random objects and views, with kinds drawn by `shares`.

    Returns bps (n, k), palms in the view's frame, and label (n,), 1 if the grasp held and 0 if not.
    """
    kinds = rng.choice(list(shares), n, p=np.array(list(shares.values())))
    source = {"hard": "held", "far": "held", "retreated": "held"}
    with_grasps = {k: [o for o in objects if len(o.rows[source.get(k, k)])] for k in shares}
    bps, poses, joints = [], np.empty((n, 4, 4)), np.empty((n, 15))
    for i, kind in enumerate(kinds):
        owner = with_grasps[kind][rng.integers(len(with_grasps[kind]))]
        view = rng.integers(len(owner.bps))
        row = rng.choice(owner.rows[source.get(kind, kind)])
        T = owner.T_object_palm[row]
        if kind == "far":
            T = _raised_above(T, owner.top, rng)
        elif kind == "retreated":
            back = np.eye(4)
            back[2, 3] = -rng.uniform(*RETREAT_M)  # the hand's z runs along its fingers
            T = T @ invert(HAND.T_hand_palm) @ back @ HAND.T_hand_palm
        T = owner.T_view_object[view] @ T
        if kind == "hard":
            T = _hard_negative(T, rng)
        bps.append(owner.bps[view])
        poses[i], joints[i] = T, owner.joints[row]
    label = np.char.endswith(kinds.astype(str), "held").astype(np.float32)
    return torch.stack(bps), palms_of(poses, joints), torch.from_numpy(label)


def _raised_above(T_object_palm: Array, top: float, rng: np.random.Generator) -> Array:
    """T_object_palm raised until the grasp centre is above the object, and up to 20 cm more."""
    T = T_object_palm.copy()
    centre = (T @ invert(HAND.T_hand_palm) @ np.append(HAND.centre, 1.0))[2]
    T[2, 3] += max(top + CLEARANCE - centre, 0.0) + rng.uniform(0, 0.2)
    return T


def _hard_negative(T: Array, rng: np.random.Generator) -> Array:
    """T moved by HARD_M on every axis and HARD_RAD in each fixed-axis Euler angle, random signs."""
    from scipy.spatial.transform import Rotation

    out = T.copy()
    out[:3, 3] += HARD_M * rng.choice([-1.0, 1.0], 3)
    angles = Rotation.from_matrix(T[:3, :3]).as_euler("xyz") + HARD_RAD * rng.choice([-1.0, 1.0], 3)
    out[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
    return out


def generator_loss(
    network: FFHGenerator, bps: Tensor, palms: Palms, z: Tensor
) -> tuple[Tensor, dict[str, float]]:
    """The published loss of the generator, and its terms by name.

    z (n, 5): standard normal draws, from which the latent code is made.
    """
    mu, logvar = network.encode(bps, palms)
    out = network.decode(mu + z * torch.exp(0.5 * logvar), bps)
    terms = {
        "t": W_T * functional.mse_loss(out.translation, palms.translation),
        "R": W_R * functional.mse_loss(out.rotation, palms.rotation),
        "joints": W_J * functional.mse_loss(out.joints, palms.joints),
        "KL": W_KL * (-0.5 * (1 + logvar - mu**2 - logvar.exp()).sum(dim=1)).mean(),
    }
    return torch.stack(list(terms.values())).sum(), {k: float(v.detach()) for k, v in terms.items()}


def evaluator_loss(
    network: FFHEvaluator, bps: Tensor, palms: Palms, label: Tensor
) -> tuple[Tensor, dict[str, float]]:
    """The published loss of an evaluator for label (n,), and its cross entropy."""
    loss = functional.binary_cross_entropy_with_logits(network.logits(bps, palms, DROPOUT), label)
    return 10 * loss, {"BCE": float(loss.detach())}


def new_network(kind: Kind, settings: Settings) -> FFHGenerator | FFHEvaluator:
    """A network of the given kind and sizes, with weights drawn from the seed."""
    torch.manual_seed(settings.seed)
    size = settings.n_bps, settings.width, settings.hidden
    return (
        FFHGenerator(*size)
        if kind == "generator"
        else FFHEvaluator(*size, joints=kind == "evaluator_fingers")
    )


def train(
    kind: Kind,
    objects: list[ObjectData],
    settings: Settings,
    checkpoint: Path,
    progress: Callable[[int, dict[str, float]], None],
) -> FFHGenerator | FFHEvaluator:
    """Train a network on objects, and return it. progress(step, loss terms).

    Training resumes from `checkpoint` if it is of the same settings. Draws depend on the step
    alone, so a resumed run ends like an uninterrupted one.
    """
    network = new_network(kind, settings)
    steps = settings.generator_steps if kind == "generator" else settings.steps

    def loss_of(step: int) -> tuple[Tensor, dict[str, float]]:
        rng = generator(settings.seed, f"train/{kind}", step)
        torch.manual_seed(int(rng.integers(2**31)))
        if isinstance(network, FFHGenerator):
            bps, palms, _ = batch_of(objects, settings.batch, {"held": 1.0}, rng)
            return generator_loss(network, bps, palms, torch.randn(settings.batch, 5))
        return evaluator_loss(network, *batch_of(objects, settings.batch, SHARES, rng))

    rates = settings.learning_rate, settings.weight_decay
    optimise(
        network, loss_of, steps, rates, {"kind": kind, **asdict(settings)}, checkpoint, progress
    )
    return network


def tune(
    network: FFHEvaluator,
    objects: list[ObjectData],
    settings: Settings,
    checkpoint: Path,
    progress: Callable[[int, dict[str, float]], None],
) -> None:
    """Train an evaluator further, in place, with its own choices among the grasps.

    The weights on the cloud's basis point set stay fixed: training them too gained only 0.01 of
    ROC-AUC.
    """
    for block, before in (
        (network.rb1, 0),
        (network.rb2, settings.width),
        (network.rb3, settings.width),
    ):
        for layer in (block.fc1, block.fc3):
            free = torch.ones_like(layer.weight)
            free[:, before : before + settings.n_bps] = 0.0
            layer.weight.register_hook(lambda gradient, free=free: gradient * free)  # type: ignore[no-untyped-call]

    def loss_of(step: int) -> tuple[Tensor, dict[str, float]]:
        rng = generator(settings.seed, "tune", step)
        torch.manual_seed(int(rng.integers(2**31)))
        return evaluator_loss(network, *batch_of(objects, settings.batch, TUNE_SHARES, rng))

    about = {"tuned": True, "joints": network.joints, **asdict(settings)}
    optimise(
        network,
        loss_of,
        settings.tune_steps,
        (settings.tune_rate, 0.0),
        about,
        checkpoint,
        progress,
    )


def calibrate(
    network: FFHEvaluator, bps: Tensor, palms: Palms, held: Tensor
) -> tuple[float, float]:
    """Calibrate an evaluator, in place, by Platt's scaling of its logit; returns factor and offset.

    The scaling is included in the last layer. bps, palms and held (n,) are of objects that the
    evaluator was not trained on.
    """
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
