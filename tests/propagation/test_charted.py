"""Charts in the views' holes: their tone, their depth, and what they leave to the references."""

from dataclasses import replace

import numpy as np
import torch

from diga3d_warp.propagation.charted import Charted, chart_views, photo_of
from diga3d_warp.propagation.fill import Fill
from diga3d_warp.propagation.unseen import Background
from diga3d_warp.scene.camera import Camera, look_at
from diga3d_warp.scene.scene import View
from diga3d_warp.surfaces.chart import Chart, frame_on
from diga3d_warp.surfaces.planes import Plane
from diga3d_warp.surfaces.surfels import surfels

SIZE = 64
POSE = torch.from_numpy(look_at(np.array([0.0, -0.5, 3.0]), np.zeros(3)))
CAMERA = Camera(SIZE, SIZE, 60.0, 60.0, SIZE / 2, SIZE / 2, POSE, near=0.01)
FLOOR = Plane(np.array([0.0, 0.0, 1.0]), 0.0, np.array([[-2.0, -2.0, 0.0], [2.0, 2.0, 0.0]]))
DEPTH = FLOOR.depth(CAMERA).astype(np.float32)
HOLE = np.zeros((SIZE, SIZE), bool)
HOLE[24:40, 20:44] = True


def chart_view(view: View, background: Background, depth: np.ndarray, charts: list[Chart]) -> Charted:
    (found,) = chart_views([view], [background], [depth], charts)
    return found


def grey_chart(value: float = 0.5, **changes) -> Chart:
    frame = frame_on(FLOOR, CAMERA)
    nothing = np.zeros(frame.size, bool)
    image = np.full((*frame.size, 3), value, np.float32)
    chart = Chart(frame, image, ~nothing, nothing, nothing, np.ones(frame.size, np.float32))
    return replace(chart, **changes)


def view(level: int = 128, alpha: np.ndarray | None = None) -> tuple[View, Background]:
    pixels = np.full((SIZE, SIZE, 3), level, np.uint8)
    image = pixels.astype(np.float32) / 255.0
    return View("a", CAMERA, pixels, alpha=alpha), Background(HOLE, image, np.zeros_like(HOLE))


def test_a_chart_fills_the_hole_with_its_depth():
    found = chart_view(*view(), DEPTH, [grey_chart()])
    np.testing.assert_array_equal(found.shown, HOLE)
    assert not found.background.unseen.any() and found.background.observed[HOLE].all()
    np.testing.assert_allclose(found.depth[HOLE], DEPTH[HOLE], rtol=1e-3)
    np.testing.assert_allclose(found.background.image[HOLE], 0.5, atol=0.01)


def test_a_chart_takes_the_tone_of_the_view():
    found = chart_view(*view(level=153), DEPTH, [grey_chart(0.5)])
    np.testing.assert_allclose(found.background.image[HOLE], 0.6, atol=0.02)


def test_what_no_chart_explains_is_left():
    chart = grey_chart()
    rows = np.arange(chart.known.shape[0])[:, None] < chart.known.shape[0] // 2
    half = replace(chart, alpha=np.where(rows, 1.0, 0.0).repeat(chart.known.shape[1], 1).astype(np.float32))
    found = chart_view(*view(), DEPTH, [half])
    assert 0 < found.shown.sum() < HOLE.sum()
    np.testing.assert_array_equal(found.background.unseen, HOLE & ~found.shown)
    left = found.background.unseen
    rest = Fill(found.background.image, np.where(left, 2.0, 0.0), left, left, np.zeros_like(left))
    whole = found.completed(rest)
    np.testing.assert_array_equal(whole.filled, HOLE)
    assert (whole.depth[HOLE] > 0.0).all() and (whole.depth[left] == 2.0).all()


def test_a_chart_among_a_nearer_surface_is_not_seen_through_it():
    """A table around the hole that no chart explains: the floor must not show in its top.

    Where only the hole's upper rim is the table's, the floor goes on from below, in front of nothing.
    """
    table = (0.5 * DEPTH).astype(np.float32)
    around = chart_view(*view(), table, [grey_chart()])
    assert not around.shown.any() and around.background.unseen.sum() == HOLE.sum()
    above = np.where(np.arange(SIZE)[:, None] < 24, table, DEPTH)
    np.testing.assert_array_equal(chart_view(*view(), above, [grey_chart()]).shown, HOLE)


def test_a_chart_that_is_not_trusted_only_hides_what_is_behind_it():
    behind = Plane(FLOOR.normal, -1.0, FLOOR.support - [0.0, 0.0, 1.0])
    far = replace(grey_chart(0.9), frame=frame_on(behind, CAMERA))
    around = behind.depth(CAMERA).astype(np.float32)  # the far surface shows beside the hole
    for charts in ([grey_chart(trusted=False), far], [far, grey_chart(trusted=False)]):
        assert not chart_view(*view(), around, charts).shown.any()
    assert chart_view(*view(), around, [far]).shown.any()


def test_no_chart_or_no_hole_changes_nothing():
    seen, background = view()
    for charts, hole in (([], HOLE), ([grey_chart()], np.zeros_like(HOLE))):
        given = replace(background, unseen=hole)
        found = chart_view(seen, given, DEPTH, charts)
        assert found.background is given and found.depth is DEPTH and not found.shown.any()


def test_transparent_pixels_see_to_infinity():
    alpha = np.full((SIZE, SIZE), 255, np.uint8)
    alpha[:8], alpha[8:12] = 0, 128
    photo = photo_of(*view(alpha=alpha), DEPTH)
    assert np.isinf(photo.depth[:8]).all() and not photo.known[:12].any()
    assert photo.known[12:][~HOLE[12:]].all()


def test_nothing_filled_gives_no_gaussian():
    assert surfels([grey_chart()], 1) == []


def beside(part: float) -> np.ndarray:
    """Depth that is the chart's at a part of the hole, from the left; elsewhere something is nearer."""
    return np.where(np.arange(SIZE)[None] < 20 + 24 * part, DEPTH, 0.8 * DEPTH).astype(np.float32)


def test_all_views_decide_whether_a_chart_is_seen_through_the_hole():
    doubtful, sure = beside(0.4), DEPTH
    assert not chart_view(*view(), doubtful, [grey_chart()]).shown.any()
    seen, background = view()
    together = chart_views([seen] * 3, [background] * 3, [doubtful, sure, sure], [grey_chart()])
    assert all(each.shown.any() for each in together)
    rather_not = chart_views([seen] * 3, [background] * 3, [beside(0.1)] * 2 + [sure], [grey_chart()])
    assert not rather_not[0].shown.any()


def slanted() -> tuple[View, Background, np.ndarray]:
    """The floor at seven degrees; its depth there."""
    pose = torch.from_numpy(look_at(np.array([0.0, -3.0, 0.35]), np.zeros(3)))
    camera = replace(CAMERA, world_to_camera=pose)
    seen, background = view()
    return replace(seen, camera=camera), background, FLOOR.depth(camera).astype(np.float32)


def test_depth_of_a_slanted_surface_may_differ_more():
    seen, background, depth = slanted()
    depth = np.where(np.isfinite(depth), depth, 0.0).astype(np.float32)
    assert chart_view(seen, background, np.float32(1.035) * depth, [grey_chart(0.9)]).shown.any()
    assert not chart_view(*view(), np.float32(1.035) * DEPTH, [grey_chart(0.9)]).shown.any()


def test_where_depth_is_unclear_colours_tell():
    """Depth 5 % behind the chart: the same grey is the chart's surface, another is not."""
    assert chart_view(*view(), np.float32(1.05) * DEPTH, [grey_chart(0.5)]).shown.any()
    assert not chart_view(*view(), np.float32(1.05) * DEPTH, [grey_chart(0.9)]).shown.any()
    assert not chart_view(*view(), np.float32(1.3) * DEPTH, [grey_chart(0.5)]).shown.any()
