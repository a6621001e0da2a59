"""The built-in prior: diffusion without learned weights, over the patches of the very image."""

from __future__ import annotations

import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.classical import telea_fill
from diga3d_warp.priors.exemplar.fill import fill_missing
from diga3d_warp.priors.exemplar.settings import FILL, PATCHES, FillSettings, PatchSettings
from diga3d_warp.priors.exemplar.source import Source, controls_of
from diga3d_warp.priors.protocol import check_fill


class ExemplarPrior:
    """Patch diffusion: every patch of what is invented is, up to blending, one of the photograph.

    It knows textures and edges of the image at hand and where in it they stand, but no objects: it will not
    complete a half hidden chair.

    Args:
        patches: When patches are alike.
        settings: How a hole is filled.
    """

    name = "exemplar"

    def __init__(self, patches: PatchSettings = PATCHES, settings: FillSettings = FILL) -> None:
        self.patches = patches
        self.settings = settings

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
        controls = (
            image.new_zeros(*mask.shape, 0) if depth is None else controls_of(depth, settings=self.patches)
        )
        source = Source(2.0 * image - 1.0, ~mask, controls.to(image))
        filled = fill_missing(source, seed, self.patches, self.settings)
        if filled is None:
            return telea_fill(image, mask)
        return torch.where(mask[..., None], (0.5 * filled + 0.5).clamp(0.0, 1.0), image)
