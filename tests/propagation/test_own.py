"""Charts that take on the colours of views that the user filled."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from diga3d_warp.propagation.own import colored_by
from diga3d_warp.propagation.unseen import Background
from diga3d_warp.scene.scene import View
from diga3d_warp.surfaces.compose import compose
from diga3d_warp.surfaces.find import find_charts
from tabletop import photos, truth

SEEN = photos()
VIEWS = [View(str(number), each.camera, each.pixels) for number, each in enumerate(SEEN)]
BACKGROUNDS = [
    Background(each.unseen, each.pixels / np.float32(255.0), np.zeros_like(each.unseen)) for each in SEEN
]
SHIFT = np.float32([0.0, 0.12, -0.12])
"""A tone that one of the user's views has as a whole."""


@pytest.fixture(scope="module")
def charts():
    found = find_charts(SEEN, np.zeros((0, 3)))
    assert any(chart.wanted.any() for chart in found)
    return found


def own(index: int, tone: np.ndarray | float = 0.0) -> dict[int, np.ndarray]:
    return {index: (truth(SEEN[index].camera) + tone).astype(np.float32)}


def unknown(charts, each) -> np.ndarray:
    """Unseen pixels that show texels whose colour nobody knows."""
    layer = compose([replace(chart, alpha=chart.wanted.astype(np.float32)) for chart in charts], each.camera)
    return each.unseen & (layer.alpha > 0.5)


@pytest.mark.parametrize("tone", [0.0, SHIFT])
def test_a_filled_view_tells_the_others_what_lies_there(charts, tone):
    colored = colored_by(charts, VIEWS, BACKGROUNDS, own(0, tone))
    for each in SEEN[1:]:
        hole = each.unseen & ~unknown(colored, each)
        assert hole.sum() > 0.8 * each.unseen.sum()
        off = np.abs(compose(colored, each.camera).image - truth(each.camera))[hole]
        assert off.mean() < 0.03
    for before, after in zip(charts, colored, strict=True):
        assert (after.known & before.wanted).any() and not (after.known & after.wanted).any()
        np.testing.assert_array_equal(after.image[before.known], before.image[before.known])
        np.testing.assert_array_equal(after.alpha, before.alpha)


def test_without_filled_views_charts_stay_as_they_are(charts):
    for before, after in zip(charts, colored_by(charts, VIEWS, BACKGROUNDS, {}), strict=True):
        assert after is before


def test_a_view_that_shows_nothing_of_a_chart_changes_nothing(charts):
    seen = [replace(each, unseen=np.zeros_like(each.unseen)) for each in BACKGROUNDS]
    for before, after in zip(charts, colored_by(charts, VIEWS, seen, own(0)), strict=True):
        np.testing.assert_array_equal(after.wanted, before.wanted)
        np.testing.assert_array_equal(after.image, before.image)


def test_what_is_unknown_around_the_hole_has_no_tone(charts):
    """It is black before it is filled: the user's view is no brighter than the chart for that."""
    ring = []
    for chart in charts:
        around = cv2.dilate(chart.wanted.astype(np.uint8), np.ones((25, 25), np.uint8)) > 0
        image = np.where((chart.known & ~around)[..., None], chart.image, 0.0).astype(np.float32)
        wanted = chart.wanted | (chart.known & around)
        ring.append(replace(chart, image=image, known=chart.known & ~around, wanted=wanted))
    colored = colored_by(ring, VIEWS, BACKGROUNDS, own(0))
    hole = SEEN[0].unseen & ~unknown(colored, SEEN[0])
    off = np.abs(compose(colored, SEEN[0].camera).image - truth(SEEN[0].camera))[hole]
    assert hole.sum() > 300 and off.mean() < 0.05
