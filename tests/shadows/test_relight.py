"""What a shadow is divided out of: photographs and gaussians, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pillar import AROUND, ground, left_by_pillar, pillar, seen, shaded

from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.scene.scene import View
from diga3d_warp.shadows.find import Shadow
from diga3d_warp.shadows.picture import shadow_picture
from diga3d_warp.shadows.relight import relit, relit_gaussians, relit_view, shaded_in
from diga3d_warp.shadows.settings import SHADOWS
from diga3d_warp.shadows.support import find_support
from diga3d_warp.surfaces.texture import textured
from scenes import random_gaussians
from tabletop import HEIGHT, WIDTH, camera_at, checks

CAMERAS = [camera_at(eye) for eye in AROUND]


def true_shadow(taken: float = 0.6) -> Shadow:
    support = find_support(pillar(), [ground()], CAMERAS)
    points = support.frame.points
    level = left_by_pillar(points[..., 0], points[..., 1], taken).astype(np.float32)
    return Shadow(support.frame, np.repeat(level[..., None], 3, axis=2), support.floor)


def view_of(photo) -> View:
    return View("view", photo.camera, photo.pixels)


def test_a_photograph_is_relit_and_the_rest_keeps_its_bits():
    shadow = true_shadow()
    for dark, bright in zip(seen(shaded(checks))[:3], seen(checks)[:3], strict=True):
        shown = shaded_in(view_of(dark), dark.depth, shadow)
        after = relit_view(view_of(dark), shown).pixels
        assert 100 < shown.where.sum() < 0.2 * shown.where.size
        assert np.array_equal(after[~shown.where], dark.pixels[~shown.where])
        inner = shown.where & (shown.ratio.mean(axis=2) < 0.45) & dark.known
        error = np.abs(after[inner].astype(int) - bright.pixels[inner].astype(int))
        assert np.median(error) <= 3


def test_what_stands_in_front_of_the_shadow_keeps_its_bits():
    dark = seen(shaded(checks))[0]
    shadow = true_shadow()
    open_area = shaded_in(view_of(dark), dark.depth, shadow).where
    nearer = dark.depth.copy()
    nearer[:, : WIDTH // 2] *= 0.7
    assert not shaded_in(view_of(dark), nearer, shadow).where[:, : WIDTH // 2].any()
    assert open_area[:, : WIDTH // 2].any()


@pytest.mark.parametrize("nothing", [0.0, np.nan, np.inf])
def test_where_there_is_no_depth_nothing_is_relit(nothing):
    dark = seen(shaded(checks))[0]
    empty = np.full((HEIGHT, WIDTH), nothing, np.float32)
    shown = shaded_in(view_of(dark), empty, true_shadow())
    assert not (shown.where | shown.black).any()
    assert relit_view(view_of(dark), shown).pixels is dark.pixels


def test_transparent_pixels_keep_their_bits():
    dark = seen(shaded(checks))[0]
    clear = replace(view_of(dark), alpha=np.zeros((HEIGHT, WIDTH), np.uint8))
    assert not shaded_in(clear, dark.depth, true_shadow()).where.any()


def test_what_is_nearly_black_is_left_to_the_fill():
    dark = seen(shaded(checks, 0.97))[0]
    shown = shaded_in(view_of(dark), dark.depth, true_shadow(0.97))
    assert shown.black.sum() > 50
    assert not (shown.black & shown.where).any()
    pixels = relit_view(view_of(dark), shown).pixels
    assert np.array_equal(pixels[shown.black], dark.pixels[shown.black])


def test_gaussians_on_the_support_are_relit():
    shadow = true_shadow(0.5)
    gaussians = random_gaussians(600, degree=1)
    rng = np.random.default_rng(0)
    places = np.concatenate([rng.uniform(-1.0, 1.0, (600, 2)), np.zeros((600, 1))], axis=1)
    places[300:, 2] = 0.3
    gaussians = replace(gaussians, means=torch.from_numpy(places).float())
    after, changed = relit_gaussians(gaussians, shadow)
    inside = left_by_pillar(places[:, 0], places[:, 1], 0.5) < 1.0
    assert changed[:300].numpy()[inside[:300]].mean() > 0.9
    assert not changed[300:].any(), "what stands over the support is not on it"
    assert torch.equal(after.sh[~changed], gaussians.sh[~changed])
    core = changed & torch.from_numpy(inside)
    before, now = (0.5 + C0 * each.sh[core, 0] for each in (gaussians, after))
    factor = float(np.median((now / before).numpy()))
    assert factor == pytest.approx(0.5 ** (-1.0 / GAMMA), rel=0.02)


def test_relighting_is_a_division_in_linear_light():
    color, ratio = np.array([0.2, 0.4, 0.6]), np.array([0.3, 0.4, 0.5])
    assert np.allclose((relit(color, ratio) ** GAMMA) * ratio, color**GAMMA)
    assert np.isfinite(relit(color, np.zeros(3))).all()


def test_the_picture_shows_before_ratio_and_after():
    shadow = true_shadow()
    chart = textured(seen(shaded(checks)), shadow.frame)
    picture = shadow_picture(chart, shadow)
    side = SHADOWS.texels
    assert picture.shape == (side, 3 * side + 8, 3) and np.isfinite(picture).all()
    dark = (shadow.level < 0.5) & chart.known
    before, after = picture[:, :side], picture[:, -side:]
    assert after[dark].mean() > before[dark].mean() + 0.1
    assert np.array_equal(before[shadow.level > 0.99], after[shadow.level > 0.99])
