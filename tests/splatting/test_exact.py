"""EXACT against float64, through projection, shading and blending."""

import pytest
import torch

import oracle
from diga3d_warp.config import Accuracy
from diga3d_warp.splatting.render import render
from scenes import camera_at, random_gaussians

BLACK = torch.zeros(3, dtype=torch.float64)


@pytest.mark.parametrize("lens", ["none", "brown"])
def test_exact_is_within_a_hundred_thousandth_of_float64(lens):
    """Sigma points, per-pixel order and hardly a cut-off, all in float32."""
    gaussians, camera, accuracy = random_gaussians(150), camera_at(lens, 37, 29), Accuracy.EXACT
    means, log_scales, quaternions, logits, sh = (tensor.double() for _, tensor in gaussians.named())
    pose = camera.world_to_camera
    splats = oracle.project(
        means, log_scales, quaternions, logits, pose, camera,
        footprint="unscented", alpha_min=accuracy.alpha_min,
    )  # fmt: skip
    image = oracle.composite(
        splats.centers, splats.conics, splats.depths, splats.opacities, oracle.shade(means, sh, pose, 3),
        splats.drawn, camera.width, camera.height,
        alpha_min=accuracy.alpha_min, transmittance_min=accuracy.transmittance_min, slopes=splats.slopes,
    )  # fmt: skip
    found = render(gaussians, camera, accuracy=accuracy)
    assert image.certain.float().mean() > 0.7
    error = (found.color.double() - image.color).abs()[image.certain]
    assert image.color.std() > 0.1
    assert error.max() < 1e-5, error.max()
    standard = render(gaussians, camera)
    assert (standard.color - image.color).abs()[image.certain].max() > 1e-3, "what STANDARD gives up shows"
