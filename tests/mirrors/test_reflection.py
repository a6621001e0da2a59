"""The mirror image is what the mirrored camera sees, on the other side of the plane."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from diga3d_warp.config import Effects
from diga3d_warp.gaussians.lift import LiftSettings, Votes
from diga3d_warp.mirrors.find import Mirror
from diga3d_warp.mirrors.masks import mirror_mask, mirrored_rows
from diga3d_warp.mirrors.picture import TINT, mirror_picture
from diga3d_warp.mirrors.reflection import Placing, Reflection, mirrored, reflection
from diga3d_warp.scene.camera import look_at
from diga3d_warp.splatting.render import render
from glossy import TALL, pillar, support
from scenes import random_gaussians
from tabletop import HEIGHT, WIDTH, camera_at, level

EYE = (0.4, -2.6, 2.2)


def frame():
    return support().frame


def test_mirroring_twice_gives_the_gaussians_back():
    gaussians = random_gaussians(50)
    twice = mirrored(mirrored(gaussians, frame()), frame())
    assert torch.allclose(twice.means, gaussians.means, atol=1e-5)
    unit = [torch.nn.functional.normalize(each.quaternions, dim=1) for each in (twice, gaussians)]
    assert torch.allclose((unit[0] * unit[1]).sum(1).abs(), torch.ones(50), atol=1e-4)


@pytest.mark.parametrize("degree", [0, 2])
def test_it_is_what_the_mirrored_camera_sees_upside_down(degree):
    gaussians = random_gaussians(150, degree=degree)
    gaussians = replace(gaussians, means=gaussians.means * 0.3 + torch.tensor([0.0, 0.0, 0.5]))
    camera = camera_at(EYE)
    shown = reflection(gaussians, camera, frame(), Effects())
    # The camera on the other side, upright there, sees left and right exchanged.
    below = torch.from_numpy(look_at(np.array(EYE) * [1, 1, -1], np.zeros(3), (0.0, 0.0, -1.0)))
    seen = render(gaussians, replace(camera, world_to_camera=below), effects=Effects(background=False))
    flipped = np.flip(seen.alpha.numpy(), axis=1)
    assert shown.cover.max() > 0.5
    assert np.abs(shown.cover - flipped).max() < 0.02
    assert shown.color.shape == (HEIGHT, WIDTH, 3) and shown.color.max() > 0.05


def test_colours_are_those_of_the_object_in_linear_light():
    red = np.array([0.5, 0.1, 0.02])
    plain = pillar(lambda turn, height: np.broadcast_to(red, (*turn.shape, 3)))
    shown = reflection(plain, camera_at(EYE), frame(), Effects())
    inside = shown.cover > 0.99
    assert inside.sum() > 100
    assert np.allclose(shown.color[inside], red, atol=0.02)


def test_other_places_lie_deeper_or_aside():
    gaussians = pillar(count=100)
    deeper = mirrored(gaussians, frame(), Placing(stretch=2.0)).means
    assert torch.allclose(deeper[:, 2], -2.0 * gaussians.means[:, 2], atol=1e-5)
    aside = mirrored(gaussians, frame(), Placing(shift=(0.5, 0.0))).means - mirrored(gaussians, frame()).means
    assert torch.allclose(aside.norm(dim=1), torch.full((100,), 0.5), atol=1e-5)


def whole() -> Mirror:
    return Mirror(frame(), np.ones(frame().size, bool), TALL, 0.05 * TALL)


def test_the_mask_goes_as_far_as_the_support():
    camera = camera_at(EYE)
    image = reflection(pillar(), camera, frame(), Effects())
    depth = level(camera, 0.0).astype(np.float32)
    mask = mirror_mask(whole(), image, camera, depth)
    assert mask.sum() > 100 and not (mask & (image.cover <= 0.1)).any()
    half = whole().surface
    half[: half.shape[0] // 2] = False
    less = mirror_mask(replace(whole(), surface=half), image, camera, depth)
    assert 0 < less.sum() < mask.sum()
    nothing = mirror_mask(replace(whole(), surface=np.zeros_like(half)), image, camera, depth)
    assert not nothing.any()


def test_what_stands_before_the_support_is_not_masked():
    camera = camera_at(EYE)
    image = reflection(pillar(), camera, frame(), Effects())
    depth = level(camera, 0.0).astype(np.float32)
    nearer = depth.copy()
    nearer[:, : WIDTH // 2] *= 0.7
    mask, less = (mirror_mask(whole(), image, camera, each) for each in (depth, nearer))
    assert mask[:, : WIDTH // 2].any() and not less[:, : WIDTH // 2].any()
    assert np.array_equal(mask[:, WIDTH // 2 :], less[:, WIDTH // 2 :])
    unknown = mirror_mask(whole(), image, camera, np.zeros_like(depth))
    assert np.array_equal(unknown, mask), "a mirror's depth is often not known"


def test_from_below_nothing_is_mirrored():
    pose = torch.from_numpy(look_at(np.array([0.4, -2.6, -1.0]), np.zeros(3)))
    camera = replace(camera_at(EYE), world_to_camera=pose)
    everywhere = Reflection(np.ones((HEIGHT, WIDTH, 3), np.float32), np.ones((HEIGHT, WIDTH), np.float32))
    assert not mirror_mask(whole(), everywhere, camera, np.zeros((HEIGHT, WIDTH), np.float32)).any()


def test_gaussians_under_the_support_go_where_they_show_the_mirror_image():
    above = pillar(count=100)
    under = mirrored(above, frame())
    both = above.joined(under)
    seen = torch.full((200,), 10.0)
    votes = Votes(seen.clone(), seen, seen, seen)
    rows = mirrored_rows(both, whole(), votes, LiftSettings())
    deep = under.means[:, 2] < -0.05 * TALL
    assert not rows[:100].any() and torch.equal(rows[100:], deep)
    elsewhere = replace(votes, masked=torch.zeros(200), inside=torch.zeros(200))
    assert not mirrored_rows(both, whole(), elsewhere, LiftSettings()).any()


def test_the_picture_shows_the_photograph_the_mirror_image_and_the_mask():
    image = reflection(pillar(), camera_at(EYE), frame(), Effects())
    photograph = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
    picture = mirror_picture(photograph, image, image.cover > 0.5)
    assert picture.shape == (HEIGHT, 3 * WIDTH + 8, 3)
    assert picture[:, WIDTH + 4 : 2 * WIDTH + 4].std() > 0.05
    marked = picture[:, -WIDTH:][image.cover > 0.5]
    assert np.allclose(marked, 0.5 * 128 / 255 + 0.5 * np.array(TINT), atol=1e-3)
