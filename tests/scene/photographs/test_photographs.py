"""Photographs with an alpha channel: composed over white, scaled without a fringe, refused where empty."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from diga3d_warp.errors import InputError
from diga3d_warp.scene.colmap.reconstruction import write_colmap
from diga3d_warp.scene.load import load_scene
from diga3d_warp.scene.photographs.images import read_image, read_photograph, resize_image

RNG = np.random.default_rng(0)
COLORS = RNG.integers(0, 256, (12, 16, 3), dtype=np.uint8)
ALPHA = RNG.integers(0, 256, (12, 16), dtype=np.uint8)


def written(path: Path, color: np.ndarray, alpha: np.ndarray, depth: type = np.uint8) -> Path:
    planes = np.dstack([color[..., ::-1], alpha]).astype(depth)
    assert cv2.imwrite(str(path), planes * depth(np.iinfo(depth).max // 255))
    return path


def over_white(color: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    share = alpha[..., None] / 255.0
    return color * share + 255.0 * (1.0 - share)


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_straight_alpha_is_composed_over_white(tmp_path, depth):
    photograph = read_photograph(written(tmp_path / "a.png", COLORS, ALPHA, depth))
    assert photograph.alpha is not None and photograph.alpha.dtype == np.uint8
    np.testing.assert_array_equal(photograph.alpha, ALPHA)
    np.testing.assert_allclose(photograph.pixels, over_white(COLORS, ALPHA), atol=0.51)


@pytest.mark.parametrize("suffix", ["webp", "tiff"])
def test_other_formats(tmp_path, suffix):
    """OpenCV multiplies the colours of an 8-bit TIFF by its alpha, and rounds."""
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(np.dstack([COLORS, ALPHA]), "RGBA").save(path, lossless=True, exact=True)
    photograph = read_photograph(path)
    np.testing.assert_array_equal(photograph.alpha, ALPHA)
    np.testing.assert_allclose(photograph.pixels, over_white(COLORS, ALPHA), atol=1.01)


def test_grey_with_alpha(tmp_path):
    Image.fromarray(np.dstack([COLORS[..., 0], ALPHA]), "LA").save(tmp_path / "a.png")
    photograph = read_photograph(tmp_path / "a.png")
    np.testing.assert_array_equal(photograph.alpha, ALPHA)
    grey = np.repeat(COLORS[..., :1], 3, axis=2)
    np.testing.assert_allclose(photograph.pixels, over_white(grey, ALPHA), atol=0.51)


@pytest.mark.parametrize("hidden", [0, 255])
def test_scaling_brings_no_fringe_in(tmp_path, hidden):
    """A grey disc: whatever the file holds around it, each smaller pixel is grey as far as it is opaque."""
    rows, columns = np.mgrid[:64, :64]
    inside = np.hypot(rows - 31.5, columns - 31.5) < 20
    color = np.where(inside[..., None], 90, hidden).astype(np.uint8).repeat(3, axis=2)
    path = written(tmp_path / "disc.png", color, inside * 255)
    pixels, alpha = read_photograph(path, 1 / 3)
    assert alpha is not None and pixels.shape == (21, 21, 3)
    rim = (alpha > 20) & (alpha < 235)
    assert rim.sum() > 20
    share = alpha[rim, None] / 255.0
    straight = (pixels[rim] - 255.0 * (1.0 - share)) / share
    assert np.abs(straight - 90).max() < 255 * 0.75 / 20, "rounding of both to a level, divided by alpha"
    np.testing.assert_allclose(alpha.mean(), 255 * inside.mean(), rtol=0.01)


def test_alpha_of_1_everywhere_changes_nothing(tmp_path):
    path = written(tmp_path / "a.png", COLORS, np.full_like(ALPHA, 255))
    pixels, alpha = read_photograph(path, 0.5)
    assert alpha is None
    np.testing.assert_array_equal(pixels, resize_image(read_image(path), 0.5))


def test_alpha_of_0_everywhere_is_refused(tmp_path):
    path = written(tmp_path / "a.png", COLORS, np.zeros_like(ALPHA))
    with pytest.raises(InputError, match=r"a\.png: alpha is 0 everywhere; export it with the object opaque$"):
        read_photograph(path)


@pytest.fixture
def cut_corner(tmp_path, corner) -> Path:
    """The corner with the right half of each image cut away, but for the last image."""
    alpha = np.where(np.arange(240) < 120, 255, 0)[None].repeat(180, axis=0)
    (tmp_path / "images").mkdir()
    for name, image in corner.images.items():
        whole = name == max(corner.images)
        written(tmp_path / "images" / f"{name}.png", image, np.full_like(alpha, 255) if whole else alpha)
    write_colmap(tmp_path, corner.cameras, corner.points)
    return tmp_path


def test_a_scene_keeps_alpha_at_the_size_of_its_views(cut_corner, corner):
    scene = load_scene(cut_corner, image_scale=0.5, hold_out=0)
    *cut, whole = scene.views
    assert whole.alpha is None and (whole.opacity == 255).all()
    for view in cut:
        assert view.alpha is not None and view.alpha.shape == view.pixels.shape[:2] == (90, 120)
        np.testing.assert_array_equal(view.alpha, np.where(np.arange(120) < 60, 255, 0)[None].repeat(90, 0))
        assert (view.pixels[:, 60:] == 255).all() and view.pixels[:, :60].std() > 20
        kept = resize_image(corner.images[view.name], 0.5)[:, :60]
        np.testing.assert_allclose(view.pixels[:, :60], kept, atol=1)


def test_an_empty_photograph_is_left_out_and_a_capture_of_them_refused(cut_corner):
    files = sorted((cut_corner / "images").glob("*.png"))
    written(files[0], np.zeros((180, 240, 3)), np.zeros((180, 240)))
    scene = load_scene(cut_corner)
    assert len(scene.views) + len(scene.test_views) == len(files) - 1
    assert any("alpha is 0 everywhere" in note for note in scene.notes)
    for file in files:
        written(file, np.zeros((180, 240, 3)), np.zeros((180, 240)))
    with pytest.raises(InputError, match="alpha is 0 everywhere") as refused:
        load_scene(cut_corner)
    assert "\n" not in str(refused.value)
