"""The soft shadow of an object on the surface that it stands on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from diga3d_warp.kernels.raycast import lamp_light
from diga3d_warp.objects.frame import Frame
from diga3d_warp.objects.light import Light
from diga3d_warp.objects.placement import PlacementSettings, openness, vectors, warp_mesh
from diga3d_warp.objects.surface import unit


@dataclass(frozen=True)
class ShadowSettings:
    """Resolution of the shadow map, and the area light.

    Attributes:
        half: Half the edge of the map, around the object [object sizes]; further off it is too faint.
        cells: Cells across the map.
        lift: Height of the cells above the surface [object sizes]: above the rounding of float32.
        lamp_distance: Distance of the area light in the brightest direction [object sizes].
        lamp_edge: Its edge [object sizes]; penumbras are half as wide as the shadow is long.
        lamp_strata: Shadow rays per axis.
        low: Least height of the lamp above the surface [sine]; lower light casts shadows beyond the map.
        direct_most: Most of the light that may come from the lamp: the estimate of its direction is rough,
            and a wrong hard shadow disturbs more than a missing one.
        thickness: Height above the surface up to which it darkens things [object sizes], softly.
    """

    half: float = 2.0
    cells: int = 112
    lift: float = 0.004
    lamp_distance: float = 6.0
    lamp_edge: float = 3.0
    lamp_strata: int = 6
    low: float = 0.35
    direct_most: float = 0.5
    thickness: float = 0.06


class Shadow:
    """Share of the light that reaches the support around an object, as a map over it."""

    def __init__(
        self, vertices: np.ndarray, faces: np.ndarray, frame: Frame, scale: float, light: Light,
        settings: ShadowSettings | None = None,
    ) -> None:  # fmt: skip
        """Cast the shadow of a mesh.

        Args:
            vertices, faces: Mesh that casts the shadow, in the asset's axes.
            frame: The asset's place.
            scale: Its size [scene units].
            light: Incident light.
            settings: Resolution of the map, and the lamp.
        """
        self.settings = s = settings or ShadowSettings()
        self.frame, self.scale = frame, scale
        step = 2 * s.half / s.cells
        along = (np.arange(s.cells) + 0.5) * step - s.half
        x, y = np.meshgrid(along, along)
        points = np.stack([x, y, np.full_like(x, s.lift)], axis=-1).reshape(-1, 3)
        up = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
        mesh = warp_mesh(vertices, faces)
        ambient = openness(mesh, points, up, PlacementSettings())
        direction, share = _brightest(light, frame, s)
        shade = (1 - share) * ambient + share * _lamp(mesh, points, up, direction, s)
        self.map = _smooth(np.clip(shade, 0.0, 1.0).reshape(s.cells, s.cells))

    def at(self, points: np.ndarray) -> np.ndarray:
        """Share of the light that is left at world points (P, 3), shape (P,); 1 away from the support."""
        from scipy.ndimage import map_coordinates

        s = self.settings
        local = self.frame.inward(points) / self.scale
        cell = (local[:, :2] + s.half) * s.cells / (2 * s.half) - 0.5
        light = map_coordinates(self.map, [cell[:, 1], cell[:, 0]], order=1, mode="constant", cval=1.0)
        near = np.clip(2.0 - np.abs(local[:, 2]) / s.thickness, 0.0, 1.0)
        return 1.0 - (1.0 - light) * near


def _brightest(light: Light, frame: Frame, settings: ShadowSettings) -> tuple[np.ndarray, float]:
    """Direction of most light in the frame, and the share of the support's light that comes from there."""
    direction = unit(frame.turned(light.coefficients[None, 1:4]))[0]
    level = np.array([frame.axes[2], -frame.axes[2]])
    towards = direction @ frame.axes
    bright, dark = light.shading(np.stack([towards, -towards]))
    if not (direction[2] > 0 and np.isfinite(bright)):
        return np.array([0.0, 0.0, 1.0]), 0.0
    direction = unit(np.array([*direction[:2], max(direction[2], settings.low)]))
    on_support = max(float(light.shading(level[:1])[0]), 1e-6)
    share = (bright - dark) * direction[2] / on_support
    return direction, float(np.clip(share, 0.0, settings.direct_most))


def _lamp(
    mesh: wp.Mesh, points: np.ndarray, normals: np.ndarray, direction: np.ndarray, settings: ShadowSettings
) -> np.ndarray:
    """Share of a lamp's light that passes the mesh, shape (P,)."""
    center = settings.lamp_distance * direction
    side = unit(np.cross(direction, [0.0, 0.0, 1.0]) + [1e-6, 0.0, 0.0])
    other = np.cross(-direction, side)
    half = 0.5 * settings.lamp_edge
    nothing = warp_mesh(np.array([[0.0, 0, -9], [1e-3, 0, -9], [0, 1e-3, -9]]), np.array([[0, 1, 2]]))

    def received(occluder: wp.Mesh) -> np.ndarray:
        return lamp_light(
            occluder, vectors(points), vectors(normals), center=wp.vec3(*center),
            half_edges=(wp.vec3(*(half * side)), wp.vec3(*(half * other))),
            radiance=wp.vec3(1.0, 1.0, 1.0), strata=settings.lamp_strata, seed=0,
        ).numpy()[:, 0]  # fmt: skip

    return received(mesh) / np.maximum(received(nothing), 1e-9)


def _smooth(shade: np.ndarray) -> np.ndarray:
    """The map without the noise of its rays, and fading to none at its border."""
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(shade, 1.0, mode="nearest")
    along = np.linspace(-1, 1, len(shade))
    radius = np.hypot(*np.meshgrid(along, along))
    return 1.0 - (1.0 - smooth) * np.clip((1.0 - radius) / 0.3, 0.0, 1.0)
