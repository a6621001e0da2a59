"""A box behind the removed object, also on a floor whose splat has wrong depth: photographs of it stay."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from diga3d_warp.propagation.charted import chart_views, photo_of, photos_of
from diga3d_warp.propagation.unseen import observe_behind
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.scene import View
from diga3d_warp.splatting.placement import projected, unprojected
from diga3d_warp.surfaces.chart import Chart, frame_on
from diga3d_warp.surfaces.consistency import consistent
from diga3d_warp.surfaces.planes import Plane
from diga3d_warp.surfaces.surfels import surfels
from diga3d_warp.surfaces.votes import refused
from tabletop import EYES, HOLE, ROUND, camera_at, level, photo, tiles

BACK, HALF, TALL = 0.45, 0.35, 0.6
"""Where the front of the box stands, half its width, and its height [m]."""


def front(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """z at which pixels meet the front of the box, infinite beside it, and its colours: red with yellow."""
    rays = unprojected(np.ones((camera.height, camera.width)), camera) - camera.center
    z = (BACK - camera.center[1]) / rays[..., 1]
    places = unprojected(np.where(z > 0.0, z, 1.0), camera)
    x, height = places[..., 0], places[..., 2]
    on = (z > 0.0) & (np.abs(x) < HALF) & (height > 0.0) & (height < TALL)
    wave = 0.5 + 0.4 * np.sin(2.0 * np.pi * x / 0.3) * np.sin(2.0 * np.pi * height / 0.3)
    return np.where(on, z, np.inf), np.stack([np.full_like(wave, 0.85), wave, np.full_like(wave, 0.1)], -1)


def around(camera: Camera) -> np.ndarray:
    """The mask of a pillar at the origin, shape (H, W), bool."""
    turns = np.linspace(0.0, 2.0 * np.pi, 40)
    rims = [np.stack([0.3 * np.cos(turns), 0.3 * np.sin(turns), 0.0 * turns + top], -1) for top in (0.0, 0.5)]
    corners = projected(np.concatenate(rims), camera)[:, :2].astype(np.float32)
    mask = np.zeros((camera.height, camera.width), np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(corners).astype(np.int32), 1)
    return mask > 0


class Room:
    """Photographs of the box, what is known behind the pillar, and the floor's chart."""

    def __init__(self, splat: str) -> None:
        self.views, self.masks, self.depths, self.box, self.truth = [], [], [], [], []
        for number, eye in enumerate(ROUND):
            camera, rng = camera_at(eye), np.random.default_rng(number)
            floor = photo(camera, tiles, hole=0.0)
            waver = cv2.GaussianBlur(rng.standard_normal(floor.shape), (0, 0), 6.0)
            depth = level(camera, -0.25) if splat == "mirrored" else floor.depth
            if splat == "wavering":
                depth = depth * (1.1 + 0.2 * waver / waver.std())
            z, colors = front(camera)
            box = z < np.where(floor.depth > 0.0, floor.depth, np.inf)
            truth = np.where(box[..., None], colors, floor.pixels / 255.0)
            mask = around(camera)
            noisy = np.clip(truth * 255.0 + rng.normal(0.0, 1.5, truth.shape), 0.0, 255.0).astype(np.uint8)
            noisy[mask] = (0, 255, 0)
            depth = np.where(box, z * (1.0 + 0.004 * rng.standard_normal(z.shape)), depth)
            self.views.append(View(f"{number}", camera, noisy))
            self.masks.append(mask)
            self.depths.append(np.where(np.isfinite(depth), depth, 0.0).astype(np.float32))
            self.box.append(box)
            self.truth.append(truth)
        solid = [np.ones_like(depth) for depth in self.depths]
        self.backgrounds = observe_behind(self.views, self.masks, self.depths, solid)
        self.charts = [replace(floor_chart(), deep=splat == "right")]
        self.charted = chart_views(self.views, self.backgrounds, self.depths, self.charts)

    @property
    def photos(self):
        return [photo_of(*each) for each in zip(self.views, self.backgrounds, self.depths, strict=True)]


def floor_chart() -> Chart:
    """The floor as photographs agree on it, filled in the hole."""
    corners = np.array([[x, y, 0.0] for x in (-1.7, 1.7) for y in (-1.7, 1.7)])
    frame = frame_on(Plane(np.array([0.0, 0.0, 1.0]), 0.0, corners, agreed=True), camera_at(EYES[0]))
    points = frame.points
    wanted = np.hypot(points[..., 0], points[..., 1]) < HOLE
    image = tiles(points[..., 0], points[..., 1]).astype(np.float32)
    nothing = np.zeros_like(wanted)
    return Chart(frame, image, ~wanted, nothing, wanted, np.ones(frame.size, np.float32), deep=False)


@pytest.fixture(scope="module", params=["right", "wavering", "mirrored"])
def room(request):
    return Room(request.param)


def test_what_photographs_show_of_the_box_is_not_painted_over(room):
    known = kept = 0
    for background, charted, box, truth in zip(
        room.backgrounds, room.charted, room.box, room.truth, strict=True
    ):
        seen = background.observed & box
        right = seen & (np.abs(background.image - truth).max(axis=2) < 0.15)
        known += right.sum()
        kept += (right & ~charted.shown).sum()
        np.testing.assert_array_equal(
            charted.background.image[seen & ~charted.shown], background.image[seen & ~charted.shown]
        )
    assert known > 100
    assert kept > 0.9 * known


def test_the_floor_goes_on_beside_it(room):
    """Whatever colour the removed object has, which the photographs still show in the hole."""
    for background, charted, box, mask, truth in zip(
        room.backgrounds, room.charted, room.box, room.masks, room.truth, strict=True
    ):
        hole = mask & ~box
        assert charted.shown[hole & background.unseen].mean() > 0.95
        assert np.abs(charted.background.image - truth)[hole & charted.shown].mean() < 0.13
        assert charted.background.image[charted.shown].std() > 0.05, "not blank"


def test_no_gaussian_stands_before_what_photographs_show(room):
    """Wrong depth refuses gaussians on the floor, and lets others hide it."""
    seen = photos_of(room.views, room.backgrounds, room.depths, room.charts)
    (discs,) = surfels(room.charts, 1)
    assert refused(discs.means.double().numpy(), seen).mean() < 0.02
    rng = np.random.default_rng(0)
    floating = rng.uniform((-0.9, -0.9, 0.15), (0.9, 0.2, 0.5), (300, 3))
    assert refused(floating, seen).mean() > 0.9
    before_box = rng.uniform((-0.2, 0.1, 0.3), (0.2, 0.25, 0.5), (300, 3))
    assert refused(before_box, seen).mean() > 0.8


def test_right_depth_is_left_alone(room):
    """Where the depth of the splat is right on a chart, gaussians are held against the splat itself."""
    right = [replace(chart, deep=True) for chart in room.charts]
    seen = photos_of(room.views, room.backgrounds, room.depths, right)
    for each, depth in zip(seen, room.depths, strict=True):
        np.testing.assert_array_equal(each.depth, depth)


def test_one_photograph_bears_nothing_out(room):
    photos = room.photos
    asked = room.box[0] & room.backgrounds[0].observed
    floor = np.full((*asked.shape, 3), 0.7)
    assert consistent(photos[0], asked, photos, floor).sum() > 0.5 * asked.sum() > 0
    assert not consistent(photos[0], asked, photos[:2], floor).any()
    assert not consistent(photos[0], np.zeros_like(asked), photos, floor).any()
