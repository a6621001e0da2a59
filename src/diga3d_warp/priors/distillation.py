"""Texture-geometry score distillation (TG-SDS, paper Sec. 3.4).

The gradient that a diffusion prior gives to rendered images: w(t) (estimated noise - added noise), under
edges and depth warped from the reference views, on masked pixels only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from diga3d_warp.errors import InputError
from diga3d_warp.perception.resampling import resize_images, resize_masks
from diga3d_warp.priors.conditioning import Conditioning, Control, Guidance
from diga3d_warp.priors.guidance import guided_noise
from diga3d_warp.priors.protocol import DiffusionPrior
from diga3d_warp.priors.schedule import Schedule
from diga3d_warp.priors.windows import WHOLE


@dataclass(frozen=True)
class DistillationSettings:
    """Weight and timesteps of score distillation.

    Attributes:
        weight: lambda of TG-SDS beside a photometric loss of weight 1 [1]. The paper does not state it;
            MVIP-NeRF: 1e-4.
        t_min: Least noisy timestep [share of the schedule]. DreamFusion: 0.02.
        t_max: Noisiest timestep [share of the schedule]. DreamFusion: 0.98.
        annealed: Timesteps fall as the optimisation goes on, t_max - (t_max - t_min) sqrt(progress)
            (MVIP-NeRF, DreamTime); otherwise they are drawn evenly from the range, as the paper writes.
    """

    weight: float = 1e-4
    t_min: float = 0.02
    t_max: float = 0.98
    annealed: bool = True

    def __post_init__(self) -> None:
        if not 0.0 <= self.t_min < self.t_max <= 1.0:
            raise InputError(f"timesteps from {self.t_min} to {self.t_max} are no range within 0 to 1")


@dataclass(frozen=True, eq=False)
class TextureGeometryGuide:
    """TG-SDS for one view, as a fit takes it (`gaussians.target.Target.guide`).

    Attributes:
        prior: The diffusion prior.
        mask: True where the edit is, shape (H, W), bool.
        guidance: Prompts and their weight.
        controls: Texture and depth map of the window, one row each, at the prior's native size
            (`propagation.conditions`).
        cond: Known part of the window, one row, on the host. It does not change while the hole is refined, so
            it is encoded once, not in every step; of the rendering in each step if None.
        settings: Strength and timesteps.
        window: Rows and columns of the view that the prior is shown; all of them as a rule. They hold the
            mask.
    """

    prior: DiffusionPrior
    mask: torch.Tensor
    guidance: Guidance
    controls: tuple[Control, ...] = ()
    cond: Conditioning | None = None
    settings: DistillationSettings = DistillationSettings()
    window: tuple[slice, slice] = WHOLE

    def __call__(self, image: torch.Tensor, done: float, generator: torch.Generator) -> torch.Tensor:
        """Weighted loss of a rendering.

        Args:
            image: RGB, shape (H, W, 3). Carries gradient, zero outside the mask.
            done: Completed share of the optimisation, in [0, 1].
            generator: Random generator for the timestep and the noise.
        """
        t = distillation_timestep(self.prior.schedule, done, self.settings, generator)
        masks = self.mask[self.window][None].to(image.device)
        cond = None if self.cond is None else self.cond.rows([0], self.prior.device)
        loss = distillation_loss(
            self.prior,
            image[self.window][None],
            masks,
            self.guidance,
            self.controls,
            t=t,
            generator=generator,
            cond=cond,
        )
        return self.settings.weight * loss.to(image.device)


def distillation_timestep(
    schedule: Schedule, progress: float, settings: DistillationSettings, generator: torch.Generator
) -> int:
    """Timestep of one optimisation step.

    Args:
        schedule: Noise levels of the prior.
        progress: Completed share of the optimisation, in [0, 1].
        settings: Range and annealing.
        generator: Drawn from only if timesteps are not annealed.
    """
    span = settings.t_max - settings.t_min
    if settings.annealed:
        share = settings.t_max - span * progress**0.5
    else:
        share = settings.t_min + span * float(torch.rand((), generator=generator))
    return schedule.timestep(share)


def distillation_loss(
    prior: DiffusionPrior,
    images: torch.Tensor,
    masks: torch.Tensor,
    guidance: Guidance,
    controls: Sequence[Control] = (),
    *,
    t: int,
    generator: torch.Generator,
    cond: Conditioning | None = None,
) -> torch.Tensor:
    """A scalar whose gradient is that of score distillation under texture and depth (paper Eq. 6).

    With w(t) = 1 - abar_t. Its value is half the squared norm of that gradient on the latents, averaged over
    the images: a figure to plot, not one that falls steadily.

    The gradient is masked on the images, before they are encoded: masked on the latents it would leak to
    unmasked pixels, because each latent cell is encoded from a wide neighbourhood.

    Args:
        prior: The diffusion prior. A mask-aware one is conditioned on mask and unmasked pixels (the paper's
            m_i as an input); for another the mask gates the gradient only.
        images: Rendered, RGB in [0, 1], shape (B, H, W, 3). Carries gradient, exactly zero outside `masks`.
        masks: True where the edit is, shape (B, H, W), bool.
        guidance: Prompts and their weight.
        controls: Texture and depth map warped from the reference of the view's cluster, B rows each, of the
            prior's native size for these images.
        t: Timestep, from `distillation_timestep`.
        generator: Random generator for the added noise, on the host.
        cond: Known part, B rows, of the prior's native size for these images; that of `images` if None.

    Raises:
        InputError: shapes do not fit.
    """
    if images.ndim != 4 or images.shape[3] != 3 or masks.shape != images.shape[:3]:
        raise InputError(
            f"images {tuple(images.shape)} and masks {tuple(masks.shape)} do not fit: "
            "give (B, H, W, 3) and (B, H, W)"
        )
    size = prior.native_size(*images.shape[1:3])
    for control in controls:
        if tuple(control.image.shape[1:]) != tuple(size):
            raise InputError(
                f"{control.kind} of {tuple(control.image.shape[1:])} do not fit prior {prior.name}, which is "
                f"shown these images at {tuple(size)}: make them at that size"
            )
    inside = masks[..., None].to(images)
    gated = images * inside + images.detach() * (1.0 - inside)
    pixels = resize_images(gated, size)
    z = prior.encode_image(pixels)
    with torch.no_grad():
        if cond is None:
            cond = prior.conditioning(pixels, resize_masks(masks, size))
        noise = torch.randn(z.shape, generator=generator).to(z)
        noisy = prior.schedule.add_noise(z, noise, t)
        estimate = guided_noise(prior, noisy, t, guidance, cond, controls)
        weight = 1.0 - prior.schedule.alpha(t)
        goal = z - torch.nan_to_num(weight * (estimate - noise))
    return 0.5 * (z - goal).square().sum() / len(images)
