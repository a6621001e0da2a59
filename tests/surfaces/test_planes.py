"""Planes from points of depth and sparse points."""

from dataclasses import replace

import numpy as np
import pytest

from diga3d_warp.surfaces.evidence import Evidence, gather
from diga3d_warp.surfaces.planes import Plane, _add, find_planes, mean_eye
from diga3d_warp.surfaces.settings import SURFACES
from tabletop import EYES, camera_at, photo, photos

NO_POINTS = np.zeros((0, 3))
EYE = mean_eye([camera_at(eye) for eye in EYES])


def plane_points(rng, normal, offset, count=2000, noise=0.0, spread=1.0) -> Evidence:
    """Points on a plane, three units from their camera."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    basis = np.linalg.svd(normal[None])[2][1:]
    points = rng.uniform(-spread, spread, (count, 2)) @ basis + offset * normal
    points += noise * rng.standard_normal((count, 1)) * normal
    return Evidence(points, np.tile(normal, (count, 1)), np.full(count, 3.0))


def joined(*parts: Evidence) -> Evidence:
    return Evidence(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.depths for part in parts]),
    )


def test_a_floor_is_found_in_depth_that_wavers():
    found = find_planes(gather(photos(waver=0.01), NO_POINTS, 0), EYE, 0)
    assert len(found) == 1
    assert found[0].normal[2] > np.cos(np.radians(1.0)), "towards the cameras"
    assert abs(found[0].offset) < 0.01


def test_two_surfaces_are_told_apart():
    seen = photos(covers=lambda x, y: x < 0.2)
    found = find_planes(gather(seen, NO_POINTS, 0), EYE, 0)
    assert sorted(round(plane.offset, 1) for plane in found) == [-1.0, 0.0]


def test_two_nearly_equal_planes_are_one():
    """A rug on a floor: what depth cannot tell apart is one surface."""
    rng = np.random.default_rng(0)
    tilted = (0.0, np.sin(np.radians(2.0)), np.cos(np.radians(2.0)))
    near = joined(plane_points(rng, (0, 0, 1), 0.0, 3000, 0.02), plane_points(rng, tilted, 0.03, 2000, 0.02))
    assert len(find_planes(near, np.array([0.0, 0.0, 5.0]), 0)) == 1
    apart = joined(plane_points(rng, (0, 0, 1), 0.0, 3000), plane_points(rng, tilted, 0.5, 2000))
    assert len(find_planes(apart, np.array([0.0, 0.0, 5.0]), 0)) == 2


def test_a_plane_that_was_found_already_is_not_kept():
    rng = np.random.default_rng(0)
    floor, again, step = (
        Plane(np.array([0.0, 0.0, 1.0]), height, plane_points(rng, (0, 0, 1), height).points)
        for height in (0.0, 0.05, 0.2)
    )
    kept: list[Plane] = []
    for plane in (floor, again, step):
        _add(kept, plane, np.full(9, 3.0), SURFACES)
    assert kept == [floor, step]


def test_scattered_points_are_no_plane():
    rng = np.random.default_rng(0)
    cloud = Evidence(rng.uniform(-1, 1, (3000, 3)), np.zeros((3000, 3)), np.full(3000, 0.1))
    assert not find_planes(cloud, np.array([0.0, 0.0, 5.0]), 0)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_units_do_not_matter(scale):
    rng = np.random.default_rng(0)
    one = plane_points(rng, (0.1, 0.2, 1.0), 0.4, 2000, 0.005)
    small = Evidence(scale * one.points, one.normals, scale * one.depths)
    (plane,) = find_planes(small, scale * np.array([0.0, 0.0, 5.0]), 0)
    assert plane.offset / scale == pytest.approx(0.4, abs=0.01)


def test_sparse_points_help_where_depth_is_missing():
    """A bench top whose splat has holes: what depth there is lies on it."""
    seen = photos()
    for each in seen:
        each.depth[:, :] = np.where(np.arange(each.shape[1]) % 5 == 0, each.depth, 0.0)
    rng = np.random.default_rng(0)
    sparse = np.c_[rng.uniform(-1.5, 1.5, (400, 2)), np.zeros(400)]
    with_points, without = gather(seen, sparse, 0), gather(seen, NO_POINTS, 0)
    assert len(with_points) > len(without)
    (plane,) = find_planes(with_points, EYE, 0)
    assert abs(plane.offset) < 0.01


@pytest.mark.parametrize("value", [0.0, np.inf, -1.0, np.nan])
def test_depth_that_is_none_is_no_evidence(value):
    seen = photos()
    for each in seen:
        each.depth[:48] = value
    evidence = gather(seen, NO_POINTS, 0)
    assert len(evidence) > 100
    assert np.isfinite(evidence.points).all() and np.abs(evidence.points[:, 2]).max() < 0.05
    blind = [replace(each, depth=np.full_like(each.depth, value)) for each in seen]
    assert len(gather(blind, NO_POINTS, 0)) == 0


def test_a_sky_of_finite_depth_is_no_evidence():
    """Splats put their sky at any distance."""
    seen = photos()
    for each in seen:
        each.depth[:40] = 1e30
    evidence = gather(seen, NO_POINTS, 0)
    assert len(evidence) > 100 and np.abs(evidence.points).max() < 1e3


def test_a_plane_through_a_camera_is_not_seen_by_it():
    camera = camera_at((0.0, -3.0, 1.0))
    through = Plane(np.array([0.0, 0.0, 1.0]), 1.0, NO_POINTS)
    assert np.isnan(through.depth(camera)).all()
    behind = Plane(np.array([0.0, 1.0, 0.0]), -4.0, NO_POINTS)
    assert np.isnan(behind.depth(camera)).all()


def test_a_plane_is_not_seen_at_a_grazing_angle():
    """Towards the horizon one pixel covers metres; there a chart would smear."""
    camera = camera_at((0.0, -3.0, 0.25), (0.0, 0.0, 0.2))
    floor = Plane(np.array([0.0, 0.0, 1.0]), 0.0, NO_POINTS)
    depth = floor.depth(camera)
    assert np.isfinite(depth[-1]).all() and np.isnan(depth[40]).all()
    assert np.nanmax(depth) < 0.25 / 0.1 * 1.1


def test_depth_is_that_of_the_plane():
    seen = photo(camera_at(EYES[1]))
    floor = Plane(np.array([0.0, 0.0, 1.0]), 0.0, NO_POINTS)
    np.testing.assert_allclose(floor.depth(seen.camera), seen.depth, rtol=1e-4)


def test_sparse_points_outweigh_depth_that_is_wrong():
    """A glossy floor: its splat lies as a plane of its own below it, and photographs agree on the floor."""
    rng = np.random.default_rng(0)
    wrong = plane_points(rng, (0.3, 0.0, 1.0), -0.3, 3000)
    right = plane_points(rng, (0, 0, 1), 0.0, 2600, 0.005)
    sparse = plane_points(rng, (0, 0, 1), 0.0, 300, 0.002)
    sparse = Evidence(sparse.points, np.zeros_like(sparse.points), sparse.depths)
    eye = np.array([0.0, 0.0, 5.0])
    assert abs(find_planes(joined(wrong, right), eye, 0)[0].offset) > 0.1
    assert abs(find_planes(joined(wrong, right, sparse), eye, 0)[0].offset) < 0.01


def test_a_mound_is_bent():
    rng = np.random.default_rng(0)
    flat = plane_points(rng, (0, 0, 1), 0.0, 4000)
    points = flat.points.copy()
    points[:, 2] = 0.3 * (points[:, 0] ** 2 + points[:, 1] ** 2) + 0.005 * rng.standard_normal(4000)
    mound = Evidence(points, flat.normals, flat.depths)
    plane = find_planes(mound, np.array([0.0, 0.0, 5.0]), 0)[0]
    assert plane.bend is not None
    assert np.median(np.abs(plane.distances(points))) < 0.01
    assert find_planes(flat, np.array([0.0, 0.0, 5.0]), 0)[0].bend is None


def test_a_support_that_holds_a_thirtieth_of_the_points_is_found():
    """A plinth's top on a wide lawn."""
    rng = np.random.default_rng(0)
    lawn = plane_points(rng, (0.0, 0.0, 1.0), 0.0, count=6000, noise=0.01, spread=3.0)
    top = plane_points(rng, (0.0, 0.0, 1.0), 0.5, count=200, noise=0.005, spread=0.3)
    found = find_planes(joined(lawn, top), EYE, 0)
    assert sorted(round(plane.offset, 1) for plane in found) == [0.0, 0.5]
