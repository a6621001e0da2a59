"""Where the hole's gaussians start, and the depth that they are fitted to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from diga3d_warp.perception.depth import DepthEstimator
from diga3d_warp.pipelines import coarse
from diga3d_warp.pipelines.run import Run
from diga3d_warp.propagation.fill import Fill
from diga3d_warp.propagation.references import References
from diga3d_warp.propagation.unseen import Background
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


class Tilted(DepthEstimator):
    """Knows the disparity of a slanted plane, up to scale and shift; or its contrary."""

    def __init__(self, sign: float = 1.0) -> None:
        self.sign = sign

    def disparity(self, image: torch.Tensor) -> torch.Tensor:
        across = torch.linspace(0.0, 1.0, image.shape[1]).expand(image.shape[:2])
        return self.sign * (5.0 + 3.0 * across)


def estimated(tmp_path, estimator: DepthEstimator | None) -> list[Fill]:
    run = Run(tmp_path / "run", "remove", {})
    plane = (1.0 / np.broadcast_to(np.linspace(0.2, 0.5, 64), (48, 64))).astype(np.float32)
    hole = np.zeros((48, 64), bool)
    hole[10:30, 20:40] = True
    fill = replace(
        filled(True), depth=np.where(hole, 9.0, 0.0).astype(np.float32), filled=hole, invented=hole
    )
    whole = replace(fill, filled=np.zeros_like(hole))
    background = Background(hole, fill.image, ~hole)
    views = [VIEW, replace(VIEW, name="b")]
    found = coarse.estimate_depth(
        run, views, [background] * 2, [np.where(hole, 0.0, plane)] * 2, [], [fill, whole], estimator
    )
    assert np.array_equal(found[1].depth, whole.depth), "nothing was filled"
    assert np.array_equal(found[0].depth[~hole], fill.depth[~hole])
    return [found[0], replace(fill, depth=np.where(hole, plane, 0.0).astype(np.float32))]


def test_an_estimate_is_aligned_to_the_surface_around(tmp_path):
    found, true = estimated(tmp_path, Tilted())
    assert np.allclose(found.depth, true.depth, rtol=1e-4)


def test_without_a_useful_estimate_the_surroundings_are_continued(tmp_path):
    assert estimated(tmp_path / "none", None)[0].depth.max() == 9.0
    assert estimated(tmp_path / "contrary", Tilted(-1.0))[0].depth.max() == 9.0
