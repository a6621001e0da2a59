"""The exemplar prior on textures whose truth is known, and at the edges of its input."""

import numpy as np
import pytest
import torch
from known_textures import HEIGHT, TEXTURES, WIDTH, error_db, grid, hole, spoilt
from scipy.ndimage import gaussian_filter

from diga3d_warp.errors import InputError
from diga3d_warp.priors.classical import telea_fill
from diga3d_warp.priors.exemplar.prior import ExemplarPrior
from diga3d_warp.priors.exemplar.scales import continued
from diga3d_warp.priors.protocol import Prior


@pytest.mark.parametrize("name", TEXTURES)
def test_it_continues_a_texture_where_telea_cannot(name):
    truth, mask = TEXTURES[name](), hole()
    image = spoilt(truth, mask)
    filled = ExemplarPrior().fill(image, mask)
    assert error_db(filled, truth, mask) > error_db(telea_fill(image, mask), truth, mask) + 4.0
    assert error_db(filled, truth, mask) > 19.0


def test_unmasked_pixels_are_returned_exactly_and_masked_ones_are_not_looked_at():
    truth, mask = TEXTURES["bricks"](), hole()
    mask[80:, 110:] = True
    filled = ExemplarPrior().fill(truth, mask)
    assert torch.equal(filled[~mask], truth[~mask])
    assert filled.dtype == torch.float32
    assert filled.min() >= 0.0 and filled.max() <= 1.0
    assert torch.equal(ExemplarPrior().fill(spoilt(truth, mask), mask), filled)


def test_a_seed_gives_the_same_bytes_and_another_gives_others(threads):
    truth, mask = TEXTURES["boundary"](), hole()
    prior = ExemplarPrior()
    threads(1)
    first = prior.fill(truth, mask, seed=3)
    threads(3)
    assert torch.equal(prior.fill(truth, mask, seed=3), first)
    assert not torch.equal(prior.fill(truth, mask, seed=4), first)


def test_the_largest_seed_is_a_seed():
    truth, mask = TEXTURES["boundary"](), hole()
    filled = ExemplarPrior().fill(spoilt(truth, mask), mask, seed=2**31 - 1)
    assert error_db(filled, truth, mask) > 19.0


def test_the_depth_behind_tells_which_surface_goes_on():
    """A hole between a near and a far surface is filled by whichever lies behind it."""
    rows, columns = grid()
    near = 0.2 + 0.05 * np.sin(columns)[..., None] * np.ones(3)
    far = 0.8 + 0.05 * np.sin(rows)[..., None] * np.ones(3)
    image = torch.from_numpy(np.where((columns < 64)[..., None], near, far)).float()
    mask = torch.from_numpy((abs(rows - 48) < 20) & (abs(columns - 64) < 20))
    for depth_inside, level in ((2.0, 0.2), (6.0, 0.8)):
        depth = torch.from_numpy(np.where(columns < 64, 2.0, 6.0)).float()
        depth[mask] = depth_inside
        filled = ExemplarPrior().fill(image, mask, depth=depth)
        assert abs(float(filled[mask].mean()) - level) < 0.08


def test_an_empty_mask_changes_nothing():
    image = TEXTURES["stripes"]()
    assert torch.equal(ExemplarPrior().fill(image, torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)), image)


def test_what_cannot_be_filled_is_refused():
    image, prior = TEXTURES["stripes"](), ExemplarPrior()
    with pytest.raises(InputError, match="whole image"):
        prior.fill(image, torch.ones(HEIGHT, WIDTH, dtype=torch.bool))
    with pytest.raises(InputError, match="do not fit"):
        prior.fill(image, torch.zeros(HEIGHT - 1, WIDTH, dtype=torch.bool))
    for depth in (
        torch.zeros(HEIGHT, WIDTH),
        torch.ones(HEIGHT, WIDTH - 1),
        torch.full((HEIGHT, WIDTH), np.nan),
    ):
        with pytest.raises(InputError, match="depth"):
            prior.fill(image, hole(), depth=depth)


@pytest.mark.parametrize("size", [(1, 2), (8, 8), (20, 300), (40, 41)])
def test_small_images(size):
    image = TEXTURES["bricks"]().repeat(1, 3, 1)[: size[0], : size[1]]
    mask = torch.zeros(size, dtype=torch.bool)
    mask[size[0] // 3 : 2 * size[0] // 3 + 1, : size[1] // 3 + 1] = True
    filled = ExemplarPrior().fill(image, mask)
    assert torch.equal(filled[~mask], image[~mask])
    assert torch.isfinite(filled).all()


@pytest.mark.parametrize(
    "known", [(slice(0, 96), slice(0, 3)), (slice(0, 1), slice(0, 1)), (slice(0, 40), slice(0, 20))]
)
def test_little_surroundings_still_give_a_whole_image(known):
    image = TEXTURES["bricks"]()
    mask = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    mask[known] = False
    filled = ExemplarPrior().fill(spoilt(image, mask), mask)
    assert torch.isfinite(filled).all()
    assert filled[mask].mean() > 0.1


def test_it_is_a_prior():
    prior: Prior = ExemplarPrior()
    assert prior.name == "exemplar"


def test_what_stands_beside_the_hole_does_not_spread_into_a_lawn():
    """A dark bush touches the hole on one side, rough grass on all others: most of the hole is grass."""
    random = np.random.default_rng(2)
    rows, columns = grid()
    rough = gaussian_filter(random.standard_normal((HEIGHT, WIDTH, 1)), (1, 1, 0))
    grass = np.array([0.3, 0.5, 0.2]) + 0.42 * rough
    bush = np.array([0.1, 0.15, 0.08]) + 0.06 * random.standard_normal((HEIGHT, WIDTH, 1))
    standing = ((rows - 45) ** 2 + (columns - 98) ** 2 < 24**2)[..., None]
    image = torch.from_numpy(np.where(standing, bush, grass)).float().clamp(0.0, 1.0)
    mask = hole() & torch.from_numpy(~standing[..., 0])
    spread = []
    for seed in range(3):
        filled = ExemplarPrior().fill(spoilt(image, mask), mask, seed=seed)
        off = (filled - torch.tensor([0.3, 0.5, 0.2])).abs().mean(-1)[mask]
        spread.append(float((off > 0.2).float().mean()))
        assert filled[mask].std(0).mean() > 0.5 * grass.std(axis=(0, 1)).mean(), "not blurred away"
    assert np.mean(spread) < 0.26


def test_colours_go_on_smoothly_along_a_surface():
    """A wall that gets lighter upwards behind a floor: each goes on under its own controls."""
    rows, columns = torch.meshgrid(torch.arange(40.0), torch.arange(50.0), indexing="ij")
    usable = (rows - 20) ** 2 + (columns - 22) ** 2 > 12**2
    plane = torch.stack([0.01 * rows, 0.02 * columns - 0.01 * rows, columns / 50], -1)
    nothing = torch.zeros(40, 50, 0)
    smooth = continued(torch.where(usable[..., None], plane, 9.0), usable, nothing)
    assert torch.equal(smooth[usable], plane[usable])
    torch.testing.assert_close(smooth, plane, atol=0.06, rtol=0.0)
    floor = (rows > 17)[..., None]
    scene = torch.where(floor, 0.2, 0.9)
    apart = continued(torch.where(usable[..., None], scene, 9.0), usable, floor.float())
    torch.testing.assert_close(apart, scene, atol=0.01, rtol=0.0)
