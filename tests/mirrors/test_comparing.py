"""Photographs of texels against a mirror image: gloss and room are found, an outline alone is no evidence."""

import numpy as np
import pytest

from diga3d_warp.mirrors.comparing import Comparison, Covered, Seen, stands_before
from diga3d_warp.mirrors.settings import MIRRORS

VIEWS, SIDE = 8, 24


def covered() -> Covered:
    """A disc that moves over the texels from view to view, its two colours in stripes of its own."""
    rows, columns = np.mgrid[:SIDE, :SIDE]
    covers, colors = [], []
    for number in range(VIEWS):
        along = columns - 3.0 * number
        cover = (np.hypot(rows - 12, along - 2) < 6).astype(np.float32)
        stripes = np.where((along.astype(int) // 2 % 2)[..., None] > 0, [0.8, 0.2, 0.1], [0.1, 0.3, 0.6])
        covers.append(cover)
        colors.append((cover[..., None] * stripes).astype(np.float32))
    return Covered(np.stack(covers), np.stack(colors))


def compared(change: np.ndarray) -> Comparison:
    """The comparison of photographs that differ by `change` from one texture, each in a tone of its own."""
    rng = np.random.default_rng(0)
    texture = rng.uniform(0.2, 0.8, (SIDE, SIDE, 3))
    tones = rng.uniform(-0.05, 0.05, (VIEWS, 1, 1, 3))
    seen = Seen((texture + tones + change).astype(np.float32), np.ones((VIEWS, SIDE, SIDE), bool), [])
    whole = np.ones((SIDE, SIDE), bool)
    return Comparison(seen, whole, covered().cover < MIRRORS.bare)


@pytest.mark.parametrize("gloss", [0.1, 0.5])
def test_gloss_and_room_are_found(gloss):
    image, room = covered(), np.array([0.5, 0.4, 0.9])
    comparison = compared(gloss * (image.color - image.cover[..., None] * room))
    comparison.weigh(image)
    fitted = comparison.fit(image)
    assert fitted.gloss == pytest.approx(gloss, abs=0.01)
    assert np.allclose(fitted.room, room, atol=0.05)
    inside = comparison.inside(image)
    assert comparison.explained(image, fitted, inside) > 0.98
    assert np.abs(comparison.left(image, fitted)).max() < 0.02
    own, detail = comparison.detail(image, inside)
    assert own == pytest.approx(gloss, abs=0.01) and detail > 0.98


def test_an_outline_of_one_colour_is_no_evidence():
    """A leg that is seen through a pane has the outline, and not the colours."""
    image = covered()
    comparison = compared(0.3 * image.cover[..., None] * np.array([1.0, 0.9, 0.8]))
    comparison.weigh(image)
    own, detail = comparison.detail(image, comparison.inside(image))
    assert abs(own) < 0.01 and detail < 0.01


def test_without_a_change_nothing_is_found():
    comparison = compared(np.zeros((VIEWS, SIDE, SIDE, 3)))
    comparison.weigh(covered())
    assert comparison.fit(covered()).gloss == 0.0


def test_texels_that_no_mirror_image_explains_count_less():
    image = covered()
    change = 0.3 * (image.color - 0.5 * image.cover[..., None])
    glints = np.random.default_rng(1).uniform(-1.0, 1.0, (VIEWS, 6, SIDE, 1))
    change[:, :6] += glints
    comparison = compared(change)
    comparison.weigh(image)
    assert comparison.fit(image).gloss == pytest.approx(0.3, abs=0.03)


def test_what_stands_before_a_support_is_told_by_its_height():
    z = np.full(4, 4.0)
    depth = np.array([4.0, 3.0, 0.0, np.nan])
    assert stands_before(depth, z, 2.0, 1.0).tolist() == [False, True, False, False]
