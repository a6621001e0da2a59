"""Inpainting of one view or many by a diffusion prior: images in, images out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from diga3d_warp.errors import InputError
from diga3d_warp.perception.depth import depth_control
from diga3d_warp.perception.edges import canny_edges
from diga3d_warp.perception.resampling import resize_images, resize_masks
from diga3d_warp.priors.conditioning import Conditioning, Control, ControlKind, Guidance
from diga3d_warp.priors.inversion import invert
from diga3d_warp.priors.plan import plan_sampling
from diga3d_warp.priors.protocol import DiffusionPrior, check_fill, check_shapes
from diga3d_warp.priors.sampling import ViewLatents, initial_noise, sample_views
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.windows import Windows


@dataclass(frozen=True)
class ViewControl:
    """One control of N views, made of what they show at the size at which the prior is given them.

    Attributes:
        kind: As in `Control`.
        shown: For "edges" the views' pictures, RGB in [0, 1], shape (H, W, 3) each; for "depth" their z
            [scene units], shape (H, W) each, 0 where it is not known.
        scale: As in `Control`.
    """

    kind: ControlKind
    shown: Sequence[torch.Tensor]
    scale: float

    def at(self, index: int, size: tuple[int, int], device: torch.device) -> Control:
        """The control of one view, one row, shape (1, *size)."""
        make = canny_edges if self.kind == "edges" else depth_control
        return Control(self.kind, make(self.shown[index].to(device), size=size)[None], self.scale)


def inpaint_views(
    prior: DiffusionPrior,
    images: Sequence[torch.Tensor],
    masks: Sequence[torch.Tensor],
    guidance: Guidance,
    settings: SamplingSettings | None = None,
    *,
    references: Sequence[int] = (),
    inpainted: bool = False,
    init_images: Sequence[torch.Tensor] | None = None,
    controls: Sequence[ViewControl] = (),
    source: Any = None,
    seed: int = 0,
    say: Callable[[str], None] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Iterator[torch.Tensor]:
    """Inpaint the masked pixels of N views, consistently with the references (paper Sec. 3.3).

    All views are resized to the native size of the first one.

    Args:
        prior: The diffusion prior.
        images: RGB in [0, 1], shape (H, W, 3) each. May be a lazy sequence; each is read twice.
        masks: True where to inpaint, shape (H, W), bool, one for each image.
        guidance: Prompts and guidance scale.
        settings: Steps, strength, batch size and weight of propagation.
        references: Indices of the views that the others attend to.
        inpainted: Whether the references are inpainted already; they then stay as they are, and a prior with
            an image encoder is told what they show (the paper's I_p), unless `guidance` names an image.
        init_images: Images that inversion, or sampling below full strength, starts from; `images` if None.
        controls: Edges and depth that condition the sampling (ControlNet).
        source: Prompt half (`Prompts.positive` of a prompt) that describes `init_images` as they are:
            sampling starts from their DDIM inversion. If None it starts from noise, the same for all views.
        seed: Seed of the noise.
        say: Called with a line on time and memory before sampling starts.
        progress: Called after each timestep with the number of finished timesteps.

    Yields:
        The views in their order, shape (H, W, 3), float32 in [0, 1]; unmasked pixels are exactly those given.

    Raises:
        InputError: shapes do not fit, a mask covers everything without a source, or references are not among
            the views. Raised
            when the first view is requested.
    """
    settings = settings or SamplingSettings()
    init_images = images if init_images is None else init_images
    counts = [len(images), len(masks), len(init_images), *(len(c.shown) for c in controls)]
    if not images or len(set(counts)) > 1:
        raise InputError(f"numbers of images, masks and controls differ or are zero: {counts}")
    size = prior.native_size(*images[0].shape[:2])
    views = replace(
        _encode(prior, images, masks, init_images, controls, size, source, settings, seed),
        inpainted=inpainted,
    )
    if inpainted and references and guidance.image_embeds is None:
        shown = [resize_images(images[index][None].to(prior.device), size) for index in references]
        guidance = replace(guidance, image_embeds=prior.embed_images(torch.cat(shown)))
    if say is not None:
        say(str(plan_sampling(prior, views, guidance, settings, references)))
    z = sample_views(prior, views, guidance, settings, references=references, progress=progress)
    for index, (image, mask) in enumerate(zip(images, masks, strict=True)):
        with torch.no_grad():
            decoded = prior.decode_latent(z[index : index + 1].to(prior.device))
            filled = resize_images(decoded, image.shape[:2])[0].clamp(0.0, 1.0).to(image)
        yield torch.where(mask[..., None], filled, image)


def fill_one(
    prior: DiffusionPrior,
    image: torch.Tensor,
    mask: torch.Tensor,
    guidance: Guidance,
    settings: SamplingSettings | None = None,
    *,
    seed: int = 0,
) -> torch.Tensor:
    """Inpaint one image from noise, within a window around its mask: `Prior.fill` of a diffusion prior.

    An empty mask returns the image.
    """
    check_fill(image, mask)
    if not bool(mask.any()):
        return image.clone()
    windows = Windows.around([mask], prior)
    parts = inpaint_views(prior, windows.cut([image]), windows.cut([mask]), guidance, settings, seed=seed)
    return windows.put_back([image], list(parts))[0]


@torch.no_grad()
def known_part(
    prior: DiffusionPrior, image: torch.Tensor, mask: torch.Tensor, size: tuple[int, int]
) -> Conditioning:
    """The known part of one image (H, W, 3) with its mask (H, W), as a prior is given it at a size."""
    pixels = resize_images(image[None].to(prior.device), size)
    return prior.conditioning(pixels, resize_masks(mask[None].to(prior.device), size))


@torch.no_grad()
def _encode(
    prior: DiffusionPrior,
    images: Sequence[torch.Tensor],
    masks: Sequence[torch.Tensor],
    init_images: Sequence[torch.Tensor],
    controls: Sequence[ViewControl],
    size: tuple[int, int],
    source: Any,
    settings: SamplingSettings,
    seed: int,
) -> ViewLatents:
    """Latents of all views, made one view at a time and kept on the host."""
    conds: list[Conditioning] = []
    starts: list[torch.Tensor] = []
    noises: list[torch.Tensor] = []
    followed: list[list[Control]] = []
    schedule, host = prior.schedule, torch.device("cpu")
    first = schedule.timesteps(settings.steps, settings.strength)[0]
    for index in range(len(images)):
        image, mask = images[index], masks[index]
        (check_fill if source is None else check_shapes)(image, mask)
        cond = known_part(prior, image, mask, size)
        along = [control.at(index, size, prior.device) for control in controls]
        if source is None and settings.strength == 1.0:
            start = noise = initial_noise(cond.latent.shape, seed).to(prior.device)
        else:
            begun = prior.encode_image(resize_images(init_images[index][None].to(prior.device), size))
            if source is None:
                noise = initial_noise(cond.latent.shape, seed).to(prior.device)
                start = schedule.add_noise(begun, noise, first)
            else:
                start = invert(
                    prior, begun, source, cond, along, steps=settings.steps, strength=settings.strength
                )
                noise = schedule.noise_between(start, begun, first)
        conds.append(cond.rows([0], host))
        followed.append([control.rows([0], host) for control in along])
        starts.append(start.to(host))
        noises.append(noise.to(host))
    channels = [cond.channels for cond in conds if cond.channels is not None]
    prepared = [part for cond in conds for part in cond.prepared or ()]
    return ViewLatents(
        start=torch.cat(starts),
        cond=Conditioning(
            torch.cat([cond.latent for cond in conds]),
            torch.cat([cond.mask for cond in conds]),
            torch.cat(channels) if channels else None,
            tuple(prepared) if prepared else None,
        ),
        controls=tuple(
            Control(parts[0].kind, torch.cat([part.image for part in parts]), parts[0].scale)
            for parts in zip(*followed, strict=True)
        ),
        noise=None if prior.mask_aware else torch.cat(noises),
    )
