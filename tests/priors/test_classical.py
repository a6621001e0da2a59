"""The classical prior on textures whose truth is known, and at the edges of its input."""

import numpy as np
import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.classical import ClassicalPrior, ClassicalSettings, mean_color_fill, telea_fill
from diga3d_warp.priors.protocol import Prior

FILLS = {
    "classical": lambda image, mask: ClassicalPrior().fill(image, mask),
    "telea": telea_fill,
    "mean": mean_color_fill,
}


def tiles(height=72, width=96) -> torch.Tensor:
    """Two-coloured tiles with dark joints: a pattern that continues exactly."""
    rows, columns = np.mgrid[:height, :width]
    odd = ((rows // 12 + columns // 12) % 2)[..., None]
    image = np.where(odd, [0.8, 0.5, 0.3], [0.3, 0.5, 0.7])
    joint = (rows % 12 < 2) | (columns % 12 < 2)
    image[joint] = 0.15
    return torch.tensor(image, dtype=torch.float32)


def hole(image: torch.Tensor, rows: slice, columns: slice) -> torch.Tensor:
    mask = torch.zeros(image.shape[:2], dtype=torch.bool)
    mask[rows, columns] = True
    return mask


def error_db(filled, truth, mask) -> float:
    return float(-10 * torch.log10((filled - truth)[mask].square().mean()))


def test_it_continues_a_pattern_where_the_baselines_cannot():
    truth = tiles()
    mask = hole(truth, slice(25, 49), slice(35, 61))
    spoilt = truth.clone()
    spoilt[mask] = torch.tensor([1.0, 0.0, 0.0])
    scores = {name: error_db(fill(spoilt, mask), truth, mask) for name, fill in FILLS.items()}
    assert scores["classical"] > 25.0
    assert scores["classical"] > max(scores["telea"], scores["mean"]) + 8.0


@pytest.mark.parametrize("name", FILLS)
def test_unmasked_pixels_are_returned_exactly_and_masked_ones_are_not_looked_at(name):
    generator = torch.Generator().manual_seed(0)
    image = (tiles() + 0.05 * torch.rand(72, 96, 3, generator=generator)).clamp(0, 1)
    mask = hole(image, slice(20, 40), slice(70, 96))
    filled = FILLS[name](image, mask)
    assert torch.equal(filled[~mask], image[~mask])
    assert filled.dtype == torch.float32
    assert filled.min() >= 0.0 and filled.max() <= 1.0
    other = image.clone()
    other[mask] = 0.0
    assert torch.equal(FILLS[name](other, mask), filled)
    assert (filled - other)[mask].abs().mean() > 0.05


def test_the_same_seed_gives_the_same_bytes():
    image = tiles()
    mask = hole(image, slice(10, 30), slice(10, 40)) | hole(image, slice(55, 65), slice(70, 90))
    prior = ClassicalPrior()
    assert torch.equal(prior.fill(image, mask, seed=3), prior.fill(image, mask, seed=3))


@pytest.mark.parametrize("name", FILLS)
def test_an_empty_mask_changes_nothing(name):
    image = tiles()
    assert torch.equal(FILLS[name](image, torch.zeros(72, 96, dtype=torch.bool)), image)


@pytest.mark.parametrize("name", FILLS)
def test_a_mask_over_everything_is_refused(name):
    with pytest.raises(InputError, match="whole image"):
        FILLS[name](tiles(), torch.ones(72, 96, dtype=torch.bool))
    with pytest.raises(InputError, match="do not fit"):
        FILLS[name](tiles(), torch.zeros(71, 96, dtype=torch.bool))


@pytest.mark.parametrize(
    "known", [(slice(0, 72), slice(0, 3)), (slice(0, 1), slice(0, 1)), (slice(0, 40), slice(0, 20))]
)
def test_little_surroundings_still_give_a_whole_image(known):
    image = tiles()
    mask = ~hole(image, *known)
    filled = ClassicalPrior().fill(image, mask)
    assert torch.isfinite(filled).all()
    assert filled[mask].mean() > 0.1


@pytest.mark.parametrize("size", [(8, 8), (20, 300), (25, 25)])
def test_small_images(size):
    image = tiles(*size)
    mask = hole(image, slice(3, 6), slice(3, 6))
    filled = ClassicalPrior().fill(image, mask)
    assert torch.equal(filled[~mask], image[~mask])


def test_a_large_cut_out_is_filled_at_a_smaller_size():
    truth = tiles()
    mask = hole(truth, slice(25, 49), slice(35, 61))
    filled = ClassicalPrior(ClassicalSettings(largest=(48, 36))).fill(truth, mask)
    assert torch.equal(filled[~mask], truth[~mask])
    assert error_db(filled, truth, mask) > error_db(telea_fill(truth, mask), truth, mask) + 1.0


def test_it_is_a_prior():
    prior: Prior = ClassicalPrior()
    assert prior.name == "classical"
