"""The scene that kernels are timed on has the statistics of the capture that it stands for."""

import pytest
import torch

from diga3d_warp.bench.garden import Garden, project_into, statistics
from diga3d_warp.splatting.render import render


def test_statistics_are_those_of_the_garden_capture():
    garden = Garden()
    gaussians = garden.gaussians()
    assert len(gaussians) == 120_000
    assert (garden.width, garden.height) == (648, 420)
    found = statistics(project_into(gaussians, garden.camera), garden.camera)
    assert found.median_radius == pytest.approx(10.0, rel=0.05)
    assert found.tile_pairs == pytest.approx(390_000, rel=0.03)
    assert found.listed_pairs == pytest.approx(360 * 648 * 420, rel=0.03)
    assert 0.9 * 120_000 < found.drawn < 120_000
    assert gaussians.opacities.min() == pytest.approx(0.2, abs=1e-3)
    assert gaussians.opacities.max() == pytest.approx(0.95, abs=1e-3)


def test_listed_pairs_are_those_of_the_pixels_of_each_tile():
    """One wide gaussian in the middle of 40 x 30 px: every tile lists it, so every pixel does, once."""
    garden = Garden(count=1, width=40, height=30, radius=10.0, radius_spread=0.0, flatness=0.0, margin=-0.4)
    found = statistics(project_into(garden.gaussians(), garden.camera), garden.camera)
    assert (found.drawn, found.tile_pairs, found.listed_pairs) == (1, 3 * 2, 40 * 30)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others():
    first, again, other = (Garden(count=50, seed=seed).gaussians() for seed in (3, 3, 4))
    for (name, one), (_, two), (_, three) in zip(first.named(), again.named(), other.named(), strict=True):
        assert torch.equal(one, two), name
        assert not torch.equal(one, three), name


@pytest.mark.parametrize("count,width,height", [(500, 160, 100), (4000, 80, 60)])
def test_every_size_covers_its_image(count, width, height):
    garden = Garden(count=count, width=width, height=height)
    image = render(garden.gaussians(), garden.camera)
    assert image.alpha.mean() > 0.9
    assert image.color.std() > 0.05
