"""Charts as a camera sees them, front to back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diga3d_warp.scene.camera import Camera
from diga3d_warp.surfaces.chart import Chart
from diga3d_warp.surfaces.settings import SHOWN, SURFACES, SurfaceSettings


@dataclass(frozen=True, eq=False)
class Layer:
    """What a camera sees of charts.

    Attributes:
        image: RGB, shape (H, W, 3), float32: of the charts alone, not darkened where they are transparent.
        alpha: Opacity of all charts together, shape (H, W), float32.
        depth: z of the nearest chart that is occupied [scene units], shape (H, W), float32; 0 where none is.
        chart: Its number, shape (H, W), int64; -1 where none is.
    """

    image: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    chart: np.ndarray


def compose(charts: Sequence[Chart], camera: Camera, settings: SurfaceSettings = SURFACES) -> Layer:
    """Render charts, each by the area that a pixel covers of it.

    Args:
        charts: Filled ones.
        camera: Of any lens.
        settings: What counts as occupied.
    """
    size = (camera.height, camera.width)
    image, left = np.zeros((*size, 3), np.float32), np.ones(size, np.float32)
    depth, number = np.zeros(size, np.float32), np.full(size, -1)
    drawn = [_drawn(chart, camera, settings) for chart in charts]
    if drawn:
        depths = np.stack([z for _, _, z in drawn])
        order = np.argsort(depths, axis=0, kind="stable")
        colors, alphas = np.stack([c for c, _, _ in drawn]), np.stack([a for _, a, _ in drawn])
        for rank in range(len(drawn)):
            at = order[rank][None]
            z = np.take_along_axis(depths, at, 0)[0]
            alpha = np.take_along_axis(alphas, at, 0)[0]
            color = np.take_along_axis(colors, at[..., None], 0)[0]
            image += (left * alpha)[..., None] * color
            first = (alpha >= settings.alpha) & (number < 0)
            depth[first], number[first] = z[first], at[0][first]
            left = left * (1.0 - alpha)
    alpha = 1.0 - left
    return Layer(image / np.maximum(alpha, 1e-6)[..., None], alpha, depth, number)


def _drawn(
    chart: Chart, camera: Camera, settings: SurfaceSettings
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colour, alpha and depth of one chart; depth is infinite where it is not met."""

    column, row, z = chart.frame.meet(camera, settings)
    height, width = chart.frame.size
    with np.errstate(invalid="ignore"):
        inside = (column > -0.5) & (column < width - 0.5) & (row > -0.5) & (row < height - 0.5)
    texels = np.concatenate([chart.image * chart.alpha[..., None], chart.alpha[..., None]], axis=2)
    found = _area_sampled(texels, np.where(inside, column, -9.0), np.where(inside, row, -9.0))
    found = np.where(inside[..., None], found, 0.0)
    alpha = found[..., 3]
    color = found[..., :3] / np.maximum(alpha, 1e-6)[..., None]
    return color, alpha, np.where(inside, z, np.inf)


def _area_sampled(texels: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Means of texels over the footprints of pixels, shape (H, W, C).

    The level of a mip pyramid fits the shorter side of a footprint; along the longer one several samples of
    that level are averaged (anisotropic filtering, as GPUs do it).
    """
    import cv2

    pyramid: list[np.ndarray] = [np.ascontiguousarray(texels, np.float32)]
    while min(pyramid[-1].shape[:2]) > 1:
        height, width = pyramid[-1].shape[:2]
        smaller = (max(width // 2, 1), max(height // 2, 1))
        pyramid.append(cv2.resize(pyramid[-1], smaller, interpolation=cv2.INTER_AREA))
    step_x = np.stack([_steps(column, 1), _steps(row, 1)], axis=-1)
    step_y = np.stack([_steps(column, 0), _steps(row, 0)], axis=-1)
    length_x, length_y = np.linalg.norm(step_x, axis=-1), np.linalg.norm(step_y, axis=-1)
    longer = np.where((length_x >= length_y)[..., None], step_x, step_y)
    long, short = np.maximum(length_x, length_y), np.minimum(length_x, length_y)
    short = np.maximum(short, long / SHOWN.anisotropy)
    level = np.clip(np.log2(np.maximum(short, 1.0)), 0.0, len(pyramid) - 1.0)
    count = np.clip(np.ceil(long / np.maximum(short, 1.0)), 1.0, SHOWN.anisotropy)
    most = int(count.max(initial=1.0))
    result, used = np.zeros((*column.shape, texels.shape[2]), np.float32), np.zeros(column.shape, np.float32)
    for k in range(most):
        active = k < count
        offset = np.where(active, (k + 0.5) / count - 0.5, 0.0)
        x, y = column + offset * longer[..., 0], row + offset * longer[..., 1]
        result += np.where(active[..., None], _trilinear(pyramid, x, y, level), 0.0)
        used += active
    return result / used[..., None]


def _steps(values: np.ndarray, axis: int) -> np.ndarray:
    """Change of a coordinate from pixel to pixel; zero next to pixels that do not meet the chart."""
    if values.shape[axis] < 2:
        return np.zeros_like(values)
    step = np.gradient(values, axis=axis)
    outside = values < -1.0
    near = outside.copy()
    index = [slice(None)] * 2
    for before, after in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
        here, there = list(index), list(index)
        here[axis], there[axis] = before, after
        near[tuple(here)] |= outside[tuple(there)]
    return np.where(near, 0.0, step)


def _trilinear(pyramid: list[np.ndarray], x: np.ndarray, y: np.ndarray, level: np.ndarray) -> np.ndarray:
    import cv2

    result = np.zeros((*x.shape, pyramid[0].shape[2]), np.float32)
    for number, texels in enumerate(pyramid):
        share = np.clip(1.0 - np.abs(level - number), 0.0, 1.0).astype(np.float32)
        if not (share > 0.0).any():
            continue
        height, width = texels.shape[:2]
        scale_x, scale_y = width / pyramid[0].shape[1], height / pyramid[0].shape[0]
        u = ((x + 0.5) * scale_x - 0.5).astype(np.float32)
        v = ((y + 0.5) * scale_y - 0.5).astype(np.float32)
        found = cv2.remap(texels, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        result += share[..., None] * found
    return result
