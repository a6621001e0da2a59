"""Views of the synthetic room: rays of a pinhole camera, textured hits, one image from several surfaces."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from diga3d_warp.kernels.raycast import Hits, nearest_hits
from diga3d_warp.kernels.texturing import hit_colors, pyramid
from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.synthetic.lighting import DEVICE, warp_mesh
from diga3d_warp.scene.synthetic.materials import Material
from diga3d_warp.scene.synthetic.solids import Surface

NEAREST = 0.05
"""Depth from which projected corners bound a body in the image [m]: nearer ones may lie beside the camera."""


class Textures:
    """The textures of materials as pyramids in one array.

    Attributes:
        mean: Average linear colour of each material, shape (M, 3).
        arrays: Texels, starts, sides and periods, as `kernels.texturing.hit_colors` takes them.
    """

    def __init__(self, seed: int, materials: Iterable[Material]) -> None:
        self._place = {material: index for index, material in enumerate(dict.fromkeys(materials))}
        pyramids = [pyramid(material.texture(seed) ** GAMMA) for material in self._place]
        starts = np.cumsum([0] + [len(p) for p in pyramids[:-1]]).astype(np.int32)
        sides = np.array([material.side for material in self._place], np.int32)
        periods = np.array([material.period for material in self._place], np.float32)
        self.mean = np.stack([p[-1] for p in pyramids])
        self.arrays: tuple[wp.array, wp.array, wp.array, wp.array] = (
            wp.array(np.concatenate(pyramids), dtype=wp.vec3, device=DEVICE),
            wp.array(starts, dtype=wp.int32, device=DEVICE),
            wp.array(sides, dtype=wp.int32, device=DEVICE),
            wp.array(periods, dtype=float, device=DEVICE),
        )

    def of_faces(self, surface: Surface) -> np.ndarray:
        """Texture of each face, shape (F,), int32."""
        places = np.array([self._place[material] for material in surface.palette], np.int32)
        return places[surface.materials]

    def corner_albedo(self, surface: Surface) -> np.ndarray:
        """Linear colour of each corner, averaged over its texture, shape (V, 3)."""
        texture = np.zeros(len(surface.vertices), np.int32)
        texture[surface.faces] = self.of_faces(surface)[:, None]
        return self.mean[texture] * surface.tints


class Body:
    """A surface ready to be seen: its mesh, and what the colour of a hit needs besides light."""

    def __init__(self, surface: Surface, textures: Textures) -> None:
        self.mesh = warp_mesh(surface)
        self.vertices = surface.vertices
        self.textures = textures
        self._tints = surface.tints
        self._uvs: wp.array = wp.array(surface.uvs.astype(np.float32), dtype=wp.vec2, device=DEVICE)
        self._materials: wp.array = wp.array(textures.of_faces(surface), dtype=wp.int32, device=DEVICE)

    def tinted(self, light: np.ndarray) -> wp.array:
        """Light at the corners times their tint, as `colors` takes it; `light` has shape (V, 3)."""
        return wp.array((light * self._tints).astype(np.float32), dtype=wp.vec3, device=DEVICE)

    def colors(self, hits: Hits, tinted_light: wp.array, ray_spread: float) -> np.ndarray:
        """Linear colour of each hit, shape (R, 3); zero where nothing was met."""
        return hit_colors(
            hits,
            self.mesh.indices,
            tinted_light,
            self._uvs,
            self._materials,
            self.textures.arrays,
            ray_spread,
        ).numpy()


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays of a camera: one through the centre of each pixel, then grid x grid through each.

    Attributes:
        origins, directions: World space, shape ((1 + grid^2) H W,), vec3; directions of unit length.
        slant: z depth per distance along the ray of each pixel's centre, shape (H, W), float32.
        spread: Width of a supersampling ray's share of the image at distance 1.
        grid: Supersampling rays per axis of a pixel.
        travelled: Length of their way before the origins [m], shape (R,); None where it starts there.
    """

    origins: wp.array
    directions: wp.array
    slant: np.ndarray
    spread: float
    grid: int
    travelled: np.ndarray | None = None

    def towards(self, body: Body, camera: Camera) -> np.ndarray:
        """Indices of the rays that may meet a body: those of the pixels about its projected corners."""
        corners = body.vertices @ camera.pose[:3, :3].T + camera.pose[:3, 3]
        near = np.ones((camera.height, camera.width), bool)
        if (corners[:, 2] > NEAREST).all():
            x, y = (corners[:, :2] / corners[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)).T
            columns, rows = np.arange(camera.width), np.arange(camera.height)[:, None]
            near = (columns > x.min() - 2) & (columns < x.max() + 1)
            near = near & (rows > y.min() - 2) & (rows < y.max() + 1)
        return np.flatnonzero(np.tile(near.ravel(), 1 + self.grid**2))

    def part(self, indices: np.ndarray) -> Rays:
        """Some of the rays, in that order."""

        def chosen(array: wp.array) -> wp.array:
            part: wp.array = wp.array(array.numpy()[indices], dtype=wp.vec3, device=DEVICE)
            return part

        travelled = None if self.travelled is None else self.travelled[indices]
        return replace(
            self, origins=chosen(self.origins), directions=chosen(self.directions), travelled=travelled
        )


def camera_rays(camera: Camera, grid: int) -> Rays:
    """Rays of a pinhole camera.

    Args:
        camera: Without distortion.
        grid: Supersampling rays per axis of a pixel.
    """
    steps = (np.arange(grid) + 0.5) / grid
    inside_x = np.concatenate([[0.5], np.tile(steps, grid)])
    inside_y = np.concatenate([[0.5], np.repeat(steps, grid)])
    x = ((np.arange(camera.width) + inside_x[:, None] - camera.cx) / camera.fx)[:, None, :, None]
    y = ((np.arange(camera.height) + inside_y[:, None] - camera.cy) / camera.fy)[:, :, None, None]
    right, down, forward = camera.pose[:3, :3]
    slant = 1 / np.sqrt(x * x + y * y + 1)
    directions = ((x * right + y * down + forward) * slant).astype(np.float32).reshape(-1, 3)
    origins = np.tile(camera.center.astype(np.float32), (len(directions), 1))
    return Rays(
        wp.array(origins, dtype=wp.vec3, device=DEVICE),
        wp.array(directions, dtype=wp.vec3, device=DEVICE),
        slant[0, ..., 0].astype(np.float32),
        1.0 / (camera.fx * grid),
        grid,
    )


def cast(body: Body, rays: Rays) -> Hits:
    """Where the rays of a camera meet a body; distances are those of their whole way."""
    hits = nearest_hits(body.mesh, rays.origins, rays.directions)
    if rays.travelled is None:
        return hits
    whole: wp.array = wp.array(hits.distance.numpy() + rays.travelled, dtype=float, device=DEVICE)
    return hits._replace(distance=whole)


def developed(linear: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Image of the supersampling rays' linear colours, averaged per pixel, shape (H, W, 3), uint8 RGB.

    Args:
        linear: Colour of all rays of a camera, shape ((1 + grid^2) H W, 3).
        shape: (H, W).
    """
    samples = linear.reshape(-1, *shape, 3)[1:]
    display = np.clip(samples.mean(0), 0, 1) ** (1 / GAMMA)
    return np.round(display * 255).astype(np.uint8)
