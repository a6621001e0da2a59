"""Clean patches that the prior draws from: an image, which part of it may be used, and its controls."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
import warp as wp

from diga3d_warp.kernels.patches import LANES, Keys, PatchForm
from diga3d_warp.priors.exemplar.scales import shrunk
from diga3d_warp.priors.exemplar.settings import PATCHES, PatchSettings
from diga3d_warp.splatting.arrays import warp_array


@dataclass(frozen=True, eq=False)
class Source:
    """An image to take patches from.

    Attributes:
        image: Colours in [-1, 1], shape (H, W, 3), float32.
        usable: Whose pixels may be taken, shape (H, W), bool.
        controls: What patches must agree in besides colours, shape (H, W, c). See `depth_control`.
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


def depth_control(depth: torch.Tensor, scale: float = 1.0, settings: PatchSettings = PATCHES) -> torch.Tensor:
    """A control channel whose square difference weighs as `PatchSettings.depth` says.

    Args:
        depth: z along the camera axis, positive, in any unit, or its reciprocal, shape (H, W).
        scale: Weight of the control [1].
        settings: Costs.
    """
    return scale * _root_of(settings.depth) * torch.log(depth.float())


def edge_control(edges: torch.Tensor, scale: float = 1.0, settings: PatchSettings = PATCHES) -> torch.Tensor:
    """A control channel whose square difference weighs as `PatchSettings.edges` says.

    Args:
        edges: 1 on edges, else 0, shape (H, W).
        scale: Weight of the control [1].
        settings: Costs.
    """
    return scale * _root_of(settings.edges) * edges.float()


def _root_of(cost: float) -> float:
    """A cost stands for a square difference of each of the three colours."""
    return (3.0 * cost) ** 0.5


def _widened(mask: torch.Tensor, radius: int) -> torch.Tensor:
    """A mask dilated by a square."""
    return F.max_pool2d(mask[None, None].float(), 2 * radius + 1, 1, radius)[0, 0] > 0.0
