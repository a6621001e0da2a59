"""Targets of a fit: images, depth and weights that renderings are compared with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.photographs.images import BACKGROUND

Guide = Callable[[torch.Tensor, float, torch.Generator], torch.Tensor]
"""Loss of a rendering (H, W, 3), given the part of the fit that is done, in [0, 1], and the generator of
random numbers, whose state is in the checkpoint."""


@dataclass(frozen=True, eq=False)
class Target:
    """Image and depth of one camera that the gaussians are fitted to.

    Attributes:
        camera: Camera at the size of the image.
        image: RGB, shape (H, W, 3), float32 in [0, 1] or uint8; over `BACKGROUND` where it is transparent.
        weight: Trust in each pixel in [0, 1], shape (H, W); None for 1 everywhere. A pixel of weight 0
            receives no gradient.
        depth: z along the camera axis [scene units], shape (H, W); 0 where it is not known. None: nowhere.
        relative_depth: `depth` is right up to scale and shift only, as from a monocular estimator; it is
            aligned to the rendering at every step.
        guide: Further loss on the rendering, such as score distillation; None for none.
        alpha: Opacity of the image, shape (H, W), uint8. None: the image is compared as it is, over the
            default background of `render`.
    """

    camera: Camera
    image: torch.Tensor
    weight: torch.Tensor | None = None
    depth: torch.Tensor | None = None
    relative_depth: bool = False
    guide: Guide | None = None
    alpha: torch.Tensor | None = None

    @property
    def color(self) -> torch.Tensor:
        """The image as float32 in [0, 1]."""
        return self.image.float() / 255.0 if self.image.dtype == torch.uint8 else self.image

    def over(self, behind: torch.Tensor) -> torch.Tensor:
        """The image over another background (3,), RGB in [0, 1]."""
        if self.alpha is None:
            return self.color
        through = 1.0 - self.alpha.float()[..., None] / 255.0
        return self.color + through * (behind - behind.new_tensor(BACKGROUND))

    @property
    def solid_weight(self) -> torch.Tensor | None:
        """`weight` as far as the image is opaque, shape (H, W); None for 1 everywhere."""
        if self.alpha is None:
            return self.weight
        opacity = self.alpha.float() / 255.0
        return opacity if self.weight is None else self.weight * opacity

    def halved(self) -> Target:
        """The target at half the size; depth, which has no mean across an edge, and guide are dropped."""
        size = (max(1, self.camera.height // 2), max(1, self.camera.width // 2))

        def shrink(planes: torch.Tensor) -> torch.Tensor:
            return torch.nn.functional.interpolate(planes[None], size, mode="area")[0]

        color = shrink(self.color.permute(2, 0, 1)).permute(1, 2, 0).contiguous()
        if self.image.dtype == torch.uint8:
            color = (color * 255.0).round().to(torch.uint8)
        weight = None if self.weight is None else shrink(self.weight[None])[0]
        alpha = self.alpha
        if alpha is not None:
            alpha = shrink(alpha.float()[None])[0].round().to(torch.uint8)
        return replace(
            self,
            camera=self.camera.resized(size[1], size[0]),
            image=color,
            weight=weight,
            depth=None,
            guide=None,
            alpha=alpha,
        )
