"""TransT and TransT-M: where in a search image the target of a template image is.

Chen et al., "Transformer Tracking", CVPR 2021, and TransT-M, which won VOT2021's real-time part:
several templates, a predicted overlap of each box, and a mask. Their weights are not shipped.
Layers have the names of the authors' checkpoints (docs/papers.md, "TransT and TransT-M").
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from dgeval.errors import Place, UsageError
from dgeval.networks.checkpoints import load_strictly, read_weights
from dgeval.networks.images import sine_positions

CHANNELS = 256  # of a token
HEADS = 8
FEED_FORWARD = 2048
STRIDE = 8  # px of a crop per token
TEMPLATE_PX, SEARCH_PX = 128, 256  # side of the crops
MASK_TOKEN = 119  # of the first template, near its middle, asks for the second set of mask maps


@dataclass(frozen=True)
class Prediction:
    """What the network says of each of n search tokens, row by row.

    logits (n, 2): of target and of background. boxes (n, 4): centre x, centre y, width and height
    as shares of the search crop. iou (n,): predicted overlap of the box with the target; None of
    weights without that part. mask (256, 256): probability that a pixel of the crop is the
    target's; None of weights without that part.
    """

    logits: Tensor
    boxes: Tensor
    iou: Tensor | None = None
    mask: Tensor | None = None


@dataclass(frozen=True)
class Template:
    """A template crop's tokens (n, 1, 256) with the code of their positions, of the same shape."""

    tokens: Tensor
    positions: Tensor


@dataclass(frozen=True)
class _Look:
    """The backbone's features of the crop, its decoded tokens and the templates' encoded ones.

    features: at 1/2, 1/4, 1/8 and 1/8. decoded (n, 256), shown (m, 256).
    """

    features: tuple[Tensor, ...]
    decoded: Tensor
    shown: Tensor


class _Bottleneck(nn.Module):
    """Of ResNet-50: 1x1, 3x3, 1x1 convolutions; the stride is on the 3x3 one."""

    def __init__(self, inputs: int, width: int, stride: int, dilation: int, aside: bool) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, width, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, stride, dilation, dilation, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, 4 * width, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(4 * width)
        self.downsample = (
            nn.Sequential(
                nn.Conv2d(inputs, 4 * width, 1, stride, bias=False), nn.BatchNorm2d(4 * width)
            )
            if aside
            else None
        )

    def forward(self, x: Tensor) -> Tensor:
        y = torch.relu(self.bn1(self.conv1(x)))
        y = torch.relu(self.bn2(self.conv2(y)))
        y = self.bn3(self.conv3(y))
        return torch.relu(y + (x if self.downsample is None else self.downsample(x)))


def _layer(inputs: int, width: int, count: int, stride: int, dilation: int) -> nn.Sequential:
    """`count` bottlenecks; stride and dilation are the first one's only."""
    first = _Bottleneck(inputs, width, stride, dilation, aside=True)
    rest = (_Bottleneck(4 * width, width, 1, 1, aside=False) for _ in range(count - 1))
    return nn.Sequential(first, *rest)


class _ResNet(nn.Module):
    """ResNet-50 to its third layer, which has no stride here, but a dilation in its first block."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.layer1 = _layer(64, 64, 3, 1, 1)
        self.layer2 = _layer(256, 128, 4, 2, 1)
        self.layer3 = _layer(512, 256, 6, 1, 2)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Features at 1/2, 1/4, 1/8 and 1/8 of the image's size: 64, 256, 512, 1024 channels."""
        first = torch.relu(self.bn1(self.conv1(image)))
        one = self.layer1(functional.max_pool2d(first, 3, 2, 1))
        two = self.layer2(one)
        return first, one, two, self.layer3(two)


class _Layers(nn.Module):
    """Linear layers with ReLU between them."""

    def __init__(self, *sizes: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))

    def forward(self, x: Tensor) -> Tensor:
        for k, layer in enumerate(self.layers):
            x = layer(torch.relu(x) if k else x)
        return x


def _attention() -> nn.MultiheadAttention:
    return nn.MultiheadAttention(CHANNELS, HEADS)


def _seen(attention: nn.Module, query: Tensor, key: Tensor, value: Tensor) -> Tensor:
    out: Tensor = attention(query, key, value, need_weights=False)[0]
    return out


class _Fusion(nn.Module):
    """One layer: each branch looks at itself, then both look at each other (ECA and CFA).

    Branch 1 is the template's, branch 2 the search image's.
    """

    def __init__(self) -> None:
        super().__init__()
        for branch in (1, 2):
            setattr(self, f"self_attn{branch}", _attention())
            setattr(self, f"multihead_attn{branch}", _attention())
            setattr(self, f"linear{branch}1", nn.Linear(CHANNELS, FEED_FORWARD))
            setattr(self, f"linear{branch}2", nn.Linear(FEED_FORWARD, CHANNELS))
            for k in (1, 2, 3):
                setattr(self, f"norm{branch}{k}", nn.LayerNorm(CHANNELS))

    def itself(self, branch: int, x: Tensor, place: Tensor) -> Tensor:
        """A branch's tokens with what they see of each other."""
        q = x + place
        out: Tensor = self._part("norm", branch, 1)(
            x + _seen(self._part("self_attn", branch), q, q, x)
        )
        return out

    def other(self, branch: int, x: Tensor, place: Tensor, y: Tensor, y_place: Tensor) -> Tensor:
        """A branch's tokens x with what they see of the other branch's, y."""
        seen = _seen(self._part("multihead_attn", branch), x + place, y + y_place, y)
        x = self._part("norm", branch, 2)(x + seen)
        wide = torch.relu(self._part("linear", branch, 1)(x))
        out: Tensor = self._part("norm", branch, 3)(x + self._part("linear", branch, 2)(wide))
        return out

    def _part(self, name: str, branch: int, k: int | str = "") -> nn.Module:
        return self.get_submodule(f"{name}{branch}{k}")


class _Encoder(nn.Module):
    def __init__(self, layers: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList(_Fusion() for _ in range(layers))


class _DecoderLayer(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.multihead_attn = _attention()
        self.linear1 = nn.Linear(CHANNELS, FEED_FORWARD)
        self.linear2 = nn.Linear(FEED_FORWARD, CHANNELS)
        self.norm1 = nn.LayerNorm(CHANNELS)
        self.norm2 = nn.LayerNorm(CHANNELS)


class _Decoder(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.ModuleList([_DecoderLayer()])
        self.norm = nn.LayerNorm(CHANNELS)

    def forward(self, x: Tensor, place: Tensor, y: Tensor, y_place: Tensor) -> Tensor:
        """Search tokens x with what they see of the template's, y."""
        for layer in self.layers:
            x = layer.norm1(x + _seen(layer.multihead_attn, x + place, y + y_place, y))  # type: ignore[operator,arg-type]
            x = layer.norm2(x + layer.linear2(torch.relu(layer.linear1(x))))  # type: ignore[operator]
        out: Tensor = self.norm(x)
        return out


class _FeatureFusion(nn.Module):
    def __init__(self, layers: int) -> None:
        super().__init__()
        self.encoder = _Encoder(layers)
        self.decoder = _Decoder()


class _MaskMaps(nn.Module):
    """Eight maps (8, h, w) of where a query token looks; together they sum to 1."""

    def __init__(self) -> None:
        super().__init__()
        self.q_linear = nn.Linear(CHANNELS, CHANNELS)
        self.k_linear = nn.Linear(CHANNELS, CHANNELS)

    def forward(self, query: Tensor, memory: Tensor) -> Tensor:
        """query (256,); memory (256, h, w)."""
        _, h, w = memory.shape
        q = self.q_linear(query).reshape(HEADS, -1)
        k = self.k_linear(memory.flatten(1).T).reshape(h * w, HEADS, -1)
        logits = torch.einsum("nc,pnc->np", q * (CHANNELS / HEADS) ** -0.5, k)
        return logits.flatten().softmax(0).reshape(HEADS, h, w)


class _MaskHead(nn.Module):
    """From maps at 1/8 to a mask at 1/2, with the backbone's finer features on the way."""

    def __init__(self) -> None:
        super().__init__()
        widths = (CHANNELS + 2 * HEADS, 128, 64, 32, 16, 8)
        sizes = ((widths[0], widths[0]), *pairwise(widths))
        for k, (a, b) in enumerate(sizes, 1):
            setattr(self, f"lay{k}", nn.Conv2d(a, b, 3, padding=1))
            setattr(self, f"gn{k}", nn.GroupNorm(8, b))
        self.out_lay = nn.Conv2d(8, 1, 3, padding=1)
        for k, (a, b) in enumerate(((1024, 128), (512, 64), (256, 32), (64, 16)), 1):
            setattr(self, f"adapter{k}", nn.Conv2d(a, b, 1))

    def forward(self, x: Tensor, features: tuple[Tensor, ...]) -> Tensor:
        """x (1, 272, h, w); features of the backbone, the coarsest first. Logits (1, 1, 4h, 4w)."""
        for k in range(1, 7):
            x = self.get_submodule(f"lay{k}")(x)
            x = torch.relu(self.get_submodule(f"gn{k}")(x))
            if 2 <= k <= 5:  # what the backbone saw at this size is added
                aside = self.get_submodule(f"adapter{k - 1}")(features[k - 2])
                x = functional.interpolate(x, size=aside.shape[2:], mode="nearest") + aside
        out: Tensor = self.out_lay(x)
        return out


class TransT(nn.Module):
    """The network with one template. layers: of the fusion, 4 or 2 (TransT-N2)."""

    def __init__(self, layers: int = 4) -> None:
        super().__init__()
        self.backbone = nn.Sequential(nn.ModuleDict({"body": _ResNet()}))
        self.input_proj = nn.Conv2d(1024, CHANNELS, 1)
        self.featurefusion_network = _FeatureFusion(layers)
        self.class_embed = _Layers(CHANNELS, CHANNELS, CHANNELS, 2)
        self.bbox_embed = _Layers(CHANNELS, CHANNELS, CHANNELS, 4)

    @torch.no_grad()
    def template(self, crop: Tensor) -> Template:
        """What is kept of a template crop (1, 3, 128, 128), as `normalised` gives it."""
        return self._tokens(self._seen_by_backbone(crop)[3])

    @torch.no_grad()
    def forward(self, crop: Tensor, templates: tuple[Template, ...]) -> Prediction:
        """Where in a search crop (1, 3, 256, 256) the target of the templates is."""
        decoded = self._looked(crop, templates).decoded
        return Prediction(self.class_embed(decoded), torch.sigmoid(self.bbox_embed(decoded)))

    def _looked(self, crop: Tensor, templates: tuple[Template, ...]) -> _Look:
        features = self._seen_by_backbone(crop)
        return _Look(features, *self._fused(self._tokens(features[3]), templates))

    def _seen_by_backbone(self, crop: Tensor) -> tuple[Tensor, ...]:
        features: tuple[Tensor, ...] = self.backbone.get_submodule("0.body")(crop)
        return features

    def _tokens(self, feature: Tensor) -> Template:
        h, w = feature.shape[2:]
        tokens = self.input_proj(feature).flatten(2).permute(2, 0, 1)
        return Template(tokens, sine_positions(h, w, CHANNELS).flatten(2).permute(2, 0, 1))

    def _fused(self, search: Template, templates: tuple[Template, ...]) -> tuple[Tensor, Tensor]:
        """Decoded search tokens (n, 256) and encoded template tokens (m, 256)."""
        y, y_place = search.tokens, search.positions
        x = torch.cat([t.tokens for t in templates])
        x_place = torch.cat([t.positions for t in templates])
        for layer in self.featurefusion_network.encoder.layers:
            x, y = layer.itself(1, x, x_place), layer.itself(2, y, y_place)  # type: ignore[operator]
            x, y = layer.other(1, x, x_place, y, y_place), layer.other(2, y, y_place, x, x_place)  # type: ignore[operator]
        return self.featurefusion_network.decoder(y, y_place, x, x_place)[:, 0], x[:, 0]


class TransTM(TransT):
    """The network with several templates, a predicted overlap and, if `has_mask`, a mask."""

    def __init__(self, layers: int = 4, has_mask: bool = True) -> None:
        super().__init__(layers)
        self.iou_embed = _Layers(CHANNELS + 4, CHANNELS, CHANNELS, 1)
        self.has_mask = has_mask
        if has_mask:
            self.bbox_attention_self = _MaskMaps()
            self.bbox_attention_cross = _MaskMaps()
            self.mask_head = _MaskHead()

    @torch.no_grad()
    def forward(self, crop: Tensor, templates: tuple[Template, ...]) -> Prediction:
        """Where in a search crop (1, 3, 256, 256) the target of the templates is."""
        look = self._looked(crop, templates)
        logits = self.class_embed(look.decoded)
        boxes = torch.sigmoid(self.bbox_embed(look.decoded))
        iou = torch.sigmoid(self.iou_embed(torch.cat([look.decoded, boxes], 1)))[:, 0]
        return Prediction(logits, boxes, iou, self._mask(look, logits) if self.has_mask else None)

    def _mask(self, look: _Look, logits: Tensor) -> Tensor:
        """Probability (256, 256), asked for by the token that is the target's most surely."""
        h, w = look.features[3].shape[2:]
        memory = look.decoded.T.reshape(CHANNELS, h, w)
        best = int(logits.softmax(1)[:, 0].argmax())
        maps = [
            self.bbox_attention_self(look.decoded[best], memory),
            self.bbox_attention_cross(look.shown[MASK_TOKEN], memory),
        ]
        at_half = self.mask_head(torch.cat([memory, *maps])[None], look.features[::-1])
        large = functional.interpolate(at_half, scale_factor=2, mode="bilinear")
        return torch.sigmoid(large)[0, 0]


def load_transt(path: Path) -> TransT:
    """TransT or TransT-M with a file's weights: the parts and layers that the file has.

    Raises UsageError if the file can't be read or doesn't fit.
    """
    weights = read_weights(path, "net")
    prefix = "featurefusion_network.encoder.layers."
    layers = {
        name.removeprefix(prefix).split(".")[0] for name in weights if name.startswith(prefix)
    }
    if not layers:
        raise UsageError("no weights of TransT: no layer of a fusion is in them", Place(str(path)))
    has_iou, has_mask = (
        any(name.startswith(part) for name in weights) for part in ("iou_embed.", "mask_head.")
    )
    network = TransTM(len(layers), has_mask) if has_iou or has_mask else TransT(len(layers))
    load_strictly(network, weights, str(path))
    return network
