"""Clean patches that the prior draws from: an image, which part of it may be used, and its controls."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import torch
import torch.nn.functional as F
import warp as wp

from diga3d_warp.kernels.patches import LANES, Keys, PatchForm
from diga3d_warp.priors.exemplar.scales import shrunk
from diga3d_warp.priors.exemplar.settings import PATCHES, PatchSettings
from diga3d_warp.splatting.arrays import warp_array

Made = TypeVar("Made")


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
    _made: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False)

    def once(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """What `make` makes of this source alone, made when it is first asked for.

        A source is read at many noise levels and by many views; its scales are the same each time.
        """
        if key not in self._made:
            self._made[key] = make()
        made: Made = self._made[key]
        return made

    def at(self, size: tuple[int, int], settings: PatchSettings = PATCHES) -> SourceScale:
        """The source shrunk to a size [px]."""
        return self.once(("keys", size, settings), lambda: self._at(size, settings))

    def with_controls(self, controls: torch.Tensor) -> Source:
        """The same source with other controls (H, W, c); what was made for equal ones is kept."""
        if controls.shape == self.controls.shape and torch.equal(controls, self.controls):
            return self
        last: Source | None = self._made.get("controlled")
        if last is None or last.controls.shape != controls.shape or not torch.equal(last.controls, controls):
            last = Source(self.image, self.usable, controls, self.placed)
            self._made["controlled"] = last
        return last

    @cached_property
    def without_controls(self) -> Source:
        """The same source without controls, for patches that have none."""
        if self.controls.shape[2] == 0:
            return self
        return Source(self.image, self.usable, self.controls[..., :0], self.placed)

    def _at(self, size: tuple[int, int], settings: PatchSettings) -> SourceScale:
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
        shift: Displacement from a query to where a placed source shows the same, across and down [px].
    """

    features: torch.Tensor
    centers: torch.Tensor
    placed: bool
    shift: tuple[float, float] = (0.0, 0.0)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width [px]."""
        return self.centers.shape[0], self.centers.shape[1]

    @cached_property
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
        factor = self.centers.float() if scale is None else self.centers * scale
        return Keys(
            warp_array(self._values, wp.float32),
            warp_array(factor.reshape(-1), wp.float32),
            self.features.shape[1],
        )

    @cached_property
    def _values(self) -> torch.Tensor:
        """Features in a row, with the slack that the kernels read."""
        return torch.cat([self.features.reshape(-1), self.features.new_zeros(LANES)])


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
