"""Where the hole's gaussians start."""

from __future__ import annotations

import numpy as np

from diga3d_warp.pipelines import coarse
from diga3d_warp.propagation.fill import Fill
from diga3d_warp.propagation.references import References
from diga3d_warp.scene.scene import View
from scenes import camera_at

CAMERA = camera_at()
VIEW = View("a", CAMERA, np.zeros((48, 64, 3), np.uint8))
PIXELS = 48 * 64


def filled(invented: bool) -> Fill:
    everywhere, flat = np.ones((48, 64), bool), np.full((48, 64), 3.0, np.float32)
    return Fill(np.full((48, 64, 3), 0.5, np.float32), flat, everywhere, everywhere & invented, ~everywhere)


def counts(invented: list[bool]) -> list[int]:
    """Gaussians of each view that invented something; the first two are references."""
    fills = [filled(each) for each in invented]
    references = References([0, 1], np.zeros(len(fills), int))
    return [len(seeds) for seeds in coarse.seeds_of([VIEW] * len(fills), fills, references, 1)]


def test_references_have_a_gaussian_on_each_pixel_that_they_invented():
    assert counts([True, True, False, False]) == [PIXELS, PIXELS]
    assert counts([True, False, True]) == [PIXELS, PIXELS], "a few others, too"


def test_gaussians_do_not_grow_with_the_number_of_views():
    """What no reference shows is invented in each view that sees it: one surface, many times."""
    first, second, *others = counts([True] * 22)
    assert (first, second) == (PIXELS, PIXELS)
    assert 0.2 * coarse.SEEDS_PER_REFERENCE < sum(others) <= coarse.SEEDS_PER_REFERENCE
    assert min(others) > 0
