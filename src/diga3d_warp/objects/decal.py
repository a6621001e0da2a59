"""A glossy support: its splat has gaussians where the mirror image is, and photographs tell its plane.

A shadow on those gaussians would lie in another place from each side, away from the object. It goes onto dark
discs on the surface itself, a decal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from diga3d_warp.gaussians.initialise import FILL_WIDTH
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.objects.shadow import Shadow
from diga3d_warp.scene.camera import Camera
from diga3d_warp.surfaces.chart import Chart
from diga3d_warp.surfaces.compose import compose
from diga3d_warp.surfaces.settings import SURFACES
from diga3d_warp.surfaces.surfels import surfels


@dataclass(frozen=True)
class DecalSettings:
    """The dark discs of a shadow.

    Attributes:
        discs: Most of them: a soft shadow has no finer detail.
        lift: Height above the surface [object sizes]: in front of the gaussians on it, however these are
            sorted, and far below what one sees of an object's foot.
        faintest, darkest: Least and most opacity of a disc [1]: between them a fit can still change it, and
            its logit is finite.
    """

    discs: int = 3000
    lift: float = 0.005
    faintest: float = 1e-4
    darkest: float = 0.95


def shown_depth(chart: Chart, camera: Camera, depth: np.ndarray) -> np.ndarray:
    """Depth of what a camera sees, with the support where it is, z [scene units], shape (H, W), float32.

    Args:
        chart: Of the support.
        camera: Of any lens.
        depth: z of the splat, shape (H, W); where it is not clearly before the support, it is the support's.
    """
    layer = compose([chart], camera)
    there = (layer.chart >= 0) & (depth > (1.0 - SURFACES.agree) * layer.depth)
    return np.where(there, layer.depth, depth).astype(np.float32)


def decal(
    shadow: Shadow, chart: Chart, coefficients: int, least: float, settings: DecalSettings | None = None
) -> Gaussians | None:
    """Dark discs on a support that take as much light as a shadow does; None where it takes none.

    Args:
        shadow: Of an object on the support.
        chart: Of the support.
        coefficients: Spherical harmonics per gaussian.
        least: Share of the light that is left from which on there is no shadow [1].
        settings: Number and height of the discs.
    """
    s = settings or DecalSettings()
    light = shadow.at(chart.frame.points.reshape(-1, 3)).reshape(chart.frame.size)
    dark = (light < least) & (chart.alpha >= SURFACES.alpha)
    if not dark.any():
        return None
    black = replace(chart, image=np.zeros_like(chart.image), wanted=dark)
    (discs,) = surfels([black], coefficients, replace(SURFACES, seeds=s.discs))
    means = discs.means.double().numpy()
    # So many discs lie over one another that together they are as opaque as the shadow is dark.
    over = 2.0 * np.pi * FILL_WIDTH**2
    taken = (1.0 - shadow.at(means) ** (1.0 / GAMMA)) / over
    opacity = torch.from_numpy(np.clip(taken, s.faintest, s.darkest)).to(discs.opacity_logits)
    raised = means + s.lift * shadow.scale * chart.frame.axes[2]
    return replace(discs, means=torch.from_numpy(raised).to(discs.means), opacity_logits=torch.logit(opacity))
