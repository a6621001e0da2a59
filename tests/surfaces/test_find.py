"""Charts behind the hole: found, filled, and put back into the views."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from diga3d_warp.priors.classical import ClassicalPrior
from diga3d_warp.splatting.placement import unprojected
from diga3d_warp.surfaces.chart import Chart
from diga3d_warp.surfaces.compose import compose
from diga3d_warp.surfaces.fill import fill_chart
from diga3d_warp.surfaces.find import find_charts
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.settings import SURFACES
from diga3d_warp.surfaces.surfels import surfels
from diga3d_warp.surfaces.votes import refused
from tabletop import EYES, HOLE, camera_at, checks, photo, photos, truth

NO_POINTS = np.zeros((0, 3))


class Refusing:
    """A prior that must not be asked."""

    name = "refusing"

    def fill(self, image, mask, *, seed=0, depth=None):
        raise AssertionError("the chart repeats: no prior is needed")


def filled_charts(seen: list[Photo], prior=None) -> list[Chart]:
    return [fill_chart(chart, prior or ClassicalPrior(), 0) for chart in find_charts(seen, NO_POINTS)]


def error(charts: list[Chart], each: Photo) -> np.ndarray:
    layer = compose(charts, each.camera)
    return np.abs(layer.image - truth(each.camera))[each.unseen]


@pytest.fixture(scope="module")
def patterned():
    seen = photos(waver=0.01)
    return seen, filled_charts(seen, Refusing())


def test_a_pattern_goes_on_in_every_view(patterned):
    seen, charts = patterned
    assert len(charts) == 1
    for each in seen:
        layer = compose(charts, each.camera)
        assert (layer.chart[each.unseen] == 0).all()
        assert error(charts, each).mean() < 0.04
        assert layer.image[each.unseen].std() > 0.1, "not blank"


def test_depth_comes_from_the_chart(patterned):
    seen, charts = patterned
    for each in seen:
        layer = compose(charts, each.camera)
        on_top = photo(each.camera, hole=0.0).depth
        np.testing.assert_allclose(layer.depth[each.unseen], on_top[each.unseen], rtol=0.01)


def test_a_view_from_elsewhere_agrees(patterned):
    _, charts = patterned
    other = photo(camera_at((0.2, -2.0, 2.9)))
    assert other.unseen.sum() > 300
    assert error(charts, other).mean() < 0.04


def test_known_texels_keep_their_colours(patterned):
    seen, charts = patterned
    found = find_charts(seen, NO_POINTS)
    for before, after in zip(found, charts, strict=True):
        np.testing.assert_array_equal(before.image[before.known], after.image[before.known])
        assert (after.alpha[before.through] == 0.0).all()


def test_gaussians_lie_on_the_surface_within_the_hole(patterned):
    _, charts = patterned
    (discs,) = surfels(charts, 4)
    assert 300 < len(discs) <= SURFACES.seeds
    assert float(discs.means[:, 2].abs().max()) < 0.02
    assert float(discs.means[:, :2].norm(dim=1).max()) < 1.17 * HOLE
    assert discs.sh.shape == (len(discs), 4, 3)
    (few,) = surfels(charts, 1, replace(SURFACES, seeds=50))
    assert 20 < len(few) <= 100


def test_a_straight_edge_goes_on_behind_the_object():
    """A table's edge runs through the hole: beyond it the chart is empty, and the ground is seen."""
    seen = photos(covers=lambda x, y: y < 0.1)
    charts = filled_charts(seen)
    top = [chart for chart in charts if chart.frame.plane.offset > -0.1]
    assert len(top) == 1
    for each in seen:
        whole = photo(each.camera, covers=lambda x, y: y < 0.1, hole=0.0)
        layer = compose(top, each.camera)
        on_top = np.abs(whole.depth - photo(each.camera, hole=0.0).depth) < 1e-3
        wrong = (layer.alpha > 0.5) != on_top
        assert wrong[each.unseen].mean() < 0.03


def before_a_wall(each: Photo) -> Photo:
    """A photograph of a ball in front of a wall that stands on the plane at y = 0.3."""
    at_one = unprojected(np.ones(each.shape), each.camera) - each.camera.center
    front = (0.3 - each.camera.center[1]) / at_one[..., 1]
    ground = np.where(each.depth > 0.0, each.depth, 2.0 * front)
    depth = np.where((at_one[..., 1] > 0.0) & (front < ground), front, each.depth)
    along = at_one / np.linalg.norm(at_one, axis=-1, keepdims=True)
    unseen = np.linalg.norm(np.cross(np.array([0.0, -0.2, 0.3]) - each.camera.center, along), axis=-1) < 0.3
    return replace(each, depth=depth.astype(np.float32), known=~unseen, unseen=unseen)


def test_a_surface_ends_where_what_stands_on_it_hides_it_from_all_photographs():
    """The hole reaches behind the wall's foot, and the wall has no chart that would hide the table."""
    seen = [before_a_wall(each) for each in photos()]
    (ground,) = find_charts(seen, NO_POINTS, settings=replace(SURFACES, planes=1))
    y = ground.frame.points[..., 1]
    assert ground.wanted[y < 0.25].sum() > 150
    assert not ground.wanted[y > 0.45].any()


def test_the_nearer_surface_is_in_front():
    seen = photos(covers=lambda x, y: y < 0.1)
    charts = filled_charts(seen)
    assert len(charts) == 2
    for each in seen:
        layer = compose(charts, each.camera)
        whole = photo(each.camera, covers=lambda x, y: y < 0.1, hole=0.0)
        right = np.abs(layer.depth - whole.depth) < 0.03 * whole.depth
        assert right[each.unseen].mean() > 0.95


def test_what_would_hide_known_pixels_is_refused():
    seen = photos()
    floating = np.array([[0.9, 0.0, 0.5], [0.9, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert refused(floating, seen).tolist() == [True, False, False]


def test_a_chart_in_front_of_what_photographs_show_is_empty_there():
    """Depth of moving leaves in one view must not stand in front of what three others see."""
    seen = photos()
    seen[0].depth[:, :64] *= 0.7
    for chart in find_charts(seen, NO_POINTS):
        if np.abs(chart.frame.points[..., 2]).max() > 0.1:
            assert not chart.alpha.any()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_exposure_that_drifts_leaves_no_seam(sign):
    """Photographs of one chart get one tone; none is left with a lighter half."""
    seen = photos()
    drifted = []
    for number, each in enumerate(seen):
        pixels = np.clip(each.pixels.astype(np.float32) + sign * 12.0 * number, 0.0, 255.0)
        drifted.append(replace(each, pixels=pixels.astype(np.uint8)))
    (even,), (drift,) = find_charts(seen, NO_POINTS), find_charts(drifted, NO_POINTS)
    first, second = (compose([chart], seen[0].camera) for chart in (even, drift))
    both = (first.alpha > 0.99) & (second.alpha > 0.99) & seen[0].clear
    assert both.sum() > 1000
    off = cv2.blur(np.where(both[..., None], second.image - first.image, 0.0), (9, 9))
    inside = cv2.erode(both.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    assert off[inside].std() < 0.01


def test_one_view_is_enough():
    seen = photos(EYES[:1])
    charts = filled_charts(seen)
    assert len(charts) == 1
    assert error(charts, seen[0]).mean() < 0.06


def test_a_hole_that_reaches_the_border_in_every_view():
    seen = []
    for each in photos():
        unseen = each.unseen.copy()
        unseen[48:, 40:88] = True
        seen.append(replace(each, unseen=unseen, known=~unseen))
    charts = filled_charts(seen)
    assert len(charts) == 1
    for each in seen:
        shown = compose(charts, each.camera).chart >= 0
        assert shown[each.unseen].mean() > 0.9


def test_without_a_hole_or_a_surface_there_is_no_chart():
    assert find_charts(photos(hole=0.0), NO_POINTS) == []
    nothing = [replace(each, depth=np.zeros_like(each.depth)) for each in photos()]
    assert find_charts(nothing, NO_POINTS) == []
    unseen = [replace(each, unseen=np.ones_like(each.unseen), known=~each.known & False) for each in photos()]
    assert find_charts(unseen, NO_POINTS) == []


def test_the_same_seed_gives_the_same_charts():
    first, second = filled_charts(photos(waver=0.01)), filled_charts(photos(waver=0.01))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.image, other.image)
        np.testing.assert_array_equal(one.alpha, other.alpha)


def test_a_trained_prior_fills_all_of_a_chart():
    class Learned:
        name, learned = "learned", True

        def fill(self, image, mask, *, seed=0, depth=None):
            return torch.where(mask[..., None], torch.tensor([0.1, 0.2, 0.3]), image)

    (chart,) = filled_charts(photos(), Learned())
    np.testing.assert_allclose(chart.image[chart.wanted], np.tile([0.1, 0.2, 0.3], (chart.wanted.sum(), 1)))


def test_a_chart_has_no_more_texels_than_allowed():
    """A hole that a near photograph shows at 20 megapixels."""
    few = replace(SURFACES, texels=5000)
    for chart in find_charts(photos(), NO_POINTS, settings=few):
        assert chart.known.size <= 5000
        assert chart.known.any() and chart.wanted.any()


def test_checks_repeat():
    assert np.allclose(checks(np.array([0.1]), np.array([0.2])), checks(np.array([0.6]), np.array([0.7])))
