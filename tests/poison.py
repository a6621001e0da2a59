"""Values that break renderers, and what must hold of a rendering whatever went into it."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from diga3d_warp.config import SPLATTING, Accuracy, Effects
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.project import Projection
from diga3d_warp.splatting.render import Rendering, render

POISON = (
    float("nan"), float("inf"), -float("inf"), 0.0, -0.0, 1e-45, -1e-40, 1e-38, 1e38, -1e38, 3.4e38,
    0.01, 1 / 255, 16.0, -16.0, 1e6, -1e6,
)  # fmt: skip
"""Not numbers, denormals, both ends of float32, and the values at which the renderer cuts."""

FIELDS = {"means": 3, "log_scales": 3, "quaternions": 4, "opacity_logits": 1, "sh": 48}
"""Numbers of a gaussian of degree 3, by field."""

SHARED = ("pose", "intrinsics", "background")
"""Leaves that are not rows of gaussians."""

Leaves = dict[str, torch.Tensor]


def rendered(
    gaussians: Gaussians,
    camera: Camera,
    effects: Effects = Effects(),
    accuracy: Accuracy = Accuracy.STANDARD,
) -> tuple[Rendering, Leaves]:
    """A rendering after its backward pass, and the leaves that hold the gradients.

    Every number of every image has a random weight of its own in the loss.
    """
    gaussians = gaussians.detached().requires_grad_()
    shared = {
        "pose": camera.world_to_camera.clone().requires_grad_(),
        "intrinsics": camera.intrinsics.clone().requires_grad_(),
        "background": torch.tensor([0.1, 0.2, 0.3], requires_grad=True),
    }
    camera = camera.with_pose(shared["pose"]).with_intrinsics(shared["intrinsics"])
    out = render(gaussians, camera, effects=effects, accuracy=accuracy, background=shared["background"])
    random = torch.Generator().manual_seed(1)
    loss = sum((image * torch.randn(image.shape, generator=random)).sum() for _, image in images(out))
    loss.backward()
    return out, {**dict(gaussians.named()), **shared}


def images(out: Rendering) -> Iterator[tuple[str, torch.Tensor]]:
    """Every image of a rendering by name."""
    for name, value in out._asdict().items():
        if isinstance(value, torch.Tensor):
            yield name, value


def check(
    out: Rendering, leaves: Leaves, accuracy: Accuracy = Accuracy.STANDARD, effects: Effects = Effects()
) -> None:
    """All numbers are finite, images bounded, culled rows zero, and nothing untouched has a gradient."""
    for name, image in images(out):
        assert image.isfinite().all(), name
    assert out.color.min() >= 0 and out.color.max() <= SPLATTING.color_max
    assert out.alpha.min() >= 0 and out.alpha.max() <= 1
    culled = ~out.projection.visible
    for name, part in out.projection._asdict().items():
        if part is None:
            continue
        assert part.isfinite().all(), name
        assert not part[culled].any(), name
    farthest = out.projection.depths.max() if len(culled) else torch.zeros(())
    rounding = 1.0 + 1e-6 / accuracy.alpha_min  # of an alpha that is 1 - transmittance
    assert out.depth.min() >= 0 and out.depth.max() <= rounding * farthest
    if out.normals is not None:
        assert out.normals.norm(dim=2).max() <= rounding
    if out.median_depth is not None:
        seen = torch.cat([torch.zeros(1), out.projection.depths])
        assert torch.isin(out.median_depth, seen).all()
    if not effects.depth:
        assert not out.depth.any()
    faint = strongest_alpha(out.projection, *out.alpha.shape) < 0.99 * accuracy.alpha_min
    untouched = culled | faint
    for name, leaf in leaves.items():
        if leaf.grad is None:
            assert name in SHARED, name
            continue
        assert leaf.grad.isfinite().all(), name
        if name not in SHARED:
            assert not leaf.grad[untouched].any(), name


def strongest_alpha(projection: Projection, height: int, width: int) -> torch.Tensor:
    """Largest alpha of each gaussian at any pixel centre, or a rounding error above it, shape (N,)."""
    l11, l21, l22 = projection.factors.detach().double()[:, None, None].unbind(-1)
    center = projection.centers.detach().double()[:, None, None]
    dx = center[..., 0] - (torch.arange(width) + 0.5)
    dy = center[..., 1] - (torch.arange(height)[:, None] + 0.5)
    rounding = 1e-6 * ((l11 * dx).abs() + (l21 * dy).abs())  # of float32; on long needles the terms cancel
    u = ((l11 * dx + l21 * dy).abs() - rounding).clamp_min(0.0)
    strongest = -0.5 * (u**2 + (1 - 1e-6) * (l22 * dy) ** 2).flatten(1).amin(1)
    return projection.opacities.detach().double() * strongest.exp()
