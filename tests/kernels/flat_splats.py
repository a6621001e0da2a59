"""Splats given in the image plane, their images, and what the plain float64 renderer says they should be."""

from dataclasses import replace

import torch

import oracle
from diga3d_warp.config import Accuracy, Effects
from diga3d_warp.splatting.composite import Composite, composite
from diga3d_warp.splatting.project import Projection

COUNT = 200
NAMES = ("centers", "factors", "depths", "opacities", "colors")
EXACT = replace(Accuracy.EXACT, pixel_order=False)
"""Its cut-offs in one order for the whole image."""

ACCURACIES = {"draft": Accuracy.DRAFT, "standard": Accuracy.STANDARD, "exact": EXACT}


def splats(
    width: int, height: int, accuracy: Accuracy = Accuracy.STANDARD
) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """Splats of all sizes and opacities over an image, and their extents; every ninth is culled."""
    random = torch.Generator().manual_seed(3)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(shape, generator=random, dtype=torch.float64)

    axes = torch.exp(2.6 * uniform(COUNT, 2))
    angle = 6.3 * uniform(COUNT)
    turn = torch.stack([angle.cos(), -angle.sin(), angle.sin(), angle.cos()], -1).reshape(-1, 2, 2)
    covariance = turn @ torch.diag_embed(axes**2) @ turn.mT
    factor = torch.linalg.cholesky(torch.linalg.inv(covariance))
    opacities = torch.where(uniform(COUNT) < 0.2, 0.99 + 0.01 * uniform(COUNT), uniform(COUNT))
    reach = (2 * torch.log((opacities / accuracy.alpha_min).clamp_min(1))).sqrt() * 1.001
    extents = reach[:, None] * covariance.diagonal(dim1=1, dim2=2).sqrt()
    extents[::9] = 0.0
    fields = {
        "centers": uniform(COUNT, 2) * torch.tensor([width + 20, height + 20]) - 10,
        "factors": torch.stack([factor[:, 0, 0], factor[:, 1, 0], factor[:, 1, 1]], -1),
        "depths": 1 + 5 * uniform(COUNT),
        "opacities": opacities,
        "colors": 1.5 * uniform(COUNT, 3),
        "normals": torch.nn.functional.normalize(uniform(COUNT, 3) - 0.5, dim=1),
        "depth_slopes": 0.1 * (uniform(COUNT, 2) - 0.5),
    }
    return {name: values.float() for name, values in fields.items()}, extents.float()


def blended(
    width: int,
    height: int,
    device: str = "cpu",
    accuracy: Accuracy = Accuracy.STANDARD,
    effects: Effects = Effects(),
    everything: bool = True,
) -> tuple[Composite, dict[str, torch.Tensor]]:
    """An image and the leaves of its gradient; with normals and median depth if `everything`."""
    fields, extents = splats(width, height, accuracy)
    slopes = fields.pop("depth_slopes").to(device)
    leaves = {name: value.to(device).requires_grad_() for name, value in fields.items()}
    projection = Projection(
        leaves["centers"], leaves["depths"], leaves["factors"], extents.to(device), leaves["opacities"],
        slopes,
    )  # fmt: skip
    extra = {"normals": leaves["normals"], "median_depth": True} if everything else {}
    image = composite(
        projection, leaves["colors"], width, height, accuracy=accuracy, effects=effects, **extra
    )
    return image, leaves


def plainly(centers, factors, depths, *others, **options) -> oracle.Image:
    """The plain renderer's image; arguments as in `oracle.composite`, but for the factors."""
    return oracle.composite(centers, oracle.conics(factors), depths, *others, **options)


def expected(
    width: int, height: int, accuracy: Accuracy = Accuracy.STANDARD
) -> tuple[list[torch.Tensor], torch.Tensor, dict[str, torch.Tensor]]:
    """Images in the order of `Composite`, where they are certain, and the leaves."""
    fields, extents = splats(width, height, accuracy)
    slopes = fields.pop("depth_slopes").double()
    leaves = {name: value.double().requires_grad_() for name, value in fields.items()}
    image = plainly(
        *(leaves[name] for name in NAMES), extents[:, 0] > 0, width, height,
        alpha_min=accuracy.alpha_min, transmittance_min=accuracy.transmittance_min,
        extents=extents.double() if accuracy.extent == "circle" else None,
        slopes=slopes if accuracy.pixel_order else None,
    )  # fmt: skip
    normal_sum = image.weights @ leaves["normals"]
    parts = [image.color, image.depth_sum, image.transmittance, normal_sum, image.median_depth]
    return parts, image.certain, leaves


def few(count: int = 7) -> list[torch.Tensor]:
    """Leaves in float64: broad splats with alphas far from every cut-off, in the order of `whole`."""
    random = torch.Generator().manual_seed(5)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(shape, generator=random, dtype=torch.float64)

    factors = torch.tensor([0.14, 0.03, 0.17]).double() * (0.8 + 0.4 * uniform(count, 3))
    leaves = [6 * uniform(count, 2), factors, 1 + uniform(count), 0.25 + 0.3 * uniform(count)]
    return [leaf.requires_grad_() for leaf in (*leaves, uniform(count, 3), uniform(count, 3))]


def whole(
    centers, factors, depths, opacities, colors, normals, slopes: torch.Tensor | None = None
) -> tuple[torch.Tensor, ...]:
    """All five images of splats without borders, in float64; each pixel in its own order given slopes."""
    projection = Projection(centers, depths, factors, torch.full_like(centers, 50.0), opacities, slopes)
    accuracy = replace(EXACT, precision="float64", pixel_order=slopes is not None)
    return tuple(composite(projection, colors, 6, 5, accuracy=accuracy, normals=normals, median_depth=True))
