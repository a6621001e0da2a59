"""The stages that fill charts and views: views that the user filled, and what no reference shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from diga3d_warp.pipelines import charting, coarse
from diga3d_warp.pipelines.method import WARPED
from diga3d_warp.pipelines.run import Run
from diga3d_warp.propagation.references import References
from diga3d_warp.propagation.unseen import Background
from diga3d_warp.scene.scene import Points, View
from diga3d_warp.surfaces.compose import compose
from tabletop import EYES, HOLE, camera_at, level, photo, photos, truth

GREEN = np.array([20, 220, 20], np.uint8)
NO_POINTS = Points(np.zeros((0, 3)), np.zeros((0, 3), np.uint8))


class Grey:
    """A prior that fills with grey."""

    name = "grey"
    learned = True  # fills all of a chart

    def fill(
        self, image: torch.Tensor, mask: torch.Tensor, *, seed: int = 0, depth: torch.Tensor | None = None
    ) -> torch.Tensor:
        return torch.where(mask[..., None], 0.5, image)


def inputs(seen):
    """Views, backgrounds and depths of photographs."""
    views = [View(str(number), each.camera, each.pixels) for number, each in enumerate(seen)]
    backgrounds = [
        Background(each.unseen, each.pixels / np.float32(255.0), np.zeros_like(each.unseen)) for each in seen
    ]
    return views, backgrounds, [each.depth for each in seen]


@pytest.fixture(scope="module")
def green(tmp_path_factory):
    """One view filled in green by the user: what was seen, the charts, the fills, and the user's view."""
    seen = photos()
    views, backgrounds, depths = inputs(seen)
    image = (truth(seen[0].camera) * 255.0).astype(np.uint8)
    image[seen[0].unseen] = GREEN
    own = {"0": image}
    # The splat is a percent too deep: what its surroundings continue is, too.
    deep = [np.float32(1.01) * depth for depth in depths]
    run = Run(tmp_path_factory.mktemp("green") / "run", "remove", {})
    charts = charting.chart_surfaces(run, views, backgrounds, depths, NO_POINTS, Grey(), WARPED, 0, own)
    references = References([0], np.zeros(len(views), int))
    fills = coarse.fill_views(run, views, backgrounds, deep, charts, references, Grey(), WARPED, 0, own)
    return seen, charts, fills, image


def test_charts_take_on_the_colours_of_the_users_view(green):
    seen, charts, _, _ = green
    for each in seen[1:]:
        colors = compose(charts, each.camera).image[each.unseen]
        assert np.mean(np.abs(colors * 255.0 - GREEN).max(axis=1) < 40) > 0.7
    assert all(chart.wanted.any() and not (chart.known & chart.wanted).any() for chart in charts)


def test_the_users_view_is_kept_and_lies_on_the_chart(green):
    seen, _, fills, image = green
    hole = seen[0].unseen
    np.testing.assert_allclose(fills[0].image[hole] * 255.0, image[hole], atol=0.6)
    np.testing.assert_allclose(fills[0].depth[hole], level(seen[0].camera, 0.0)[hole], rtol=0.004)


def test_other_views_follow_the_users_view(green):
    seen, _, fills, _ = green
    for each, fill in zip(seen[1:], fills[1:], strict=True):
        assert not (fill.missing & each.unseen).any()
        assert np.mean(fill.image[each.unseen][:, 1] > 0.6) > 0.7, "green"


@pytest.mark.parametrize(("propagation", "most"), [("warp", 0.05), ("none", 1.0)])
def test_what_no_reference_shows_is_filled_where_fills_are_warped(tmp_path, propagation, most):
    seen = [photo(camera_at(eye), hole=HOLE if k < 2 else 2 * HOLE) for k, eye in enumerate(EYES)]
    views, backgrounds, depths = inputs(seen)
    references = References([0, 1], np.array([0, 1, 0, 1]))
    method = replace(WARPED, propagation=propagation)
    run = Run(tmp_path / "run", "remove", {})
    fills = coarse.fill_views(run, views, backgrounds, depths, [], references, Grey(), method, 0)
    left = [fill.missing.sum() / each.unseen.sum() for fill, each in zip(fills, seen, strict=True)]
    assert max(left) < most if most < 1.0 else min(left[2:]) > 0.3, "every view is filled on its own later"
