"""Rays against analytic shapes and brute force in float64, light against closed forms."""

import numpy as np
import pytest
import trimesh
import warp as wp

from diga3d_warp.kernels.launch import set_thread_count, thread_count
from diga3d_warp.kernels.raycast import gathered_light, lamp_light, nearest_hits
from diga3d_warp.kernels.texturing import hit_colors, pyramid


def warp_mesh(mesh: trimesh.Trimesh) -> wp.Mesh:
    points = wp.array(np.asarray(mesh.vertices, np.float32), dtype=wp.vec3, device="cpu")
    return wp.Mesh(
        points, wp.array(np.asarray(mesh.faces, np.int32).reshape(-1), dtype=wp.int32, device="cpu")
    )


def vectors(rows: np.ndarray) -> wp.array:
    return wp.array(np.ascontiguousarray(rows, np.float32), dtype=wp.vec3, device="cpu")


def random_rays(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    origins = rng.normal(size=(count, 3))
    origins *= 3 / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = rng.uniform(-1, 1, (count, 3)) - origins
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def brute_force_distances(mesh: trimesh.Trimesh, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Nearest hit over all triangles in float64, infinite where there is none (Cramer's rule)."""
    a, b, c = np.moveaxis(np.asarray(mesh.triangles), 1, 0)
    distances = np.full(len(origins), np.inf)
    for k, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        normal = np.cross(b - a, c - a)
        slope = -normal @ direction
        turned = np.cross(origin - a, direction)
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = ((c - a) * turned).sum(1) / slope, -((b - a) * turned).sum(1) / slope
            t = ((origin - a) * normal).sum(1) / slope
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0)
        distances[k] = t[hit].min(initial=np.inf)
    return distances


def floor(half: float = 50.0) -> trimesh.Trimesh:
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    return trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)


def test_nearest_hit_on_a_sphere_is_the_analytic_one():
    origins, directions = random_rays(400)
    hits = nearest_hits(warp_mesh(trimesh.creation.icosphere(5)), vectors(origins), vectors(directions))
    along = -(origins * directions).sum(1)
    discriminant = along**2 - (origins**2).sum(1) + 1
    hit, distance = hits.face.numpy() >= 0, hits.distance.numpy()
    clear = np.abs(discriminant) > 0.01  # the mesh lies up to 1e-3 inside the sphere
    assert 100 < hit.sum() < 400
    np.testing.assert_array_equal(hit[clear], discriminant[clear] > 0)
    expected = along - np.sqrt(np.maximum(discriminant, 0))
    sure = clear & hit
    np.testing.assert_allclose(distance[sure], expected[sure], atol=6e-3)
    assert np.isposinf(distance[~hit]).all()


def test_nearest_hit_agrees_with_every_triangle_in_turn():
    mesh = trimesh.util.concatenate(
        [trimesh.creation.box((1, 1, 1)), trimesh.creation.torus(1.2, 0.2), trimesh.creation.cone(0.4, 1.5)]
    )
    origins, directions = random_rays(300, seed=1)
    hits = nearest_hits(warp_mesh(mesh), vectors(origins), vectors(directions))
    expected = brute_force_distances(mesh, origins, directions)
    face = hits.face.numpy()
    assert (face >= 0).sum() > 100
    np.testing.assert_array_equal(face >= 0, np.isfinite(expected))
    np.testing.assert_allclose(hits.distance.numpy(), expected, rtol=1e-5)
    u, v = hits.barycentric.numpy()[face >= 0].T
    weights = np.stack([u, v, 1 - u - v], -1)[..., None]
    positions = (weights * mesh.vertices[mesh.faces[face[face >= 0]]]).sum(1)
    along = origins + directions * np.where(np.isfinite(expected), expected, 0)[:, None]
    np.testing.assert_allclose(positions, along[face >= 0], atol=1e-5)


def lamp_arguments() -> dict:
    half = 0.5
    return {
        "center": wp.vec3(0.0, 0.0, 2.0),
        "half_edges": (wp.vec3(half, 0.0, 0.0), wp.vec3(0.0, -half, 0.0)),
        "radiance": wp.vec3(3.0, 2.0, 1.0),
        "strata": 16,
        "seed": 4,
    }


def lamp_irradiance(points: np.ndarray) -> np.ndarray:
    """Midpoint rule in float64 for the unit lamp 2 above a plane, per unit radiance."""
    s = (np.arange(200) + 0.5) / 200 - 0.5
    x, y = np.meshgrid(s, s)
    squared = (x - points[:, 0, None, None]) ** 2 + (y - points[:, 1, None, None]) ** 2 + 4
    return (4 / squared**2).mean((1, 2))


def test_lamp_light_is_the_integral_over_the_lamp():
    points = np.array([(0, 0, 0), (1, 0.5, 0), (-3, 2, 0)], float)
    normals = np.tile((0.0, 0.0, 1.0), (3, 1))
    light = lamp_light(warp_mesh(floor()), vectors(points), vectors(normals), **lamp_arguments()).numpy()
    expected = lamp_irradiance(points)[:, None] * (3, 2, 1) / np.pi
    np.testing.assert_allclose(light, expected, rtol=3e-3)


def test_lamp_light_is_blocked_and_half_blocked():
    # A half plane at height 1 with its edge at x = 0 hides the lamp's half x < 0 from the point below.
    screen = floor().apply_translation((-50, 0, 1))
    points = np.array([(-3, 0, 0), (0, 0, 0), (3, 0, 0)], float)
    normals = np.tile((0.0, 0.0, 1.0), (3, 1))
    light = lamp_light(warp_mesh(screen), vectors(points), vectors(normals), **lamp_arguments()).numpy()[:, 2]
    expected = lamp_irradiance(points) / np.pi * (0, 0.5, 1)
    np.testing.assert_allclose(light, expected, rtol=3e-3)


def test_lamp_lights_neither_its_back_nor_averted_surfaces():
    points = np.array([(0, 0, 3), (0, 0, 0)], float)
    normals = np.array([(0, 0, -1), (0, 0, -1)], float)
    light = lamp_light(
        warp_mesh(floor().apply_translation((0, 0, -9))),
        vectors(points),
        vectors(normals),
        **lamp_arguments(),
    )
    np.testing.assert_array_equal(light.numpy(), 0)


@pytest.mark.parametrize("height", [0.5, 2.0])
def test_gathered_light_is_sky_plus_what_a_disc_above_sends(height):
    # A disc of radius 1 overhead fills 1 / (1 + h^2) of the cosine-weighted hemisphere.
    disc = trimesh.creation.cylinder(1.0, 0.01, sections=128).apply_translation((0, 0, height + 0.005))
    mesh = warp_mesh(disc)
    sent = np.tile((1.0, 0.5, 0.0), (len(disc.vertices), 1))
    light = gathered_light(
        mesh,
        vectors(sent),
        vectors(np.zeros((1, 3))),
        vectors(np.array([(0.0, 0.0, 1.0)])),
        sky=wp.vec3(0.0, 0.0, 2.0),
        strata=64,
        seed=1,
    ).numpy()[0]
    share = 1 / (1 + height**2)
    np.testing.assert_allclose(light, (share, share / 2, 2 * (1 - share)), atol=0.012)


def test_light_depends_on_the_seed_alone():
    origins, normals = random_rays(5000, seed=3)
    mesh = warp_mesh(trimesh.creation.icosphere(2))
    before = thread_count()
    try:
        results = []
        for threads, seed in ((1, 4), (3, 4), (3, 5)):
            set_thread_count(threads)
            arguments = {**lamp_arguments(), "seed": seed, "strata": 2}
            results.append(lamp_light(mesh, vectors(origins), vectors(normals), **arguments).numpy())
    finally:
        set_thread_count(before)
    np.testing.assert_array_equal(results[0], results[1])
    assert (results[1] != results[2]).any()


def floor_colors(texture: np.ndarray, places: np.ndarray, distance: float) -> np.ndarray:
    """Colours of a floor whose texture repeats once a unit, seen straight from above; a ray is 0.01 wide."""
    mesh = warp_mesh(floor())
    origins = np.concatenate([places, np.full((len(places), 1), distance)], 1)
    hits = nearest_hits(mesh, vectors(origins), vectors(np.tile((0.0, 0.0, -1.0), (len(places), 1))))
    uvs = wp.array(floor().vertices[:, :2].astype(np.float32), dtype=wp.vec2, device="cpu")
    light = vectors(np.tile((1.0, 0.5, 2.0), (4, 1)))
    textures = (
        vectors(pyramid(texture)),
        wp.array([0], dtype=wp.int32, device="cpu"),
        wp.array([len(texture)], dtype=wp.int32, device="cpu"),
        wp.array([1.0], dtype=float, device="cpu"),
    )
    materials = wp.array([0, 0], dtype=wp.int32, device="cpu")
    return hit_colors(hits, mesh.indices, light, uvs, materials, textures, 0.01).numpy()


def test_hit_colors_are_the_texels_near_by_and_their_mean_far_away():
    texture = np.random.default_rng(0).random((16, 16, 3))
    rows, columns = np.mgrid[:16, :16].reshape(2, -1)
    places = (np.stack([columns, rows], -1) + 0.5) / 16 + (3, -2)
    near = floor_colors(texture, places, 1.0)
    np.testing.assert_allclose(near, texture.reshape(-1, 3) * (1, 0.5, 2), atol=2e-3)
    far = floor_colors(texture, places, 1e4)
    np.testing.assert_allclose(far, np.tile(texture.mean((0, 1)) * (1, 0.5, 2), (256, 1)), rtol=1e-4)
    # At this distance a ray is two texels wide: the colours of the first halving, at its own centres.
    halved = texture.reshape(8, 2, 8, 2, 3).mean((1, 3))
    rows, columns = np.mgrid[:8, :8].reshape(2, -1)
    middle = floor_colors(texture, (np.stack([columns, rows], -1) + 0.5) / 8, 12.5)
    np.testing.assert_allclose(middle, halved.reshape(-1, 3) * (1, 0.5, 2), atol=2e-3)


def test_a_ray_that_meets_nothing_is_black():
    texture = np.ones((2, 2, 3))
    assert (floor_colors(texture, np.array([(0.2, 0.3)]), 1.0) > 0).all()
    np.testing.assert_array_equal(floor_colors(texture, np.array([(99.0, 0.0)]), 1.0), 0)
