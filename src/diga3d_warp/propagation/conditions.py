"""Texture and depth maps of a view, warped from its reference (paper Sec. 3.4).

The paper warps the reference, takes Canny's edges of what arrives, and estimates depth of it anew. Here the
warped depth itself is the depth map: it is the same surface in all views, unlike an estimate for each view.
Outside the mask, and where nothing is warped to, the maps are those of the view's own rendering.
"""

from __future__ import annotations

import torch

from diga3d_warp.perception.depth import depth_control
from diga3d_warp.perception.edges import canny_edges
from diga3d_warp.priors.conditioning import Control, ControlScales
from diga3d_warp.priors.windows import WHOLE
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.reproject import reproject


def texture_geometry(
    reference_image: torch.Tensor,
    reference_depth: torch.Tensor,
    reference: Camera,
    image: torch.Tensor,
    depth: torch.Tensor,
    mask: torch.Tensor,
    camera: Camera,
    window: tuple[slice, slice] = WHOLE,
    size: tuple[int, int] | None = None,
    scales: ControlScales | None = None,
) -> tuple[Control, Control]:
    """Texture map C' and depth map D' of one view, warped from the reference of its cluster.

    Both are made of the part of the view that the prior is shown, at the size at which it is shown.

    Args:
        reference_image: Inpainted reference, RGB in [0, 1], shape (H, W, 3).
        reference_depth: z in the reference's camera [scene units], shape (H, W); 0 where unknown.
        reference: Camera of the reference.
        image: The view as the splat shows it, shape (h, w, 3).
        depth: z of the splat in the view, shape (h, w).
        mask: True where the edit is, shape (h, w), bool.
        camera: Camera of the view.
        window: Rows and columns of the view that the prior is shown.
        size: Height and width at which it is shown them [px], from `Prior.native_size`; their own if None.
        scales: Weights of the two; the paper's if None.

    Returns:
        Edges and inverse depth, one row each, shape (1, *size). No edge is drawn
        near pixels that neither the reference nor the view's unmasked part shows.
    """
    scales = scales or ControlScales()
    with torch.no_grad():
        warped = reproject(reference_image, reference_depth, reference, camera)
        covered = mask & warped.visible
        known = covered | ~mask
        picture = torch.where(covered[..., None], warped.image, torch.where(known[..., None], image, 0.0))
        surface = torch.where(covered, warped.depth, depth)
        edges = canny_edges(picture[window], known[window], size)
        near = depth_control(surface[window], known[window], size)
        return Control("edges", edges[None], scales.edges), Control("depth", near[None], scales.depth)
