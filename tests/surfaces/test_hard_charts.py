"""Charts where little is known, or what is known is broken."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from diga3d_warp.surfaces.chart import Chart, frame_on
from diga3d_warp.surfaces.compose import compose
from diga3d_warp.surfaces.evidence import Evidence
from diga3d_warp.surfaces.find import find_charts
from diga3d_warp.surfaces.parts import surroundings_of
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.planes import Plane, _bent
from diga3d_warp.surfaces.settings import LAYOUT, SURFACES
from diga3d_warp.surfaces.surfels import surfels
from diga3d_warp.surfaces.texture import even_tone
from tabletop import EYES, camera_at, checks, photos

NO_POINTS = np.zeros((0, 3))
FLOOR = Plane(np.array([0.0, 0.0, 1.0]), 0.0, np.array([[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)]))

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")


def with_depth(change) -> list[Photo]:
    return [replace(each, depth=change(each).astype(np.float32)) for each in photos(EYES[:3])]


def check(charts: list[Chart], seen: list[Photo]) -> float:
    """Least part of a hole that charts show; what they show is finite."""
    shown = []
    for each in seen:
        layer = compose(charts, each.camera)
        for plane in (layer.image, layer.alpha, layer.depth):
            assert np.isfinite(plane).all()
        shown.append(float((layer.chart[each.unseen] >= 0).mean()))
    for discs in surfels(charts, 1):
        assert bool(discs.means.isfinite().all())
    return min(shown)


@pytest.mark.parametrize("value", [0.0, np.inf, np.nan, -1.0, 1e30, 1e-30])
def test_depth_behind_the_hole_does_not_matter(value):
    seen = with_depth(lambda each: np.where(each.unseen, value, each.depth))
    assert check(find_charts(seen, NO_POINTS), seen) > 0.95


@pytest.mark.parametrize("value", [0.0, np.nan, -1.0])
def test_a_rim_without_depth_is_bridged(value):
    def change(each):
        near = cv2.dilate(each.unseen.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
        return np.where(near, value, each.depth)

    seen = with_depth(change)
    assert check(find_charts(seen, NO_POINTS), seen) > 0.95


@pytest.mark.parametrize("value", [np.inf, 1e30])
def test_nothing_goes_on_where_the_rim_is_seen_through(value):
    """A splat's sky right around the hole: the ground is not drawn over it."""

    def change(each):
        near = cv2.dilate(each.unseen.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
        return np.where(near, value, each.depth)

    seen = with_depth(change)
    assert check(find_charts(seen, NO_POINTS), seen) == 0.0


@pytest.mark.parametrize("value", [0.0, np.inf, np.nan, 1e30, 1e-30])
def test_without_depth_there_is_no_chart(value):
    seen = with_depth(lambda each: np.full_like(each.depth, value))
    assert find_charts(seen, NO_POINTS) == []


def test_depth_with_holes_of_all_kinds():
    def change(each):
        depth = each.depth.copy()
        depth[::4], depth[1::7], depth[:, ::5], depth[:, 3::11] = np.nan, np.inf, 0.0, -2.0
        return depth

    seen = with_depth(change)
    assert check(find_charts(seen, NO_POINTS), seen) > 0.95


def test_depth_of_no_surface_has_no_chart():
    rng = np.random.default_rng(0)
    seen = with_depth(lambda each: np.exp(rng.normal(0.0, 3.0, each.shape)))
    assert find_charts(seen, NO_POINTS) == []


@pytest.mark.parametrize("points", [np.full((50, 3), np.nan), np.full((400, 3), 0.7), np.full((9, 3), 1e12)])
def test_sparse_points_that_tell_nothing_change_nothing(points):
    seen = photos(EYES[:3])
    assert check(find_charts(seen, points), seen) > 0.95


def test_a_hole_of_few_pixels_has_no_chart():
    seen = photos(hole=0.03)
    assert 0 < sum(int(each.unseen.sum()) for each in seen) < 2 * LAYOUT.least
    assert find_charts(seen, NO_POINTS) == []


def test_a_small_chart_still_holds_patches():
    """A distant hole of a few pixels: its chart has finer texels than the photographs."""
    seen = photos(hole=0.09)
    for chart in find_charts(seen, NO_POINTS):
        assert max(chart.frame.size) >= SURFACES.texels_min


def test_where_no_photograph_shows_anything_there_is_no_chart():
    assert find_charts([replace(each, known=np.zeros_like(each.known)) for each in photos()], NO_POINTS) == []


@pytest.mark.parametrize(
    "eyes",
    [
        [(0.0, -3.0, 0.2), (0.5, -3.0, 0.22), (-0.5, -3.0, 0.18)],
        [(0.0, -3.0, 1e-6), (0.5, -3.0, 0.0), (-0.5, -3.0, -1e-6)],
    ],
    ids=["grazing", "in the plane"],
)
def test_cameras_that_see_a_plane_edge_on_have_no_chart_of_it(eyes):
    assert find_charts(photos(eyes), NO_POINTS) == []


def test_a_camera_in_a_plane_sees_nothing_of_its_chart():
    """Others do: each photograph is asked from its own place."""
    seen = photos([*EYES[:2], (0.0, -1e-3, 1e-3)])
    charts = find_charts(seen, NO_POINTS)
    shown = [(compose(charts, each.camera).chart[each.unseen] >= 0).mean() for each in seen]
    assert min(shown[:2]) > 0.95 and shown[2] == 0.0


def test_a_side_that_cameras_see_from_behind_is_not_drawn_twice():
    """Cameras under a glass plate: its chart faces the mean camera, and is drawn for those above it."""
    seen = photos([(0.0, -3.0, 1.0), (0.5, -3.0, -1.0), (-0.5, -3.0, 1.0)])
    assert check(find_charts(seen, NO_POINTS), seen) >= 0.0


def test_the_chart_of_an_endless_plane_is_bounded():
    """20 megapixels of texture would take minutes to fill; frames of any shape stay below the bound."""
    for low, high in ((-1e6, 1e6), (-1e-6, 1e-6), (-1.0, 1e5)):
        corner = np.array([low, low])
        frame = frame_on(FLOOR, camera_at(EYES[0]), corner, np.array([high, high]), texel=1e-9)
        assert 0 < np.prod(frame.size) <= SURFACES.texels
        thin = frame_on(FLOOR, camera_at(EYES[0]), corner, np.array([high, low + 1e-9 * (high - low)]), 1e-9)
        assert 0 < np.prod(thin.size) <= SURFACES.texels


def test_two_planes_that_are_nearly_one_are_drawn_once():
    """A rug's edge on the floor: without a step to be seen, one story goes on."""
    seen = photos(pattern=checks, covers=lambda x, y: y < 0.1, below=-0.02)
    charts = find_charts(seen, NO_POINTS)
    assert len(charts) == 1 and check(charts, seen) > 0.95


def test_few_points_are_not_bent():
    """Six numbers of a bent surface fit any few points."""
    rng = np.random.default_rng(0)
    points = np.c_[rng.uniform(-1.0, 1.0, (9, 2)), rng.uniform(-0.03, 0.03, 9)]
    few = Evidence(points, np.tile(FLOOR.normal, (9, 1)), np.full(9, 3.0))
    for evidence in (few, few.select(np.zeros(9, bool))):
        assert _bent(FLOOR, evidence, SURFACES) is FLOOR


def test_photographs_of_a_chart_get_one_tone():
    """Each shows a part, and exposures drift by up to a tenth."""
    rng = np.random.default_rng(0)
    texture = rng.uniform(0.3, 0.7, (40, 90, 3)).astype(np.float32)
    drift = np.array([-0.1, 0.02, 0.08], np.float32)
    weights = np.zeros((3, 40, 90), np.float32)
    for number in range(3):
        weights[number, :, 20 * number : 20 * number + 50] = 1.0
    even = even_tone([texture + each for each in drift], weights)
    left = [float((sample - texture).mean()) for sample in even]
    assert np.ptp(left) < 1e-3 and abs(np.mean(left) - drift.mean()) < 1e-3


def test_surroundings_end_at_the_border():
    part = np.zeros((50, 60), bool)
    part[:4, 55:] = True
    rows, columns = surroundings_of(part, 1.0, 8)
    assert (rows.start, columns.start) == (0, 47)
    assert part[rows, columns].sum() == part.sum()
