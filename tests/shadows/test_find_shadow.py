"""The shadow of a pillar: found where there is one, of the right strength, and not taken for paint."""

from dataclasses import replace

import numpy as np
import pytest
from pillar import AROUND, TALL, ground, left_by_pillar, pillar, seen, shaded

from diga3d_warp.shadows.find import ShadowEvidence, find_shadow
from diga3d_warp.shadows.light import Measured, _drift, _explained
from diga3d_warp.shadows.settings import SHADOWS
from diga3d_warp.shadows.support import Solid, find_support, on_floor
from diga3d_warp.surfaces.planes import Plane
from tabletop import camera_at, checks

CAMERAS = [camera_at(eye) for eye in AROUND]

FEW = replace(SHADOWS, texels=120, places=2500)
"""A coarser chart: tests take less time."""


def grey(x, y):
    return np.full((*x.shape, 3), 0.6)


def noise(x, y):
    """Turf: a texture without repeats."""
    tone = 0.45 + 0.12 * np.sin(23.0 * x + 9.0 * np.sin(11.0 * y)) * np.sin(19.0 * y + 7.0 * np.sin(13.0 * x))
    return np.stack([0.7 * tone, tone, 0.4 * tone], axis=-1)


def found_on(pattern, eyes=AROUND, solid=None):
    solid = solid or pillar()
    support = find_support(solid, [ground()], CAMERAS, FEW)
    assert support is not None
    return find_shadow(seen(pattern, eyes), solid, support, 0, FEW)


@pytest.mark.parametrize(
    ("pattern", "taken"), [(grey, 0.35), (grey, 0.85), (checks, 0.6), (noise, 0.35), (noise, 0.6)]
)
def test_a_shadow_is_found_with_its_strength(pattern, taken):
    shadow, evidence, chart = found_on(shaded(pattern, taken))
    assert evidence.suffices(), evidence
    x, y = chart.frame.points[..., 0], chart.frame.points[..., 1]
    truth = left_by_pillar(x, y, taken)
    inside = chart.known & (truth < 1.0)
    assert inside.sum() > 100
    assert np.abs(shadow.level - truth)[inside].mean() < 0.15
    assert np.abs(shadow.level - truth)[chart.known & ~inside].mean() < 0.03


@pytest.mark.parametrize("pattern", [grey, checks, noise])
def test_there_is_none_in_even_light(pattern):
    found = found_on(pattern)
    assert found is not None and not found[1].suffices(), found[1]


@pytest.mark.parametrize("round_mat", [True, False])
def test_a_dark_mat_under_the_object_is_no_shadow(round_mat):
    def mat(x, y):
        away = np.hypot(x, y) if round_mat else np.maximum(np.abs(x), np.abs(y))
        return np.where((away < 0.35)[..., None], 0.35, grey(x, y))

    found = found_on(mat)
    assert not found[1].suffices(), found[1]


def test_paint_of_another_hue_is_no_shadow():
    found = found_on(shaded(grey, 0.6, tint=(0.0, 1.0, 1.0)))
    assert not found[1].suffices(), found[1]


def test_a_shadow_that_only_one_view_shows_is_none():
    dark, bright = seen(shaded(grey)), seen(grey)
    solid = pillar()
    support = find_support(solid, [ground()], CAMERAS, FEW)
    mixed = [dark[k] if k % 3 == 0 else bright[k] for k in range(len(dark))]
    evidence = find_shadow(mixed, solid, support, 0, FEW)[1]
    assert not evidence.suffices(), evidence


def test_one_view_is_enough():
    _, evidence, _ = found_on(shaded(grey), AROUND[:1])
    assert evidence.suffices() and evidence.spread == 0.0


def test_light_from_beside_the_object_is_never_above_one():
    """The side that the object brightens is not darkened to even things out."""

    def brighter(x, y):
        return np.clip(grey(x, y) * (2.0 - left_by_pillar(x, y, 0.5)[..., None]), 0.0, 1.0)

    shadow, evidence, _ = found_on(brighter)
    assert not evidence.suffices()
    assert shadow.ratio.max() <= 1.0


@pytest.mark.parametrize("change", [-0.6, 0.6])
def test_no_light_has_a_negative_share(change):
    """What is brighter under the object than beside it is not explained by a light that it adds."""
    at = np.random.default_rng(0).uniform(-1.0, 1.0, (600, 2)).astype(np.float32)
    shade = (np.hypot(*at.T) < 0.4).astype(np.float32)
    measured = Measured(np.arange(600), at, 1.0 + change * shade, np.ones(600))
    found = _explained(measured, shade[None], _drift(at)).shares
    assert found[0] == pytest.approx(max(-change, 0.0), abs=0.1) and found[0] >= 0.0


def test_where_nothing_is_known_there_is_nothing_to_tell():
    solid = pillar()
    support = find_support(solid, [ground()], CAMERAS, FEW)
    assert find_shadow([], solid, support, 0, FEW) is None
    flat = Solid(solid.points * [1.0, 1.0, 0.0], solid.widths, solid.opacities)
    faint = Solid(solid.points, solid.widths, np.zeros_like(solid.opacities))
    for nothing in (flat, faint):
        assert find_shadow(seen(shaded(grey)), nothing, support, 0, FEW) is None


@pytest.mark.parametrize("level", [0.0, 0.01, 1.0])
def test_a_support_without_light_or_without_a_shade_left_shows_none(level):
    """Black stays black in the shadow, and what is overexposed is white in it."""
    found = found_on(lambda x, y: np.full((*x.shape, 3), level))
    assert found is not None and not found[1].suffices(), found[1]
    assert np.isfinite(found[0].ratio).all()


@pytest.mark.parametrize("nothing", [0.0, np.nan, np.inf])
def test_without_depth_there_is_no_shadow(nothing):
    solid = pillar()
    support = find_support(solid, [ground()], CAMERAS, FEW)
    blind = [replace(each, depth=np.full_like(each.depth, nothing)) for each in seen(shaded(grey))]
    assert find_shadow(blind, solid, support, 0, FEW) is None


def test_a_ratio_near_zero_is_bounded():
    """A shadow as black as the camera tells: what is left of the light stays within 0 and 1."""
    shadow, evidence, _ = found_on(shaded(grey, 1.0))
    assert evidence.suffices() and evidence.strength <= 1.0 - FEW.black + 1e-6
    assert shadow.ratio.min() >= 0.0 and shadow.ratio.max() <= 1.0 and shadow.ratio.min() < FEW.black


def test_the_same_seed_gives_the_same_shadow():
    first, again = (found_on(shaded(checks))[0].ratio for _ in range(2))
    assert np.array_equal(first, again)


def test_the_support_is_the_plane_under_the_foot():
    solid = pillar()
    below = Plane(np.array([0.0, 0.0, 1.0]), -0.7, ground().support - [0.0, 0.0, 0.7])
    wall = Plane(np.array([0.0, -1.0, 0.0]), -0.8, np.random.default_rng(0).uniform(-1, 1, (99, 3)))
    support = find_support(solid, [below, wall, ground()], CAMERAS)
    assert support.height == pytest.approx(TALL, rel=0.05)
    assert abs(support.frame.plane.offset) < 1e-9
    assert find_support(solid, [below, wall], CAMERAS) is None
    assert find_support(solid, [], CAMERAS) is None
    nothing = Solid(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    assert find_support(nothing, [ground()], CAMERAS) is None


def test_support_that_masks_held_is_told_from_the_foot():
    """Masks that hold the shadow lift to gaussians of the support, and to floaters over it."""
    solid, rng = pillar(), np.random.default_rng(3)
    count = 800
    flat = np.stack(
        [rng.uniform(0.2, 0.8, count), rng.uniform(-0.5, 0.0, count), 0.004 * rng.standard_normal(count)], 1
    )
    flat[:20, 2] = 0.06
    both = Solid(
        np.concatenate([solid.points, flat]),
        np.full(len(solid.points) + count, 0.01),
        np.full(len(solid.points) + count, 0.9),
    )
    support = find_support(both, [ground()], CAMERAS)
    held = on_floor(both, support)
    assert held[len(solid.points) + 20 :].mean() > 0.95
    assert held[: len(solid.points)].mean() < 0.01
    alone = find_support(solid, [ground()], CAMERAS)
    assert not on_floor(solid, alone).any()


@pytest.mark.parametrize(
    "change",
    [
        {"strength": 0.1},
        {"explained": 0.3},
        {"chance": 2.0},
        {"hues": 3.0},
        {"spread": 1.0},
        {"painted": True},
    ],
)
def test_each_kind_of_evidence_counts(change):
    good = {"strength": 0.6, "explained": 0.8, "chance": 0.4, "hues": 1.1, "spread": 0.05}
    assert ShadowEvidence(**good).suffices()
    assert not ShadowEvidence(**(good | change)).suffices()
