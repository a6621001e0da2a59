"""Density control with a fixed budget: gaussians go where the images pull, faded ones first.

Gaussians that have faded, or that no image shows, are moved onto chosen ones, and new ones are added the same
way until the budget is reached, as in 3DGS as Markov chain Monte Carlo (Kheradmand et al. 2024). Unlike
there, they are chosen by the pull of the images on their centres (3DGS's measure) rather than by opacity, and
copies are spread over the original (3DGS's split) rather than laid on one spot: coincident copies get the
same gradient, so only a long random walk parts them, and a fit on a CPU is short.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import warp as wp

from diga3d_warp.gaussians.optimiser import GaussianAdam
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.kernels import walk as kernels
from diga3d_warp.splatting.arrays import vector_arrays, warp_array


@dataclass(frozen=True)
class DensitySettings:
    """When and how gaussians are moved, added and shaken.

    Attributes:
        interval: Iterations between two rounds.
        begin: Part of all iterations before the first round: the first gaussians need time to converge.
        end: Part of all iterations after the last round: what was moved last needs that time, too.
        dead_opacity: Below this opacity a gaussian has faded. 3DGS-MCMC: 0.005.
        spread: How far copies lie from the original's centre [its standard deviations]. They shrink by
            sqrt(1 - spread^2), so that all copies together have the covariance of the original; 0.8 gives
            0.6, the 1 / 1.6 of 3DGS's split.
        noise: Size of the random walk, in learning rates of the means [1 / scene extent^2]. 3DGS-MCMC: 5e5
            [1 / scene unit^2], at extents of some 3 to 5 scene units.
        noise_steepness, noise_threshold: Gaussians below an opacity of 1 - threshold walk; the step falls by
            a sigmoid of this steepness. 3DGS-MCMC: 100 and 0.995.
        noise_opacity_max: Above this opacity the walk is shorter than 0.002 of its full length: not computed.
    """

    interval: int = 100
    begin: float = 0.05
    end: float = 0.75
    dead_opacity: float = 0.005
    spread: float = 0.8
    noise: float = 5e6
    noise_steepness: float = 100.0
    noise_threshold: float = 0.995
    noise_opacity_max: float = 0.07


@torch.no_grad()
def relocate_and_grow(
    optimiser: GaussianAdam, wanted: int, pull: torch.Tensor, unseen: torch.Tensor,
    settings: DensitySettings, generator: torch.Generator, held: torch.Tensor | None = None,
) -> torch.Tensor:  # fmt: skip
    """Move faded and unseen gaussians onto others, then add new ones until there are `wanted`.

    Args:
        optimiser: Changed in place.
        wanted: Number of gaussians to reach; never less than there are.
        pull: How much each gaussian deserves company, shape (N,), not negative.
        unseen: Gaussians that no image shows, shape (N,), bool; they count as faded.
        settings: Thresholds.
        generator: Source of the random choices.
        held: Rows that are neither moved nor chosen, shape (N,), bool.

    Returns:
        Rows of the gaussians that were moved or added, shape (M,).
    """
    gaussians = optimiser.gaussians()
    opacities = gaussians.opacities
    free = torch.ones_like(opacities, dtype=torch.bool) if held is None else ~held
    alive = free & ~unseen & (opacities > settings.dead_opacity)
    dead_rows = torch.nonzero(free & ~alive)[:, 0]
    added = max(0, wanted - len(gaussians))
    moved = len(dead_rows) + added
    weights = torch.where(alive, pull, torch.zeros_like(pull))
    if moved == 0 or not (weights > 0.0).any():
        return dead_rows[:0]
    chosen = torch.multinomial(weights, moved, replacement=True, generator=generator)
    sources = torch.unique(chosen)
    values = spread_out(gaussians.select(chosen), settings.spread, generator)
    optimiser.overwrite(sources, spread_out(gaussians.select(sources), settings.spread, generator))
    optimiser.overwrite(dead_rows, values.select(torch.arange(len(dead_rows))))
    if added:
        optimiser.append(values.select(torch.arange(len(dead_rows), moved)))
    return torch.cat([dead_rows, torch.arange(len(gaussians), len(gaussians) + added)])


def spread_out(gaussians: Gaussians, spread: float, generator: torch.Generator) -> Gaussians:
    """Smaller gaussians at random places within the given ones.

    Many of them from one gaussian have its mean and its covariance.

    Args:
        gaussians: N gaussians.
        spread: Distance from the old centre [standard deviations], in [0, 1).
        generator: Source of the places.
    """
    steps = spread * gaussians.scales * torch.randn(len(gaussians), 3, generator=generator)
    placed = gaussians.detached()
    placed.means += (_rotations(gaussians.quaternions) @ steps[..., None])[..., 0]
    placed.log_scales += 0.5 * math.log(1.0 - spread**2)
    return placed


@torch.no_grad()
def walk(
    gaussians: Gaussians, relative_rate: float, settings: DensitySettings, generator: torch.Generator,
    held: torch.Tensor | None = None,
) -> None:  # fmt: skip
    """Shake faint gaussians within their own shape (3DGS-MCMC Eq. 8), so that they find something to show.

    Args:
        gaussians: Their means are moved in place.
        relative_rate: Learning rate of the means over the squared scene extent [1 / scene units], the unit of
            the walk: times a covariance it is a length, so the walk is the same in any unit.
        settings: Size and gate of the walk.
        generator: Source of the noise.
        held: Gaussians that stay, shape (N,), bool.
    """
    if held is None:
        held = torch.zeros(len(gaussians), dtype=torch.bool, device=gaussians.means.device)
    shapes = vector_arrays([gaussians.log_scales, gaussians.quaternions, gaussians.opacity_logits])
    kernels.walk(
        int(torch.randint(2**31 - 1, (), generator=generator)), shapes, warp_array(held, wp.bool),
        settings.noise_opacity_max, settings.noise_steepness, settings.noise_threshold,
        settings.noise * relative_rate, warp_array(gaussians.means, wp.vec3),
    )  # fmt: skip


def _rotations(quaternions: torch.Tensor) -> torch.Tensor:
    """Rotation matrices of quaternions (w, x, y, z), shape (M, 3, 3)."""
    from kornia.geometry.conversions import quaternion_to_rotation_matrix

    return quaternion_to_rotation_matrix(quaternions)
