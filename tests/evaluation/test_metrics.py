"""Metrics against their definitions; the two masked ways stay apart."""

import math

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from diga3d_warp.evaluation.metrics import (
    Score,
    bounding_box,
    compare,
    matched,
    mean_scores,
    psnr,
    ssim,
    ssim_map,
)

SIZE = (40, 56)


@pytest.fixture
def pair():
    generator = torch.Generator().manual_seed(3)
    truth = torch.rand(*SIZE, 3, generator=generator)
    image = (truth + 0.1 * torch.randn(*SIZE, 3, generator=generator)).clamp(0, 1)
    return image, truth


def reference_ssim(image, truth):
    """Wang et al. 2004 with the Gaussian window cut at 5 pixels, float64."""

    def blur(array):
        return gaussian_filter(array, (1.5, 1.5, 0), truncate=5 / 1.5, mode="mirror")

    a, b = image.double().numpy(), truth.double().numpy()
    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b, cov = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2, blur(a * b) - mean_a * mean_b
    c1, c2 = 0.01**2, 0.03**2
    value = (2 * mean_a * mean_b + c1) * (2 * cov + c2)
    return (value / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))).mean(2)


def test_psnr_of_a_known_error():
    truth = torch.full((*SIZE, 3), 0.5)
    assert psnr(truth + 0.1, truth) == pytest.approx(20.0, abs=1e-4)
    mask = torch.zeros(SIZE, dtype=torch.bool)
    mask[3, 4] = True
    image = truth.clone()
    image[3, 4] += 0.01
    assert psnr(image, truth, mask) == pytest.approx(40.0, abs=1e-3)
    assert psnr(image, truth, ~mask) == math.inf


def test_psnr_sums_in_double():
    # In float32, 2^24 squares of 1e-4 sum to a value that is off by several percent.
    truth = torch.zeros(2048, 2731, 3)
    assert psnr(truth + 1e-4, truth) == pytest.approx(80.0, abs=1e-4)


def test_ssim_matches_its_definition(pair):
    image, truth = pair
    expected = reference_ssim(image, truth)
    assert 0.2 < expected.mean() < 0.99
    np.testing.assert_allclose(ssim_map(image, truth).numpy(), expected, atol=1e-6)
    assert ssim(truth, truth) == pytest.approx(1.0)


def test_regions_are_apart(pair):
    image, truth = pair
    mask = np.zeros(SIZE, bool)
    mask[5:25, 10:30] = np.tri(20, dtype=bool)  # a triangle: half of its bounding box
    scores = compare(image, truth, mask)
    assert list(scores) == ["whole", "masked", "box", "unmasked"]
    error = (image - truth).double().square().numpy()
    expected = {
        "whole": error.mean(),
        "masked": error[mask].mean(),
        "box": error[5:25, 10:30].mean(),
        "unmasked": error[~mask].mean(),
    }
    for region, value in expected.items():
        assert scores[region].psnr == pytest.approx(-10 * math.log10(value), abs=1e-6)
    similarity = reference_ssim(image, truth)
    assert scores["masked"].ssim == pytest.approx(similarity[mask].mean(), abs=1e-6)
    crop = reference_ssim(image[5:25, 10:30], truth[5:25, 10:30])
    assert scores["box"].ssim == pytest.approx(crop.mean(), abs=1e-6)
    assert len({round(score.psnr, 6) for score in scores.values()}) == 4
    image[mask] = truth[mask]
    similarity = reference_ssim(image, truth)
    assert scores["unmasked"].ssim == pytest.approx(similarity[~mask].mean(), abs=1e-6)


def test_edit_does_not_reach_unmasked_figures(pair):
    image, truth = pair
    mask = np.zeros(SIZE, bool)
    mask[10:20, 10:20] = True
    before = compare(image, truth, mask)
    image[10:20, 10:20] = 0.0
    after = compare(image, truth, mask)
    assert after["unmasked"] == before["unmasked"]
    assert after["masked"].psnr < before["masked"].psnr - 3


def test_values_are_clipped_as_on_a_screen():
    bright = torch.ones(*SIZE, 3)
    assert compare(bright * 1.5, bright)["whole"].psnr == math.inf


@pytest.mark.parametrize("fill", [True, False])
def test_region_without_pixels_is_absent(pair, fill):
    regions = set(compare(*pair, np.full(SIZE, fill)))
    assert regions == ({"whole", "masked", "box"} if fill else {"whole", "unmasked"})


@pytest.mark.parametrize(
    ("pixel", "rows", "columns"),
    [((0, 0), (0, 11), (0, 11)), ((39, 55), (29, 40), (45, 56)), ((20, 30), (15, 26), (25, 36))],
)
def test_small_box_grows_to_the_window(pixel, rows, columns):
    mask = torch.zeros(SIZE, dtype=torch.bool)
    mask[pixel] = True
    assert bounding_box(mask) == (slice(*rows), slice(*columns))


def test_large_box_is_tight():
    mask = torch.zeros(SIZE, dtype=torch.bool)
    mask[4, 7] = mask[30, 50] = True
    assert bounding_box(mask) == (slice(4, 31), slice(7, 51))


def test_mean_is_over_views_that_have_the_region():
    views = [{"whole": Score(20.0, 0.5), "masked": Score(10.0, 0.1)}, {"whole": Score(30.0, 0.7)}]
    assert mean_scores(views) == {"whole": Score(25.0, pytest.approx(0.6)), "masked": Score(10.0, 0.1)}


def test_equal_images_are_null_in_json():
    assert Score(math.inf, 1.0).as_json() == {"psnr": None, "ssim": 1.0}
    for score in (Score(math.inf, 1.0), Score(21.5, 0.8)):
        assert Score.from_json(score.as_json()) == score


def test_matching_takes_exposure_out_and_nothing_else():
    generator = torch.Generator().manual_seed(4)
    truth = 0.2 + 0.5 * torch.rand(20, 24, 3, generator=generator)
    brighter = 0.05 + truth @ torch.tensor([[1.2, 0.0, 0.05], [0.0, 1.1, 0.0], [0.0, 0.02, 0.9]])
    assert psnr(brighter, truth) < 22
    assert psnr(matched(brighter, truth), truth) > 90
    noise = 0.02 * torch.randn(20, 24, 3, generator=generator)
    assert psnr(matched(truth + noise, truth), truth) == pytest.approx(psnr(truth + noise, truth), abs=0.5)
    flat = matched(torch.full_like(truth, 0.3), truth)
    torch.testing.assert_close(flat, truth.mean((0, 1)).expand_as(truth), atol=1e-4, rtol=0)


def test_matching_leaves_the_background_of_cut_out_things_alone():
    generator = torch.Generator().manual_seed(4)
    color = 0.2 + 0.5 * torch.rand(20, 24, 3, generator=generator)
    alpha = torch.randint(0, 256, (20, 24), generator=generator, dtype=torch.uint8)
    alpha[:, :8] = 0
    share = alpha[..., None] / 255.0
    over_white = share * color + (1.0 - share)
    brighter = share * (0.05 + 0.8 * color) + (1.0 - share)
    assert psnr(matched(brighter, over_white, alpha.numpy()), over_white) > 90
    assert psnr(matched(brighter, over_white), over_white) < 50
