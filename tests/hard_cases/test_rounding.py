"""What rounding to float32 leaves: 1e-4 in colour and 1e-3 in gradients, where no cut-off falls otherwise."""

from dataclasses import replace

import pytest
import torch

from diga3d_warp.bench.accuracy.rounding import Margin, decided_pixels, rounding
from diga3d_warp.bench.accuracy.scenes import Subject, subjects
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera
from scenes import camera_at, random_gaussians

NEEDLES = 24


def needles(width: int) -> Subject:
    """Needles a pixel thin through the middle of an image, in all directions, from border to border."""
    camera = Camera(width, width * 3 // 4, 0.75 * width, 0.75 * width, width / 2, width * 3 / 8, torch.eye(4))
    half = torch.pi * (torch.arange(NEEDLES) + 0.3) / NEEDLES / 2
    random = torch.Generator().manual_seed(1)
    zero = torch.zeros(NEEDLES)
    gaussians = Gaussians(
        means=torch.tensor([0.0, 0.0, 2.0]) + 0.3 * (torch.rand(NEEDLES, 3, generator=random) - 0.5),
        log_scales=torch.tensor([[0.0, -12.0, -12.0]]).repeat(NEEDLES, 1),
        quaternions=torch.stack([half.cos(), zero, zero, half.sin()], -1),
        opacity_logits=torch.linspace(-1.0, 4.0, NEEDLES),
        sh=torch.rand(NEEDLES, 1, 3, generator=random),
    )
    return Subject(f"{width} px", gaussians, camera)


@pytest.mark.parametrize("width", [100, 400, 800])
def test_needles_across_an_image(width):
    """Expanded into products of offsets, their exponent is off by 4e-3 at 800 px."""
    found = rounding(needles(width), Margin(alpha=1e-3, transmittance=1e-2))
    assert found.undecided < 0.2
    assert found.decided.largest < 1e-4
    assert found.decided.gradient < 1e-3


@pytest.mark.parametrize("subject", subjects(), ids=lambda subject: subject.name)
def test_scenes_of_the_benchmark(subject):
    found = rounding(replace(subject, camera=subject.camera.resized(120, 90)))
    assert found.undecided < 0.02
    assert found.decided.largest < 1e-4
    assert found.error.gradient < 1e-3, "of all pixels"


def test_a_pixel_at_the_edge_of_a_splat_is_undecided():
    """The wider the margin, the more pixels; the mask is what the sharp bounds above are claimed for."""
    camera = camera_at("none", 20, 15)
    subject = Subject("one", random_gaussians(30), camera)
    narrow, wide = (decided_pixels(subject, Margin(alpha=share)) for share in (1e-6, 0.2))
    assert narrow.float().mean() > wide.float().mean()
    assert wide.any() and not wide.all()
    assert (narrow | ~wide).all()
