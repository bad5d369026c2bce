"""Contact-GraspNet as in `cgn-pytorch`: one parallel-jaw grasp at each of 2048 points of a scene.

Its weights are not shipped. Layers have the names of its checkpoint (docs/papers.md,
"Contact-GraspNet"). Two accidents of the original are kept, because the weights were trained with
them: point i always counts as a neighbour of centre i, wherever it lies, and the output of
`set_abstract_final` is not used.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import KDTree
from scipy.special import expit
from torch import Tensor, nn
from torch.nn import functional

from dgeval.errors import UsageError
from dgeval.geometry import Array
from dgeval.networks.checkpoints import load_strictly, read_weights
from dgeval.networks.point_sets import farthest_points, neighbours_in_ball

# sizes of the three set abstractions and the three feature propagations (docs/papers.md,
# "Contact-GraspNet")
CENTRES = (2048, 512, 128)
RADII = ((0.02, 0.04, 0.08), (0.04, 0.08, 0.16), (0.08, 0.16, 0.32))  # m, of the neighbourhoods
WIDTHS = (
    ((32, 32, 64), (64, 64, 128), (64, 96, 128)),
    ((64, 64, 128), (128, 128, 256), (128, 128, 256)),
    ((64, 64, 128), (128, 128, 256), (128, 128, 256)),
)
PROPAGATION_WIDTHS: tuple[tuple[int, ...], ...] = ((256, 256), (256, 128), (128, 128, 128))
NEIGHBOURS = 64  # most neighbours of a centre
INTERPOLATION_POINTS = 3  # nearest points that a propagated feature is interpolated from
MAX_WIDTH = 0.08  # m, opening of the Panda gripper that the network was trained for


@dataclass(frozen=True)
class JawGrasps:
    """Grasps of a parallel jaw in the cloud's frame.

    T_cloud_grasp (n, 4, 4), float64: origin between the fingertips, m; x is the closing direction,
    z the approach. width (n,): opening, m. score (n,): predicted success, 0 to 1.
    """

    T_cloud_grasp: Array
    width: Array
    score: Array


def _layers(inputs: int, widths: tuple[int, ...]) -> nn.Sequential:
    """Layers of the given output widths, each linear, then ReLU, then batch norm."""
    return nn.Sequential(
        *(
            nn.Sequential(nn.Linear(a, b), nn.ReLU(), nn.BatchNorm1d(b))
            for a, b in zip((inputs, *widths), widths, strict=False)
        )
    )


class ContactGraspNet(nn.Module):
    """The network: from scene points to contacts, directions, widths and success."""

    def __init__(self) -> None:
        super().__init__()
        inputs, widths_out = 0, []
        stages = []
        for widths in WIDTHS:
            scales = [
                nn.ModuleDict({"conv": nn.ModuleDict({"local_nn": _layers(inputs + 3, w)})})
                for w in widths
            ]
            stages.append(nn.ModuleList(scales))
            inputs = sum(w[-1] for w in widths)
            widths_out.append(inputs)
        self.set_abstract_msg = nn.ModuleList(stages)
        self.set_abstract_final = _layers(inputs, (256, 512, 1024))  # in the checkpoint, not used
        width, back = inputs, []
        for skip, layer_widths in zip(reversed(widths_out), PROPAGATION_WIDTHS, strict=True):
            back.append(nn.ModuleDict({"nn": _layers(width + skip, layer_widths)}))
            width = layer_widths[-1]
        self.feat_prop = nn.ModuleList(back)
        self.multihead = nn.ModuleList(
            nn.Sequential(
                nn.Conv1d(3 + width, 128, 1),
                nn.BatchNorm1d(128),
                nn.Dropout(0.0),
                nn.Conv1d(128, n, 1),
            )
            for n in (1, 3, 3, 1)
        )

    @torch.no_grad()
    def forward(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """points (n, 3) float32, m: mean subtracted, z up, n >= 2048 (20,000 in training).

        Returns contacts (2048, 3) m; unit vectors of the closing direction and of the approach,
        each (2048, 3); width (2048,) m, not yet clipped at 0; logit of success (2048,).
        """
        xyz, features = points, points[:, :0]
        levels: list[tuple[Tensor, Tensor]] = []
        for stage, count, radii in zip(self.set_abstract_msg, CENTRES, RADII, strict=True):
            flat = xyz.numpy()[None]
            chosen = farthest_points(flat, count, -1.0)[0]
            centres = flat[:, chosen]
            scales = []
            for scale, radius in zip(stage, radii, strict=True):  # type: ignore[call-overload]
                neighbours = neighbours_in_ball(flat, centres, radius, NEIGHBOURS)[0]
                neighbours = torch.from_numpy(
                    np.concatenate([neighbours, np.arange(count)[:, None]], axis=1)
                )
                offsets = xyz[neighbours] - torch.from_numpy(centres[0])[:, None]
                local = torch.cat([features[neighbours], offsets], 2)
                rows = scale["conv"]["local_nn"](local.reshape(-1, local.shape[2]))
                scales.append(rows.reshape(*neighbours.shape, -1).amax(1))
            xyz, features = torch.from_numpy(centres[0]), torch.cat(scales, 1)
            levels.append((xyz, features))
        for step, (finer, skip) in zip(self.feat_prop, reversed(levels), strict=True):
            interpolated = _interpolated(features, xyz, finer)
            features = step["nn"](torch.cat([interpolated, skip], 1))  # type: ignore[index]
            xyz = finer
        inputs = torch.cat([xyz, features], 1).T[None]
        score, across, approach, width = (head(inputs)[0].T for head in self.multihead)
        across = functional.normalize(across, dim=1)
        approach = functional.normalize(
            approach - (across * approach).sum(1, keepdim=True) * across, dim=1
        )
        return xyz, across, approach, width[:, 0].clamp(-2 * MAX_WIDTH, MAX_WIDTH), score[:, 0]

    def grasps(self, cloud: Array) -> JawGrasps:
        """Grasps on a scene's points (n, 3) m, n >= 2048, in a frame whose z points up."""
        mean = cloud.mean(axis=0)
        points = torch.from_numpy((cloud - mean).astype(np.float32))
        contacts, across, approach, width, logit = (v.double().numpy() for v in self(points))
        T = np.tile(np.eye(4), (len(contacts), 1, 1))
        T[:, :3, 0], T[:, :3, 1], T[:, :3, 2] = across, np.cross(approach, across), approach
        T[:, :3, 3] = contacts + width[:, None] / 2 * across + mean
        return JawGrasps(T, np.maximum(width, 0.0), expit(logit))


def _interpolated(features: Tensor, coarse: Tensor, fine: Tensor) -> Tensor:
    """Interpolate features (c, w) of points coarse (c, 3) to points fine (f, 3): (f, w).

    The mean over the three nearest coarse points, weighted by the inverse square distance.
    """
    neighbours = np.asarray(
        KDTree(coarse.numpy()).query(fine.numpy(), INTERPOLATION_POINTS)[1], dtype=np.int64
    )
    index = torch.from_numpy(neighbours)
    weights = 1 / ((coarse[index] - fine[:, None]) ** 2).sum(2, keepdim=True).clamp(min=1e-16)
    return (features[index] * weights).sum(1) / weights.sum(1)


def installed_weights() -> Path | None:
    """The weights in the package `cgn-pytorch`; None where it is not installed."""
    package = importlib.util.find_spec("cgn_pytorch")
    if package is None or not package.submodule_search_locations:
        return None
    return Path(package.submodule_search_locations[0]) / "checkpoints" / "current.pth"


def load_contact_graspnet(path: Path | None = None) -> ContactGraspNet:
    """The network with weights from a file, or from the `cgn-pytorch` package if path is None.

    Raises UsageError if the package is not installed, or if the weights can't be read or don't fit.
    """
    path = path or installed_weights()
    if path is None:
        raise UsageError(
            "Contact-GraspNet is asked for seeds and is not installed",
            hint="pip install --no-deps cgn-pytorch (only its weights are read; mind their "
            "licence), or name a checkpoint",
        )
    network = ContactGraspNet()
    load_strictly(network, read_weights(path, "state_dict"), str(path))
    return network
