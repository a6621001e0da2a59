"""Clean patches that the prior draws from: an image, which part of it may be used, and its controls."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
import warp as wp

from diga3d_warp.kernels.patches import LANES, Keys, PatchForm
from diga3d_warp.priors.exemplar.settings import PATCHES, PatchSettings
from diga3d_warp.splatting.arrays import warp_array


@dataclass(frozen=True, eq=False)
class Source:
    """An image to take patches from.

    Attributes:
        image: Colours in [-1, 1], shape (H, W, 3), float32.
        usable: Whose pixels may be taken, shape (H, W), bool.
        controls: What patches must agree in besides colours, scaled by the roots of its costs, shape
            (H, W, c). See `controls_of`.
        placed: Whether it shows the scene from the query's camera, so that a patch far away costs.
    """

    image: torch.Tensor
    usable: torch.Tensor
    controls: torch.Tensor
    placed: bool = True

    def at(self, size: tuple[int, int], settings: PatchSettings = PATCHES) -> SourceScale:
        """The source shrunk to a size [px]."""
        image, share = shrunk(self.image, self.usable, size)
        usable = share > 0.999
        whole = ~_widened(~usable, settings.radius)
        inner = torch.zeros_like(whole)
        r = settings.radius
        inner[r : size[0] - r, r : size[1] - r] = True
        controls, _ = shrunk(self.controls, torch.ones_like(self.usable), size)
        features = torch.cat([image, controls], -1)
        return SourceScale(features, whole & inner, self.placed)


@dataclass(frozen=True, eq=False)
class SourceScale:
    """A source at one scale.

    Attributes:
        features: Colours and controls, shape (h, w, 3 + c).
        centers: Where a usable patch has its centre, shape (h, w), bool.
        placed: As in `Source`.
    """

    features: torch.Tensor
    centers: torch.Tensor
    placed: bool

    @property
    def size(self) -> tuple[int, int]:
        """Height and width [px]."""
        return self.centers.shape[0], self.centers.shape[1]

    @property
    def count(self) -> int:
        """Number of usable patches."""
        return int(self.centers.sum())

    def form(self, settings: PatchSettings = PATCHES) -> PatchForm:
        """What the patch kernels are compiled for."""
        return PatchForm(settings.radius, self.features.shape[2], settings.kept)

    def keys(self, scale: torch.Tensor | None = None) -> Keys:
        """The patches as the kernels take them.

        Args:
            scale: Factor on the distances to each, shape (h, w); 1 if None.
        """
        slack = self.features.new_zeros(LANES)
        values = torch.cat([self.features.reshape(-1), slack])
        factor = self.centers.float() if scale is None else self.centers * scale
        return Keys(
            warp_array(values, wp.float32), warp_array(factor.reshape(-1), wp.float32), self.features.shape[1]
        )


def controls_of(
    depth: torch.Tensor | None = None,
    edges: torch.Tensor | None = None,
    scales: tuple[float, float] = (1.0, 1.0),
    settings: PatchSettings = PATCHES,
) -> torch.Tensor:
    """Control channels whose square differences weigh as `settings` says.

    Args:
        depth: z along the camera axis [scene units], positive, shape (H, W).
        edges: 1 on edges, else 0, shape (H, W).
        scales: Weights of depth and edges [1].
        settings: Costs.

    Returns:
        Shape (H, W, c), float32, with c the number of controls given.
    """
    # A cost counts once for each of the three colours.
    planes = []
    if depth is not None:
        planes.append(scales[0] * (3.0 * settings.depth) ** 0.5 * torch.log(depth.float()))
    if edges is not None:
        planes.append(scales[1] * (3.0 * settings.edges) ** 0.5 * edges.float())
    return torch.stack(planes, -1)


def shrunk(
    image: torch.Tensor, usable: torch.Tensor, size: tuple[int, int]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Area means of the usable pixels.

    Args:
        image: shape (H, W, c).
        usable: shape (H, W), bool.
        size: New height and width [px].

    Returns:
        Image, shape (h, w, c), zero where nothing is usable; and the usable share, shape (h, w).
    """
    if size == tuple(usable.shape):
        return torch.where(usable[..., None], image, 0.0), usable.float()
    weights = usable.float()[None, None]
    share = F.interpolate(weights, size, mode="area")
    means = F.interpolate(image.movedim(-1, 0)[None] * weights, size, mode="area")
    means = means / share.clamp(min=1e-6)
    return means[0].movedim(0, -1).contiguous(), share[0, 0]


def _widened(mask: torch.Tensor, radius: int) -> torch.Tensor:
    """A mask dilated by a square."""
    return F.max_pool2d(mask[None, None].float(), 2 * radius + 1, 1, radius)[0, 0] > 0.0
