"""The denoiser: what a noisy image most likely was, given that all its patches come from a source.

A patch q that holds gaussian noise of variance s^2 was k_j with probability softmax_j(-|q - k_j|^2 / 2 s^2)
if all patches of the source are equally likely: attention with patches as keys and values. The clean image
is estimated by the mean over all patches that show a pixel. Kamb and Ganguli 2024, "An analytic theory of
creativity in convolutional diffusion models", show this to be the best score that looks at patches only.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import warp as wp

from diga3d_warp.kernels import patches as kernels
from diga3d_warp.priors.exemplar.query import QueryScale
from diga3d_warp.priors.exemplar.settings import PatchSettings
from diga3d_warp.priors.exemplar.source import SourceScale
from diga3d_warp.splatting.arrays import warp_array


@dataclass(frozen=True, eq=False)
class Estimate:
    """What the clean image may be.

    Attributes:
        image: Posterior mean where missing, known elsewhere, shape (h, w, 3).
        candidates: Nearest patches of each query, as pixels of the source, nearest first, -1 for none, shape
            (N, kept), int32.
        distances: Of the candidates, shape (N, kept).
    """

    image: torch.Tensor
    candidates: torch.Tensor
    distances: torch.Tensor


@torch.no_grad()
def attend_all(query: QueryScale, source: SourceScale, image: torch.Tensor, noise: float) -> Estimate:
    """Posterior mean over all patches of the source.

    Args:
        query: What is sought.
        source: Patches, at least one.
        image: Noisy where missing, clean elsewhere, shape (h, w, 3).
        noise: Standard deviation of the noise [1].
    """
    s = query.settings
    channels = source.features.shape[2]
    places = source.centers.reshape(-1).nonzero()[:, 0]
    keys = unfolded(source.features, s.side)[_corners(places, source.centers.shape[1], s.radius)]
    pixels = query.pixels.long()
    q = unfolded(query.features(image), s.side)[pixels]
    weights = unfolded(query.weights(noise), s.side)[pixels]
    distances = weights @ keys.square().T - 2.0 * (weights * q) @ keys.T
    distances += (weights * q.square()).sum(1, keepdim=True)
    across, down, shift_x, shift_y = displacement_costs(query, source, noise)
    step_x = pixels[:, None] % query.width - places % source.centers.shape[1] + shift_x
    step_y = pixels[:, None] // query.width - places // source.centers.shape[1] + shift_y
    distances = distances.clamp(min=0.0) + across * step_x.square() + down * step_y.square()
    means = (torch.softmax(-distances, 1) @ keys).view(len(pixels), -1, channels)[..., :3]
    nearest = torch.topk(distances, min(s.kept, len(places)), 1, largest=False)
    candidates = no_candidates(query)
    candidates[:, : nearest.indices.shape[1]] = places[nearest.indices].int()
    found = torch.full(candidates.shape, kernels.FAR, device=q.device)
    found[:, : nearest.values.shape[1]] = nearest.values
    return Estimate(query.pasted(_folded(means, pixels, query)), candidates, found)


@torch.no_grad()
def attend_candidates(
    query: QueryScale,
    source: SourceScale,
    image: torch.Tensor,
    noise: float,
    candidates: torch.Tensor,
    *,
    seed: int,
    steps: int = 1,
    spread: float | None = None,
    scale: torch.Tensor | None = None,
) -> Estimate:
    """Posterior mean over few patches of the source for each query, searched for from given candidates.

    Args:
        query, source, image, noise: As in `attend_all`.
        candidates: To start from, shape (N, kept), int32; -1 for none.
        seed: Of random candidates.
        steps: Of the search.
        spread: Radius of the first random candidate [px]; that of the settings if None.
        scale: Factor on the distances to each patch, shape (h, w); 1 if None.
    """
    s = query.settings
    form, keys, queries = source.form(s), source.keys(scale), query.queries(image, noise)
    spread = s.spread * query.width if spread is None else spread
    costs = displacement_costs(query, source, noise)
    distances = torch.empty(candidates.shape, device=image.device)
    for step in range(steps):
        found = torch.empty_like(candidates)
        kernels.search(
            form, queries, keys, costs, warp_array(candidates.view(-1), wp.int32),
            [warp_array(found.view(-1), wp.int32), warp_array(distances.view(-1), wp.float32)],
            apart=s.apart * query.unit(noise), draws=s.draws, spread=spread, seed=seed + step,
        )  # fmt: skip
        candidates = found
    attention = torch.softmax(-distances, 1)
    colors = torch.zeros(len(query.targets), 3, device=image.device)
    kernels.vote(
        form, queries, keys, warp_array(query.targets, wp.int32), warp_array(candidates.view(-1), wp.int32),
        warp_array(attention.view(-1), wp.float32), warp_array(window(s).to(image.device), wp.float32),
        warp_array(colors, wp.vec3),
    )  # fmt: skip
    means = query.known.clone()
    means.view(-1, 3)[query.targets.long()] = colors
    return Estimate(means, candidates, distances)


def no_candidates(query: QueryScale) -> torch.Tensor:
    """Candidates of queries that know none yet, shape (N, kept)."""
    shape = (len(query.pixels), query.settings.kept)
    return torch.full(shape, -1, dtype=torch.int32, device=query.missing.device)


def upsampled_candidates(
    candidates: torch.Tensor,
    coarse: QueryScale,
    fine: QueryScale,
    coarse_source: tuple[int, int],
    fine_source: tuple[int, int],
) -> torch.Tensor:
    """Candidates for a finer scale: each query takes those of the coarse query that it lies in, upsampled.

    Args:
        candidates: Of the coarse queries, shape (N, kept).
        coarse, fine: The queries.
        coarse_source, fine_source: Height and width of the source at both scales [px].
    """
    pixels = fine.pixels.long()
    y, x = pixels // fine.width, pixels % fine.width
    (h, w), (coarse_h, coarse_w) = fine.size, coarse.size
    cy = ((y + 0.5) * coarse_h / h).long().clamp(max=coarse_h - 1)
    cx = ((x + 0.5) * coarse_w / w).long().clamp(max=coarse_w - 1)
    slot = coarse.slots[cy * coarse_w + cx].long()
    taken = candidates[slot.clamp(min=0)].long()
    ky, kx = taken // coarse_source[1], taken % coarse_source[1]
    # The middle of the coarse key's cell, plus the offset of the query from the middle of its coarse cell.
    fine_y = (
        ((ky + 0.5) * fine_source[0] / coarse_source[0] + (y - (cy + 0.5) * h / coarse_h)[:, None])
        .floor()
        .long()
    )
    fine_x = (
        ((kx + 0.5) * fine_source[1] / coarse_source[1] + (x - (cx + 0.5) * w / coarse_w)[:, None])
        .floor()
        .long()
    )
    inside = (fine_y >= 0) & (fine_y < fine_source[0]) & (fine_x >= 0) & (fine_x < fine_source[1])
    valid = inside & (taken >= 0) & (slot >= 0)[:, None]
    return torch.where(valid, fine_y * fine_source[1] + fine_x, -1).int().contiguous()


def displacement_costs(
    query: QueryScale, source: SourceScale, noise: float
) -> tuple[float, float, float, float]:
    """Cost of displacement to a key, across and down, per px^2 in units of `distances`; and the shift."""
    if not source.placed:
        return 0.0, 0.0, 0.0, 0.0
    s = query.settings
    unit = query.unit(noise) * query.cost_scale / (query.size[0] ** 2 + query.size[1] ** 2)
    return unit * s.across, unit * s.down, *source.shift


def window(settings: PatchSettings) -> torch.Tensor:
    """Share of each pixel of a patch in a vote, shape (side * side,)."""
    steps = torch.arange(settings.side) - settings.radius
    line = torch.exp(-0.5 * (steps / settings.window) ** 2)
    return (line[:, None] * line).reshape(-1)


def unfolded(planes: torch.Tensor, side: int) -> torch.Tensor:
    """All patches of planes (h, w, c), shape ((h - side + 1) (w - side + 1), side * side * c)."""
    windows = planes.unfold(0, side, 1).unfold(1, side, 1)
    return windows.permute(0, 1, 3, 4, 2).reshape(-1, side * side * planes.shape[2])


def _corners(places: torch.Tensor, width: int, radius: int) -> torch.Tensor:
    """Index among the patches of `unfolded` of those that are centred at pixels of the planes."""
    y, x = places // width - radius, places % width - radius
    return y * (width - 2 * radius) + x


def _folded(means: torch.Tensor, pixels: torch.Tensor, query: QueryScale) -> torch.Tensor:
    """Mean over overlapping patches (N, side * side, 3) around `pixels`, shape (h, w, 3)."""
    s, (h, w) = query.settings, query.size
    share = window(s).to(means.device)[:, None]
    votes = torch.cat([means * share, share.expand(len(pixels), -1, -1)], -1)
    across = torch.arange(s.side, device=means.device)
    padded_width = w + 2 * s.radius
    within = (across[:, None] * padded_width + across).reshape(-1)
    cells = (pixels // w * padded_width + pixels % w)[:, None] + within
    total = means.new_zeros((h + 2 * s.radius) * padded_width, 4)
    total.index_add_(0, cells.reshape(-1), votes.reshape(-1, 4))
    total = total.view(h + 2 * s.radius, padded_width, 4)[s.radius : s.radius + h, s.radius : s.radius + w]
    return total[..., :3] / total[..., 3:].clamp(min=1e-8)
