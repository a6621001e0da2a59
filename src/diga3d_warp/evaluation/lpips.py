"""LPIPS: distance between two pictures in the features of VGG16 or AlexNet (Zhang et al. 2018, version 0.1).

The network is torchmetrics', which brings the linear layers; the backbone is torchvision's file, as published
for ImageNet. Over a mask it is the mean of the spatial map there, as in GScream's evaluation; over the mask's
bounding box, the LPIPS of the two crops, as in SPIn-NeRF's.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from torch.nn.functional import interpolate

from diga3d_warp.evaluation.metrics import REGIONS, bounding_box
from diga3d_warp.evaluation.weights import WeightsFile, fill, read_tensors, require

TORCHVISION = "https://download.pytorch.org/models/"

UNIT = 1e-10
"""Added to the length by which features are divided, as the package `lpips` does; torchmetrics adds 1e-8 to
its square, which differs where features are faint."""


@dataclass(frozen=True)
class Backbone:
    """A network whose features are compared.

    Attributes:
        net: Name of the backbone, as LPIPS has it.
        title: Name in tables.
        file: Weights, as torchvision publishes them.
        smallest: Least side of an image [px]: the last layer that is compared still has a pixel. For VGG
            four poolings by 2; for AlexNet a window of 11 px and stride 4, and two poolings of 3 px by 2.
    """

    net: Literal["vgg", "alex"]
    title: str
    file: WeightsFile
    smallest: int


VGG = Backbone("vgg", "LPIPS (VGG)", WeightsFile("vgg16-397923af.pth", TORCHVISION, 553), 16)
ALEX = Backbone("alex", "LPIPS (Alex)", WeightsFile("alexnet-owt-7be5be79.pth", TORCHVISION, 244), 31)


class Lpips:
    """LPIPS with one backbone."""

    def __init__(self, backbone: Backbone, weights: Path | None = None, device: str = "cpu") -> None:
        """Load the network.

        Args:
            backbone: `VGG` or `ALEX`.
            weights: Folder with the backbone's file; torch.hub's cache if None or not there.
            device: Where it runs.

        Raises:
            InputError: a library or the file is missing, or the file is damaged.
        """
        path = backbone.file.find(weights)
        require("torchmetrics", "torchvision")
        self.backbone, self.device = backbone, device
        self.network = _network(backbone, path).to(device)

    def whole(self, picture: torch.Tensor, reference: torch.Tensor) -> float:
        """LPIPS of two pictures, as `lpips.LPIPS(...)` gives it.

        Args:
            picture, reference: RGB in [0, 1], shape (H, W, 3), at least `Backbone.smallest` pixels a side.
        """
        return _mean(self._layers(self._features(picture), self._features(reference)))

    def spatial(self, picture: torch.Tensor, reference: torch.Tensor) -> torch.Tensor:
        """LPIPS around each pixel, shape (H, W), as `lpips.LPIPS(..., spatial=True)` gives it.

        Args:
            picture, reference: RGB in [0, 1], shape (H, W, 3), at least `Backbone.smallest` pixels a side.
        """
        layers = self._layers(self._features(picture), self._features(reference))
        return _map(layers, picture.shape[:2])

    def scores(
        self,
        picture: torch.Tensor,
        reference: torch.Tensor,
        mask: torch.Tensor | None = None,
        regions: Collection[str] = REGIONS,
    ) -> dict[str, float]:
        """LPIPS over the regions that have a pixel; none for too small a picture.

        Args:
            picture, reference: RGB in [0, 1], shape (H, W, 3).
            mask: True where the object is or was, shape (H, W), bool; None if unknown.
            regions: Those of `metrics.REGIONS` that are wanted. Passes through the network take the time, and
                each of "box" and "unmasked" needs its own.

        Returns:
            whole: of the two pictures. masked: mean of the spatial map over the mask. box: of the two crops
            to the mask's bounding box, grown to what the network takes. unmasked: mean of the spatial map
            over the other pixels, after the mask's were made equal.
        """
        size = picture.shape[:2]
        if min(size) < self.backbone.smallest:
            return {}
        if mask is None:
            mask, regions = torch.zeros(size, dtype=torch.bool), set(regions) & {"whole"}
        wanted = set(regions) - ({"unmasked"} if mask.all() else set())
        wanted -= set() if mask.any() else {"masked", "box"}
        scores = {}
        target = self._features(reference)
        if wanted & {"whole", "masked"}:
            layers = self._layers(self._features(picture), target)
            if "whole" in wanted:
                scores["whole"] = _mean(layers)
            if "masked" in wanted:
                scores["masked"] = float(_map(layers, size)[mask].double().mean())
        if "box" in wanted:
            rows, columns = bounding_box(mask, self.backbone.smallest)
            scores["box"] = self.whole(picture[rows, columns], reference[rows, columns])
        if "unmasked" in wanted:
            equal = torch.where(mask[..., None], reference, picture)
            outside = _map(self._layers(self._features(equal), target), size)
            scores["unmasked"] = float(outside[~mask].double().mean())
        return scores

    @torch.no_grad()
    def _features(self, picture: torch.Tensor) -> list[torch.Tensor]:
        """Features of each layer that is compared, of unit length over the channels, shape (1, C, h, w)."""
        image = 2.0 * picture.to(self.device, torch.float32).permute(2, 0, 1)[None] - 1.0
        layers = self.network.net(self.network.scaling_layer(image))
        return [layer / (layer.norm(dim=1, keepdim=True) + UNIT) for layer in layers]

    @torch.no_grad()
    def _layers(self, first: list[torch.Tensor], second: list[torch.Tensor]) -> list[torch.Tensor]:
        """Distance in each layer, at its own resolution, shape (1, 1, h, w)."""
        return [
            linear((one - other).square())
            for linear, one, other in zip(self.network.lins, first, second, strict=True)
        ]


def _mean(layers: list[torch.Tensor]) -> float:
    return sum(float(layer.double().mean()) for layer in layers)


def _map(layers: list[torch.Tensor], size: Sequence[int]) -> torch.Tensor:
    """The sum of the layers, enlarged to the picture, shape (H, W), on the CPU."""
    enlarged = [interpolate(layer, tuple(size), mode="bilinear", align_corners=False) for layer in layers]
    return torch.stack(enlarged).sum(0)[0, 0].cpu()


def _network(backbone: Backbone, path: Path) -> Any:
    """torchmetrics' network with its own linear layers and a backbone from torchvision's file."""
    from torchmetrics.functional.image import lpips

    # On the device "meta" nothing is initialised, which for VGG with its classifier takes seconds.
    with torch.device("meta"):
        network: Any = lpips._LPIPS(net=backbone.net, pretrained=False, pnet_rand=True)
    network.scaling_layer = lpips.ScalingLayer()
    linear = Path(lpips.__file__).with_name("lpips_models") / f"{backbone.net}.pth"
    published = read_tensors(path)
    # "slice2.5.weight" of LPIPS is "features.5.weight" of torchvision.
    names = {name: f"features.{name.split('.', 1)[1]}" for name in network.net.state_dict()}
    fill(network.net, {name: published.get(names[name]) for name in names}, path)
    layers = read_tensors(linear)
    fill(network.lins, {name.replace("lin", "", 1): value for name, value in layers.items()}, linear)
    return network
