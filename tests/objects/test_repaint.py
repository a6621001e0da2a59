"""Light told from paint, textures wrapped without stretching, and views that agree."""

import numpy as np
import pytest
from ball import CENTER, ball_sight, brightness, plain, ring

from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.materials.vocabulary import MATERIALS
from diga3d_warp.objects.frame import Frame
from diga3d_warp.objects.light import estimate_light, exposed, shade_beyond
from diga3d_warp.objects.repaint import MaterialRepainter
from diga3d_warp.objects.surface import fuse
from diga3d_warp.objects.wrapping import sampled, wrap


def striped(normals: np.ndarray) -> np.ndarray:
    """Dark and bright paint in ten bands around."""
    around = np.arctan2(normals[:, 1], normals[:, 0])
    return np.where(np.sin(10 * around) > 0, 0.75, 0.25)[:, None].repeat(3, 1)


@pytest.mark.parametrize("albedo", [plain, striped])
def test_shading_follows_the_light_and_not_the_paint(albedo):
    surface = fuse([ball_sight(camera, albedo) for camera in ring()])
    light = estimate_light(surface.normals, surface.colors, np.full((10, 3), 0.5))
    truth = brightness(surface.normals)
    truth = truth / truth.mean()
    shading = light.shading(surface.normals)
    assert np.corrcoef(shading, truth)[0, 1] > 0.95
    assert np.abs(shading - truth).mean() < 0.08
    assert truth.std() > 0.2, "there is shading to find"


def test_a_texture_keeps_its_size_and_stands_upright():
    """On a wall that faces -y, u runs to the right and v downwards, one repeat a period."""
    texture = np.random.default_rng(0).random((32, 32, 3))
    frame = Frame(np.zeros(3), np.eye(3), np.ones(3))
    u, v = np.meshgrid((np.arange(32) + 0.5) / 32, (np.arange(32) + 0.5) / 32)
    points = np.stack([2 * u, np.zeros_like(u), -2 * v], -1).reshape(-1, 3)
    normals = np.broadcast_to([0.0, -1.0, 0.0], points.shape)
    wall = wrap(texture, points, normals, frame, period=2.0).reshape(32, 32, 3)
    shifted = sampled(texture, (u + 0.37).ravel(), (v + 0.61).ravel()).reshape(32, 32, 3)
    assert np.allclose(wall, shifted)
    assert wall.std() > 0.1


def test_blending_keeps_the_contrast():
    texture = 0.5 + 0.1 * np.random.default_rng(0).standard_normal((64, 64, 3))
    frame = Frame(np.zeros(3), np.eye(3), np.ones(3))
    points = np.random.default_rng(1).uniform(-3, 3, (4000, 3))
    slanted = np.broadcast_to(np.ones(3) / np.sqrt(3), points.shape)
    straight = np.broadcast_to([1.0, 0.0, 0.0], points.shape)
    deviations = [wrap(texture, points, n, frame, 1.0).std() for n in (slanted, straight)]
    assert deviations[0] == pytest.approx(deviations[1], rel=0.1)


def test_views_agree_on_the_new_look():
    """The same point of the ball has the same colour in every view that shows it."""
    sights = [ball_sight(camera, waver=0.003, seed=n) for n, camera in enumerate(ring(12))]
    repainter = MaterialRepainter(MATERIALS["brick"])
    images = repainter.repaint(sights, [0], seed=0)
    again = repainter.repaint(sights, [0], seed=0)
    assert all(np.array_equal(a, b) for a, b in zip(images, again, strict=True))
    first, second = sights[0], sights[1]
    points = first.points
    local = points @ second.camera.pose[:3, :3].T + second.camera.pose[:3, 3]
    x, y = (local[:, :2] / local[:, 2:] * second.camera.fx + second.camera.cx).T
    facing = np.minimum(*((points - CENTER) @ (s.camera.center - CENTER) for s in (first, second)))
    both = facing > 0.75 * 0.5 * 2.2
    column, row = x[both].astype(int), y[both].astype(int)
    mine, theirs = images[0][first.touched][both], images[1][row, column]
    assert both.sum() > 200
    apart = np.abs(mine - theirs).mean()
    assert apart < 0.35 * np.abs(mine - mine.mean(axis=0)).mean()
    assert mine.std() > 0.05


def test_brightness_is_kept_where_the_light_was():
    sights = [ball_sight(camera) for camera in ring()]
    images = MaterialRepainter(MATERIALS["plaster"]).repaint(sights, [0], seed=0)
    for sight, image in zip(sights, images, strict=True):
        before, after = (each[sight.mask] ** GAMMA @ [0.3, 0.6, 0.1] for each in (sight.image, image))
        assert np.corrcoef(before, after)[0, 1] > 0.8


def test_hollows_of_an_object_of_one_hue_stay_dark_and_paint_does_not():
    """A dark patch of the same hue is shade; one of another hue is paint."""

    def patched(color):
        def albedo(normals: np.ndarray) -> np.ndarray:
            dark = normals @ [1.0, 0.0, 0.0] > 0.8
            return np.where(dark[:, None], color, np.full(3, 0.6))

        return albedo

    kept = []
    for color in ([0.2, 0.2, 0.2], [0.05, 0.1, 0.5]):
        surface = fuse([ball_sight(camera, patched(np.array(color))) for camera in ring()])
        light = estimate_light(surface.normals, surface.colors, np.full((10, 3), 0.5))
        beyond = shade_beyond(light, surface)
        side = surface.normals @ [1.0, 0.0, 0.0]
        kept.append(beyond[side > 0.9].mean() / beyond[np.abs(side) < 0.3].mean())
    shade, paint = kept
    assert shade < 0.75 and paint > shade + 0.15


def test_highlights_are_compressed_and_keep_their_order():
    light = np.linspace(0, 4, 400)
    display = exposed(light)
    assert (np.diff(display) > 0).all() and display[-1] < 1.0
    assert np.allclose(display[light < 0.5], light[light < 0.5] ** (1 / GAMMA))
