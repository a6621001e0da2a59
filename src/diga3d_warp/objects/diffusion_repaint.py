"""Retexture by free text: a diffusion prior repaints the object in all views (paper Sec. 3.3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch

from diga3d_warp.objects.surface import Sight
from diga3d_warp.priors.conditioning import ControlScales, Guidance
from diga3d_warp.priors.editing import edit_views
from diga3d_warp.priors.protocol import DiffusionPrior
from diga3d_warp.priors.settings import SamplingSettings
from diga3d_warp.priors.views import ViewControl


class DiffusionRepainter:
    """A `Repainter` that samples a diffusion prior under any prompt.

    Shape and shading are kept in two ways: sampling starts from the inverted views, and follows their edges
    and their depth as far as the prior has ControlNets for these. That the views agree is up to attention
    propagation; unlike a material wrapped around the surface, nothing makes them agree to the pixel.

    Args:
        prior: The diffusion prior.
        guidance: Prompts of the new look, and guidance scale.
        settings: Steps, strength, batch size and weight of propagation.
        scales: Weights of edges and depth.
        inverted: Whether sampling starts from the inverted views; from noise if not.
        say: Called with a line on time and memory before sampling starts.
        progress: As in `edit_views`.
    """

    def __init__(
        self,
        prior: DiffusionPrior,
        guidance: Guidance,
        settings: SamplingSettings | None = None,
        *,
        scales: ControlScales | None = None,
        inverted: bool = True,
        say: Callable[[str], None] | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        self.name = prior.name
        self.prior = prior
        self.guidance = guidance
        self.settings = settings
        self.scales = scales or ControlScales()
        self.inverted = inverted
        self.say = say
        self.progress = progress

    def repaint(self, sights: Sequence[Sight], references: Sequence[int], seed: int) -> list[np.ndarray]:
        """See `Repainter.repaint`; inverted views bring their own noise, and need no seed."""
        images = [torch.from_numpy(sight.image) for sight in sights]
        masks = [torch.from_numpy(sight.touched) for sight in sights]
        depths = [torch.from_numpy(sight.scene_depth) for sight in sights]
        controls = {
            "edges": ViewControl("edges", images, self.scales.edges),
            "depth": ViewControl("depth", depths, self.scales.depth),
        }
        painted = edit_views(
            self.prior,
            images,
            masks,
            self.guidance,
            self.settings,
            references=references,
            controls=[controls[kind] for kind in self.prior.control_kinds],
            inverted=self.inverted,
            seed=seed,
            say=self.say,
            progress=self.progress,
        )
        return [image.numpy() for image in painted]
