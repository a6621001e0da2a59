"""What nobody saw behind a board that stands before a textured wall, against geometry worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.propagation.unseen import observe_behind
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import View

WALL, BOARD, HALF_WIDTH, HALF_HEIGHT = 4.0, 3.0, 0.5, 0.4
WIDTH, HEIGHT, FOCAL = 120, 90, 100.0


def wall_color(x, y):
    return np.stack([0.5 + 0.3 * np.sin(3 * x), 0.5 + 0.3 * np.cos(2 * y), 0.5 + 0.1 * x + 0.1 * y], -1)


def rays():
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return (columns - WIDTH / 2) / FOCAL, (rows - HEIGHT / 2) / FOCAL


def hides(eye_x, x, y):
    """Whether the board hides wall point (x, y) from a camera at (eye_x, 0, 0)."""
    share = BOARD / WALL
    return (np.abs(eye_x + (x - eye_x) * share) < HALF_WIDTH) & (np.abs(y * share) < HALF_HEIGHT)


def board_scene(eyes):
    views = []
    for n, eye in enumerate(eyes):
        rx, ry = rays()
        x, y = eye + WALL * rx, WALL * ry
        hidden = hides(eye, x, y)
        image = np.where(hidden[..., None], [1.0, 0.0, 0.0], wall_color(x, y))
        pose = np.eye(4)
        pose[0, 3] = -eye
        camera = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, torch.tensor(pose))
        pixels = np.rint(255 * image).astype(np.uint8)
        views.append(View(f"{n:02d}", camera, pixels, hidden))
    depth, alpha = np.full((HEIGHT, WIDTH), WALL, np.float32), np.ones((HEIGHT, WIDTH), np.float32)
    return views, [depth] * len(views), [alpha] * len(views)


def masks_of(views):
    return [view.mask for view in views]


EYES = np.linspace(-0.9, 0.9, 7)


def seen_by_two(eyes, i):
    rx, ry = rays()
    x, y = eyes[i] + WALL * rx, WALL * ry
    inside = [np.abs(x - eye) * FOCAL / WALL < WIDTH / 2 - 1 for eye in eyes]
    count = sum(
        (~hides(eye, x, y) & ok).astype(int)
        for j, (eye, ok) in enumerate(zip(eyes, inside, strict=True))
        if j != i
    )
    return x, y, count >= 2


def test_only_what_no_view_sees_remains_and_the_rest_has_the_true_colours():
    views, depths, alphas = board_scene(EYES)
    for i, (view, background) in enumerate(
        zip(views, observe_behind(views, masks_of(views), depths, alphas), strict=True)
    ):
        x, y, seen = seen_by_two(EYES, i)
        truth = view.mask & ~seen
        assert 0.05 < truth.sum() / view.mask.sum() < 0.95
        assert (background.unseen ^ truth).sum() < 0.12 * view.mask.sum()
        assert not (truth & ~background.unseen).any()
        np.testing.assert_array_equal(background.observed, view.mask & ~background.unseen)
        error = np.abs(background.image - wall_color(x, y))[background.observed]
        assert error.max() < 0.005
        kept = ~background.observed
        np.testing.assert_allclose(background.image[kept], view.image.numpy()[kept])


def test_a_hole_without_opacity_is_unseen():
    views, depths, alphas = board_scene(EYES)
    alphas = [alpha.copy() for alpha in alphas]
    alphas[3][30:60, 40:80] = 0.1
    background = observe_behind(views, masks_of(views), depths, alphas)[3]
    assert background.unseen[views[3].mask & (alphas[3] < 0.5)].all()


def test_a_depth_that_other_views_deny_is_unseen():
    views, depths, alphas = board_scene(EYES)
    depths = [depth.copy() for depth in depths]
    depths[3][views[3].mask] = 0.8 * WALL  # a floater where the object was, which nobody else renders
    background = observe_behind(views, masks_of(views), depths, alphas)[3]
    assert background.unseen[views[3].mask].mean() > 0.95


def test_the_backs_of_surfaces_do_not_count():
    """A camera beyond the wall renders the same depth, but looks at the other side of it."""
    views, depths, alphas = board_scene([0.0, 0.01, -0.01])
    turned = np.diag([-1.0, 1.0, -1.0, 1.0])
    turned[:3, 3] = turned[:3, :3] @ [0.0, 0.0, -2 * WALL]
    behind = [
        View(f"b{n}", view.camera.with_pose(turned), np.full_like(view.pixels, 255), np.zeros_like(view.mask))
        for n, view in enumerate(views)
    ]
    alone = observe_behind(views, masks_of(views), depths, alphas)[0]
    joined = observe_behind([*views, *behind], masks_of([*views, *behind]), depths * 2, alphas * 2)[0]
    np.testing.assert_array_equal(joined.unseen, alone.unseen)
    assert alone.unseen.sum() > 0.8 * views[0].mask.sum()


def test_one_view_and_empty_masks():
    views, depths, alphas = board_scene([0.0])
    np.testing.assert_array_equal(
        observe_behind(views, masks_of(views), depths, alphas)[0].unseen, views[0].mask
    )
    empty = views[0].with_mask(np.zeros_like(views[0].mask))
    background = observe_behind([empty], masks_of([empty]), depths, alphas)[0]
    assert not background.unseen.any() and not background.observed.any()


def test_sizes_that_do_not_fit_are_refused():
    views, depths, alphas = board_scene([0.0, 0.1])
    with pytest.raises(InputError, match=r"view 01 .* one size"):
        observe_behind(views, [views[0].mask, views[1].mask[1:]], depths, alphas)
    with pytest.raises(InputError, match="one size"):
        observe_behind(views, masks_of(views), [depths[0][:-1], depths[1]], alphas)


def cut_scene(plinth: float):
    """The board scene with nothing but a plinth behind the board: the wall from y = `plinth` downwards."""
    views, depths, _ = board_scene(EYES)
    cut, left = [], []
    for eye, view in zip(EYES, views, strict=True):
        rx, ry = rays()
        wall = WALL * ry > plinth
        own = np.where(view.mask | wall, 255, 0).astype(np.uint8)
        pixels = np.where(own[..., None] > 0, view.pixels, 255).astype(np.uint8)
        cut.append(replace(view, pixels=pixels, alpha=own))
        x = eye + WALL * rx
        # The hole that the board left in the splat: a part of the plinth that touched it.
        hole = (np.abs(x) < 0.1) & (np.abs(WALL * ry - plinth - 0.25) < 0.1)
        stands = wall & ~hole
        stands[33:35, 65:67] = stands[36:45, 60] = True  # what is left of the object: a crumb, and a spike
        left.append(stands.astype(np.float32))
    return cut, depths, left


def test_where_nothing_is_behind_nothing_is_missing():
    """Above the plinth nothing is to be filled; a hole in the plinth is, wherever the plinth encloses it."""
    views, depths, alphas = cut_scene(plinth=0.0)
    _, ry = rays()
    above = np.broadcast_to(WALL * ry < 0.0, views[0].mask.shape)
    for eye, view, alpha, background in zip(
        EYES, views, alphas, observe_behind(views, masks_of(views), depths, alphas), strict=True
    ):
        nothing = view.mask & above
        hole = view.mask & ~above & (alpha == 0.0)
        assert nothing.sum() > 300 and hole.sum() > 10, eye
        assert background.unseen[nothing].sum() <= 1, "the foot of the spike"
        assert background.unseen[hole].all()
        nothing &= ~background.unseen
        assert (background.image[nothing] == 1.0).all()
        np.testing.assert_array_equal(background.alpha, np.where(nothing, 0, view.alpha))


def test_a_rim_of_a_photograph_is_nobodys_witness():
    """Pixels that let half of the background through would be carried into others' views."""
    views, depths, alphas = board_scene(EYES)
    rimmed = []
    for view in views:
        own = np.full(view.mask.shape, 255, np.uint8)
        own[:, ::8] = 128
        pixels = np.where(own[..., None] < 255, (view.pixels // 2 + 128).astype(np.uint8), view.pixels)
        rimmed.append(replace(view, pixels=pixels, alpha=own))
    for i, background in enumerate(observe_behind(rimmed, masks_of(rimmed), depths, alphas)):
        x, y, _ = seen_by_two(EYES, i)
        error = np.abs(background.image - wall_color(x, y))[background.observed]
        assert background.observed.sum() > 100 and np.median(error) < 0.005 and (error < 0.03).all()
