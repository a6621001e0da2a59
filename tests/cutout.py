"""A capture of cut-out things: a rug on its block with a vase on it, and nothing around them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from diga3d_warp.scene.colmap.reconstruction import write_colmap
from diga3d_warp.scene.scene import Points
from diga3d_warp.scene.synthetic.arc import arc_cameras
from diga3d_warp.scene.synthetic.lighting import corner_light
from diga3d_warp.scene.synthetic.rendering import Body, Textures, camera_rays, cast, developed
from diga3d_warp.scene.synthetic.room import RUG_TOP, vase
from diga3d_warp.scene.synthetic.solids import box, joined, panel


@dataclass(frozen=True)
class Cutout:
    """How the things are photographed.

    Attributes:
        width, height: Of the images [px].
        views: Number of views.
        seed: Of textures, cameras and points.
    """

    width: int = 96
    height: int = 72
    views: int = 9
    seed: int = 0

    def write(self, folder: Path) -> Path:
        """A COLMAP folder with RGBA images, masks of the vase, and truth/ with the alpha without it.

        Where nothing shows the files hold black, as renderers leave it.
        """
        top = panel((-0.6, -0.45, RUG_TOP), (1.2, 0, 0), (0, 0.9, 0), "rug", cell=0.04, whole=True)
        block = box((-0.6, -0.45, -0.3), (0.6, 0.45, RUG_TOP - 0.001), "oak", cell=0.1)
        stand, thing = joined([top, block]), vase()
        whole = joined([stand, thing])
        textures = Textures(self.seed, whole.palette)
        light = corner_light(whole, textures.corner_albedo(whole), self.seed)
        bodies = [Body(stand, textures), Body(thing, textures)]
        lights = [
            body.tinted(part)
            for body, part in zip(bodies, np.split(light, [len(stand.vertices)]), strict=True)
        ]
        rng = np.random.default_rng(self.seed)
        cameras = arc_cameras(self.width, self.height, self.views, self.seed)
        positions, colors = [], []
        for name, camera in cameras.items():
            rays = camera_rays(camera, 2)
            hits = [cast(body, rays) for body in bodies]
            near, far = hits[1].distance.numpy(), hits[0].distance.numpy()
            front, met = near < far, np.isfinite(np.minimum(near, far))
            shown = [
                body.colors(hit, lit, rays.spread)
                for body, hit, lit in zip(bodies, hits, lights, strict=True)
            ]
            shape = (self.height, self.width)
            samples = np.where(front[:, None], shown[1], shown[0])
            coverage = met.reshape(-1, *shape)[1:].mean(0)
            # The mean over the covered part of a pixel alone: straight alpha.
            part = np.tile(np.maximum(coverage, 0.25).ravel(), len(met) // coverage.size)
            image = developed(np.where(met[:, None], samples / part[:, None], 0.0), shape)
            _write(folder / "images" / f"{name}.png", image, coverage)
            _write(folder / "masks" / f"{name}.png", front.reshape(-1, *shape).any(0)[..., None] * 255)
            alone = np.isfinite(far).reshape(-1, *shape)[1:].mean(0)
            _write(folder / "truth" / f"{name}.png", alone[..., None] * 255)
            centers = np.flatnonzero(met[: shape[0] * shape[1]])
            picked = rng.choice(centers, min(150, len(centers)), replace=False)
            along = rays.directions.numpy()[picked].astype(np.float64)
            positions.append(camera.center + along * np.minimum(near, far)[picked, None])
            colors.append(image.reshape(-1, 3)[picked])
        points = Points(np.concatenate(positions), np.concatenate(colors))
        write_colmap(folder, cameras, points, suffix=".png")
        return folder


def truth(folder: Path, name: str) -> np.ndarray:
    """Opacity of a view without the vase, in [0, 1], shape (H, W)."""
    return cv2.imread(str(folder / "truth" / f"{name}.png"), cv2.IMREAD_GRAYSCALE) / 255.0


def _write(path: Path, color: np.ndarray, alpha: np.ndarray | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    planes = color[..., ::-1] if alpha is None else np.dstack([color[..., ::-1], 255 * alpha])
    assert cv2.imwrite(str(path), np.rint(planes).astype(np.uint8))
