"""FFHNet (Mayer et al., ICRA 2022): five-finger grasps from one cloud.

Layers have the authors' names (docs/papers.md, "FFHNet").

Inputs, all float32:
- bps (n, basis points): distances in m from the basis points to a cloud (m) whose mean was
  subtracted, in the camera's axes;
- palm rotation (row-major matrix) and palm translation (m) from the cloud's mean, in the same axes;
- the 15 joint positions before closing (rad), finger by finger from thumb to little: abduction,
  flexion, coupled flexion.

All candidates share the cloud, and the first layers are linear in the parts of their input. So the
cloud's part is multiplied once: every method accepts a bps of one row with n candidates, and
returns what it would return for that row repeated n times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from dgeval.geometry import Array
from dgeval.networks.checkpoints import load_strictly, metadata_of, read_weights

# of the published networks (docs/papers.md, "FFHNet")
N_JOINTS = 15
LATENT = 5  # dimensions of the latent code
SLOPE = 0.2  # of the leaky ReLU below zero


def linear_of_parts(layer: nn.Linear, parts: Sequence[Tensor]) -> Tensor:
    """Apply `layer` to parts, each (n or 1, k), as if concatenated along axis 1: (n, out)."""
    start = 0
    out: Tensor = layer.bias
    for part in parts:
        out = out + functional.linear(part, layer.weight[:, start : start + part.shape[1]])
        start += part.shape[1]
    return out


def normalise_parts(norm: nn.BatchNorm1d, parts: Sequence[Tensor]) -> list[Tensor]:
    """Apply `norm` to parts as if concatenated along axis 1; returns the normalised parts."""
    assert norm.running_mean is not None
    assert norm.running_var is not None
    start, out = 0, []
    for part in parts:
        s = slice(start, start + part.shape[1])
        mean, var, weight, bias = (
            norm.running_mean[s],
            norm.running_var[s],
            norm.weight[s],
            norm.bias[s],
        )
        out.append(
            functional.batch_norm(
                part, mean, var, weight, bias, norm.training, norm.momentum or 0.1, norm.eps
            )
        )
        start = s.stop
    return out


class ResBlock(nn.Module):
    """Residual block: two layers, plus a linear layer with leaky ReLU as the skip connection.

    `hidden` is 256 in the published networks, whatever the output width.
    """

    def __init__(self, inputs: int, outputs: int, hidden: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(inputs, hidden)
        self.bn1 = nn.BatchNorm1d(hidden)
        self.fc2 = nn.Linear(hidden, outputs)
        self.bn2 = nn.BatchNorm1d(outputs)
        self.fc3 = nn.Linear(inputs, outputs)

    def forward(self, parts: Sequence[Tensor]) -> Tensor:
        skip = functional.leaky_relu(linear_of_parts(self.fc3, parts), SLOPE)
        main = functional.leaky_relu(self.bn1(linear_of_parts(self.fc1, parts)), SLOPE)
        return functional.leaky_relu(skip + self.bn2(self.fc2(main)), SLOPE)


def matrix_from_6d(six: Tensor) -> Tensor:
    """Rotation matrices (n, 3, 3) from six numbers each (n, 6), two vectors a and b.

    The columns are x = a / |a|, y = z x x, and z = (x x b) / |x x b|.
    """
    x = functional.normalize(six[:, :3], dim=1, eps=1e-8)
    z = functional.normalize(torch.linalg.cross(x, six[:, 3:]), dim=1, eps=1e-8)
    return torch.stack([x, torch.linalg.cross(z, x), z], dim=2)


@dataclass(frozen=True)
class Palms:
    """Grasp candidates, in the cloud's axes.

    rotation (n, 3, 3); translation (n, 3), m from the cloud's mean; joints (n, 15), rad before
    closing.
    """

    rotation: Tensor
    translation: Tensor
    joints: Tensor


def palms_of(poses: Array, joints: Array) -> Palms:
    """Palms from poses (n, 4, 4), m from the cloud's mean, and joints (n, 15), rad."""
    R, t, q = (a.astype(np.float32) for a in (poses[:, :3, :3], poses[:, :3, 3], joints))
    return Palms(torch.from_numpy(R), torch.from_numpy(t), torch.from_numpy(q))


def poses_of(palms: Palms) -> Array:
    """Poses (n, 4, 4) float64 of palms, m from the cloud's mean."""
    T = np.tile(np.eye(4), (len(palms.joints), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = palms.rotation.double().numpy(), palms.translation.double().numpy()
    return T


class FFHGenerator(nn.Module):
    """Conditional variational autoencoder of grasps.

    The published sizes are the defaults: 4096 basis points, width 512, hidden 256.
    """

    def __init__(self, n_bps: int = 4096, width: int = 512, hidden: int = 256) -> None:
        super().__init__()
        grasp = 9 + 3 + N_JOINTS
        self.enc_bn1 = nn.BatchNorm1d(n_bps + grasp)
        self.enc_rb1 = ResBlock(n_bps + grasp, width, hidden)
        self.enc_rb2 = ResBlock(n_bps + grasp + width, width, hidden)
        self.enc_mu = nn.Linear(width, LATENT)
        self.enc_logvar = nn.Linear(width, LATENT)
        self.dec_bn1 = nn.BatchNorm1d(n_bps)
        self.dec_rb1 = ResBlock(LATENT + n_bps, width, hidden)
        self.dec_rb2 = ResBlock(LATENT + n_bps + width, width, hidden)
        self.dec_joint_conf = nn.Linear(width, N_JOINTS)
        self.dec_rot = nn.Linear(width, 6)
        self.dec_transl = nn.Linear(width, 3)

    def encode(self, bps: Tensor, palms: Palms) -> tuple[Tensor, Tensor]:
        """Mean and log variance of the latent code, each (n, 5)."""
        x = normalise_parts(
            self.enc_bn1, [bps, palms.rotation.flatten(1), palms.translation, palms.joints]
        )
        first = self.enc_rb1(x)
        second = self.enc_rb2([*x, first])
        return self.enc_mu(second), self.enc_logvar(second)

    def decode(self, z: Tensor, bps: Tensor) -> Palms:
        """Grasps from latent codes z (n, 5). The caller applies the joint limits."""
        x = [z, *normalise_parts(self.dec_bn1, [bps])]
        first = self.dec_rb1(x)
        second = self.dec_rb2([*x, first])
        return Palms(
            matrix_from_6d(self.dec_rot(second)),
            self.dec_transl(second),
            self.dec_joint_conf(second),
        )

    @torch.no_grad()
    def generate(self, bps: Tensor, n: int, draws: torch.Generator) -> Palms:
        """n grasps for one cloud, bps (1, basis points), from codes z drawn from N(0, I)."""
        return self.decode(torch.randn(n, LATENT, generator=draws), bps)


class FFHEvaluator(nn.Module):
    """Predicts the probability that a grasp holds.

    The published network does not see the joints; with `joints` they are inputs too (our
    extension). upright: the network was trained on clouds whose z points down, not in the camera's
    axes.
    """

    def __init__(
        self, n_bps: int = 4096, width: int = 512, hidden: int = 256, joints: bool = False
    ) -> None:
        super().__init__()
        inputs = n_bps + 9 + 3 + (N_JOINTS if joints else 0)
        self.joints = joints
        self.upright = False
        self.bn1 = nn.BatchNorm1d(inputs)
        self.rb1 = ResBlock(inputs, width, hidden)
        self.rb2 = ResBlock(inputs + width, width, hidden)
        self.rb3 = ResBlock(inputs + width, width, hidden)
        self.out_success = nn.Linear(width, 1)

    def logits(self, bps: Tensor, palms: Palms, dropout: float = 0.0) -> Tensor:
        """Logits (n,) of success.

        dropout: probability after each block, in training only; the authors trained with 0.3.
        """
        parts = [bps, palms.rotation.flatten(1), palms.translation]
        x = normalise_parts(self.bn1, [*parts, palms.joints] if self.joints else parts)
        out = functional.dropout(self.rb1(x), dropout, self.training)
        for block in (self.rb2, self.rb3):
            out = functional.dropout(block([out, *x]), dropout, self.training)
        logit: Tensor = self.out_success(out)[:, 0]
        return logit

    def forward(self, bps: Tensor, palms: Palms) -> Tensor:
        """Probability of success (n,), 0 to 1."""
        return torch.sigmoid(self.logits(bps, palms))


def load_generator(path: Path) -> FFHGenerator:
    """A generator from the authors' `*_gen_net.pt` or from a safetensors file, of any size.

    Raises UsageError if the weights can't be read or don't fit.
    """
    weights = read_weights(path, "ffhgenerator_state_dict")
    sizes = _sizes(weights, "dec_bn1.weight", "dec_rb1")
    network = FFHGenerator(*sizes) if sizes else FFHGenerator()
    load_strictly(network, weights, str(path))
    return network


def load_evaluator(path: Path) -> FFHEvaluator:
    """An evaluator from the authors' `*_eva_net.pt` or from a safetensors file, of any size.

    It takes joints as inputs if its file says so; where that says nothing, if the file's name
    contains `fingers`. Raises UsageError if the weights can't be read or don't fit.
    """
    weights = read_weights(path, "ffhevaluator_state_dict")
    about = metadata_of(path)
    joints = about["joints"] == "yes" if "joints" in about else "fingers" in path.name
    sizes = _sizes(weights, "bn1.weight", "rb1")
    if sizes:
        sizes = (sizes[0] - 12 - (N_JOINTS if joints else 0), *sizes[1:])
    network = FFHEvaluator(*sizes, joints=joints) if sizes else FFHEvaluator(joints=joints)
    load_strictly(network, weights, str(path))
    network.upright = about.get("axes") == "upright"
    return network


def _sizes(weights: dict[str, Tensor], norm: str, block: str) -> tuple[int, int, int] | None:
    """Number of inputs of a norm, and width and hidden size of a block, from shapes of weights.

    None if a key is missing; `load_strictly` then raises and names it.
    """
    keys = (norm, f"{block}.fc2.weight")
    if any(k not in weights for k in keys) or weights[keys[1]].ndim != 2:
        return None
    return weights[norm].shape[0], *weights[keys[1]].shape
