"""What networks on images share: ImageNet's normalisation, and the code of a cell's position."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

# mean and standard deviation of ImageNet's RGB, of 1
MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)
TEMPERATURE = 10_000.0  # of the sine code


def normalised(image: NDArray[np.uint8]) -> Tensor:
    """An RGB image (h, w, 3) as ImageNet's networks take it: (1, 3, h, w) float32."""
    pixels = torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1)[None].float() / 255
    return (pixels - torch.tensor(MEAN)[:, None, None]) / torch.tensor(STD)[:, None, None]


def sine_positions(h: int, w: int, channels: int) -> Tensor:
    """Sine code (1, channels, h, w) of the cells of an image: half for y, half for x.

    As in DETR (Carion et al., ECCV 2020), normalised: the first cell is 1 / n and the last 1, of
    2 pi.
    """
    half = channels // 2
    period = TEMPERATURE ** (2 * (torch.arange(half) // 2) / half)
    codes = []
    for n in (h, w):
        place = torch.arange(1, n + 1, dtype=torch.float32) / (n + 1e-6) * (2 * math.pi)
        angle = place[:, None] / period
        codes.append(torch.stack([angle[:, 0::2].sin(), angle[:, 1::2].cos()], 2).flatten(1))
    y = codes[0].T[:, :, None].expand(half, h, w)
    x = codes[1].T[:, None, :].expand(half, h, w)
    return torch.cat([y, x])[None]
