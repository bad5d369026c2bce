"""Weights and images that the authors' code and dgeval's are both given, to compare what they say.

The reference outputs in `reference/` are what the authors' code makes of them; see each test.
"""

from __future__ import annotations

import zlib

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

PATCH = (24, 16, 72, 58)  # px, of what moves in `video`, near a corner: crops reach over the border


MAPS = "mask_head.lay1.weight"  # of TransT-M: 256 channels of tokens, then its 16 maps
SIZES = "bbox_embed.layers.2.bias"  # of TransT: centre, then width and height


def filled(network: nn.Module) -> nn.Module:
    """The network with weights that follow from each layer's name and shape alone, ready to use."""
    state = network.state_dict()
    state = {k: _weights(k, tuple(v.shape)).to(v.dtype) for k, v in state.items()}
    if SIZES in state:
        state[SIZES][2:] -= 1.2  # else every box is twice the last one
    if MAPS in state:
        state[MAPS][:, 256:] *= 2000  # else the maps, some 1e-4 a pixel, don't count
    network.load_state_dict(state)
    return network.eval()


def _weights(name: str, shape: tuple[int, ...]) -> torch.Tensor:
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    if name.endswith("num_batches_tracked"):
        values = np.zeros(shape)
    elif name.endswith("running_var"):
        values = rng.uniform(0.5, 1.5, shape)
    elif name.endswith("running_mean"):
        values = 0.1 * rng.standard_normal(shape)
    elif len(shape) == 1 and name.endswith(".weight"):
        values = rng.uniform(0.7, 1.3, shape)
    elif len(shape) == 1:
        values = 0.05 * rng.standard_normal(shape)
    else:
        values = rng.standard_normal(shape) / np.sqrt(np.prod(shape[1:]))
    return torch.from_numpy(np.asarray(values, np.float32))


def picture(seed: int, h: int, w: int) -> NDArray[np.uint8]:
    """A smooth coloured texture (h, w, 3), RGB."""
    rng = np.random.default_rng(seed)
    small = rng.integers(0, 256, (max(2, h // 8), max(2, w // 8), 3)).astype(np.uint8)
    return np.asarray(cv2.resize(small, (w, h), interpolation=cv2.INTER_CUBIC), np.uint8)


def video(frames: int) -> list[NDArray[np.uint8]]:
    """Frames (240, 320, 3), RGB, in which a patch moves over a background; `PATCH` in the first."""
    background, patch = picture(5, 240, 320), picture(6, PATCH[3] - PATCH[1], PATCH[2] - PATCH[0])
    out = []
    for k in range(frames):
        frame = background.copy()
        x, y = PATCH[0] + 7 * k, PATCH[1] + 4 * k
        frame[y : y + patch.shape[0], x : x + patch.shape[1]] = patch
        out.append(frame)
    return out
