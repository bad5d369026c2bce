"""GMFlow: optical flow by matching the features of two images everywhere against everywhere.

Xu et al., "GMFlow: Learning Optical Flow via Global Matching", CVPR 2022. Its weights are not
shipped. Layers have the names of the authors' checkpoints (docs/papers.md, "GMFlow"). Two kinds of
weights exist: `basic`, which matches once at 1/8 of the image's size, and `refine`, which matches
at 1/8 and then corrects at 1/4 in a small neighbourhood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from dgeval.networks.checkpoints import load_strictly, read_weights
from dgeval.networks.images import normalised, sine_positions

CHANNELS = 128  # of a feature
BLOCKS = 6  # of the transformer
UNREACHABLE = -1e9  # logit of a match that lies outside the image
SEPARATE = -100.0  # added to logits between parts that the window's shift has put together


@dataclass(frozen=True)
class Level:
    """How one scale is matched: windows per side, search radius and propagation radius in cells.

    A radius of None means everywhere.
    """

    windows: int
    search: int | None
    propagation: int | None


BASIC = (Level(2, None, None),)
REFINE = (Level(2, None, None), Level(8, 4, 1))


class _Residual(nn.Module):
    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.downsample = (
            None
            if stride == 1 and inputs == outputs
            else nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride))
        )

    def forward(self, x: Tensor) -> Tensor:
        y = _rectified(self.conv2(_rectified(self.conv1(x))))
        aside = x if self.downsample is None else functional.instance_norm(self.downsample(x))
        return torch.relu(aside + y)


def _rectified(x: Tensor) -> Tensor:
    """Instance normalisation without parameters, then ReLU."""
    return torch.relu(functional.instance_norm(x))


class _Backbone(nn.Module):
    """Image to features at 1/8, or at 1/8 and 1/4."""

    def __init__(self, scales: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, 2, 3, bias=False)
        self.layer1 = nn.Sequential(_Residual(64, 64, 1), _Residual(64, 64, 1))
        self.layer2 = nn.Sequential(_Residual(64, 96, 2), _Residual(96, 96, 1))
        last = 2 if scales == 1 else 1
        self.layer3 = nn.Sequential(_Residual(96, CHANNELS, last), _Residual(CHANNELS, CHANNELS, 1))
        self.conv2 = nn.Conv2d(CHANNELS, CHANNELS, 1)
        self.trident_conv = (
            None if scales == 1 else nn.Conv2d(CHANNELS, CHANNELS, 3, padding=1, bias=False)
        )

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Features of a normalised image (1, 3, h, w), the coarsest first."""
        x = self.layer3(self.layer2(self.layer1(_rectified(self.conv1(image)))))
        x = self.conv2(x)
        if self.trident_conv is None:
            return (x,)
        weight = self.trident_conv.weight  # one kernel with two strides
        return tuple(functional.conv2d(x, weight, stride=s, padding=1) for s in (2, 1))


class _Attention(nn.Module):
    """One attention between windows, added to its source; with a feed-forward part or without."""

    def __init__(self, feeds_forward: bool) -> None:
        super().__init__()
        self.q_proj = nn.Linear(CHANNELS, CHANNELS, bias=False)
        self.k_proj = nn.Linear(CHANNELS, CHANNELS, bias=False)
        self.v_proj = nn.Linear(CHANNELS, CHANNELS, bias=False)
        self.merge = nn.Linear(CHANNELS, CHANNELS, bias=False)
        self.norm1 = nn.LayerNorm(CHANNELS)
        if feeds_forward:
            self.mlp: nn.Sequential | None = nn.Sequential(
                nn.Linear(2 * CHANNELS, 8 * CHANNELS, bias=False),
                nn.GELU(),
                nn.Linear(8 * CHANNELS, CHANNELS, bias=False),
            )
            self.norm2 = nn.LayerNorm(CHANNELS)
        else:
            self.mlp = None

    def forward(self, source: Tensor, target: Tensor, windows: int, mask: Tensor | None) -> Tensor:
        """source, target (n, h, w, c). mask: of shifted windows, (windows ** 2, cells, cells)."""
        q, k, v = self.q_proj(source), self.k_proj(target), self.v_proj(target)
        n, h, w, _ = source.shape
        shift = (0, 0) if mask is None else (h // windows // 2, w // windows // 2)
        q, k, v = (
            _split(torch.roll(x, (-shift[0], -shift[1]), (1, 2)), windows).flatten(1, 2)
            for x in (q, k, v)
        )
        if mask is not None:
            mask = mask.repeat(n, 1, 1)
        seen = functional.scaled_dot_product_attention(q, k, v, mask)
        seen = _joined(seen.reshape(len(q), h // windows, w // windows, -1), windows)
        message = self.norm1(self.merge(torch.roll(seen, shift, (1, 2))))
        if self.mlp is not None:
            message = self.norm2(self.mlp(torch.cat([source, message], -1)))
        out: Tensor = source + message
        return out


class _Block(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.self_attn = _Attention(False)
        self.cross_attn_ffn = _Attention(True)

    def forward(self, source: Tensor, target: Tensor, windows: int, mask: Tensor | None) -> Tensor:
        source = self.self_attn(source, source, windows, mask)
        out: Tensor = self.cross_attn_ffn(source, target, windows, mask)
        return out


class _Transformer(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.ModuleList(_Block() for _ in range(BLOCKS))

    def forward(self, first: Tensor, second: Tensor, windows: int) -> tuple[Tensor, Tensor]:
        """Features (1, c, h, w) of both images, each with what it has seen of the other."""
        h, w = first.shape[2:]
        place = sine_positions(h // windows, w // windows, CHANNELS).repeat(1, 1, windows, windows)
        both = (torch.cat([first, second]) + place).permute(0, 2, 3, 1)
        mask = _shift_mask(h, w, windows) if windows > 1 else None
        for k, layer in enumerate(self.layers):
            both = layer(both, both.flip(0), windows, mask if k % 2 else None)
        both = both.permute(0, 3, 1, 2)
        return both[:1], both[1:]


class _Propagation(nn.Module):
    """Flow carried to where it could not be matched, from cells that look alike."""

    def __init__(self) -> None:
        super().__init__()
        self.q_proj = nn.Linear(CHANNELS, CHANNELS)
        self.k_proj = nn.Linear(CHANNELS, CHANNELS)

    def forward(self, feature: Tensor, flow: Tensor, radius: int | None) -> Tensor:
        """feature (1, c, h, w), flow (1, 2, h, w). Everywhere the key is projected from the query.

        That is a slip of the original which its weights were trained with; within a radius the key
        is projected from the feature.
        """
        h, w = feature.shape[2:]
        cells = feature[0].flatten(1).T
        query = self.q_proj(cells)
        if radius is None:
            seen = functional.scaled_dot_product_attention(
                query[None], self.k_proj(query)[None], flow[0].flatten(1).T[None]
            )[0]
            return seen.T.reshape(1, 2, h, w)
        size = 2 * radius + 1
        key = self.k_proj(cells).T.reshape(1, CHANNELS, h, w)
        keys = functional.unfold(key, size, padding=radius).reshape(CHANNELS, size**2, h * w)
        values = functional.unfold(flow, size, padding=radius).reshape(2, size**2, h * w)
        logits = torch.einsum("pc,ckp->kp", query, keys) / math.sqrt(CHANNELS)
        return (values * logits.softmax(0)).sum(1).reshape(1, 2, h, w)


class GMFlow(nn.Module):
    """The network: from two images to the displacement of the first one's pixels."""

    def __init__(self, refine: bool = False) -> None:
        super().__init__()
        self.levels = REFINE if refine else BASIC
        self.upsampling = 4 if refine else 8  # px per cell of the finest features
        self.backbone = _Backbone(len(self.levels))
        self.transformer = _Transformer()
        self.feature_flow_attn = _Propagation()
        self.upsampler = nn.Sequential(
            nn.Conv2d(2 + CHANNELS, 256, 3, 1, 1),
            nn.ReLU(),
            nn.Conv2d(256, 9 * self.upsampling**2, 1),
        )

    @property
    def multiple(self) -> int:
        """An image's height and width, px, are filled up to multiples of this."""
        return 32 if len(self.levels) > 1 else 16

    @torch.no_grad()
    def features(self, image: NDArray[np.uint8]) -> tuple[Tensor, ...]:
        """Features of an RGB image (h, w, 3); those of a frame serve for both of its pairs."""
        h, w = image.shape[:2]
        features: tuple[Tensor, ...] = self.backbone(
            functional.pad(normalised(image), _border(h, w, self.multiple), mode="replicate")
        )
        return features

    @torch.no_grad()
    def match(
        self, first: tuple[Tensor, ...], second: tuple[Tensor, ...], h: int, w: int
    ) -> NDArray[np.float32]:
        """Displacement (h, w, 2) px, x and y, of every pixel of the first image; h, w of both."""
        flow: Tensor | None = None
        for level, a, b in zip(self.levels, first, second, strict=True):
            if flow is not None:
                flow = 2 * functional.interpolate(
                    flow, scale_factor=2, mode="bilinear", align_corners=True
                )
                b = _sampled(b, _grid(flow) + flow)
            a, b = self.transformer(a, b, level.windows)
            found = _matched(a, b, level.search)
            flow = found if flow is None else flow + found
            flow = self.feature_flow_attn(a, flow, level.propagation)
        assert flow is not None
        large = self._upsampled(flow, a)
        left, _, top, _ = _border(h, w, self.multiple)
        inside = large[0, :, top : top + h, left : left + w].permute(1, 2, 0)
        return np.ascontiguousarray(inside.numpy())

    def forward(self, first: NDArray[np.uint8], second: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Displacement (h, w, 2) px of the first RGB image's pixels; both images (h, w, 3)."""
        return self.match(self.features(first), self.features(second), *first.shape[:2])

    def _upsampled(self, flow: Tensor, feature: Tensor) -> Tensor:
        """Flow of cells (1, 2, h, w) to flow of pixels, each a mean of the 9 cells around it."""
        u, (h, w) = self.upsampling, flow.shape[2:]
        weights = self.upsampler(torch.cat([flow, feature], 1)).reshape(9, u, u, h, w).softmax(0)
        around = functional.unfold(u * flow, 3, padding=1).reshape(2, 9, 1, 1, h, w)
        pixels = (weights * around).sum(1)  # (2, u, u, h, w)
        out: Tensor = pixels.permute(0, 3, 1, 4, 2).reshape(1, 2, u * h, u * w)
        return out


def _border(h: int, w: int, multiple: int) -> tuple[int, int, int, int]:
    """Pixels to add left, right, above and below, so that both sizes become multiples."""
    across, down = -w % multiple, -h % multiple
    return across // 2, across - across // 2, down // 2, down - down // 2


def _split(x: Tensor, windows: int) -> Tensor:
    """(n, h, w, c) to (n * windows ** 2, h / windows, w / windows, c), row by row."""
    n, h, w, c = x.shape
    parts = x.reshape(n, windows, h // windows, windows, w // windows, c)
    return parts.transpose(2, 3).reshape(-1, h // windows, w // windows, c)


def _joined(x: Tensor, windows: int) -> Tensor:
    """Undo `_split`."""
    _, h, w, c = x.shape
    parts = x.reshape(-1, windows, windows, h, w, c)
    return parts.transpose(2, 3).reshape(-1, windows * h, windows * w, c)


def _shift_mask(h: int, w: int, windows: int) -> Tensor:
    """Logits to add (windows ** 2, cells, cells) where half a window's shift joins far parts."""
    part = torch.zeros(h, w)
    for side, size in ((0, h // windows), (1, w // windows)):
        length = (h, w)[side]
        name = torch.zeros(length)
        name[length - size : length - size // 2] = 1
        name[length - size // 2 :] = 2
        part = part + (3 * name[:, None] if side == 0 else name[None])
    cells = _split(part[None, :, :, None], windows).flatten(1)
    return (cells[:, None] != cells[:, :, None]) * SEPARATE


def _grid(like: Tensor) -> Tensor:
    """Cell coordinates (1, 2, h, w), x then y."""
    h, w = like.shape[2:]
    y, x = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
    return torch.stack([x, y])[None].to(like.dtype)


def _sampled(x: Tensor, places: Tensor) -> Tensor:
    """x (1, c, h, w) at places (1, 2, a, b) in cells, bilinear; zero outside."""
    h, w = x.shape[2:]
    scale = torch.tensor([(w - 1) / 2, (h - 1) / 2])
    return functional.grid_sample(
        x, places.permute(0, 2, 3, 1) / scale - 1, padding_mode="zeros", align_corners=True
    )


def _matched(first: Tensor, second: Tensor, radius: int | None) -> Tensor:
    """Expected displacement (1, 2, h, w) in cells, over all cells or those within a radius."""
    _, c, h, w = first.shape
    grid = _grid(first)
    cells = first[0].flatten(1).T
    if radius is None:
        places = grid[0].flatten(1).T
        seen = functional.scaled_dot_product_attention(
            cells[None], second[0].flatten(1).T[None], places[None]
        )[0]
        return (seen - places).T.reshape(1, 2, h, w)
    steps = torch.arange(-radius, radius + 1, dtype=first.dtype)
    dy, dx = torch.meshgrid(steps, steps, indexing="ij")
    offsets = torch.stack([dx.flatten(), dy.flatten()])  # (2, k)
    places = grid[0].flatten(1)[:, :, None] + offsets[:, None]  # (2, h * w, k)
    around = _sampled(second, places[None])[0]  # (c, h * w, k)
    logits = torch.einsum("pc,cpk->pk", cells, around) / math.sqrt(c)
    outside = (places < 0) | (places >= torch.tensor([w, h])[:, None, None])
    logits = logits.masked_fill(outside.any(0), UNREACHABLE)
    expected = (places * logits.softmax(1)).sum(2)
    return expected.reshape(1, 2, h, w) - grid


def load_gmflow(path: Path) -> GMFlow:
    """GMFlow with the weights of a file; `basic` or `refine`, as the file has it.

    Raises UsageError if the file can't be read or doesn't fit.
    """
    weights = read_weights(path, "model")
    network = GMFlow(refine="backbone.trident_conv.weight" in weights)
    load_strictly(network, weights, str(path))
    return network
