"""Filling in turn: cameras over a textured floor with a hole that nobody saw into."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from diga3d_warp.propagation.fill import Fill, RestSettings, fill_references, fill_rest, invent, warp_fills
from diga3d_warp.propagation.references import References
from diga3d_warp.propagation.unseen import Background
from diga3d_warp.scene.camera import Camera, look_at

WIDTH, HEIGHT, FOCAL = 96, 72, 80.0
EYES = [(0.0, -3.0, 2.5), (0.9, -2.9, 2.4), (-0.8, -3.0, 2.6), (0.4, -3.1, 2.2)]
HOLE = 0.55  # radius of the disc on the floor that nobody saw [m]


def make_camera(eye) -> Camera:
    pose = torch.from_numpy(look_at(np.array(eye), np.zeros(3)))
    return Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, pose)


CAMERAS = [make_camera(eye) for eye in EYES]


def floor_points(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Where each pixel's ray meets the floor z = 0, shape (H, W, 2), and its depth, shape (H, W)."""
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack(
        [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones_like(rows)], -1
    )
    rays = rays @ camera.pose[:3, :3]
    depth = -camera.center[2] / rays[..., 2]
    points = camera.center + rays * depth[..., None]
    return points[..., :2], depth.astype(np.float32)


def floor_color(points: np.ndarray) -> np.ndarray:
    x, y = points[..., 0], points[..., 1]
    return np.stack([0.5 + 0.2 * np.sin(3 * x), 0.5 + 0.2 * np.cos(4 * y), 0.3 + 0.1 * x], -1).astype(
        np.float32
    )


def unseen_disc(camera: Camera, radius: float = HOLE) -> np.ndarray:
    return np.linalg.norm(floor_points(camera)[0], axis=-1) < radius


def background(camera: Camera, radius: float = HOLE) -> Background:
    image = floor_color(floor_points(camera)[0])
    unseen = unseen_disc(camera, radius)
    image[unseen] = [1.0, 0.0, 0.0]  # the object
    return Background(unseen, image, np.zeros_like(unseen))


class Story:
    """A prior that paints the true floor but in its own tint, and remembers what it was asked for."""

    name = "story"

    def __init__(self) -> None:
        self.asked: list[np.ndarray] = []
        self.tints = iter((0.3, 0.1, 0.2))

    def fill(
        self, image: torch.Tensor, mask: torch.Tensor, *, seed: int = 0, depth: torch.Tensor | None = None
    ) -> torch.Tensor:
        assert not ((image[~mask] == torch.tensor([1.0, 0.0, 0.0])).all(-1)).any(), "the object is masked"
        assert depth is not None and depth.shape == mask.shape and (depth > 0.0).all()
        self.asked.append(mask.numpy().copy())
        painted = image.clone()
        painted[mask] = torch.tensor([0.0, 0.0, 0.7]) + next(self.tints)
        return painted


class Truth:
    """A prior that knows the floor; it tells the view by its known pixels."""

    name = "truth"

    def fill(
        self, image: torch.Tensor, mask: torch.Tensor, *, seed: int = 0, depth: torch.Tensor | None = None
    ) -> torch.Tensor:
        views = [torch.from_numpy(floor_color(floor_points(camera)[0])) for camera in CAMERAS]
        truth = min(views, key=lambda view: float((view - image)[~mask].abs().sum()))
        return torch.where(mask[..., None], truth, image)


DEPTHS = [floor_points(camera)[1] for camera in CAMERAS]
REFERENCES = References([0, 1], np.array([0, 1, 0, 1]))


@pytest.fixture
def filled():
    """The prior, and the fills of both references."""
    prior = Story()
    backgrounds = [background(camera) for camera in CAMERAS]
    depths = []
    for camera in CAMERAS:
        depth = floor_points(camera)[1].copy()
        depth[unseen_disc(camera)] = 1.0  # what shows through the hole is of no use
        depths.append(depth)
    return prior, backgrounds, fill_references(CAMERAS, backgrounds, depths, REFERENCES, prior, seed=0)


def test_the_first_reference_is_invented_whole(filled):
    prior, backgrounds, (first, _) = filled
    unseen = backgrounds[0].unseen
    assert 200 < unseen.sum() < 3000
    for mask in (prior.asked[0], first.filled, first.invented):
        np.testing.assert_array_equal(mask, unseen)
    assert not first.missing.any()
    np.testing.assert_allclose(first.image[unseen], np.tile([0.3, 0.3, 1.0], (unseen.sum(), 1)), atol=1e-6)


def test_the_fill_lies_on_the_floor(filled):
    _, backgrounds, fills = filled
    for index, fill in zip(REFERENCES.indices, fills, strict=True):
        unseen = backgrounds[index].unseen
        np.testing.assert_allclose(fill.depth[unseen], floor_points(CAMERAS[index])[1][unseen], rtol=2e-3)
        assert not fill.depth[~unseen].any()


def test_the_second_reference_tells_the_story_of_the_first(filled):
    prior, backgrounds, (_, second) = filled
    unseen = backgrounds[1].unseen
    np.testing.assert_array_equal(second.filled, unseen)
    assert second.invented.sum() < 0.12 * unseen.sum(), "hardly anything is left to invent"
    taken = unseen & ~second.invented
    np.testing.assert_allclose(second.image[taken], np.tile([0.3, 0.3, 1.0], (taken.sum(), 1)), atol=0.01)
    if second.invented.any():
        np.testing.assert_array_equal(prior.asked[1], second.invented)


def test_unmasked_pixels_are_untouched(filled):
    _, backgrounds, fills = filled
    views = warp_fills(CAMERAS, backgrounds, DEPTHS, REFERENCES, fills)
    assert len(views) == len(CAMERAS)
    for view, known in zip(views, backgrounds, strict=True):
        np.testing.assert_array_equal(view.image[~known.unseen], known.image[~known.unseen])
        assert not (view.filled | view.missing | view.invented)[~known.unseen].any()
        np.testing.assert_array_equal(view.filled ^ view.missing, known.unseen)


def test_every_view_shows_the_same_fill_where_it_belongs(filled):
    _, backgrounds, fills = filled
    views = warp_fills(CAMERAS, backgrounds, DEPTHS, REFERENCES, fills)
    assert views[0] is fills[0] and views[1] is fills[1]
    for index in (2, 3):
        view, unseen = views[index], backgrounds[index].unseen
        assert view.filled.sum() > 0.9 * unseen.sum()
        assert not view.invented.any()
        np.testing.assert_allclose(
            view.depth[view.filled], floor_points(CAMERAS[index])[1][view.filled], rtol=5e-3
        )
        assert (view.image[view.filled][:, 0] < 0.35).all(), "no trace of the object"


def test_a_view_takes_from_its_own_reference_first():
    backgrounds = [background(camera) for camera in CAMERAS]
    fills = []
    for index, tint in zip(REFERENCES.indices, (0.2, 0.6), strict=True):
        unseen = backgrounds[index].unseen
        image = backgrounds[index].image.copy()
        image[unseen] = tint
        depth = np.where(unseen, floor_points(CAMERAS[index])[1], 0.0).astype(np.float32)
        fills.append(Fill(image, depth, unseen, unseen, np.zeros_like(unseen)))
    for index, tint, other in ((2, 0.2, 0.6), (3, 0.6, 0.2)):
        view = warp_fills(CAMERAS, backgrounds, DEPTHS, REFERENCES, fills)[index]
        values = view.image[view.filled][:, 0]
        assert np.isclose(values, tint, atol=1e-3).mean() > 0.9
        assert np.isclose(values, other, atol=1e-3).mean() < 0.1


def test_what_no_reference_shows_stays_missing():
    backgrounds = [background(camera, HOLE if i < 2 else 2 * HOLE) for i, camera in enumerate(CAMERAS)]
    fills = fill_references(CAMERAS, backgrounds, DEPTHS, REFERENCES, Story(), seed=0)
    view = warp_fills(CAMERAS, backgrounds, DEPTHS, REFERENCES, fills)[2]
    inside = unseen_disc(CAMERAS[2], 0.9 * HOLE)
    outside = backgrounds[2].unseen & ~unseen_disc(CAMERAS[2], 1.1 * HOLE)
    assert view.missing[outside].all() and not view.depth[outside].any()
    assert view.filled[inside].mean() > 0.98
    assert not view.missing[~backgrounds[2].unseen].any()


def wide_behind(views: int):
    """A hole that is twice as wide in the last views, and the fills of both references in all of them."""
    backgrounds = [
        background(camera, HOLE if i < 4 - views else 2 * HOLE) for i, camera in enumerate(CAMERAS)
    ]
    prior = Story()
    fills = fill_references(CAMERAS, backgrounds, DEPTHS, REFERENCES, prior, seed=0)
    return prior, backgrounds, warp_fills(CAMERAS, backgrounds, DEPTHS, REFERENCES, fills)


def test_what_no_reference_shows_is_filled_once_for_all_further_views():
    prior, backgrounds, warped = wide_behind(2)
    fills = fill_rest(CAMERAS, backgrounds, DEPTHS, warped, prior, 0, RestSettings(views=1))
    asked = prior.asked[2:]
    (most,) = (i for i in (2, 3) if fills[i].invented.any())
    assert len(asked) == 1 and most == max((2, 3), key=lambda i: warped[i].missing.sum())
    np.testing.assert_array_equal(fills[most].invented, warped[most].missing)
    other = 5 - most
    assert fills[other].missing.mean() < 0.4 * warped[other].missing.mean(), "the rest is out of its sight"
    new = warped[other].missing & fills[other].filled
    np.testing.assert_allclose(fills[other].image[new], np.tile([0.2, 0.2, 0.9], (new.sum(), 1)), atol=0.03)
    np.testing.assert_allclose(fills[other].depth[new], DEPTHS[other][new], rtol=5e-3)
    for before, after in zip(warped, fills, strict=True):
        np.testing.assert_array_equal(after.image[~before.missing], before.image[~before.missing])
        np.testing.assert_array_equal(after.depth[before.filled], before.depth[before.filled])


def test_further_views_are_bounded_and_rims_are_left():
    prior, backgrounds, warped = wide_behind(2)
    none = fill_rest(CAMERAS, backgrounds, DEPTHS, warped, prior, 0, RestSettings(views=0))
    assert len(prior.asked) == 2 and none[3].missing.any()
    fill_rest(CAMERAS, backgrounds, DEPTHS, warped, prior, 0, RestSettings(share=0.95))
    assert len(prior.asked) == 2


def test_where_everything_was_seen_nothing_is_invented():
    prior = Story()
    backgrounds = [background(camera, 0.0) for camera in CAMERAS]
    fills = fill_references(CAMERAS, backgrounds, DEPTHS, REFERENCES, prior, seed=0)
    assert prior.asked == []
    for view, known in zip(
        warp_fills(CAMERAS, backgrounds, DEPTHS, REFERENCES, fills), backgrounds, strict=True
    ):
        np.testing.assert_array_equal(view.image, known.image)
        assert not (view.filled | view.missing | view.invented).any()


def test_a_carried_fill_takes_on_the_light_of_its_view():
    gains = np.array([1.0, 1.0, 0.8, 1.15], np.float32)
    backgrounds = [background(camera) for camera in CAMERAS]
    lit = [
        Background(b.unseen, b.image * gain, b.observed) for b, gain in zip(backgrounds, gains, strict=True)
    ]
    fills = fill_references(CAMERAS, lit, DEPTHS, REFERENCES, Truth(), seed=0)
    for index in (2, 3):
        view = warp_fills(CAMERAS, lit, DEPTHS, REFERENCES, fills)[index]
        truth = floor_color(floor_points(CAMERAS[index])[0])
        inside = view.filled
        error = np.abs(view.image - truth * gains[index])[inside].mean()
        untoned = np.abs(truth - truth * gains[index])[inside].mean()
        assert inside.sum() > 150
        assert error < 0.25 * untoned


def test_what_is_nowhere_is_no_source_of_a_fill():
    """A prior is not told the white of transparent pixels, and only the hole takes what it paints there."""
    hole, alpha = np.zeros((40, 50), bool), np.zeros((40, 50), np.uint8)
    hole[15:25, 20:30] = True
    alpha[12:32, 18:38] = 255
    image = np.where(alpha[..., None] > 0, np.float32([0.2, 0.4, 0.3]), np.float32(1.0))
    image[hole] = [1.0, 0.0, 0.0]
    depth = np.where((alpha > 0) & ~hole, 2.0, 0.0).astype(np.float32)

    class Told(Story):
        def fill(self, image, mask, *, seed=0, depth=None):
            assert mask.any() and not (image[~mask] == 1.0).all(-1).any()
            return super().fill(image, mask, seed=seed, depth=depth)

    filled, completed = invent(image, depth, hole, Told(), 0, alpha)
    np.testing.assert_array_equal(filled[~hole], image[~hole])
    assert (filled[hole] == np.float32([0.3, 0.3, 1.0])).all() and (completed[hole] > 0).all()
