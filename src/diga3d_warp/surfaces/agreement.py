"""Where photographs agree that they see a surface.

Photographs that are warped onto the surface that they show are alike there. Light that a glossy surface
reflects moves with the camera. So brightness is compared without its mean over a window, and with the median
of all photographs. A window without contrast tells nothing; it grows until it has some.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.placement import projected
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.settings import AGREEMENT, AgreementSettings


@dataclass(frozen=True, eq=False)
class Grey:
    """A photograph reduced to brightness, at some size.

    Attributes:
        camera: At that size.
        pixels: Brightness in [0, 1], shape (H, W), float32.
        clear: Where it shows what is there, shape (H, W), bool.
    """

    camera: Camera
    pixels: np.ndarray
    clear: np.ndarray

    @staticmethod
    def of(photo: Photo) -> Grey:
        """A photograph's brightness at full size."""
        import cv2

        pixels = cv2.cvtColor(np.ascontiguousarray(photo.pixels), cv2.COLOR_RGB2GRAY)
        return Grey(photo.camera, pixels.astype(np.float32) / 255.0, photo.clear)

    @cached_property
    def half(self) -> Grey:
        """The same at half the size."""
        import cv2

        size = (max(self.camera.width // 2, 1), max(self.camera.height // 2, 1))
        pixels = cv2.resize(self.pixels, size, interpolation=cv2.INTER_AREA)
        clear = cv2.resize(self.clear.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.99
        return Grey(self.camera.resized(*size), pixels, clear)

    def smaller(self, level: int) -> Grey:
        """The same after some halvings."""
        return self if level == 0 else self.half.smaller(level - 1)

    def at(self, points: np.ndarray) -> np.ndarray:
        """Brightness at world positions (H, W, 3), shape (H, W), float32; NaN where it does not show them."""
        import cv2

        place = projected(points, self.camera)
        height, width = self.pixels.shape
        column, row, z = place[..., 0] - 0.5, place[..., 1] - 0.5, place[..., 2]
        with np.errstate(invalid="ignore"):
            inside = (column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)
            inside &= z > self.camera.near
        column = np.where(inside, column, -1.0).astype(np.float32)
        row = np.where(inside, row, -1.0).astype(np.float32)
        found = cv2.remap(self.pixels, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        shown = inside & self.clear[np.rint(row).astype(int), np.rint(column).astype(int)]
        return np.where(shown, found, np.float32(np.nan))


@dataclass(frozen=True, eq=False)
class Agreement:
    """How alike photographs are on a surface.

    Attributes:
        alike: Share of the contrast that photographs have in common, at most 1, shape (H, W), float32; about
            0 where they have none, NaN where they tell nothing.
        contrast: Mean square contrast of the smallest window, shape (H, W), float32; 0 where none is shown.
        unlike: Mean square of what photographs do not have in common, in the smallest window, shape (H, W),
            float32.
        brightness: Median brightness, shape (H, W), float32; NaN where few show anything.
    """

    alike: np.ndarray
    contrast: np.ndarray
    unlike: np.ndarray
    brightness: np.ndarray

    def total(self, settings: AgreementSettings = AGREEMENT) -> float:
        """Mean likeness of texels with contrast, at most 1; 0 where there is no contrast."""
        told = np.isfinite(self.alike)
        if not told.any():
            return 0.0
        contrast = self.contrast[told]
        weight = contrast / (contrast + settings.contrast)
        return float((weight * np.clip(self.alike[told], -1.0, 1.0)).sum() / max(float(weight.sum()), 1e-12))


def agreement(
    samples: Sequence[np.ndarray], sides: Sequence[int], settings: AgreementSettings = AGREEMENT
) -> Agreement:
    """How alike photographs of a surface are.

    Args:
        samples: Brightness of each photograph at the surface's texels, shape (H, W); NaN where it shows none.
        sides: Sides of the windows, the smallest first [texels].
        settings: Contrast that counts.
    """
    shape = samples[0].shape
    stacked = np.stack(samples)
    shown = np.isfinite(stacked)
    detail = np.stack([_detail(sample, sides[0]) for sample in samples])
    several = shown.sum(axis=0) >= settings.views_least
    consensus = _medians(np.where(shown, detail, np.float32(np.nan)))
    brightness = _medians(stacked)
    brightness = np.where(several, brightness, np.float32(np.nan)).astype(np.float32)
    consensus = np.where(several, consensus, 0.0).astype(np.float32)
    used = shown & several
    unlike = np.where(used, (detail - consensus) ** 2, 0.0).sum(axis=0).astype(np.float32)
    square = np.where(used, detail**2, 0.0).sum(axis=0).astype(np.float32)
    count = used.sum(axis=0).astype(np.float32)
    alike = np.full(shape, np.nan, np.float32)
    contrast, rest = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for number, side in enumerate(sides):
        there = np.maximum(_box(count, side), 1e-6)
        power, off = _box(square, side) / there, _box(unlike, side) / there
        if number == 0:
            contrast, rest = np.where(several, power, 0.0), np.where(several, off, 0.0)
        decided = ~np.isfinite(alike) & (power > settings.contrast) & several
        alike = np.where(decided, 1.0 - off / np.maximum(power, 1e-12), alike)
    return Agreement(alike, contrast, rest, brightness)


def _medians(values: np.ndarray) -> np.ndarray:
    """Medians of what is known along the first axis; NaN where nothing is.

    As `np.nanmedian`, which takes masked arrays for few values: over a search it was 40 % of the time.
    """
    ordered = np.sort(values, axis=0)  # NaN comes last
    count = np.isfinite(values).sum(axis=0)
    middle = np.stack([np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(values) - 1)])
    return np.take_along_axis(ordered, middle, axis=0).mean(axis=0)


def _detail(sample: np.ndarray, side: int) -> np.ndarray:
    """Brightness without its mean over a window; 0 where nothing is shown."""
    shown = np.isfinite(sample)
    value = np.where(shown, sample, 0.0).astype(np.float32)
    mean = _box(value, side) / np.maximum(_box(shown.astype(np.float32), side), 1e-6)
    return np.where(shown, value - mean, 0.0)


def _box(values: np.ndarray, side: int) -> np.ndarray:
    import cv2

    return cv2.boxFilter(values, -1, (side, side), borderType=cv2.BORDER_CONSTANT)
