"""Contact-GraspNet as in `cgn-pytorch`: a parallel-jaw grasp at each of 2048 points of a scene. Its weights are not shipped.

Layers by the names of its checkpoint (PAPERS section 6). Two accidents of the original are kept, because the weights were
trained with them: centre i also gathers point i, wherever that lies, and `set_abstract_final` leads nowhere.
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

CENTRES = (2048, 512, 128)
RADII = ((0.02, 0.04, 0.08), (0.04, 0.08, 0.16), (0.08, 0.16, 0.32))  # m
WIDTHS = (
    ((32, 32, 64), (64, 64, 128), (64, 96, 128)),
    ((64, 64, 128), (128, 128, 256), (128, 128, 256)),
    ((64, 64, 128), (128, 128, 256), (128, 128, 256)),
)
BACK: tuple[tuple[int, ...], ...] = (
    (256, 256),
    (256, 128),
    (128, 128, 128),
)  # widths on the way back
NEIGHBOURS = 64  # at most, of each centre
INTERPOLATED = 3  # nearest points a feature is carried over from
WIDEST = 0.08  # m; of the Panda's gripper, for which it was trained


@dataclass(frozen=True)
class JawGrasps:
    """Grasps T_cloud_grasp (n, 4, 4), between the fingertips: x across the jaws, z the approach; width (n,) m; score (n,)."""

    T_cloud_grasp: Array
    width: Array
    score: Array


def _layers(inputs: int, widths: tuple[int, ...]) -> nn.Sequential:
    return nn.Sequential(
        *(
            nn.Sequential(nn.Linear(a, b), nn.ReLU(), nn.BatchNorm1d(b))
            for a, b in zip((inputs, *widths), widths, strict=False)
        )
    )


class ContactGraspNet(nn.Module):
    """Scene points -> contacts, directions, widths, confidence."""

    def __init__(self) -> None:
        super().__init__()
        inputs, gathered = 0, []
        stages = []
        for widths in WIDTHS:
            scales = [
                nn.ModuleDict({"conv": nn.ModuleDict({"local_nn": _layers(inputs + 3, w)})})
                for w in widths
            ]
            stages.append(nn.ModuleList(scales))
            inputs = sum(w[-1] for w in widths)
            gathered.append(inputs)
        self.set_abstract_msg = nn.ModuleList(stages)
        self.set_abstract_final = _layers(inputs, (256, 512, 1024))  # in the weights, and not used
        carried, back = inputs, []
        for skip, outward in zip(reversed(gathered), BACK, strict=True):
            back.append(nn.ModuleDict({"nn": _layers(carried + skip, outward)}))
            carried = outward[-1]
        self.feat_prop = nn.ModuleList(back)
        self.multihead = nn.ModuleList(
            nn.Sequential(
                nn.Conv1d(3 + carried, 128, 1),
                nn.BatchNorm1d(128),
                nn.Dropout(0.0),
                nn.Conv1d(128, n, 1),
            )
            for n in (1, 3, 3, 1)
        )

    @torch.no_grad()
    def forward(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """points (n, 3) m about their mean, z up, n >= 2048 (20,000 in training).

        Returns contacts (2048, 3), unit vectors across the jaws and of the approach (2048, 3), width (2048,) m before its
        clipping at 0, logit of success (2048,).
        """
        xyz, features = points, points[:, :0]
        levels: list[tuple[Tensor, Tensor]] = []
        for stage, count, radii in zip(self.set_abstract_msg, CENTRES, RADII, strict=True):
            flat = xyz.numpy()[None]
            chosen = farthest_points(flat, count, -1.0)[0]
            centres = flat[:, chosen]
            scales = []
            for scale, radius in zip(stage, radii, strict=True):  # type: ignore[call-overload]
                near = neighbours_in_ball(flat, centres, radius, NEIGHBOURS)[0]
                near = torch.from_numpy(np.concatenate([near, np.arange(count)[:, None]], axis=1))
                offsets = xyz[near] - torch.from_numpy(centres[0])[:, None]
                local = torch.cat([features[near], offsets], 2)
                rows = scale["conv"]["local_nn"](local.reshape(-1, local.shape[2]))
                scales.append(rows.reshape(*near.shape, -1).amax(1))
            xyz, features = torch.from_numpy(centres[0]), torch.cat(scales, 1)
            levels.append((xyz, features))
        for step, (finer, skip) in zip(self.feat_prop, reversed(levels), strict=True):
            features = step["nn"](torch.cat([_carried_over(features, xyz, finer), skip], 1))  # type: ignore[index]
            xyz = finer
        whole = torch.cat([xyz, features], 1).T[None]
        score, across, approach, width = (head(whole)[0].T for head in self.multihead)
        across = functional.normalize(across, dim=1)
        approach = functional.normalize(
            approach - (across * approach).sum(1, keepdim=True) * across, dim=1
        )
        return xyz, across, approach, width[:, 0].clamp(-2 * WIDEST, WIDEST), score[:, 0]

    def grasps(self, cloud: Array) -> JawGrasps:
        """Grasps of a scene's points (n, 3) m, n >= 2048, its frame's z up."""
        mean = cloud.mean(axis=0)
        points = torch.from_numpy((cloud - mean).astype(np.float32))
        at, across, approach, width, logit = (v.double().numpy() for v in self(points))
        T = np.tile(np.eye(4), (len(at), 1, 1))
        T[:, :3, 0], T[:, :3, 1], T[:, :3, 2] = across, np.cross(approach, across), approach
        T[:, :3, 3] = at + width[:, None] / 2 * across + mean
        return JawGrasps(T, np.maximum(width, 0.0), expit(logit))


def _carried_over(features: Tensor, coarse: Tensor, fine: Tensor) -> Tensor:
    """Features (c, w) of points coarse (c, 3) at points fine (f, 3): mean of the nearest three by inverse square distance."""
    near = np.asarray(KDTree(coarse.numpy()).query(fine.numpy(), INTERPOLATED)[1], dtype=np.int64)
    index = torch.from_numpy(near)
    weights = 1 / ((coarse[index] - fine[:, None]) ** 2).sum(2, keepdim=True).clamp(min=1e-16)
    return (features[index] * weights).sum(1) / weights.sum(1)


def load_contact_graspnet(path: Path | None = None) -> ContactGraspNet:
    """Weights of a file, or of the `cgn-pytorch` that the user installed. UsageError where there is none, or they don't fit."""
    if path is None:
        found = importlib.util.find_spec("cgn_pytorch")
        if found is None or not found.submodule_search_locations:
            raise UsageError(
                "Contact-GraspNet is asked for seeds and is not installed",
                hint="pip install --no-deps cgn-pytorch (only its weights are read; mind their licence), or name a checkpoint",
            )
        path = Path(found.submodule_search_locations[0]) / "checkpoints" / "current.pth"
    network = ContactGraspNet()
    load_strictly(network, read_weights(path, "state_dict"), str(path))
    return network
