"""What is behind the object of a synthetic capture, and what of it no photograph shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from diga3d_warp.bench.ablation.measure import TRUE_DEPTH, Truth
from diga3d_warp.bench.room import true_picture
from diga3d_warp.evaluation.metrics import psnr
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.pipelines.run import Run
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.layouts.cameras_file import load_cameras
from diga3d_warp.scene.photographs.images import read_image
from diga3d_warp.scene.scene import Scene
from diga3d_warp.splatting.render import render

ELSEWHERE = TRUE_DEPTH.with_name("elsewhere")
"""Test views without the object, from other places than the capture's, in its folder."""


@dataclass(frozen=True)
class Sight:
    """When a view shows a point.

    Attributes:
        same_surface: Largest difference of the point's depth from that of the pixel where it is projected
            [share of the latter]. A pixel on a floor seen at 15 degrees spans 1 % of its depth.
    """

    same_surface: float = 0.02


def truth_of(scene: Scene) -> Truth:
    """Images, depths and unseen pixels of the fitted views, from the generator's exact depth.

    Pixels are unseen if the point of the scene that the object hides there is shown by no fitted view: in
    every other, the object or another surface hides it, or it is out of the picture. It does not depend on
    the splat, so that all methods are measured on the same pixels.
    """
    masks = []
    for view in scene.views:
        assert view.mask is not None, "the generator writes a mask for each view"
        masks.append(view.mask)
    depths = [np.load(scene.path / TRUE_DEPTH / f"{view.name}.npy") for view in scene.views]
    images = [true_picture(scene, view).numpy() for view in scene.views]
    return Truth(images, depths, unseen_pixels([view.camera for view in scene.views], depths, masks))


def unseen_pixels(
    cameras: Sequence[Camera],
    depths: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
    sight: Sight | None = None,
) -> list[np.ndarray]:
    """Masked pixels whose background no view shows, one array (H, W), bool, a view.

    Args:
        cameras: Pinhole cameras.
        depths: z of the scene without the object [scene units], shape (H, W).
        masks: Where the object hides it, shape (H, W), bool.
        sight: When a view shows a point.
    """
    sight = sight or Sight()
    unseen = []
    for camera, depth, mask in zip(cameras, depths, masks, strict=True):
        rows, columns = np.nonzero(mask)
        points = _world_points(camera, rows, columns, depth[mask])
        shown = np.zeros(len(rows), bool)
        for other, surface, hidden in zip(cameras, depths, masks, strict=True):
            if other is camera:
                continue
            local = points @ other.pose[:3, :3].T + other.pose[:3, 3]
            z = np.maximum(local[:, 2], 1e-6)
            column = np.floor(local[:, 0] / z * other.fx + other.cx).astype(int)
            row = np.floor(local[:, 1] / z * other.fy + other.cy).astype(int)
            inside = (local[:, 2] > other.near) & (column >= 0) & (column < other.width)
            inside &= (row >= 0) & (row < other.height)
            at = row[inside], column[inside]
            near = np.abs(surface[at] - z[inside]) <= sight.same_surface * surface[at]
            shown[inside] |= near & ~hidden[at]
        pixels = np.zeros_like(mask)
        pixels[rows[~shown], columns[~shown]] = True
        unseen.append(pixels)
    return unseen


def _world_points(camera: Camera, rows: np.ndarray, columns: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Points at depth z under pixels, shape (P, 3)."""
    rays = [(columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy, np.ones(len(rows))]
    return (np.stack(rays, -1) * z[:, None] - camera.pose[:3, 3]) @ camera.pose[:3, :3]


def psnr_elsewhere(scene: Scene, gaussians: Gaussians, run: Run) -> float:
    """Of the views without the object from other places, whole images, mean [dB]."""
    folder = scene.path / ELSEWHERE
    figures = []
    for name, camera in load_cameras(folder / "views.json").test.items():
        true = torch.from_numpy(read_image(folder / "images" / f"{name}.png")).float() / 255.0
        with torch.no_grad():
            shown = render(gaussians, camera, effects=run.effects).color.clamp(0.0, 1.0)
        figures.append(psnr(shown, true))
    return float(np.mean(figures))
