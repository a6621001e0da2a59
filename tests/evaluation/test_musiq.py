"""MUSIQ's patches and positions by hand, and its network on random weights."""

import math

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.musiq import KONIQ, Musiq, _padded_to, _StandardConvolution, patches


@pytest.fixture(scope="module")
def measure(weights_of) -> Musiq:
    return Musiq(weights_of("musiq"))


def test_patches_are_centred_rows_of_32_px():
    image = torch.rand(1, 3, 40, 70, generator=torch.Generator().manual_seed(0)) + 1.0
    cut, positions = patches(image)
    assert cut.shape == (6, 3, 32, 32)
    torch.testing.assert_close(cut[1, :, 12:, 0], image[0, :, :20, 19], msg="12 px above, 13 to the left")
    assert (cut[0, :, :12] == 0).all() and (cut[0, :, :, :13] == 0).all()
    assert positions.tolist() == [0, 3, 6, 50, 53, 56], "spread over a table of 10 x 10"


def test_padding_is_tensorflows():
    ones = torch.ones(1, 1, 32, 32)
    assert _padded_to(ones, 7, 2).shape[2:] == (37, 37)
    assert _padded_to(ones, 7, 2)[0, 0, 2, 2] == 1 and _padded_to(ones, 7, 2)[0, 0, 1, 1] == 0
    assert _padded_to(ones, 1, 1).shape[2:] == (32, 32)


def test_weights_of_a_convolution_are_standardised():
    convolution = _StandardConvolution(2, 3, 3)
    image = torch.rand(1, 2, 8, 8, generator=torch.Generator().manual_seed(1))
    before = convolution(image)
    with torch.no_grad():
        convolution.weight.mul_(5.0).add_(0.7)
    torch.testing.assert_close(convolution(image), before, atol=1e-4, rtol=1e-4)


def test_score_tells_pictures_apart(measure):
    image = torch.rand(40, 70, 3, generator=torch.Generator().manual_seed(2))
    score = measure.score(image)
    assert math.isfinite(score)
    assert measure.score(image.clone()) == score
    assert abs(measure.score(0.5 * torch.ones_like(image)) - score) > 1e-4
    assert abs(measure.score(image.flip(1)) - score) > 1e-6, "positions count"


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 400)])
def test_small_and_narrow_pictures(measure, height, width):
    assert math.isfinite(measure.score(torch.full((height, width, 3), 0.25)))


def test_weights(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "hub"))
    with pytest.raises(InputError, match=r"musiq_koniq.*\(109 MB\) .*hub/pyiqa/.*IQA-PyTorch-Weights"):
        Musiq()
    torch.save({"params": {"conv_root.weight": torch.zeros(1)}}, tmp_path / KONIQ.name)
    with pytest.raises(InputError, match=r"has conv_root\.weight of shape \(1,\)"):
        Musiq(tmp_path)
