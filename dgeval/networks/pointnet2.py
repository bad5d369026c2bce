"""Grasp evaluators of 6-DoF GraspNet's type: PointNet++ on points of the scene and of the gripper.

A label per point tells scene from gripper. Layers have the names of the public PyTorch 6-DoF
GraspNet (docs/papers.md, "Grasp evaluator"), whose checkpoints load. VFAS-Grasp's evaluator is the
same network with other sizes and the opposite labels.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.nn import functional

from dgeval.networks.checkpoints import load_strictly, metadata_of, read_weights
from dgeval.networks.point_sets import farthest_points, gathered, neighbours_in_ball

# m, corners of the box that the scene is cropped to, in the grasp frame (docs/papers.md, "Grasp
# evaluator")
CROP_LOW = np.array([-0.10, -0.05, -0.10])
CROP_HIGH = np.array([0.10, 0.05, 0.03])


@dataclass(frozen=True)
class Sizes:
    """Settings of an evaluator that the shapes of its weights don't show.

    - scale: factor on the public layer widths.
    - centres, neighbours, radii (m): of the first two set abstractions.
    - labels: of scene and gripper points; "jsll" 1 and 0 (the public weights), "vfas" 0 and 1.
    - centre: points are given in the grasp's frame ("grasp"), or from the scene's mean ("mean").
    - skipped: points with |p|^2 up to this, m^2, are never chosen as centres.
    - scene, gripper: number of points of each.
    """

    scale: float = 1.0
    centres: tuple[int, int] = (128, 32)
    neighbours: tuple[int, int] = (64, 128)
    radii: tuple[float, float] = (0.02, 0.04)
    labels: Literal["jsll", "vfas"] = "jsll"
    centre: Literal["grasp", "mean"] = "mean"
    skipped: float = 1e-3
    scene: int = 1024
    gripper: int = 6


PUBLIC = Sizes()  # of the public weights (docs/papers.md, "Grasp evaluator")
# of the shipped evaluator; the VFAS paper does not give these numbers (docs/papers.md, "Grasp
# evaluator")
VFAS = Sizes(0.5, (64, 16), (24, 24), (0.025, 0.05), "vfas", "grasp", -1.0, 512, 64)


class SetAbstraction(nn.Module):
    """PointNet++'s set abstraction: features of neighbourhoods from features of points.

    Gathers the points round each centre, applies a small network to each of them, and takes the
    largest value of each channel. The layers are 1x1 convolutions without bias.
    """

    def __init__(self, inputs: int, widths: tuple[int, int, int]) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for a, b in zip((inputs, *widths), widths, strict=False):
            layers += [nn.Conv2d(a, b, 1, bias=False), nn.BatchNorm2d(b), nn.ReLU(inplace=True)]
        self.mlps = nn.ModuleList([nn.Sequential(*layers)])

    def _layer(self, k: int) -> tuple[Tensor, Tensor | None, nn.BatchNorm2d]:
        """Weight, bias and batch norm of layer k.

        In eval mode the norm is a factor and an offset, already included in weight and bias.
        """
        conv, norm = self.mlps[0][3 * k], self.mlps[0][3 * k + 1]  # type: ignore[index]
        weight = conv.weight[:, :, 0, 0]
        if self.training:
            return weight, None, norm
        factor = norm.weight / torch.sqrt(norm.running_var + norm.eps)
        return weight * factor[:, None], norm.bias - norm.running_mean * factor, norm

    def forward(
        self,
        xyz: Tensor,
        features: Tensor | None,
        neighbours: Tensor | None,
        centres: Tensor | None,
    ) -> Tensor:
        """Features (b, m, width) of m neighbourhoods.

        xyz (b, n, 3) m and features (b, n, c) of points; neighbours (b, m, k), indices of points,
        of centres (b, m, 3). If neighbours and centres are None, all points form one neighbourhood
        without a centre. The first layer is linear, so it is applied once to each point and once to
        each centre, not to each pair.
        """
        inputs = xyz if features is None else torch.cat([xyz, features], 2)
        weight, bias, norm = self._layer(0)
        x = functional.linear(inputs, weight, bias)
        if neighbours is None or centres is None:
            x = x[:, None]
        elif not self.training:
            # as in training, but in one pass over the memory, which includes the ReLU
            offsets = functional.linear(centres, weight[:, :3])
            x = torch.from_numpy(
                gathered(x.detach().numpy(), offsets.detach().numpy(), neighbours.numpy())
            )
        else:
            b, m, k = neighbours.shape
            flat = (neighbours + torch.arange(b)[:, None, None] * xyz.shape[1]).reshape(-1)
            x = x.reshape(-1, x.shape[2]).index_select(0, flat).reshape(b, m, k, -1)
            x = x - functional.linear(centres, weight[:, :3])[:, :, None]
        shape = x.shape
        x = x.reshape(-1, shape[3])
        for layer in range(3):
            if layer:
                weight, bias, norm = self._layer(layer)
                x = functional.linear(functional.relu(x, inplace=True), weight, bias)
            if self.training:
                x = _normalised(norm, x)
        return functional.relu(x.reshape(*shape[:3], -1).amax(2))


def _normalised(norm: nn.BatchNorm2d, x: Tensor) -> Tensor:
    """Apply a 2D batch norm to x (rows, channels), with statistics over all rows of a channel."""
    if norm.training and norm.num_batches_tracked is not None:
        norm.num_batches_tracked.add_(1)
    momentum = norm.momentum or 0.1
    return functional.batch_norm(
        x,
        norm.running_mean,
        norm.running_var,
        norm.weight,
        norm.bias,
        norm.training,
        momentum,
        norm.eps,
    )


class GraspEvaluator(nn.Module):
    """Predicts success and confidence of grasps from scene and gripper points."""

    def __init__(self, sizes: Sizes = PUBLIC) -> None:
        super().__init__()
        self.sizes = sizes
        w = [int(n * sizes.scale) for n in (64, 128, 256, 512, 1024)]
        stages = [
            SetAbstraction(3 + 4, (w[0], w[0], w[1])),
            SetAbstraction(3 + w[1], (w[1], w[1], w[2])),
            SetAbstraction(3 + w[2], (w[2], w[2], w[3])),
        ]
        dense = [nn.Linear(w[3], w[4]), nn.BatchNorm1d(w[4]), nn.ReLU(True)]
        dense += [nn.Linear(w[4], w[4]), nn.BatchNorm1d(w[4]), nn.ReLU(True)]
        self.evaluator = nn.ModuleList([nn.ModuleList(stages), nn.Sequential(*dense)])
        self.predictions_logits = nn.Linear(w[4], 1)
        self.confidence = nn.Linear(w[4], 1)

    def forward(self, scene: Tensor, gripper: Tensor) -> tuple[Tensor, Tensor]:
        """Logits of success (b, 1) and confidence (b, 1), 0 to 1.

        scene (b, n, 3) and gripper (b, m, 3): points in one frame, m.
        """
        s = self.sizes
        xyz = torch.cat([scene, gripper], 1)
        of_scene, of_gripper = (1.0, 0.0) if s.labels == "jsll" else (0.0, 1.0)
        label = torch.cat(
            [
                torch.full_like(scene[:, :, :1], of_scene),
                torch.full_like(gripper[:, :, :1], of_gripper),
            ],
            1,
        )
        features = torch.cat([xyz, label], 2)
        stages: Any = self.evaluator[0]
        for stage, count, most, radius in zip(
            stages[:2], s.centres, s.neighbours, s.radii, strict=True
        ):
            points = xyz.detach().numpy()
            chosen = farthest_points(points, count, s.skipped)
            centre_points = np.take_along_axis(points, chosen[:, :, None], 1)
            neighbours = torch.from_numpy(neighbours_in_ball(points, centre_points, radius, most))
            centres = torch.from_numpy(centre_points)
            features = stage(xyz, features, neighbours, centres)
            xyz = centres
        pooled = stages[2](xyz, features, None, None)[:, 0]
        dense = self.evaluator[1](pooled)
        return self.predictions_logits(dense), torch.sigmoid(self.confidence(dense))

    @torch.no_grad()
    def success(self, scene: Tensor, gripper: Tensor, batch: int = 16) -> Tensor:
        """Probability (b,) that each grasp holds.

        scene (b, n, 3) and gripper (b or 1, m, 3), m. batch: grasps computed at a time.
        """
        out = []
        for k in range(0, len(scene), batch):
            part = scene[k : k + batch]
            tool = (
                gripper.expand(len(part), -1, -1) if len(gripper) == 1 else gripper[k : k + batch]
            )
            out.append(torch.sigmoid(self(part, tool)[0][:, 0]))
        return torch.cat(out)


def save_evaluator(network: GraspEvaluator, path: Path) -> None:
    """Write a safetensors file: matrices in half precision, `sizes` in the metadata."""
    state = {
        k: (v.half() if v.ndim > 1 else v).contiguous() for k, v in network.state_dict().items()
    }
    save_file(state, path, {"sizes": json.dumps(asdict(network.sizes))})


def load_evaluator(path: Path) -> GraspEvaluator:
    """An evaluator from a file of `save_evaluator`, or from 6-DoF GraspNet's `latest_net.pth`.

    Raises UsageError if the weights can't be read or don't fit.
    """
    weights = read_weights(path, "model_state_dict")
    stored = json.loads(metadata_of(path).get("sizes", "{}"))
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in stored.items()}
    network = GraspEvaluator(replace(PUBLIC, **values))
    load_strictly(network, weights, str(path))
    return network
