"""A glossy support: level surfaces at the foot of the object mirror what is above them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp

from diga3d_warp.kernels.raycast import Hits
from diga3d_warp.scene.synthetic.lighting import DEVICE
from diga3d_warp.scene.synthetic.rendering import Rays
from diga3d_warp.scene.synthetic.solids import Surface

LEVEL = 0.015
"""Greatest height of a mirroring face over or under the object's foot [m]: a rug is no thicker."""

UPRIGHT = 0.999
"""Least vertical component of its normal [1]."""

STANDOFF = 1e-4
"""Height over the mirror at which reflected rays start [m], so that they do not meet it again."""


def level_faces(surface: Surface) -> np.ndarray:
    """Which faces of a surface may mirror, shape (F,), bool."""
    corners = surface.vertices[surface.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    up = across[:, 2] > UPRIGHT * np.linalg.norm(across, axis=1)
    return np.asarray(up & (np.abs(corners[..., 2]) <= LEVEL).all(axis=1))


class Mirror:
    """The part of a view's rays that meets a glossy support, and where it goes from there.

    Args:
        rays: Of the camera.
        hits: Where they meet the surroundings.
        level: Which faces of these mirror, shape (F,).
        gloss: Reflectance of the support seen from straight above [1]; it grows with the slant as that of
            glass and varnish does (Schlick 1994).

    Attributes:
        indices: Rays that meet the support, shape (S,).
        rays: Their continuation after the mirror.
    """

    def __init__(self, rays: Rays, hits: Hits, level: np.ndarray, gloss: float) -> None:
        face, distance = hits.face.numpy(), hits.distance.numpy()
        self.indices = np.flatnonzero((face >= 0) & level[face])
        part, travelled = rays.part(self.indices), distance[self.indices]
        directions = part.directions.numpy()
        origins = part.origins.numpy() + travelled[:, None] * directions
        directions = directions * np.array([1.0, 1.0, -1.0], np.float32)
        origins[:, 2] += STANDOFF
        self.rays = replace(
            part,
            origins=wp.array(origins, dtype=wp.vec3, device=DEVICE),
            directions=wp.array(directions, dtype=wp.vec3, device=DEVICE),
            travelled=travelled,
        )
        slant = 1.0 - np.clip(directions[:, 2], 0.0, 1.0)
        self._reflectance = (gloss + (1.0 - gloss) * slant**5)[:, None]

    def mixed(self, colors: np.ndarray, mirrored: np.ndarray) -> np.ndarray:
        """Linear colours of all rays (R, 3) with those of the mirror image (S, 3) over the support."""
        mixed = colors.copy()
        mixed[self.indices] += self._reflectance * (mirrored - mixed[self.indices])
        return mixed
