"""Rays against a triangle mesh: nearest hits, soft light and light gathered from the surroundings.

Invariants
- Directions have unit length, so distances are in scene units. A ray that meets nothing has face -1 and an
  infinite distance.
- Barycentric (u, v) weigh the first and second corner of a face; the third has 1 - u - v.
- Light means irradiance / pi, what a white matte surface sends out in every direction: times the albedo it
  is the colour.
- A surface point draws its random numbers from (seed, its index) alone: the same seed gives the same light,
  whatever the number of threads, and adding an object changes nothing where it is not met.
- Corners send and receive light on their outer side only; the back of a face is black.
"""

from typing import NamedTuple

import warp as wp

from diga3d_warp.kernels.launch import OPTIONS, launch

wp.set_module_options(OPTIONS)

RAY_WORK = 20
"""A ray costs about 0.4 us in a room of 100,000 faces, 20 times a light index."""

FAR = wp.constant(1.0e6)
"""Length of a ray [scene units]: beyond any room."""

STANDOFF = wp.constant(1.0e-3)
"""Distance of shadow and gather rays from their own surface [scene units]: a millimetre in a room, ten
thousand times float32's step at its size, and too thin to see."""


class Hits(NamedTuple):
    """Where rays meet a mesh.

    Attributes:
        face: Index of the nearest face, -1 where nothing is met, shape (R,), int32.
        distance: Along the ray [scene units], infinite where nothing is met, shape (R,), float32.
        barycentric: Weights of the face's first two corners, shape (R,), vec2.
    """

    face: wp.array
    distance: wp.array
    barycentric: wp.array


@wp.kernel
def nearest_hit_kernel(
    offset: int,
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    # outputs
    face: wp.array(dtype=wp.int32),
    distance: wp.array(dtype=float),
    barycentric: wp.array(dtype=wp.vec2),
):
    i = wp.tid() + offset
    hit = wp.mesh_query_ray(mesh, origins[i], directions[i], FAR)
    if hit.result:
        face[i] = hit.face
        distance[i] = hit.t
        barycentric[i] = wp.vec2(hit.u, hit.v)
    else:
        face[i] = -1
        distance[i] = wp.inf
        barycentric[i] = wp.vec2(0.0, 0.0)


@wp.kernel
def lamp_light_kernel(
    offset: int,
    mesh: wp.uint64,
    positions: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    center: wp.vec3,
    half_u: wp.vec3,
    half_v: wp.vec3,
    radiance: wp.vec3,
    strata: int,
    seed: int,
    # outputs
    light: wp.array(dtype=wp.vec3),
):
    """Light from a one-sided rectangle of half edges `half_u`, `half_v`: strata^2 jittered shadow rays."""
    i = wp.tid() + offset
    random = wp.rand_init(seed, i)
    normal = normals[i]
    start = positions[i] + normal * STANDOFF
    area_vector = wp.cross(half_u, half_v) * 4.0
    total = float(0.0)
    for a in range(strata):
        for b in range(strata):
            s = 2.0 * (float(a) + wp.randf(random)) / float(strata) - 1.0
            t = 2.0 * (float(b) + wp.randf(random)) / float(strata) - 1.0
            to_lamp = center + half_u * s + half_v * t - start
            length = wp.length(to_lamp)
            direction = to_lamp / length
            at_surface = wp.dot(normal, direction)
            at_lamp = -wp.dot(area_vector, direction)
            if at_surface > 0.0 and at_lamp > 0.0:
                if not wp.mesh_query_ray_anyhit(mesh, start, direction, length):
                    total += at_surface * at_lamp / (length * length)
    light[i] = radiance * (total / (wp.pi * float(strata * strata)))


@wp.kernel
def gathered_light_kernel(
    offset: int,
    mesh: wp.uint64,
    indices: wp.array(dtype=wp.int32),
    sent: wp.array(dtype=wp.vec3),
    positions: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    sky: wp.vec3,
    strata: int,
    seed: int,
    # outputs
    light: wp.array(dtype=wp.vec3),
):
    """Light from all around: the sky where a ray escapes, else what the surface there sends out (`sent`)."""
    i = wp.tid() + offset
    random = wp.rand_init(seed, i)
    normal = normals[i]
    start = positions[i] + normal * STANDOFF
    side = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(normal[0]) > 0.7:
        side = wp.vec3(0.0, 1.0, 0.0)
    tangent = wp.normalize(wp.cross(normal, side))
    bitangent = wp.cross(normal, tangent)
    total = wp.vec3(0.0, 0.0, 0.0)
    for a in range(strata):
        for b in range(strata):
            squared_radius = (float(a) + wp.randf(random)) / float(strata)
            angle = 2.0 * wp.pi * (float(b) + wp.randf(random)) / float(strata)
            radius = wp.sqrt(squared_radius)
            direction = (
                tangent * (radius * wp.cos(angle))
                + bitangent * (radius * wp.sin(angle))
                + normal * wp.sqrt(1.0 - squared_radius)
            )
            hit = wp.mesh_query_ray(mesh, start, direction, FAR)
            if not hit.result:
                total += sky
            elif wp.dot(hit.normal, direction) < 0.0:
                total += (
                    sent[indices[3 * hit.face]] * hit.u
                    + sent[indices[3 * hit.face + 1]] * hit.v
                    + sent[indices[3 * hit.face + 2]] * (1.0 - hit.u - hit.v)
                )
    light[i] = total / float(strata * strata)


def nearest_hits(mesh: wp.Mesh, origins: wp.array, directions: wp.array) -> Hits:
    """Nearest hit of each ray.

    Args:
        mesh: What the rays meet.
        origins: Start of each ray [scene units], shape (R,), vec3.
        directions: Unit length, shape (R,), vec3.
    """
    count, device = len(origins), mesh.device
    hits = Hits(
        wp.empty(count, dtype=wp.int32, device=device),
        wp.empty(count, dtype=float, device=device),
        wp.empty(count, dtype=wp.vec2, device=device),
    )
    launch(nearest_hit_kernel, count, [mesh.id, origins, directions], hits, device=device, work=RAY_WORK)
    return hits


def lamp_light(
    mesh: wp.Mesh,
    positions: wp.array,
    normals: wp.array,
    *,
    center: wp.vec3,
    half_edges: tuple[wp.vec3, wp.vec3],
    radiance: wp.vec3,
    strata: int,
    seed: int,
) -> wp.array:
    """Light of a rectangular lamp at surface points, with soft shadows, shape (P,), vec3.

    Args:
        mesh: What casts shadows.
        positions: Surface points [scene units], shape (P,), vec3.
        normals: Outer unit normals, shape (P,), vec3.
        center: Centre of the lamp.
        half_edges: Half edges u, v of the lamp; it shines towards u x v.
        radiance: What the lamp sends out, RGB.
        strata: Shadow rays per axis of the lamp; strata^2 rays a point.
        seed: Of the jitter within a stratum.
    """
    light = wp.empty(len(positions), dtype=wp.vec3, device=mesh.device)
    arguments = [mesh.id, positions, normals, center, *half_edges, radiance, strata, seed]
    work = RAY_WORK * strata * strata
    launch(lamp_light_kernel, len(positions), arguments, [light], device=mesh.device, work=work)
    return light


def gathered_light(
    mesh: wp.Mesh,
    sent: wp.array,
    positions: wp.array,
    normals: wp.array,
    *,
    sky: wp.vec3,
    strata: int,
    seed: int,
) -> wp.array:
    """Light that surface points receive from the sky and from the surfaces around them, shape (P,), vec3.

    Args:
        mesh: The surroundings.
        sent: What each corner of `mesh` sends out (its albedo times its light), shape (V,), vec3.
        positions: Surface points [scene units], shape (P,), vec3.
        normals: Outer unit normals, shape (P,), vec3.
        sky: Radiance of a ray that escapes, RGB.
        strata: Rays per axis of the hemisphere; strata^2 rays a point, denser towards the normal.
        seed: Of the jitter within a stratum.
    """
    light = wp.empty(len(positions), dtype=wp.vec3, device=mesh.device)
    arguments = [mesh.id, mesh.indices, sent, positions, normals, sky, strata, seed]
    work = RAY_WORK * strata * strata
    launch(gathered_light_kernel, len(positions), arguments, [light], device=mesh.device, work=work)
    return light
