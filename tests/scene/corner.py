"""A small textured corner of a room, photographed by code: scenes for the readers."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from diga3d_warp.scene.camera import Camera, look_at
from diga3d_warp.scene.scene import Points

WIDTH, HEIGHT = 240, 180
# Two walls and a floor: (unit normal, distance from the origin, two axes on the plane).
PLANES = [
    ((0.0, 1.0, 0.0), 3.0, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    ((1.0, 0.0, 0.0), 3.0, (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    ((0.0, 0.0, -1.0), 1.0, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
]
TEXELS_PER_UNIT = 60


class Corner:
    """Views of the corner, their cameras and points on its planes."""

    def __init__(self, views: int = 6) -> None:
        rng = np.random.default_rng(7)
        self.textures = [self._texture(rng) for _ in PLANES]
        eyes = [(-3.0 + 0.5 * i, -2.5 - 0.4 * (i % 3), 0.4 + 0.25 * (i % 2)) for i in range(views)]
        self.cameras = {
            f"view_{i:02d}": Camera(
                WIDTH, HEIGHT, 200.0, 200.0, 120.0, 90.0, look_at(np.array(eye), np.array([1.8, 1.8, 0.0]))
            )
            for i, eye in enumerate(eyes)
        }
        self.images = {name: self.photograph(camera) for name, camera in self.cameras.items()}
        self.points = self._points(rng)

    @staticmethod
    def _texture(rng: np.random.Generator) -> np.ndarray:
        size = 12 * TEXELS_PER_UNIT
        coarse = rng.integers(0, 256, (size // 24, size // 24, 3), dtype=np.uint8)
        fine = rng.integers(0, 256, (size // 6, size // 6, 3), dtype=np.uint8)
        layers = [cv2.resize(layer, (size, size), interpolation=cv2.INTER_CUBIC) for layer in (coarse, fine)]
        return cv2.addWeighted(layers[0], 0.5, layers[1], 0.5, 0)

    def photograph(self, camera: Camera) -> np.ndarray:
        columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        rays = np.stack(
            [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones_like(rows)], -1
        )
        rays = rays @ camera.pose[:3, :3]
        nearest = np.full(rows.shape, np.inf)
        image = np.zeros((camera.height, camera.width, 3), np.uint8)
        for (normal, distance, *axes), texture in zip(PLANES, self.textures, strict=True):
            with np.errstate(divide="ignore"):
                depth = (distance - camera.center @ np.array(normal)) / (rays @ np.array(normal))
            hit = camera.center + rays * depth[..., None]
            u, v = ((hit @ np.array(axis) + 6) * TEXELS_PER_UNIT for axis in axes)
            colors = cv2.remap(
                texture,
                u.astype(np.float32),
                v.astype(np.float32),
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_WRAP,
            )
            closer = (depth > 0) & (depth < nearest)
            image[closer], nearest[closer] = colors[closer], depth[closer]
        return image

    def _points(self, rng: np.random.Generator) -> Points:
        floor = np.array([[x, y, -1.0] for x, y in rng.uniform(0.5, 2.5, (40, 2))])
        return Points(floor, rng.integers(0, 256, (40, 3), dtype=np.uint8))

    def write_images(self, folder: Path, suffix: str = ".png", scale: float = 1.0) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for name, image in self.images.items():
            small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            cv2.imwrite(str(folder / (name + suffix)), small[..., ::-1])

    def write_masks(self, folder: Path, names=None, value: int = 255, size=(WIDTH, HEIGHT)) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for name in names if names is not None else self.images:
            mask = np.zeros((size[1], size[0]), np.uint8)
            mask[size[1] // 4 : size[1] // 2, size[0] // 4 : size[0] // 2] = value
            cv2.imwrite(str(folder / f"{name}.png"), mask)


def same_camera(a: Camera, b: Camera) -> None:
    """Assert that two cameras agree to rounding."""
    assert (a.width, a.height) == (b.width, b.height)
    np.testing.assert_allclose((a.fx, a.fy, a.cx, a.cy), (b.fx, b.fy, b.cx, b.cy), rtol=1e-9)
    np.testing.assert_allclose(a.pose, b.pose, atol=1e-9)
    assert (a.distortion is None) == (b.distortion is None)
    if a.distortion and b.distortion:
        assert a.distortion.kind == b.distortion.kind
        np.testing.assert_allclose(a.distortion.coefficients, b.distortion.coefficients, atol=1e-12)
