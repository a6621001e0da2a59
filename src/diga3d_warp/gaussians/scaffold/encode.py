"""Gaussians as anchors: the first ones of a fit, and those that an edit adds."""

from __future__ import annotations

import math

import numpy as np
import torch

from diga3d_warp.gaussians.density import spread_out
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.scaffold.anchors import Scaffold
from diga3d_warp.gaussians.scaffold.decoder import OUTPUTS, VIEW, Decoder, Head, activation_of
from diga3d_warp.gaussians.scaffold.voxels import grouped, usual_distance, voxels_of
from diga3d_warp.kernels.harmonics import C0

SHARE = 2.0
"""Size of an anchor [largest standard deviation of its gaussians]: the share of each can still double."""

SHARE_LEAST = 1e-3
"""Smallest share of it that is encoded, against a disc of no thickness."""

COLOR_LEAST = 0.02
"""Colours are encoded from this to 1 - this: beyond, the sigmoid has no slope left to learn by."""

SPREAD = 0.8
"""Distance of copies from their gaussian [its standard deviations], as `DensitySettings.spread`."""

DEPTH_MOST = 5.0
"""Optical depth of a copy at most: an opacity of 0.993."""

BIAS = 4.0
"""Bias of the hidden units [standard deviations of a feature]: nearly all are on at first, so that the
networks start linear, and reproduce what was encoded."""

IMPORTANCE = {"opacity": 1.0, "color": 1.0, "shape": 0.3}
"""Weight of each output where the features cannot hold all: colours show most."""

DEVIATION = 0.1
"""Standard deviation of a feature. Larger ones make hidden units large, and steps of Adam on the weights that
follow them jumps."""

FRESH = 0.1
"""Standard deviation of weights that encode nothing yet, so that they can learn."""


def encoded(
    gaussians: Gaussians, reach: float, slots: int, width: int, size: float | None = None
) -> Scaffold:
    """Anchors whose decoder gives back gaussians, whatever the view.

    Positions are exact. Opacities, colours and shapes of an anchor's gaussians are those that `width`
    principal components of all anchors' hold. Slots that a voxel has left are filled with copies, spread over
    the original and smaller.

    Args:
        gaussians: N gaussians, at least one; of their harmonics the first is taken.
        reach: Distance that the networks see as a half [scene units].
        slots: Gaussians k of an anchor.
        width: Numbers of a feature, and hidden units of each network.
        size: Side of a voxel [scene units]; None for one that holds about half of the slots, if gaussians lie
            on surfaces.
    """
    positions = gaussians.means.detach().cpu().double().numpy()
    if size is None:
        size = math.sqrt(0.5 * slots) * usual_distance(positions)
    places, chosen = _slotted(positions, size, slots)
    filled = _copies(gaussians, chosen, len(places) * slots)
    centers = torch.from_numpy((places + 0.5) * size).to(gaussians.sh)
    away = (filled.means.to(centers) - centers.repeat_interleave(slots, 0)).view(-1, slots, 3)
    log_spans = torch.log(away.abs().amax(dim=1).clamp_min(0.25 * size))
    scales = filled.scales.view(-1, slots, 3)
    log_sizes = torch.log((SHARE * scales.amax(dim=1).amax(dim=1)).clamp_min(1e-12 * size))
    log_sizes = log_sizes[:, None].expand(-1, 3).contiguous()
    features, decoder = _compressed(_activations(filled, log_sizes, slots), width, slots)
    return Scaffold(
        centers, features, away / torch.exp(log_spans)[:, None], log_spans, log_sizes,
        torch.ones_like(centers), torch.zeros(len(centers), dtype=torch.int64),
        torch.zeros(len(centers), slots, dtype=torch.bool), decoder, reach, size,
    )  # fmt: skip


def _slotted(positions: np.ndarray, size: float, slots: int) -> tuple[np.ndarray, np.ndarray]:
    """Voxel of each anchor, shape (A, 3), and the gaussian that fills each slot, shape (A * slots,).

    A voxel with more than `slots` gaussians has several anchors.
    """
    cells, voxel = grouped(voxels_of(positions, size))
    order = np.argsort(voxel, kind="stable")
    counts = np.bincount(voxel, minlength=len(cells))
    rank = np.empty(len(positions), np.int64)
    rank[order] = np.arange(len(positions)) - np.repeat(np.cumsum(counts) - counts, counts)
    anchors_of_cell = -(-counts // slots)
    first = np.cumsum(anchors_of_cell) - anchors_of_cell
    owner = first[voxel] + rank // slots
    places = np.repeat(cells, anchors_of_cell, axis=0)
    held = np.bincount(owner, minlength=len(places))
    begin = np.cumsum(held) - held
    turn = np.arange(len(places) * slots)
    anchor = turn // slots
    by_owner = np.argsort(owner, kind="stable")
    return places, by_owner[begin[anchor] + (turn % slots) % held[anchor]]


def _copies(gaussians: Gaussians, chosen: np.ndarray, count: int) -> Gaussians:
    """The chosen gaussians (count,); of those chosen several times, copies spread over the original.

    Copies are smaller, and together as opaque: their optical depths sum up to that of the original.
    """
    rows = torch.from_numpy(chosen)
    plain = gaussians.select(rows)
    copies = torch.bincount(rows, minlength=len(gaussians))[rows]
    repeated = copies > 1
    if not repeated.any():
        return plain
    spread = spread_out(plain, SPREAD, torch.Generator().manual_seed(count))
    depth = torch.nn.functional.softplus(plain.opacity_logits)  # -log(1 - opacity)
    depth = (depth / ((1.0 - SPREAD**2) * copies)).clamp_min(1e-6)
    spread.opacity_logits = torch.log(torch.expm1(depth.clamp(max=DEPTH_MOST)))
    mine = dict(plain.named())
    for name, tensor in spread.named():
        mine[name][repeated] = tensor[repeated]
    return Gaussians(**mine)


def _activations(filled: Gaussians, log_sizes: torch.Tensor, slots: int) -> dict[str, torch.Tensor]:
    """What each network should give for each anchor, shapes (A, slots * outputs), float64."""
    rgb = (0.5 + C0 * filled.sh[:, 0].double()).clamp(COLOR_LEAST, 1.0 - COLOR_LEAST)
    shares = torch.exp(filled.log_scales.double() - log_sizes.double().repeat_interleave(slots, 0))
    shares = shares.clamp(SHARE_LEAST, 1.0 - SHARE_LEAST)
    quaternions = torch.nn.functional.normalize(filled.quaternions.double(), dim=1)
    # q and -q are one rotation: those with w >= 0 differ least from each other and from the identity.
    quaternions = torch.where(quaternions[:, :1] < 0.0, -quaternions, quaternions)
    identity = quaternions.new_tensor([1.0, 0.0, 0.0, 0.0])
    wanted = {
        "opacity": activation_of(filled.opacity_logits.double())[:, None],
        "color": torch.logit(rgb),
        "shape": torch.cat([torch.logit(shares), quaternions - identity], dim=1),
    }
    return {name: values.reshape(-1, slots * OUTPUTS[name]) for name, values in wanted.items()}


def _compressed(wanted: dict[str, torch.Tensor], width: int, slots: int) -> tuple[torch.Tensor, Decoder]:
    """Features (A, width) and the decoder that gives back what was wanted of them."""
    weighted = torch.cat([IMPORTANCE[name] * values for name, values in wanted.items()], dim=1)
    mean = weighted.mean(dim=0)
    centered = weighted - mean
    variances, axes = torch.linalg.eigh(centered.T @ centered / len(weighted))
    order = torch.arange(len(variances) - 1, -1, -1)[:width]
    deviations, axes = variances[order].clamp_min(0.0).sqrt(), axes[:, order]
    # The sign of an eigenvector is arbitrary: its largest entry is made positive.
    axes = axes * torch.sign(axes.gather(0, axes.abs().argmax(dim=0)[None]))
    holds = deviations > 1e-6 * deviations.max().clamp_min(1e-12)
    features = torch.zeros(len(weighted), width, dtype=torch.float64)
    features[:, : len(order)][:, holds] = DEVIATION * (centered @ axes)[:, holds] / deviations[holds]
    generator = torch.Generator().manual_seed(width)
    heads, column = {}, 0
    for name, values in wanted.items():
        outputs = values.shape[1]
        rows = slice(column, column + outputs)
        column += outputs
        outer = FRESH * torch.randn(width, outputs, generator=generator, dtype=torch.float64)
        outer[: len(order)][holds] = ((axes * deviations)[rows] / IMPORTANCE[name] / DEVIATION).T[holds]
        bias = mean[rows] / IMPORTANCE[name] - BIAS * DEVIATION * outer.sum(dim=0)
        inner = torch.eye(width + VIEW, width, dtype=torch.float64)  # of the view, nothing yet
        hidden = torch.full((width,), BIAS * DEVIATION, dtype=torch.float64)
        heads[name] = Head(*(each.float()[None].contiguous() for each in (inner, hidden, outer, bias)))
    return features.clamp(-BIAS * DEVIATION, BIAS * DEVIATION).float(), Decoder(**heads)
