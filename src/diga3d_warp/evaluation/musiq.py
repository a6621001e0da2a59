"""MUSIQ: quality of a picture without a reference, 0 to 100 (Ke et al. 2021), trained on KonIQ-10k.

A transformer reads patches of the picture at its own size and at two smaller ones. Weights are those of
IQA-PyTorch, whose figures the field reports. Its licence is non-commercial and it requires some 25 packages,
so the network is written here after the paper, with IQA-PyTorch's names for its parameters.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from pathlib import Path

import torch
from torch import nn
from torch.nn.functional import (
    conv2d,
    interpolate,
    max_pool2d,
    pad,
    relu,
    scaled_dot_product_attention,
    unfold,
)

from diga3d_warp.evaluation.weights import WeightsFile, fill, read_tensors

KONIQ = WeightsFile(
    "musiq_koniq_ckpt-e95806b9.pth",
    "https://huggingface.co/chaofengc/IQA-PyTorch-Weights/resolve/main/",
    109,
    cache="pyiqa",
)

PATCH = 32
"""Side of a patch [px]."""

LONGER_SIDES = (224, 384)
"""Longer side of the smaller versions of the picture [px]; the third version is the picture itself."""

GRID = 10
"""Side of the table of positions that a picture's patches are spread over, whatever their number."""

STEM, TOKEN, HIDDEN, HEADS, LAYERS = 64, 384, 1152, 6, 14
"""Channels of the first convolution, width of a token and of a block inside, attention heads, blocks."""


class Musiq:
    """MUSIQ trained on KonIQ-10k."""

    title = "MUSIQ"

    def __init__(self, weights: Path | None = None, device: str = "cpu") -> None:
        """Load the network.

        Args:
            weights: Folder with the file; IQA-PyTorch's part of torch.hub's cache if None or not there.
            device: Where it runs.

        Raises:
            InputError: the file is missing or damaged.
        """
        path = KONIQ.find(weights)
        state = read_tensors(path, "params")
        with torch.device("meta"):
            self.network = _Network()
        fill(self.network, state, path)
        self.network.to(device)
        self.device = device

    @torch.no_grad()
    def score(self, picture: torch.Tensor) -> float:
        """Quality of a picture, higher is better; trained for 0 to 100.

        Args:
            picture: RGB in [0, 1], shape (H, W, 3), of any size.
        """
        image = 2.0 * picture.to(self.device, torch.float32).permute(2, 0, 1)[None] - 1.0
        versions = [patches(version) for version in (*(_resized(image, s) for s in LONGER_SIDES), image)]
        pixels = torch.cat([version[0] for version in versions])
        positions = torch.cat([version[1] for version in versions]).to(self.device)
        scales = torch.cat([torch.full_like(v[1], i) for i, v in enumerate(versions)]).to(self.device)
        return float(self.network(pixels, positions, scales))


def patches(image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Patches of an image, padded with zeros to whole ones, and their places in the table of positions.

    Args:
        image: Shape (1, 3, H, W).

    Returns:
        Patches (N, 3, PATCH, PATCH), row by row, and positions (N,), int64.
    """
    rows, columns = (math.ceil(size / PATCH) for size in image.shape[2:])
    down, across = rows * PATCH - image.shape[2], columns * PATCH - image.shape[3]
    padded = pad(image, (across // 2, across - across // 2, down // 2, down - down // 2))
    cut = unfold(padded, PATCH, stride=PATCH)[0].T.reshape(-1, 3, PATCH, PATCH)
    down_grid, across_grid = (torch.arange(count) * GRID // count for count in (rows, columns))
    return cut, (down_grid[:, None] * GRID + across_grid).flatten()


def _resized(image: torch.Tensor, longer: int) -> torch.Tensor:
    height, width = image.shape[2:]
    ratio = longer / max(height, width)
    size = max(round(height * ratio), 1), max(round(width * ratio), 1)
    return interpolate(image, size, mode="bicubic", align_corners=False)


def _padded_to(image: torch.Tensor, window: int, stride: int) -> torch.Tensor:
    """Zeros around an image so that a window yields size / stride values, the odd one behind (TensorFlow)."""
    widths: list[int] = []
    for size in (image.shape[3], image.shape[2]):
        missing = max((math.ceil(size / stride) - 1) * stride + window - size, 0)
        widths += [missing // 2, missing - missing // 2]
    return pad(image, widths)


class _StandardConvolution(nn.Conv2d):
    """Convolution whose weights are brought to mean 0 and deviation 1 (Qiao et al. 2019)."""

    def __init__(self, channels: int, out: int, window: int, stride: int = 1) -> None:
        super().__init__(channels, out, window, stride, bias=False)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        weight = self.weight - self.weight.mean((1, 2, 3), keepdim=True)
        weight = weight / (weight.std((1, 2, 3), keepdim=True) + 1e-5)
        return conv2d(_padded_to(image, self.kernel_size[0], self.stride[0]), weight, stride=self.stride)


class _Bottleneck(nn.Module):
    """A block of ResNet with group normalisation."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.conv1, self.gn1 = _StandardConvolution(channels, channels, 1), _group_norm(channels)
        self.conv2, self.gn2 = _StandardConvolution(channels, channels, 3), _group_norm(channels)
        self.conv3, self.gn3 = _StandardConvolution(channels, out, 1), _group_norm(out)
        self.conv_proj, self.gn_proj = _StandardConvolution(channels, out, 1), _group_norm(out)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        inner = relu(self.gn1(self.conv1(image)))
        inner = relu(self.gn2(self.conv2(inner)))
        return relu(self.gn3(self.conv3(inner)) + self.gn_proj(self.conv_proj(image)))


def _group_norm(channels: int) -> nn.GroupNorm:
    return nn.GroupNorm(32, channels, eps=1e-4)


class _Attention(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.query, self.key, self.value, self.out = (nn.Linear(TOKEN, TOKEN) for _ in range(4))

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        parts = (layer(tokens).unflatten(-1, (HEADS, -1)) for layer in (self.query, self.key, self.value))
        query, key, value = (part.transpose(0, 1)[None] for part in parts)
        return self.out(scaled_dot_product_attention(query, key, value)[0].transpose(0, 1).flatten(1))


class _Block(nn.Module):
    """A block of the transformer."""

    def __init__(self) -> None:
        super().__init__()
        self.norm1, self.norm2 = (nn.LayerNorm(TOKEN, eps=1e-6) for _ in range(2))
        self.attention = _Attention()
        layers = {"fc1": nn.Linear(TOKEN, HIDDEN), "act": nn.GELU(), "fc2": nn.Linear(HIDDEN, TOKEN)}
        self.mlp = nn.Sequential(OrderedDict(layers))

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        tokens = tokens + self.attention(self.norm1(tokens))
        return tokens + self.mlp(self.norm2(tokens))


class _Embedding(nn.Module):
    """A table of embeddings under the name that the file gives it."""

    def __init__(self, name: str, *shape: int) -> None:
        super().__init__()
        self.register_parameter(name, nn.Parameter(torch.zeros(*shape)))

    def forward(self, index: torch.Tensor) -> torch.Tensor:
        (table,) = self.parameters()
        return table.reshape(-1, TOKEN)[index]


class _Encoder(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.posembed_input = _Embedding("position_emb", 1, GRID * GRID, TOKEN)
        self.scaleembed_input = _Embedding("scale_emb", len(LONGER_SIDES) + 1, TOKEN)
        self.cls = nn.Parameter(torch.zeros(1, 1, TOKEN))
        self.transformer = nn.ModuleDict({f"encoderblock_{layer}": _Block() for layer in range(LAYERS)})
        self.encoder_norm = nn.LayerNorm(TOKEN, eps=1e-6)

    def forward(self, tokens: torch.Tensor, positions: torch.Tensor, scales: torch.Tensor) -> torch.Tensor:
        tokens = tokens + self.posembed_input(positions) + self.scaleembed_input(scales)
        tokens = torch.cat([self.cls[0], tokens])
        for block in self.transformer.values():
            tokens = block(tokens)
        return self.encoder_norm(tokens)


class _Network(nn.Module):
    """Patches to a score, without the paper's padding to a fixed number of patches, which attention masks."""

    def __init__(self) -> None:
        super().__init__()
        self.conv_root = _StandardConvolution(3, STEM, 7, 2)
        self.gn_root = nn.GroupNorm(32, STEM, eps=1e-6)
        self.block1 = _Bottleneck(STEM, 4 * STEM)
        self.embedding = nn.Linear(4 * STEM * (PATCH // 4) ** 2, TOKEN)
        self.transformer_encoder = _Encoder()
        self.head = nn.Linear(TOKEN, 1)

    def forward(self, pixels: torch.Tensor, positions: torch.Tensor, scales: torch.Tensor) -> torch.Tensor:
        features = relu(self.gn_root(self.conv_root(pixels)))
        features = self.block1(max_pool2d(_padded_to(features, 3, 2), 3, 2))
        tokens = self.embedding(features.permute(0, 2, 3, 1).flatten(1))  # TensorFlow's order of channels
        return self.head(self.transformer_encoder(tokens, positions, scales)[0])
