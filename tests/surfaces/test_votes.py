"""Spots of wrong depth on a surface that photographs agree on."""

from dataclasses import replace

import numpy as np

from diga3d_warp.splatting.placement import unprojected
from diga3d_warp.surfaces.chart import frame_on
from diga3d_warp.surfaces.planes import Plane
from diga3d_warp.surfaces.votes import _spots, poll
from tabletop import ROUND, level, photos


def test_spots_where_photographs_agree_are_no_holes():
    through = np.zeros((40, 60), bool)
    through[10:14, 10:14] = through[20:24, 30:34] = through[:5, 50:] = True
    agreed = np.zeros_like(through)
    agreed[:, :40] = agreed[:5, 50:] = True  # windows reach over the edge at the border
    agreed[20:24, 30:34] = False
    wrong = np.zeros_like(through)
    wrong[10:14, 10:14] = True
    np.testing.assert_array_equal(_spots(through, agreed), wrong)


def test_a_spot_of_wrong_depth_on_an_agreed_plane_stays_known():
    """The splat is deeper than the table on a disc beside the hole; the photographs show the table there."""
    seen = []
    for each in photos(eyes=ROUND):
        top = level(each.camera, 0.0)
        points = unprojected(np.where(np.isfinite(top), top, 1.0), each.camera)
        spot = np.hypot(points[..., 0] - 0.75, points[..., 1]) < 0.15
        seen.append(replace(each, depth=np.where(spot, 1.3 * each.depth, each.depth).astype(np.float32)))
    corners = np.array([[-1.2, -1.2, 0.0], [1.2, 1.2, 0.0], [1.2, -1.2, 0.0], [-1.2, 1.2, 0.0]])
    frame = replace(frame_on(Plane(np.array([0.0, 0.0, 1.0]), 0.0, corners), seen[0].camera), agreed=True)
    there = np.hypot(frame.points[..., 0] - 0.75, frame.points[..., 1]) < 0.1
    assert there.sum() > 20
    for agreed in (True, False):
        polled = poll(seen, replace(frame, agreed=agreed))
        assert polled.occupied[there].mean() > 0.9 if agreed else polled.through[there].mean() > 0.9


def test_what_stands_in_front_of_a_surface_for_all_photographs_covers_it():
    """A wall on the table at y = 0.6: seen from the front, it hides all of the table behind."""
    seen = []
    for each in photos():
        at_one = unprojected(np.ones(each.shape), each.camera) - each.camera.center
        wall = (0.6 - each.camera.center[1]) / at_one[..., 1]
        nearer = (wall > 0.0) & (wall < np.where(each.depth > 0.0, each.depth, np.inf))
        seen.append(replace(each, depth=np.where(nearer, wall, each.depth).astype(np.float32)))
    corners = np.array([[-0.9, -0.9, 0.0], [0.9, 1.2, 0.0], [0.9, -0.9, 0.0], [-0.9, 1.2, 0.0]])
    frame = frame_on(Plane(np.array([0.0, 0.0, 1.0]), 0.0, corners), seen[0].camera)
    polled, y = poll(seen, frame), frame.points[..., 1]
    assert polled.covered[y > 0.75].mean() > 0.9
    assert not polled.covered[y < 0.55].any()
    assert not (polled.covered & (polled.occupied | polled.through)).any()


def test_what_nobody_looks_at_is_not_covered():
    corners = np.array([[-9.0, -9.0, 0.0], [9.0, 9.0, 0.0], [9.0, -9.0, 0.0], [-9.0, 9.0, 0.0]])
    seen = photos()
    assert not poll(
        seen, frame_on(Plane(np.array([0.0, 0.0, 1.0]), 0.0, corners), seen[0].camera)
    ).covered.any()
