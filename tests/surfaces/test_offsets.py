"""Regular textures: their offsets, and how they go on."""

import numpy as np
import pytest

from diga3d_warp.surfaces.fill import mirrored
from diga3d_warp.surfaces.offsets import dominant_offsets
from diga3d_warp.surfaces.regular import continue_regular, shifted


def tiles(height: int = 90, width: int = 120, period=(15.0, 12.5), noise: float = 0.02) -> np.ndarray:
    rows, columns = np.indices((height, width)).astype(float)
    wave = np.sin(2 * np.pi * rows / period[0]) * np.sin(2 * np.pi * columns / period[1])
    lines = np.where(rows % 30 < 2, 0.2, 0.0)
    image = np.stack([0.5 + 0.3 * wave, 0.5 - lines, 0.4 + 0.1 * wave], axis=-1)
    return (image + noise * np.random.default_rng(0).standard_normal(image.shape)).astype(np.float32)


HOLE = np.hypot(*(np.indices((90, 120)) - np.array([45, 60])[:, None, None])) < 16


def test_offsets_are_periods_to_a_part_of_a_texel():
    found = dominant_offsets(tiles(noise=0.0), ~HOLE)
    assert len(found.steps) >= 10
    across = found.steps[:, 1] / 12.5
    down = found.steps[:, 0] / 30.0
    best = found.unlike < 0.1
    assert best.sum() >= 6
    assert np.abs(across - across.round())[best].max() < 0.03
    assert np.abs(down - down.round())[best].max() < 0.03


def test_a_regular_texture_goes_on():
    image = tiles()
    known = np.where(HOLE[..., None], 0.0, image).astype(np.float32)
    filled, copied = continue_regular(known, ~HOLE, HOLE)
    assert (copied == HOLE).all()
    assert np.abs(filled - image)[HOLE].mean() < 0.03
    np.testing.assert_array_equal(filled[~HOLE], known[~HOLE])


def test_a_texture_without_repeats_is_left_to_the_prior():
    noise = np.random.default_rng(1).uniform(size=(90, 120, 3)).astype(np.float32)
    _, copied = continue_regular(noise, ~HOLE, HOLE)
    assert not copied.any()


@pytest.mark.parametrize("value", [0.0, 0.5])
def test_a_flat_texture_has_no_offsets_of_its_own(value):
    flat = np.full((90, 120, 3), value, np.float32)
    filled, _ = continue_regular(flat, ~HOLE, HOLE)
    assert np.isfinite(filled).all() and np.abs(filled - value).max() < 1e-5


def test_nothing_known_or_wanted():
    image = tiles()
    none = np.zeros_like(HOLE)
    for known, wanted in ((none, HOLE), (~none, none), (none, none)):
        filled, copied = continue_regular(image, known, wanted)
        assert not copied.any()
        np.testing.assert_array_equal(filled, image)


def test_an_offset_between_texels_is_interpolated():
    image = np.tile(np.arange(20, dtype=np.float32)[None, :, None], (8, 1, 1))
    moved, there = shifted(image, np.ones((8, 20), bool), np.array([0.0, 2.5]))
    np.testing.assert_allclose(moved[3, 2:10, 0], np.arange(2, 10) + 2.5)
    assert there[:, :17].all() and not there[:, 18:].any()


def test_what_is_not_wanted_is_mirrored():
    image = np.zeros((4, 6, 3), np.float32)
    image[:, :3] = np.arange(3)[None, :, None]
    known = np.zeros((4, 6), bool)
    known[:, :3] = True
    np.testing.assert_array_equal(mirrored(image, known)[0, :, 0], [0, 1, 2, 1, 0, 2])
