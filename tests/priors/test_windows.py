"""Windows around masks: one size for all views, large enough for the object, within each view."""

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.windows import WHOLE, Windows, WindowSettings
from gaussian_prior import GaussianPrior


class Short:
    """A prior that works at a short side of so many pixels."""

    def __init__(self, short):
        self.short = short

    def native_size(self, height, width):
        scale = self.short / min(height, width)
        return round(height * scale), round(width * scale)


def mask_at(rows, columns, size=(100, 150)):
    mask = torch.zeros(size, dtype=torch.bool)
    mask[slice(*rows), slice(*columns)] = True
    return mask


MASKS = [mask_at((40, 60), (70, 100)), mask_at((0, 0), (0, 0)), mask_at((0, 5), (140, 150))]


def test_windows_have_one_size_and_hold_the_masks():
    windows = Windows.around(MASKS, Short(64), WindowSettings(around=1.6))
    assert windows.views == [0, 2], "the view without a mask has none"
    holes = windows.cut(MASKS)
    assert [tuple(hole.shape) for hole in holes] == [(32, 48)] * 2
    assert [int(hole.sum()) for hole in holes] == [600, 50]
    first = holes[0].nonzero()
    assert first.min(0).values.tolist() == [6, 9] and first.max(0).values.tolist() == [25, 38], (
        "in the middle"
    )
    assert windows.places[1] == (slice(0, 32), slice(102, 150)), "moved in where the view ends"


def test_a_small_object_is_not_enlarged_without_end():
    settings = WindowSettings(around=1.5, enlarged=4.0)
    speck = [mask_at((50, 54), (70, 74))]
    (hole,) = Windows.around(speck, Short(64), settings).cut(speck)
    assert hole.shape == (16, 16) and hole.sum() == 16
    (hole,) = Windows.around(speck, Short(6), settings).cut(speck)
    assert hole.shape == (6, 6), "the surroundings suffice"


def test_a_mast_is_shown_with_what_stands_beside_it():
    mast = [mask_at((10, 90), (70, 74))]
    (hole,) = Windows.around(mast, Short(64), WindowSettings(around=1.0, oblong=2.0)).cut(mast)
    assert hole.shape == (80, 40)


def test_a_window_ends_with_a_smaller_view():
    masks = [mask_at((10, 90), (30, 130)), mask_at((3, 9), (4, 11), size=(20, 30))]
    large, small = Windows.around(masks, Short(64)).cut(masks)
    assert large.shape == (100, 150) and small.shape == (20, 30)


def test_parts_are_put_back_where_they_came_from():
    windows = Windows.around(MASKS, Short(64))
    images = [torch.zeros(100, 150, 3) for _ in MASKS]
    whole = windows.put_back(images, [part + 1.0 for part in windows.cut(images)])
    assert all(float(image.sum()) == 0.0 for image in images), "the given ones stay"
    assert [float(image.sum()) for image in whole] == [32 * 48 * 3, 0.0, 32 * 48 * 3]
    assert all(torch.equal(part, torch.ones(32, 48, 3)) for part in windows.cut(whole))


def test_masks_that_are_all_empty():
    with pytest.raises(InputError, match="shows in no view"):
        Windows.around([MASKS[1]], Short(64))


def test_a_prior_that_takes_any_size_sees_whole_views():
    windows = Windows.around(MASKS, GaussianPrior())
    assert windows.views == Windows.around(MASKS, Short(64)).views
    assert set(map(str, windows.places)) == {str(WHOLE)}
