"""The classical prior on textures whose truth is known, and at the edges of its input."""

from ctypes import CDLL, c_int, c_size_t, c_void_p

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


def tiles(height=130, width=140) -> torch.Tensor:
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
    truth = tiles() + 0.02 * torch.rand(130, 140, 3, generator=torch.Generator().manual_seed(0))
    mask = hole(truth, slice(25, 49), slice(35, 61))
    spoilt = truth.clone()
    spoilt[mask] = torch.tensor([1.0, 0.0, 0.0])
    scores = {name: error_db(fill(spoilt, mask), truth, mask) for name, fill in FILLS.items()}
    assert scores["classical"] > 25.0
    assert scores["classical"] > max(scores["telea"], scores["mean"]) + 8.0


@pytest.mark.parametrize("name", FILLS)
def test_unmasked_pixels_are_returned_exactly_and_masked_ones_are_not_looked_at(name):
    generator = torch.Generator().manual_seed(0)
    image = (tiles() + 0.05 * torch.rand(130, 140, 3, generator=generator)).clamp(0, 1)
    mask = hole(image, slice(20, 36), slice(124, 140))
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
    mask = hole(image, slice(30, 42), slice(20, 32)) | hole(image, slice(90, 98), slice(110, 120))
    prior = ClassicalPrior()
    assert torch.equal(prior.fill(image, mask, seed=3), prior.fill(image, mask, seed=3))


def test_what_lay_in_freed_memory_does_not_matter():
    """OpenCV may read past a table of 480 bytes; the fill must not depend on what lies there."""
    libc = CDLL(None)
    if not hasattr(libc, "gnu_get_libc_version"):
        pytest.skip("the block is found by the way glibc allocates")
    libc.malloc.restype, libc.free.argtypes = c_void_p, [c_void_p]
    libc.memset.argtypes = [c_void_p, c_int, c_size_t]
    image = tiles(56, 58) + 0.02 * torch.rand(56, 58, 3, generator=torch.Generator().manual_seed(0))
    mask = hole(image, slice(20, 32), slice(20, 34))
    fills = []
    for value in (0x00, 0x11):
        blocks = [libc.malloc(488) for _ in range(200)]
        for block in blocks:
            libc.memset(block, value, 488)
        for block in blocks:
            libc.free(block)
        fills.append(ClassicalPrior().fill(image, mask))
    assert torch.equal(*fills)


@pytest.mark.parametrize("name", FILLS)
def test_an_empty_mask_changes_nothing(name):
    image = tiles()
    assert torch.equal(FILLS[name](image, torch.zeros(130, 140, dtype=torch.bool)), image)


@pytest.mark.parametrize("name", FILLS)
def test_a_mask_over_everything_is_refused(name):
    with pytest.raises(InputError, match="whole image"):
        FILLS[name](tiles(), torch.ones(130, 140, dtype=torch.bool))
    with pytest.raises(InputError, match="do not fit"):
        FILLS[name](tiles(), torch.zeros(129, 140, dtype=torch.bool))


@pytest.mark.parametrize(
    "known", [(slice(0, 130), slice(0, 3)), (slice(0, 1), slice(0, 1)), (slice(0, 40), slice(0, 20))]
)
def test_little_surroundings_still_give_a_whole_image(known):
    image = tiles()
    mask = ~hole(image, *known)
    filled = ClassicalPrior().fill(image, mask)
    assert torch.isfinite(filled).all()
    assert filled[mask].mean() > 0.1


@pytest.mark.parametrize("size", [(8, 8), (20, 300), (56, 58)])
def test_small_images(size):
    """Too small for OpenCV as they are: see `ClassicalSettings.side_min`."""
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


def test_a_hole_as_wide_as_the_image_is_filled_from_below():
    """Strips at its top have nothing known beside them."""
    torch.manual_seed(0)
    image = 0.2 + 0.2 * torch.rand(120, 100, 3)
    mask = torch.zeros(120, 100, dtype=torch.bool)
    mask[:70] = True
    image[:70] = torch.tensor([1.0, 0.0, 0.0])
    filled = ClassicalPrior().fill(image, mask)
    assert (filled[:70, :, 0] < 0.6).all(), "nothing red is left"
