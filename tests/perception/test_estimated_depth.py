"""Alignment of estimated depth, depth as a control, and DPT against transformers' own processor."""

import numpy as np
import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.perception.depth import DepthEstimator, align_disparity, depth_control


@pytest.fixture
def depth():
    """A slanted floor with a box on it, 1 to 6 scene units away."""
    depth = torch.linspace(6.0, 1.0, 30)[:, None].repeat(1, 40)
    depth[10:20, 10:25] *= 0.7
    return depth


def test_alignment_recovers_scale_and_shift(depth):
    disparity = (1.0 / depth - 0.3) / 0.02
    alignment = align_disparity(disparity, depth, torch.ones(30, 40, dtype=torch.bool))
    assert alignment.scale == pytest.approx(0.02, rel=1e-5)
    assert alignment.shift == pytest.approx(0.3, rel=1e-5)
    torch.testing.assert_close(alignment.depth(disparity), depth, rtol=1e-4, atol=1e-4)


def test_only_valid_pixels_count(depth):
    """The object is gone from the estimate and still in the rendered depth; some pixels show nothing."""
    rendered, valid = depth.clone(), torch.ones(30, 40, dtype=torch.bool)
    rendered[5:15, 5:15] = 0.3
    valid[5:15, 5:15] = False
    rendered[0, :3] = torch.tensor([0.0, torch.nan, torch.inf])
    alignment = align_disparity(5.0 / depth + 1.0, rendered, valid)
    torch.testing.assert_close(alignment.depth(5.0 / depth + 1.0), depth, rtol=1e-4, atol=1e-4)


def test_it_is_the_least_squares_solution(depth):
    generator = torch.Generator().manual_seed(2)
    disparity = 3.0 / depth + 0.2 * torch.randn(depth.shape, generator=generator)
    alignment = align_disparity(disparity, depth, torch.ones(30, 40, dtype=torch.bool))
    columns = np.stack([disparity.double().numpy().ravel(), np.ones(depth.numel())], 1)
    expected = np.linalg.lstsq(columns, 1.0 / depth.double().numpy().ravel(), rcond=None)[0]
    np.testing.assert_allclose([alignment.scale, alignment.shift], expected, rtol=1e-6)


def test_the_sky_stays_finite(depth):
    alignment = align_disparity(1.0 / depth, depth, torch.ones(30, 40, dtype=torch.bool))
    assert float(alignment.depth(torch.tensor([-5.0, 0.0])).max()) == pytest.approx(12.0)


def test_what_cannot_be_aligned(depth):
    everywhere = torch.ones(30, 40, dtype=torch.bool)
    with pytest.raises(InputError, match="contradicts the rendered depth"):
        align_disparity(depth, depth, everywhere)
    with pytest.raises(InputError, match="contradicts the rendered depth"):
        align_disparity(torch.ones(30, 40), depth, everywhere)
    with pytest.raises(InputError, match="fewer than 16 pixels"):
        align_disparity(1.0 / depth, depth, ~everywhere)


def test_a_control_is_bright_where_near(depth):
    control = depth_control(depth)
    assert float(control.min()) == 0.0
    assert float(control.max()) == 1.0
    order = depth.flatten().argsort()
    assert (control.flatten()[order].diff() <= 1e-6).all()


def test_a_control_with_holes(depth):
    valid = torch.ones(30, 40, dtype=torch.bool)
    valid[25:] = False
    depth[0, 0] = 0.0
    control = depth_control(depth, valid)
    assert control.isfinite().all()
    assert (control[25:] == 0.0).all()
    assert control[0, 0] == 0.0
    assert float(control.max()) == 1.0
    assert (depth_control(depth, ~valid & valid) == 0.0).all()
    assert depth_control(torch.full((4, 4), 2.0)).isfinite().all()


def test_dpt_sees_what_transformers_would_show_it(models):
    from transformers.models.dpt.image_processing_pil_dpt import DPTImageProcessorPil

    generator = torch.Generator().manual_seed(4)
    image = torch.nn.functional.interpolate(
        torch.rand(1, 3, 6, 9, generator=generator), (48, 72), mode="bicubic"
    )
    image = image[0].permute(1, 2, 0).clamp(0.0, 1.0)
    estimator = DepthEstimator.load(models / "dpt")
    found = estimator.disparity(image)
    assert found.shape == (48, 72)
    processor = DPTImageProcessorPil(size={"height": 32, "width": 32})
    pixels = processor((image * 255).round().byte().numpy(), return_tensors="pt").pixel_values
    with torch.no_grad():
        expected = estimator.model(pixels).predicted_depth
    expected = torch.nn.functional.interpolate(expected[None], (48, 72), mode="bicubic")[0, 0]
    assert float(expected.std()) > 1e-3
    assert float((found - expected).abs().max()) < 0.05 * float(expected.max() - expected.min())


def test_dpt_that_was_never_downloaded(monkeypatch, tmp_path):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    with pytest.raises(InputError, match=r"the weights of Intel/dpt-large \(1.4 GB\) are not"):
        DepthEstimator.load()


@pytest.mark.parametrize("size", [(12, 15), (48, 60)])
def test_holes_do_not_blend_into_a_resized_control(size):
    """Two planes and a hole: every pixel lies on a plane, between the two at their border, or is 0."""
    depth = torch.full((24, 30), 2.0)
    depth[:, 15:] = 4.0
    valid = torch.ones(24, 30, dtype=torch.bool)
    valid[8:16, 3:11] = False
    control = depth_control(depth, valid, size)
    assert control.shape == size and float(control.min()) == 0.0 and float(control.max()) == 1.0
    left = control[:, : size[1] // 2 - 2]
    assert set(left.unique().tolist()) == {0.0, 1.0}
    assert 0.15 < float((left == 0.0).float().mean()) < 0.30
