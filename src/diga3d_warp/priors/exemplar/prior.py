"""The built-in prior: diffusion without learned weights, over the patches of given images.

The denoiser is the mean of patches under their posterior, in closed form, as in training-free single-image
diffusion (Qiu, Kutulakos and Lindell, CVPR 2026, arXiv 2606.04299).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from diga3d_warp.errors import InputError
from diga3d_warp.priors.attention import AttentionBank
from diga3d_warp.priors.classical import telea_fill
from diga3d_warp.priors.conditioning import Conditioning, Control, ControlKind, Guidance, Prompts
from diga3d_warp.priors.exemplar.denoiser import posterior_mean
from diga3d_warp.priors.exemplar.fill import fill_missing
from diga3d_warp.priors.exemplar.prompts import PatchPrompt, prompts_of
from diga3d_warp.priors.exemplar.settings import FILL, PATCHES, FillSettings, PatchSettings
from diga3d_warp.priors.exemplar.source import Source, depth_control, edge_control
from diga3d_warp.priors.protocol import Task, check_fill
from diga3d_warp.priors.schedule import Schedule
from diga3d_warp.priors.settings import SamplingSettings

PATCH_GUIDANCE = 1.2
"""Guidance scale of a negative prompt. Means over patches differ by more than a network's two estimates: at
the paper's 7.5 colours leave their range."""

LAYER = "patches"
"""Name of the prior's only attention."""

NOISE_RANGE = (0.02, 40.0)
"""Least and most noise of the schedule, as a standard deviation on images in [-1, 1]. The least is
`PatchSettings.noise_min`; the most leaves 2.5 on an image shrunk 16 times, as good as no image."""

DEPTH_FLOOR = 0.05
"""Inverse depth of a control below which all is far [share of the nearest]: keeps its logarithm finite."""


def patch_schedule(count: int = 1000) -> Schedule:
    """Noise levels in geometric steps, each scale of an image thus getting as many as the next."""
    noise = torch.from_numpy(np.geomspace(*NOISE_RANGE, count))
    return Schedule(1.0 / (1.0 + noise.square()), final=1.0, offset=0)


class ExemplarPrior:
    """Patch diffusion: every patch of what is invented is, up to blending, one of an image at hand.

    It knows textures and edges of that image and where in it they stand, but no objects: it will not
    complete a half hidden chair. Latents are images in [-1, 1]; the one self-attention is that to patches.

    Args:
        patches: When patches are alike.
        settings: How a hole is filled.
        device: Where latents belong.
        negative: What a removal goes away from, besides going on with the surroundings; empty for nothing.
    """

    name = "exemplar"
    learned = False
    mask_aware = True
    control_kinds: tuple[ControlKind, ...] = ("edges", "depth")
    sampling = SamplingSettings(steps=20, strength=0.3)
    """Patches know no perspective: views start from the warped fill, and only its details are redrawn."""

    def __init__(
        self,
        patches: PatchSettings = PATCHES,
        settings: FillSettings = FILL,
        device: torch.device | str = "cpu",
        negative: str = "",
    ) -> None:
        self.patches = patches
        self.settings = settings
        self.device = torch.device(device)
        self.schedule = patch_schedule()
        self.guidance = Guidance(prompts_of("", negative, "remove"), PATCH_GUIDANCE if negative else 1.0)
        self._bank: AttentionBank | None = None

    def fill(
        self, image: torch.Tensor, mask: torch.Tensor, *, seed: int = 0, depth: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Fill the masked pixels; see `Prior.fill`.

        Args:
            image, mask, seed, depth: As in `Prior.fill`. With a depth, patches are taken from surfaces at
                about the same depth.

        Raises:
            InputError: the mask covers everything, the shapes do not fit, or a depth is not positive.
        """
        check_fill(image, mask)
        if depth is not None and (depth.shape != mask.shape or not bool((depth > 0.0).all())):
            raise InputError(
                f"depth {tuple(depth.shape)} must be positive and as large as {tuple(mask.shape)}"
            )
        if not mask.any():
            return image
        controls = image.new_zeros(*mask.shape, 0)
        if depth is not None:
            controls = depth_control(depth, settings=self.patches)[..., None].to(image)
        source = Source(2.0 * image - 1.0, ~mask, controls)
        filled = fill_missing(source, seed, self.patches, self.settings)
        if filled is None:
            return telea_fill(image, mask)
        return torch.where(mask[..., None], (0.5 * filled + 0.5).clamp(0.0, 1.0), image)

    def native_size(self, height: int, width: int) -> tuple[int, int]:
        """Any size is native."""
        return height, width

    def encode_image(self, images: torch.Tensor) -> torch.Tensor:
        """Images in [-1, 1]; see `DiffusionPrior.encode_image`."""
        return images.to(self.device).permute(0, 3, 1, 2) * 2.0 - 1.0

    def decode_latent(self, z: torch.Tensor) -> torch.Tensor:
        """Images in [0, 1]; see `DiffusionPrior.decode_latent`."""
        return ((z + 1.0) / 2.0).clamp(0.0, 1.0).permute(0, 2, 3, 1)

    def encode_prompts(self, positive: str, negative: str, task: Task) -> Prompts:
        """Patches that the prompts stand for; see `prompts_of`."""
        return prompts_of(positive, negative, task)

    def conditioning(self, images: torch.Tensor, masks: torch.Tensor) -> Conditioning:
        """The known part; see `DiffusionPrior.conditioning`."""
        latent, mask = self.encode_image(images).detach(), masks[:, None].to(self.device, torch.float32)
        return Conditioning(latent, mask, prepared=tuple(map(_known, latent, mask[:, 0])))

    def embed_images(self, images: torch.Tensor) -> None:
        """There is no image encoder."""

    def install_attention(self, bank: AttentionBank | None) -> None:
        """Let the attention to patches pass through `bank.attend`."""
        self._bank = bank

    @torch.no_grad()
    def predict_noise(
        self,
        z: torch.Tensor,
        t: int,
        text: PatchPrompt,
        cond: Conditioning | None = None,
        controls: Sequence[Control] = (),
        image_embeds: Any = None,
    ) -> torch.Tensor:
        """The noise that the images hold; see `DiffusionPrior.predict_noise`.

        Args:
            z, t, controls: As there.
            text: Where patches come from.
            cond: Known part. Required: its images are where `PatchPrompt.part` is taken from.
            image_embeds: Not used.
        """
        assert cond is not None, "the exemplar prior needs to know the known part"
        alpha = self.schedule.alpha(t)
        noise = ((1.0 - alpha) / alpha) ** 0.5
        means = []
        for row in range(len(z)):
            known = cond.prepared[row] if cond.prepared else _known(cond.latent[row], cond.mask[row, 0])
            planes = [_control_plane(control, row, self.patches) for control in controls]
            if planes:
                known = known.with_controls(torch.stack(planes, -1).to(known.image))
            means.append(
                self._attend(z[row].permute(1, 2, 0) / alpha**0.5, noise, known, text, cond.inpainted)
            )
        return self.schedule.noise_between(z, torch.stack(means).permute(0, 3, 1, 2), t)

    def _attend(
        self, noisy: torch.Tensor, noise: float, known: Source, text: PatchPrompt, inpainted: bool
    ) -> torch.Tensor:
        """Estimate of one view, blended by the bank with those from the references' patches."""
        own = known.image if inpainted else self._mean(noisy, noise, known, _source_of(text, known))
        if self._bank is None:
            return own

        def attention(left: LeftPatches) -> torch.Tensor:
            here = known.once("hole", lambda: _middle(~known.usable))
            shift = (left.hole[0] - here[0], left.hole[1] - here[1]) if left.hole and here else (0.0, 0.0)
            return self._mean(noisy, noise, known, left.source, shift)[None]

        left = LeftPatches(own, known.controls, ~known.usable)
        return self._bank.attend(LAYER, own[None], [left], attention)[0]

    def _mean(
        self,
        noisy: torch.Tensor,
        noise: float,
        known: Source,
        source: Source,
        shift: tuple[float, float] = (0.0, 0.0),
    ) -> torch.Tensor:
        if source.controls.shape[2] == 0:
            known = known.without_controls
        return posterior_mean(noisy, noise, known, source, self.patches, self.settings, shift)


def _known(latent: torch.Tensor, mask: torch.Tensor) -> Source:
    """A view (3, H, W) as a source whose masked pixels are not usable."""
    image = latent.permute(1, 2, 0).contiguous()
    return Source(image, mask < 0.5, image.new_zeros(*mask.shape, 0))


@dataclass(frozen=True, eq=False)
class LeftPatches:
    """What a reference leaves at one timestep: its clean patches, what it now makes of its hole among them.

    Attributes:
        image: Colours in [-1, 1], shape (H, W, 3).
        controls: Of all its pixels, shape (H, W, c).
        missing: Its hole, shape (H, W), bool; empty if all of it is known.
    """

    image: torch.Tensor
    controls: torch.Tensor
    missing: torch.Tensor

    @property
    def nbytes(self) -> int:
        """What they occupy [bytes]."""
        return self.image.nbytes + self.controls.nbytes + self.missing.nbytes

    @cached_property
    def hole(self) -> tuple[float, float] | None:
        """Middle of the hole, across and down [px]: a view looks there for its own hole."""
        return _middle(self.missing)

    @cached_property
    def source(self) -> Source:
        """The patches that views take, the same for all of them.

        Of a reference with a hole only what it made of that, and the rim, are taken: in a network, too, what
        is to be invented attends to what was invented, while most patches of an image show other things.
        """
        if self.hole is None:
            return Source(self.image, torch.ones_like(self.missing), self.controls, placed=False)
        reach = int(float(self.missing.sum()) ** 0.5) // 2
        near = F.max_pool2d(self.missing[None, None].float(), 2 * reach + 1, 1, reach)[0, 0] > 0.0
        return Source(self.image, near, self.controls)


def _middle(hole: torch.Tensor) -> tuple[float, float] | None:
    """Mean place of a hole (H, W), across and down [px]; None if there is none."""
    if not bool(hole.any()):
        return None
    down, across = hole.nonzero().float().mean(0).tolist()
    return across, down


def _source_of(text: PatchPrompt, known: Source) -> Source:
    """The patches that a prompt means in one view."""
    if text.exemplar is not None:
        image = (2.0 * text.exemplar - 1.0).to(known.image)
        usable = torch.ones(image.shape[:2], dtype=torch.bool, device=image.device)
        return Source(image, usable, image.new_zeros(*usable.shape, 0), placed=False)
    if text.part == "object":
        return Source(known.image, ~known.usable, known.controls)
    return known


def _control_plane(control: Control, row: int, settings: PatchSettings) -> torch.Tensor:
    """A control as a channel of patches, shape (H, W)."""
    if control.kind == "edges":
        return edge_control(control.image[row], control.scale, settings)
    return depth_control(control.image[row].clamp(min=DEPTH_FLOOR), control.scale, settings)
