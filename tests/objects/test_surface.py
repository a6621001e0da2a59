"""A surface fused from wavering depth is the true one; frames stand upright."""

from dataclasses import replace

import numpy as np
import pytest
from ball import CENTER, RADIUS, ball_sight, ring

from diga3d_warp.errors import InputError
from diga3d_warp.objects.frame import frame_of, upward
from diga3d_warp.objects.surface import Surface, fuse, without_floaters


@pytest.fixture(scope="module")
def surface():
    return fuse([ball_sight(camera, waver=0.01, seed=n) for n, camera in enumerate(ring())])


def test_fused_points_lie_on_the_ball(surface):
    radius = np.linalg.norm(surface.points - CENTER, axis=1)
    assert len(surface.points) > 1000
    assert np.abs(radius - RADIUS).mean() < 0.006, "below the 0.008 of one view"
    outward = (surface.points - CENTER) / radius[:, None]
    assert (surface.normals * outward).sum(axis=1).mean() > 0.98


def test_feet_lie_on_the_ball_wherever_they_are_looked_for_from(surface):
    rng = np.random.default_rng(0)
    out = rng.normal(size=(500, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    out = out[np.abs(out[:, 2]) < 0.6]  # the cameras stand around: none sees the poles well
    feet, normals = surface.nearest(CENTER + out * (RADIUS + 0.03 * rng.normal(size=(len(out), 1))))
    assert np.abs(np.linalg.norm(feet - CENTER, axis=1) - RADIUS).mean() < 0.006
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    smooth = surface.smooth_normals(feet)
    assert (smooth * out).sum(axis=1).mean() > (normals * out).sum(axis=1).mean()


def test_repainted_views_change_only_the_object():
    sight = ball_sight(ring()[0])
    half = replace(sight, own=0.5 * sight.own, share=0.5 * sight.share)
    red = np.zeros_like(sight.image) + np.float32([1, 0, 0])
    for each, part in ((sight, 1.0), (half, 0.5)):
        changed = each.repainted(red)
        assert np.array_equal(changed[~each.touched], each.image[~each.touched])
        wanted = (1 - part) * each.image + part * red
        assert np.allclose(changed[each.touched], wanted[each.touched], atol=1e-6)


def test_parts_that_lie_apart_are_left_out():
    share = np.zeros((40, 40), np.float32)
    share[5:25, 5:25], share[30:32, 30:32] = 0.9, 0.9
    kept = without_floaters(share)
    assert kept[5:25, 5:25].min() == np.float32(0.9) and kept[30:].max() == 0
    assert without_floaters(np.zeros((4, 4), np.float32)).max() == 0


def test_an_object_that_shows_nowhere_is_refused():
    sight = ball_sight(ring()[0])
    empty = replace(sight, own=0 * sight.own, share=0 * sight.share, depth=0 * sight.depth)
    with pytest.raises(InputError, match="show in no view"):
        fuse([empty])


def test_up_is_found_whether_cameras_surround_the_object_or_stand_side_by_side():
    assert np.allclose(upward(ring()), [0, 0, 1], atol=1e-6)
    assert upward(ring()[:1]) @ [0, 0, 1] > 0.9


def test_a_frame_stands_on_the_base_of_the_object():
    rng = np.random.default_rng(1)
    points = rng.uniform([-1, -2, 3], [3, 2, 4], (20_000, 3))
    frame = frame_of(points, np.array([0.0, 0.0, 1.0]), np.array([0.0, -5.0, 2.0]))
    assert np.allclose(frame.origin, [1, 0, 3], atol=0.05)
    assert np.allclose(frame.extent, [4, 4, 1], rtol=0.03)
    assert np.allclose(frame.axes, np.eye(3), atol=1e-6)
    assert np.allclose(frame.outward(frame.inward(points)), points)


def test_objects_that_stand_apart_are_told_apart(surface):
    """The largest comes first; a gap that no view shows and a floater make no second object."""
    assert len(surface.parts()) == 1

    def beside(part, *shifts):
        points = [surface.points, *(part.points + [shift, 0, 0] for shift in shifts)]
        normals = [surface.normals, *(part.normals for _ in shifts)]
        colors = [surface.colors, *(part.colors for _ in shifts)]
        return Surface(*map(np.concatenate, (points, normals, colors)), surface.spacing)

    half = Surface(*(a[::2] for a in (surface.points, surface.normals, surface.colors)), surface.spacing)
    found = beside(half, 4 * RADIUS).parts()
    assert [len(part.points) for part in found] == [len(surface.points), len(half.points)]
    assert np.array_equal(found[0].points, surface.points)
    assert len(beside(half, 2.05 * RADIUS).parts()) == 1
    speck = Surface(*(a[:20] for a in (surface.points, surface.normals, surface.colors)), surface.spacing)
    assert len(beside(speck, 4 * RADIUS).parts()) == 1
