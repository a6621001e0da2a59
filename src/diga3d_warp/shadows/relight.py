"""Take a shadow back: divide by the share of the light that it left, in linear light."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.propagation.unseen import OPAQUE
from diga3d_warp.scene.scene import View
from diga3d_warp.shadows.find import Shadow
from diga3d_warp.shadows.settings import SHADOWS, ShadowSettings
from diga3d_warp.surfaces.photo import DIAGONAL


@dataclass(frozen=True, eq=False)
class Shaded:
    """Where a view shows a shadow.

    Attributes:
        ratio: Share of the light that is left, of each channel, shape (H, W, 3), float32; 1 elsewhere.
        where: What is relit, shape (H, W), bool.
        black: What is too dark to be relit, shape (H, W), bool; apart from `where`.
    """

    ratio: np.ndarray
    where: np.ndarray
    black: np.ndarray


def shaded_in(view: View, depth: np.ndarray, shadow: Shadow, settings: ShadowSettings = SHADOWS) -> Shaded:
    """Where a view shows a shadow.

    Args:
        view: The photograph.
        depth: z of the splat without the object [scene units], shape (H, W); 0 where it shows nothing.
        shadow: On the support.
        settings: How near the depth must be to the support.
    """
    import cv2

    column, row, z = shadow.frame.meet(view.camera)
    x, y = (np.where(np.isfinite(each), each, -9.0).astype(np.float32) for each in (column, row))
    left = cv2.remap(
        shadow.ratio, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(1.0, 1.0, 1.0)
    )
    ratio = np.asarray(left, np.float32)
    with np.errstate(invalid="ignore"):
        on = (depth > 0.0) & (np.abs(depth - z) <= settings.depth * z)
    radius = max(1, round(settings.speck * float(np.hypot(*depth.shape)) / DIAGONAL))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
    closed = cv2.morphologyEx(on.astype(np.uint8), cv2.MORPH_CLOSE, disc)
    on = cv2.morphologyEx(closed, cv2.MORPH_OPEN, disc) > 0
    if view.alpha is not None:
        on &= view.alpha >= OPAQUE
    level = ratio.mean(axis=2)
    dark = on & (level < settings.shaded)
    black = dark & (level < settings.black)
    return Shaded(np.where(dark[..., None], ratio, 1.0).astype(np.float32), dark & ~black, black)


def relit_view(view: View, shaded: Shaded) -> View:
    """A photograph without the shadow; pixels outside `Shaded.where` keep their bits."""
    if not shaded.where.any():
        return view
    pixels = view.pixels.copy()
    colors = pixels[shaded.where].astype(np.float64) / 255.0
    pixels[shaded.where] = np.clip(relit(colors, shaded.ratio[shaded.where]) * 255.0 + 0.5, 0.0, 255.0)
    return replace(view, pixels=pixels)


def relit(colors: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """sRGB colours (..., 3) as they are in full light."""
    return colors * np.maximum(ratio, 1e-3) ** (-1.0 / GAMMA)


def relit_gaussians(
    gaussians: Representation, shadow: Shadow, settings: ShadowSettings = SHADOWS
) -> tuple[Representation, torch.Tensor]:
    """Gaussians or anchors on the support with the shadow taken from their colours.

    Args:
        gaussians: N gaussians or anchors.
        shadow: On the support.
        settings: What counts as shaded.

    Returns:
        The gaussians, and which were changed, shape (N,), bool.
    """
    from scipy.ndimage import map_coordinates

    local = shadow.frame.coordinates(gaussians.means.double().numpy())
    u, v = local[:, 0], local[:, 1]
    column, row = shadow.frame.texels(u, v)
    ratio = np.stack(
        [
            map_coordinates(shadow.ratio[..., channel], [row, column], order=1, mode="constant", cval=1.0)
            for channel in range(3)
        ],
        axis=1,
    )
    near = np.abs(local[:, 2] - shadow.frame.height(u, v)) <= shadow.floor
    changed = near & (ratio.mean(axis=1) < settings.shaded)
    factor = np.maximum(ratio[changed], settings.black) ** (-1.0 / GAMMA)
    rows = torch.from_numpy(changed)
    return gaussians.brightened(rows, torch.from_numpy(factor)), rows
