"""The patches that are to be denoised, at one scale."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
import torch.nn.functional as F
import warp as wp

from diga3d_warp.kernels.patches import Queries
from diga3d_warp.priors.exemplar.scales import continued, shrunk
from diga3d_warp.priors.exemplar.settings import PATCHES, PatchSettings
from diga3d_warp.priors.exemplar.source import Source
from diga3d_warp.splatting.arrays import warp_array


@dataclass(frozen=True, eq=False)
class QueryScale:
    """What is known and what is sought at one scale.

    Attributes:
        known: Clean colours, shape (h, w, 3); of no meaning where `missing`.
        missing: Where colours are sought, shape (h, w), bool.
        controls: As those of the source, shape (h, w, c).
        shrink: How many times smaller than the image it is [1].
        settings: Of the patches.
        smooth: How much the difference from `continuation` counts beside that from the noisy image [1].
    """

    known: torch.Tensor
    missing: torch.Tensor
    controls: torch.Tensor
    shrink: float = 1.0
    settings: PatchSettings = PATCHES
    smooth: float = 0.0

    @property
    def size(self) -> tuple[int, int]:
        """Height and width [px]."""
        return self.missing.shape[0], self.missing.shape[1]

    @property
    def width(self) -> int:
        return self.missing.shape[1]

    @cached_property
    def pixels(self) -> torch.Tensor:
        """Centres of the patches that show a missing pixel, as pixel indices, shape (N,)."""
        r = self.settings.radius
        near = F.max_pool2d(self.missing[None, None].float(), 2 * r + 1, 1, r)[0, 0] > 0.0
        return near.reshape(-1).nonzero()[:, 0].int()

    @cached_property
    def slots(self) -> torch.Tensor:
        """Index into `pixels`, -1 where there is no query, shape (h * w,), int32."""
        slots = torch.full((self.missing.numel(),), -1, dtype=torch.int32, device=self.missing.device)
        slots[self.pixels.long()] = torch.arange(len(self.pixels), dtype=torch.int32, device=slots.device)
        return slots

    @cached_property
    def targets(self) -> torch.Tensor:
        """Missing pixels, as indices, shape (M,), int32."""
        return self.missing.reshape(-1).nonzero()[:, 0].int()

    @cached_property
    def continuation(self) -> torch.Tensor:
        """The known colours going on smoothly into what is missing, shape (h, w, 3)."""
        return continued(self.known, ~self.missing, self.controls)

    def pasted(self, colors: torch.Tensor) -> torch.Tensor:
        """The known image with `colors` (h, w, 3) where colours are missing."""
        return torch.where(self.missing[..., None], colors, self.known)

    @property
    def cost_scale(self) -> float:
        """Factor on the costs of controls and of displacement; see `PatchSettings`."""
        return self.shrink**0.5

    def unit(self, noise: float) -> float:
        """What a cost of 1 counts in the distances of patches that hold noise."""
        return self.precision(noise) * 3 * self.settings.side**2

    def precision(self, noise: float) -> float:
        """1 / (2 s^2) of a missing pixel's colour, when it holds noise of this standard deviation."""
        return 0.5 / (noise**2 + self.settings.noise_min**2)

    def features(self, image: torch.Tensor) -> torch.Tensor:
        """Colours and controls, padded by the radius, shape (h + 2 r, w + 2 r, 3 + c).

        |x - k|^2 + a |m - k|^2 is (1 + a) |(x + a m) / (1 + a) - k|^2 and a term without k: so the smooth
        continuation m counts by moving the colours and, in `weights`, by their weight.
        """
        if self.smooth > 0.0:
            share = self.smooth / (1.0 + self.smooth)
            image = self.pasted(torch.lerp(image, self.continuation, share))
        return padded(torch.cat([image, self.controls], -1), self.settings.radius)

    def weights(self, noise: float) -> torch.Tensor:
        """Weights of the padded features' square differences, zero outside the image.

        Missing pixels hold noise, known ones are clean: each counts by its own variance. Controls count as
        the colours of their pixel do, so that costs keep their ratio to colours while the noise falls.
        """
        sought = self.precision(noise)
        clean = self.precision(min(noise, self.settings.known_noise))
        weight = torch.where(self.missing[..., None], sought, clean)
        controls = (self.cost_scale * weight).expand_as(self.controls)
        colors = torch.where(self.missing[..., None], 1.0 + self.smooth, 1.0) * weight.expand(-1, -1, 3)
        return padded(torch.cat([colors, controls], -1), self.settings.radius)

    def queries(self, image: torch.Tensor, noise: float) -> Queries:
        """The patches as the kernels take them.

        Args:
            image: Noisy colours where missing, clean ones elsewhere, shape (h, w, 3).
            noise: Standard deviation of the noise [1].
        """
        return Queries(
            warp_array(self.pixels, wp.int32),
            warp_array(self.slots, wp.int32),
            warp_array(self.features(image).view(-1), wp.float32),
            warp_array(self.weights(noise).view(-1), wp.float32),
            self.width,
        )


def query_at(
    known: Source, size: tuple[int, int], shrink: float, settings: PatchSettings = PATCHES
) -> QueryScale:
    """What is sought of an image at one scale: the cells that are mostly not usable.

    Args:
        known: The image; what is not usable is sought.
        size, shrink: From `scale_sizes`.
        settings: Of the patches.
    """

    def make() -> QueryScale:
        image, share = shrunk(known.image, known.usable, size)
        controls, _ = shrunk(known.controls, torch.ones_like(known.usable), size)
        missing = ~known.usable if shrink == 1.0 else share < 0.5
        return QueryScale(image, missing, controls, shrink, settings)

    return known.once(("queries", size, shrink, settings), make)


def padded(planes: torch.Tensor, radius: int) -> torch.Tensor:
    """Planes (h, w, c) with zeros around, so that each pixel is the centre of a patch."""
    return F.pad(planes, (0, 0, radius, radius, radius, radius)).contiguous()
