"""Planes on which photographs agree, where depth is wrong."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from diga3d_warp.priors.classical import ClassicalPrior
from diga3d_warp.surfaces.agreement import agreement
from diga3d_warp.surfaces.compose import compose
from diga3d_warp.surfaces.evidence import away_from_object
from diga3d_warp.surfaces.fill import fill_chart
from diga3d_warp.surfaces.find import find_charts
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.planes import Plane
from diga3d_warp.surfaces.sweep import agreed_planes
from tabletop import EYES, HOLE, ROUND, camera_at, photos, tiles, truth

FLOOR = Plane(np.array([0.0, 0.0, 1.0]), 0.0, np.zeros((0, 3)))


def glossy() -> list[Photo]:
    """A tiled floor with a reflection that moves with the camera, and depth that is off by a fifth."""
    seen = []
    for number, each in enumerate(photos(ROUND, pattern=tiles)):
        rng = np.random.default_rng(number)
        waver = cv2.GaussianBlur(rng.standard_normal(each.shape), (0, 0), 6.0)
        shine = 25.0 * np.exp(-(((np.indices(each.shape)[1] - 20 * number) / 25.0) ** 2))
        pixels = np.clip(each.pixels + shine[..., None] + rng.normal(0.0, 1.5, (*each.shape, 3)), 0, 255)
        depth = each.depth * (1.1 + 0.2 * waver / waver.std())
        seen.append(replace(each, pixels=pixels.astype(np.uint8), depth=depth.astype(np.float32)))
    return seen


@pytest.fixture(scope="module")
def floor():
    return glossy()


@pytest.fixture(scope="module")
def joints():
    """Sparse points on the floor, where the joints are, and some in the air."""
    rng = np.random.default_rng(0)
    return np.concatenate([np.c_[rng.uniform(-1.2, 1.2, (150, 2)), 0.004 * rng.standard_normal(150)],
                           rng.uniform((-1, -1, 0.2), (1, 1, 0.6), (20, 3))])  # fmt: skip


def test_a_glossy_floor_goes_on_where_depth_is_wrong(floor, joints):
    charts = [fill_chart(chart, ClassicalPrior(), 0) for chart in find_charts(floor, joints)]
    (chart,) = [chart for chart in charts if chart.frame.agreed]
    assert chart.trusted and not chart.deep
    assert abs(chart.frame.points[..., 2]).max() < 0.03
    for each in floor:
        layer = compose([chart], each.camera)
        shown = each.unseen & (layer.chart == 0)
        assert shown.sum() > 0.95 * each.unseen.sum()
        joint = truth(each.camera, tiles)[..., 0] < 0.5
        dark = layer.image[..., 0] < 0.62
        agree = (dark == joint)[shown].mean()
        assert agree > 0.85, "joints go on"


def test_known_colours_are_the_floors_and_not_its_reflections(floor, joints):
    (chart,) = [chart for chart in find_charts(floor, joints) if chart.frame.agreed]
    points = chart.frame.points
    around = np.hypot(points[..., 0], points[..., 1]) < 2.0 * HOLE
    off = np.abs(chart.image - tiles(points[..., 0], points[..., 1]))[chart.known & around].mean(axis=1)
    assert np.median(off) < 0.1


@pytest.mark.parametrize("shift", [0.04, -0.05])
def test_a_plane_is_moved_to_where_photographs_agree(floor, shift):
    rng = np.random.default_rng(1)
    tilted = np.array([0.02, -0.015, 1.0])
    tilted /= np.linalg.norm(tilted)
    support = np.c_[rng.uniform(-1, 1, (200, 2)), np.zeros(200)]
    guess = Plane(tilted, shift, support)
    (found,) = agreed_planes([], [guess], floor, 0)
    assert found.agreed
    assert found.normal[2] > np.cos(np.radians(0.7)) and abs(found.offset) < 0.012


def test_a_guess_that_photographs_do_not_share_is_dropped(floor):
    rng = np.random.default_rng(0)
    wall = Plane(
        np.array([0.0, -1.0, 0.0]), -0.1, np.c_[rng.uniform(-1, 1, 99), 0.1 + np.zeros(99), np.ones(99)]
    )
    assert agreed_planes([], [wall], floor, 0) == []
    above = Plane(np.array([0.0, 0.0, 1.0]), 0.6, np.c_[rng.uniform(-1, 1, (99, 2)), np.full(99, 0.6)])
    assert agreed_planes([], [above], floor, 0) == []


def test_photographs_without_detail_refuse_and_confirm_nothing():
    seen = photos(ROUND, pattern=lambda x, y: np.full((*x.shape, 3), 0.5))
    rng = np.random.default_rng(0)
    support = np.c_[rng.uniform(-1, 1, (99, 2)), np.zeros(99)]
    plain = replace(FLOOR, support=support)
    (kept,) = agreed_planes([plain], [], seen, 0)
    assert not kept.agreed and kept.offset == 0.0
    assert agreed_planes([], [plain], seen, 0) == []


def test_two_photographs_are_too_few_to_agree(floor):
    plain = replace(FLOOR, support=np.c_[np.random.default_rng(0).uniform(-1, 1, (99, 2)), np.zeros(99)])
    (kept,) = agreed_planes([plain], [], floor[:2], 0)
    assert not kept.agreed


def test_likeness_is_the_share_of_contrast_in_common():
    rng = np.random.default_rng(0)
    same = rng.uniform(0.0, 1.0, (40, 40)).astype(np.float32)
    assert agreement([same, same + 0.1, same - 0.05], [9]).total() == pytest.approx(1.0, abs=0.02)
    apart = [rng.uniform(0.0, 1.0, (40, 40)).astype(np.float32) for _ in range(7)]
    assert abs(agreement(apart, [9]).total()) < 0.25
    flat = [np.full((40, 40), value, np.float32) for value in (0.2, 0.4, 0.6)]
    assert np.isnan(agreement(flat, [9]).alike).all() and agreement(flat, [9]).total() == 0.0


def test_of_two_photographs_likeness_is_unknown():
    """Their median is their mean: each is as near to it as the other."""
    same = np.random.default_rng(0).uniform(0.0, 1.0, (40, 40)).astype(np.float32)
    assert agreement([same, same + 0.1], [9]).total() == 0.0


def test_a_window_grows_until_it_has_contrast():
    lines = np.full((60, 60), 0.5, np.float32)
    lines[:, 30] = 0.1
    near, far = agreement([lines] * 3, [5]), agreement([lines] * 3, [5, 25])
    assert np.isnan(near.alike[30, 20]) and far.alike[30, 20] == pytest.approx(1.0)


def test_points_of_the_object_are_no_evidence(floor, joints):
    on_object = np.c_[np.random.default_rng(0).uniform(-0.1, 0.1, (50, 2)), np.full(50, 0.05)]
    kept = away_from_object(floor, np.concatenate([joints, on_object]))
    inside = np.hypot(kept.points[:, 0], kept.points[:, 1]) < 0.2
    assert len(kept) > 80 and not inside.any()
    assert (kept.depths > 1.0).all() and camera_at(EYES[0]).near < 1.0
