"""Density control with a fixed budget: 3D gaussian splatting as Markov chain Monte Carlo.

After Kheradmand et al. 2024 (3DGS-MCMC): gaussians that have faded are moved onto visible ones, new ones are
added the same way until the budget is reached, and faint ones take a random walk. Splitting one gaussian into
n keeps the image: the opacities compose to the old one, and scales shrink by Eq. 9 of that paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import comb

import torch

from diga3d_warp.gaussians.optimiser import GaussianAdam


@dataclass(frozen=True)
class DensitySettings:
    """When and how gaussians are moved, added and shaken.

    Attributes:
        interval: Iterations between two rounds.
        begin: Part of all iterations before the first round: the first gaussians must settle.
        end: Part of all iterations after the last round: what was moved last must settle too.
        dead_opacity: Below this opacity a gaussian has faded. 3DGS-MCMC: 0.005.
        copies_max: Most gaussians that one becomes in a round; bounds the binomials. 3DGS-MCMC: 51.
        opacity_floor: Least opacity of a copy, just above `dead_opacity`, or it would be moved again.
        noise: Size of the random walk, in learning rates of the means. 3DGS-MCMC: 5e5.
        noise_steepness, noise_threshold: Gaussians below an opacity of 1 - threshold walk; the step falls by
            a sigmoid of this steepness. 3DGS-MCMC: 100 and 0.995.
        noise_opacity_max: Above this opacity the walk is shorter than 0.002 of its full length: not computed.
    """

    interval: int = 100
    begin: float = 0.05
    end: float = 0.75
    dead_opacity: float = 0.005
    copies_max: int = 51
    opacity_floor: float = 0.0051
    noise: float = 5e5
    noise_steepness: float = 100.0
    noise_threshold: float = 0.995
    noise_opacity_max: float = 0.07


@cache
def _shrink_coefficients(copies_max: int) -> torch.Tensor:
    """Factors of the powers of opacity in 3DGS-MCMC Eq. 9, by number of copies.

    Its inner sum over i of C(i - 1, k) is C(n, k + 1). Row n - 1 holds the factors of o^1, o^2, ... o^n,
    shape (copies_max, copies_max), float64.
    """
    table = torch.zeros(copies_max, copies_max, dtype=torch.float64)
    for n in range(1, copies_max + 1):
        for k in range(n):
            table[n - 1, k] = (-1) ** k * comb(n, k + 1) / (k + 1) ** 0.5
    return table


def split(opacities: torch.Tensor, scales: torch.Tensor, copies: torch.Tensor, settings: DensitySettings):
    """Opacities and scales of gaussians after each became several.

    Args:
        opacities: shape (M,).
        scales: Standard deviations, shape (M, 3).
        copies: How many each one becomes, at least 1, shape (M,), int64.

    Returns:
        Opacities (M,) and scales (M, 3) of each copy, such that the copies on one spot look like the
        original (3DGS-MCMC Eq. 9).
    """
    copies = copies.clamp(1, settings.copies_max)
    old = opacities.double().clamp(1e-6, 1.0 - 1e-6)
    new = 1.0 - (1.0 - old) ** (1.0 / copies)
    powers = new[:, None] ** torch.arange(1, settings.copies_max + 1)
    denominator = (_shrink_coefficients(settings.copies_max)[copies - 1] * powers).sum(dim=1)
    factor = torch.where(denominator > 0.0, old / denominator, torch.ones_like(old)).clamp(max=1.0)
    opacity = new.clamp(settings.opacity_floor, 1.0 - 1e-6)
    return opacity.float(), (scales * factor[:, None]).float()


@torch.no_grad()
def relocate_and_grow(
    optimiser: GaussianAdam, wanted: int, settings: DensitySettings, generator: torch.Generator,
    held: torch.Tensor | None = None,
) -> int:  # fmt: skip
    """Move faded gaussians onto visible ones, then add new ones until there are `wanted`.

    Args:
        optimiser: Changed in place.
        wanted: Number of gaussians to reach; never less than there are.
        settings: Thresholds.
        generator: Source of the random choices.
        held: Rows that are neither moved nor chosen, shape (N,), bool.

    Returns:
        The number of gaussians that were moved or added.
    """
    gaussians = optimiser.gaussians()
    opacities = gaussians.opacities
    free = torch.ones_like(opacities, dtype=torch.bool) if held is None else ~held
    alive = free & (opacities > settings.dead_opacity)
    dead_rows = torch.nonzero(free & ~alive)[:, 0]
    added = max(0, wanted - len(gaussians))
    moved = len(dead_rows) + added
    if moved == 0 or not alive.any():
        return 0
    weights = torch.where(alive, opacities, torch.zeros_like(opacities))
    chosen = torch.multinomial(weights, moved, replacement=True, generator=generator)
    sources, copies = torch.unique(chosen, return_counts=True)
    copied = gaussians.select(sources)
    opacity, scales = split(copied.opacities, copied.scales, copies + 1, settings)
    copied.opacity_logits = torch.logit(opacity)
    copied.log_scales = torch.log(scales)
    optimiser.overwrite(sources, copied)
    values = copied.select(torch.searchsorted(sources, chosen))
    if len(dead_rows):
        optimiser.overwrite(dead_rows, values.select(torch.arange(len(dead_rows))))
    if added:
        optimiser.append(values.select(torch.arange(len(dead_rows), moved)))
    return moved


@torch.no_grad()
def walk(optimiser: GaussianAdam, settings: DensitySettings, generator: torch.Generator, held=None) -> None:
    """Shake faint gaussians within their own shape (3DGS-MCMC Eq. 8), so that they find something to show."""
    tensors = optimiser.tensors
    opacities = torch.sigmoid(tensors["opacity_logits"])
    faint = opacities < settings.noise_opacity_max
    if held is not None:
        faint &= ~held
    rows = torch.nonzero(faint)[:, 0]
    if len(rows) == 0:
        return
    gate = torch.sigmoid(settings.noise_steepness * ((1.0 - opacities[rows]) - settings.noise_threshold))
    noise = (
        torch.randn(len(rows), 3, generator=generator)
        * (gate * settings.noise * optimiser.means_rate)[:, None]
    )
    factor = _rotations(tensors["quaternions"][rows]) * tensors["log_scales"][rows].exp()[:, None, :]
    shaped = factor @ (factor.transpose(1, 2) @ noise[..., None])
    tensors["means"][rows] += shaped[..., 0]


def _rotations(quaternions: torch.Tensor) -> torch.Tensor:
    """Rotation matrices of quaternions (w, x, y, z), shape (M, 3, 3)."""
    from kornia.geometry.conversions import quaternion_to_rotation_matrix

    return quaternion_to_rotation_matrix(quaternions)
