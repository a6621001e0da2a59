"""A new object on the old one's place: where it stands, what cameras see of it, and its shadow."""

import numpy as np
import pytest
import torch
from ball import CENTER, RADIUS, ball_sight, ring

from diga3d_warp.gaussians.initialise import initialise
from diga3d_warp.objects.frame import Frame
from diga3d_warp.objects.light import Light
from diga3d_warp.objects.placement import PlacedMesh, turning_z_to
from diga3d_warp.objects.shadow import Shadow
from diga3d_warp.objects.solids import solid_of
from diga3d_warp.objects.support import find_place
from diga3d_warp.objects.surface import fuse
from diga3d_warp.scene.camera import look_at
from diga3d_warp.scene.scene import Points
from diga3d_warp.splatting.render import render
from diga3d_warp.surfaces.planes import Plane

EVEN = Light(np.zeros(9), 0.9)
"""The same light from all around."""


def floor(slope: float = 0.0, count: int = 4000):
    """Gaussians of a floor that touches the ball from below, wavering, with things standing around on it."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-2, 2, (2, count)) + CENTER[:2, None]
    z = CENTER[2] - RADIUS + slope * (x - CENTER[0]) + 0.004 * rng.standard_normal(count)
    clutter = CENTER + rng.uniform([-1, -1, -0.5], [1, 1, 0.3], (count // 3, 3))
    positions = np.concatenate([np.stack([x, y, z], -1), clutter])
    splat = initialise(Points(positions, np.full((len(positions), 3), 120, np.uint8)), coefficients=1)
    splat.opacity_logits += 4.0
    return splat


@pytest.fixture(scope="module")
def surface():
    return fuse([ball_sight(camera) for camera in ring()])


@pytest.mark.parametrize("slope", [0.0, 0.12])
def test_the_place_is_on_the_floor_under_the_ball(surface, slope):
    place = find_place(surface, ring(), floor(slope))
    assert place.supported
    foot = CENTER - [0, 0, RADIUS]
    assert np.abs(place.frame.origin - foot).max() < 0.06
    upright = np.array([-slope, 0.0, 1.0]) / np.hypot(1.0, slope)
    assert place.frame.axes[2] @ upright > 0.999
    assert np.allclose(place.frame.axes @ place.frame.axes.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(place.frame.axes) == pytest.approx(1.0)
    assert place.scale(np.ones(3)) == pytest.approx(2 * RADIUS, rel=0.1)


@pytest.mark.parametrize("count", [60, 400, 12_000])
def test_the_place_does_not_depend_on_how_many_gaussians_a_floor_has(surface, count):
    """Small photographs give a splat fewer gaussians, each as much larger."""
    place = find_place(surface, ring(), floor(count=count))
    assert place.supported
    assert np.abs(place.frame.origin - (CENTER - [0, 0, RADIUS])).max() < 0.06


def test_a_textured_cloth_beside_the_object_does_not_outvote_the_floor(surface):
    """It has many small gaussians, and the smooth floor under the object has few."""
    rng = np.random.default_rng(1)
    cloth = CENTER + np.c_[rng.uniform([0.7, -0.6], [1.1, 0.6], (3000, 2)), np.full(3000, 0.09 - RADIUS)]
    textured = initialise(Points(cloth, np.full((3000, 3), 120, np.uint8)), coefficients=1)
    textured.opacity_logits += 4.0
    place = find_place(surface, ring(), floor(count=400).joined(textured))
    assert place.supported
    assert place.frame.origin[2] == pytest.approx(CENTER[2] - RADIUS, abs=0.03)


@pytest.mark.parametrize("height", [-0.05, 0.1])
def test_a_plane_that_photographs_tell_is_the_support(surface, height):
    """On a glossy floor the gaussians lie below it, and a mirror image puts the object's base too low."""
    foot = CENTER[2] - RADIUS
    upside_down = Plane(np.array([0.0, 0.0, -1.0]), -(foot + height), np.zeros((0, 3)))
    wall = Plane(np.array([1.0, 0.0, 0.0]), CENTER[0], np.zeros((0, 3)))
    place = find_place(surface, ring(), floor(), told=[wall, upside_down])
    assert place.supported and place.told == 1
    assert place.frame.origin[2] == pytest.approx(foot + height, abs=1e-6)
    assert place.frame.axes[2] @ [0.0, 0.0, 1.0] == pytest.approx(1.0)
    far = Plane(np.array([0.0, 0.0, 1.0]), foot - 3.0, np.zeros((0, 3)))
    elsewhere = find_place(surface, ring(), floor(), told=[far, wall])
    assert elsewhere.told is None
    assert elsewhere.frame.origin[2] == pytest.approx(foot, abs=0.06)


def test_without_a_floor_the_place_is_at_the_base(surface):
    nothing = floor().select(torch.zeros(0, dtype=torch.long))
    place = find_place(surface, ring(), nothing)
    assert not place.supported
    assert place.frame.origin[2] == pytest.approx(CENTER[2] - RADIUS, abs=0.25), "no camera saw the underside"


def test_an_object_seen_from_one_side_is_taken_to_be_as_deep_as_wide():
    cameras = [camera for camera in ring(24) if camera.center[1] < CENTER[1] - 1.9]
    place = find_place(fuse([ball_sight(camera) for camera in cameras]), cameras, floor())
    assert np.abs(place.frame.origin[:2] - CENTER[:2]).max() < 0.1


@pytest.fixture(scope="module")
def cube():
    frame = Frame(CENTER - [0, 0, RADIUS], np.eye(3), np.ones(3))
    return PlacedMesh(solid_of("a wooden cube", 0), frame, 0.8, EVEN)


def test_gaussians_of_a_solid_look_like_the_solid(cube):
    for camera in ring(3):
        color, coverage, depth = cube.look(camera)
        drawn = render(cube.gaussians(pixel=0.008, coefficients=1), camera)
        inside = coverage == 1.0
        assert 0.05 < inside.mean() < 0.5
        assert color[inside].std() > 0.02 and color[coverage == 0].max() == 0
        assert (drawn.alpha.numpy()[inside] > 0.9).mean() > 0.97
        assert drawn.alpha.numpy()[coverage == 0].mean() < 0.06, "half a gaussian's width beyond the rim"
        assert np.abs(drawn.color.numpy() - color)[inside].mean() < 0.05
        assert np.abs(drawn.depth.numpy() - depth)[inside].mean() < 0.02


def test_a_camera_that_looks_elsewhere_sees_nothing(cube):
    camera = ring(1)[0]
    away = camera.with_pose(look_at(camera.center, camera.center + (camera.center - CENTER)))
    beside = camera.with_pose(look_at(camera.center, CENTER + [0.0, 40.0, 0.0]))
    for each in (away, beside):
        assert all(plane.shape[:2] == (96, 96) and not plane.any() for plane in cube.look(each))


def test_the_sides_of_a_solid_are_lit_by_their_direction():
    sun = np.zeros(9)
    sun[1] = 0.8  # from +x
    frame = Frame(np.zeros(3), np.eye(3), np.ones(3))
    placed = PlacedMesh(solid_of("a plaster cube", 0), frame, 1.0, Light(sun, 0.8))
    sample = placed.sample(4000)
    bright, dark = (sample.colors[sample.normals[:, 0] * side > 0.9].mean() for side in (1, -1))
    assert bright > 1.5 * dark


def test_what_is_closed_in_is_darker():
    frame = Frame(np.zeros(3), np.eye(3), np.ones(3))
    sample = PlacedMesh(solid_of("a plaster torus", 0), frame, 1.0, EVEN).sample(6000)
    radius = np.hypot(sample.points[:, 0], sample.points[:, 1])
    upright = np.abs(sample.normals[:, 2]) < 0.3
    inner, outer = (sample.colors[upright & where].mean() for where in (radius < 0.25, radius > 0.45))
    assert inner < 0.96 * outer


def test_a_shadow_is_darkest_at_the_contact_and_falls_away_from_the_light(cube):
    frame, scale = cube.frame, cube.scale

    def shade(light: Light, *places: tuple[float, float, float]) -> np.ndarray:
        shadow = Shadow(cube.asset.vertices, cube.asset.faces, frame, scale, light)
        return shadow.at(frame.outward(np.array(places) * scale))

    contact, near, far, above = shade(EVEN, (0.53, 0, 0), (0.8, 0, 0), (1.9, 0, 0), (0.53, 0, 0.5))
    assert 0.2 < contact < near < far
    assert far > 0.97 and above == 1.0
    left, right = shade(EVEN, (-0.7, 0.1, 0), (0.7, 0.1, 0))
    assert left == pytest.approx(right, abs=0.05)
    sun = np.zeros(9)
    sun[[1, 3]] = 0.6, 0.6  # from +x and above
    left, right = shade(Light(sun, 0.9), (-0.7, 0.1, 0), (0.7, 0.1, 0))
    assert left < right - 0.1


def test_quaternions_turn_z_to_a_direction():
    from scipy.spatial.transform import Rotation

    directions = np.random.default_rng(0).normal(size=(50, 3))
    directions = np.concatenate([directions, np.eye(3), -np.eye(3)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turned = Rotation.from_quat(turning_z_to(directions)[:, [1, 2, 3, 0]]).apply([0.0, 0.0, 1.0])
    assert np.allclose(turned, directions, atol=1e-9)
