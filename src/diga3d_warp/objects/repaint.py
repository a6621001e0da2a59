"""Repainting of an object in all views: the protocol, and procedural materials on the fused surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.materials.vocabulary import Material
from diga3d_warp.objects.frame import frame_of, upward
from diga3d_warp.objects.light import estimate_light, exposed, shade_beyond
from diga3d_warp.objects.sheen import polished
from diga3d_warp.objects.surface import Sight, fuse
from diga3d_warp.objects.wrapping import wrap

TEXTURE = 512
"""Edge of a painted texture [texels]; scaled down to the object's height in the images before it is used."""


class Repainter(Protocol):
    """Makes the images that the object's colours are fitted to."""

    @property
    def name(self) -> str:
        """Name on the command line."""
        ...

    def repaint(self, sights: Sequence[Sight], references: Sequence[int], seed: int) -> list[np.ndarray]:
        """Other colours for the object.

        Args:
            sights: The object in every view.
            references: Indices of the reference views; a prior may repaint them first.
            seed: Same sights and seed, same bytes.

        Returns:
            One image a view, RGB in [0, 1], shape (H, W, 3), float32; only the pixels that the sight
            `touched` are read, and blended into the view by its `share`.
        """
        ...


class MaterialRepainter:
    """Wraps a procedural material around the fused surface, under the light that the object was under.

    All views take their colours from one surface, so they agree by construction.
    """

    name = "material"

    def __init__(self, material: Material) -> None:
        self.material = material

    def repaint(self, sights: Sequence[Sight], references: Sequence[int], seed: int) -> list[np.ndarray]:
        """See `Repainter.repaint`; the references are not needed."""
        surface = fuse(sights)
        cameras = [sight.camera for sight in sights]
        center = surface.points.mean(axis=0)
        facing = np.mean([camera.center for camera in cameras], axis=0) - center
        frame = frame_of(surface.points, upward(cameras), facing)
        around = np.concatenate([sight.shown[::7] for sight in sights])
        light = estimate_light(surface.normals, surface.colors, around)
        beyond = shade_beyond(light, surface)
        texture = self._texture(sights, frame.extent[2], seed)
        images = []
        for sight in sights:
            image = sight.image.copy()
            if sight.touched.any():
                feet, normals = surface.nearest(sight.points)
                smooth = surface.smooth_normals(feet)
                colors = wrap(texture, feet, normals, frame, frame.extent[2])
                albedo = polished(colors, frame.turned(smooth), self.material.polish) ** GAMMA
                received = light.on(smooth) * surface.interpolated(beyond, feet)
                lit = albedo * received[:, None]
                image[sight.touched] = exposed(lit)
            images.append(image)
        return images

    def _texture(self, sights: Sequence[Sight], height: float, seed: int) -> np.ndarray:
        """The material at about one texel a pixel: finer detail would flicker from view to view."""
        import cv2

        sizes = [
            height * sight.camera.fy / float(np.median(sight.depth[sight.mask]))
            for sight in sights
            if sight.mask.any()
        ]
        side = int(np.clip(round(float(np.median(sizes))), 32, TEXTURE))
        painted = self.material.exemplar(TEXTURE, seed)
        return cv2.resize(painted, (side, side), interpolation=cv2.INTER_AREA).astype(np.float64)
