"""Light of the synthetic room: a soft lamp, an open sky and one bounce, computed once at every corner.

Everything is matte and stands still, so the light at a surface point is the same from every view. Computing
it at the corners of fine cells costs a hundredth of computing it at every pixel of every view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from diga3d_warp.kernels.raycast import gathered_light, lamp_light
from diga3d_warp.scene.synthetic.solids import Surface


@dataclass(frozen=True)
class Lighting:
    """Lamp and sky.

    Attributes:
        lamp_center: Centre of the lamp [m]: high at the front left, so that shadows fall to the right and
            backwards on floor that the cameras see.
        lamp_edge: Edge of the square lamp [m]; gives penumbras of about a tenth of the shadow's length.
        lamp_radiance: Linear RGB, a warm white. With the sky it lights the floor to about 0.8 of white.
        sky: Radiance of a ray that leaves the room, linear RGB, a cool white; fills shadows to about half.
        lamp_strata: Shadow rays per axis; 16 rays leave under 4 % noise in a penumbra.
        gather_strata: Rays per axis of the hemisphere; 36 rays leave about 2 % noise, fixed to the surface.
    """

    lamp_center: tuple[float, float, float] = (-1.9, -0.9, 2.6)
    lamp_edge: float = 0.6
    lamp_radiance: tuple[float, float, float] = (100.0, 91.0, 78.0)
    sky: tuple[float, float, float] = (0.37, 0.41, 0.47)
    lamp_strata: int = 4
    gather_strata: int = 6


LIGHTING = Lighting()

DEVICE = "cpu"
"""Where captures are made: the same seed then gives the same bytes with and without a GPU."""


def corner_light(
    surface: Surface, albedo: np.ndarray, seed: int, lighting: Lighting = LIGHTING
) -> np.ndarray:
    """Light that each corner of `surface` receives, with shadows and one bounce, shape (V, 3), float32.

    Args:
        surface: Everything that casts shadows and sends light back.
        albedo: Linear RGB that each corner sends back, averaged over its texture, shape (V, 3).
        seed: Of the sampling noise.
        lighting: Lamp and sky.
    """
    mesh = warp_mesh(surface)
    positions: wp.array = wp.array(_inward_positions(surface), dtype=wp.vec3, device=DEVICE)
    normals: wp.array = wp.array(surface.normals.astype(np.float32), dtype=wp.vec3, device=DEVICE)
    center = np.array(lighting.lamp_center)
    axis = -center / np.linalg.norm(center)
    half_u = np.cross(axis, (0.0, 0.0, 1.0))
    half_u *= 0.5 * lighting.lamp_edge / np.linalg.norm(half_u)
    half_v = np.cross(axis, half_u)
    direct = lamp_light(
        mesh,
        positions,
        normals,
        center=wp.vec3(*center),
        half_edges=(wp.vec3(*half_u), wp.vec3(*half_v)),
        radiance=wp.vec3(*lighting.lamp_radiance),
        strata=lighting.lamp_strata,
        seed=seed,
    ).numpy()
    # Light that bounced more often is left to the sky: the surroundings send back the lamp's light and the
    # sky's, the latter as if half of it reached them.
    sent = albedo * (direct + 0.5 * np.array(lighting.sky))
    ambient = gathered_light(
        mesh,
        wp.array(sent.astype(np.float32), dtype=wp.vec3, device=DEVICE),
        positions,
        normals,
        sky=wp.vec3(*lighting.sky),
        strata=lighting.gather_strata,
        seed=seed + 1,
    ).numpy()
    return direct + ambient


def warp_mesh(surface: Surface) -> wp.Mesh:
    """The triangles of a surface, ready for rays."""
    return wp.Mesh(
        points=wp.array(surface.vertices.astype(np.float32), dtype=wp.vec3, device=DEVICE),
        indices=wp.array(surface.faces.reshape(-1), dtype=wp.int32, device=DEVICE),
    )


def _inward_positions(surface: Surface) -> np.ndarray:
    """Corners moved 1 % towards the middle of their faces, shape (V, 3), float32.

    A corner of the wall lies exactly on the floor, where rounding would decide whether it is above or below.
    """
    total = np.zeros_like(surface.vertices)
    count = np.zeros(len(surface.vertices))
    middles = surface.vertices[surface.faces].mean(1)
    for k in range(3):
        np.add.at(total, surface.faces[:, k], middles)
        np.add.at(count, surface.faces[:, k], 1)
    middle = total / count[:, None]
    return (surface.vertices + 0.01 * (middle - surface.vertices)).astype(np.float32)
