"""A shadow on a glossy floor, whose gaussians lie below it."""

import numpy as np
import pytest

from diga3d_warp.gaussians.initialise import round_gaussians
from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.objects.decal import DecalSettings, decal, shown_depth
from diga3d_warp.objects.frame import Frame
from diga3d_warp.objects.light import Light
from diga3d_warp.objects.shadow import Shadow
from diga3d_warp.objects.solids import solid_of
from diga3d_warp.splatting.placement import unprojected
from diga3d_warp.splatting.render import render
from diga3d_warp.surfaces.chart import Chart, frame_on
from diga3d_warp.surfaces.planes import Plane
from tabletop import camera_at, level

EYES = [(0.0, -2.6, 2.2), (2.2, 0.6, 2.1), (-0.9, -2.5, 2.6)]


@pytest.fixture(scope="module")
def floor() -> Chart:
    corners = np.array([[x, y, 0.0] for x in (-1.5, 1.5) for y in (-1.5, 1.5)])
    frame = frame_on(Plane(np.array([0.0, 0.0, 1.0]), 0.0, corners), camera_at(EYES[0]))
    known, nothing = np.ones(frame.size, bool), np.zeros(frame.size, bool)
    image = np.full((*frame.size, 3), 0.8, np.float32)
    return Chart(frame, image, known, nothing, nothing, known.astype(np.float32), deep=False)


@pytest.fixture(scope="module")
def shadow() -> Shadow:
    cube = solid_of("a wooden cube", 0)
    place = Frame(np.zeros(3), np.eye(3), np.full(3, 0.6))
    return Shadow(cube.vertices, cube.faces, place, 0.6, Light(np.zeros(9), 0.9))


def test_depth_below_the_floor_is_the_floors(floor):
    camera = camera_at(EYES[0])
    top, below = level(camera, 0.0), level(camera, -0.6)
    shown = shown_depth(floor, camera, below.astype(np.float32))
    points = unprojected(top, camera)
    on = np.abs(points[..., :2]).max(axis=2) < 1.4
    assert on.mean() > 0.3
    np.testing.assert_allclose(shown[on], top[on], rtol=1e-4)
    beside = np.abs(points[..., :2]).max(axis=2) > 1.6
    np.testing.assert_allclose(shown[beside], below[beside], rtol=1e-6)


def test_a_thing_on_the_floor_keeps_its_depth(floor):
    camera = camera_at(EYES[0])
    before = (0.7 * level(camera, 0.0)).astype(np.float32)
    np.testing.assert_array_equal(shown_depth(floor, camera, before), before)


def test_discs_darken_the_floor_where_the_shadow_lies_from_every_side(floor, shadow):
    """White gaussians far below stand for the mirror image; darkened ones would show it displaced."""
    discs = decal(shadow, floor, 1, 0.985)
    assert discs is not None and 100 < len(discs) <= 2 * DecalSettings().discs
    rng = np.random.default_rng(0)
    places = np.c_[rng.uniform(-4.0, 4.0, (6000, 2)), np.full(6000, -1.0)]
    white = round_gaussians(places, np.full(6000, np.log(0.2)), np.full((6000, 3), 0.9), 0.9, 1)
    for eye in EYES:
        camera = camera_at(eye)
        both = (white, white.joined(discs))
        plain, dark = (render(each, camera).color.detach().numpy().mean(axis=2) for each in both)
        points = unprojected(level(camera, 0.0), camera)
        light = shadow.at(points.reshape(-1, 3)).reshape(plain.shape) ** (1.0 / GAMMA)
        on = (np.abs(points[..., :2]).max(axis=2) < 1.2) & (plain > 0.5)
        found = dark[on] / plain[on]
        assert light[on].min() < 0.75, "there is a shadow to find"
        assert np.corrcoef(found, light[on])[0, 1] > 0.9
        assert np.abs(found - light[on]).mean() < 0.03
        assert found[light[on] > 0.995].min() > 0.9


def test_without_a_shadow_there_are_no_discs(floor, shadow):
    assert decal(shadow, floor, 1, 0.0) is None
