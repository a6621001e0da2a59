"""What one view knows of the surfaces behind the object."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from diga3d_warp.scene.camera import Camera

DIAGONAL = 630.0
"""Image diagonal at which lengths in pixels are given [px]."""


@dataclass(frozen=True, eq=False)
class Photo:
    """One view, after the object was taken out of the splat.

    Attributes:
        camera: At the size of the image.
        pixels: The photograph, shape (H, W, 3), uint8 RGB. Read where `known`.
        depth: z of the splat without the object [scene units], shape (H, W), float32; infinite where nothing
            is, zero or NaN where nothing is known.
        known: Where the photograph itself shows what is there: outside the widened mask, and opaque, shape
            (H, W), bool.
        unseen: What no photograph shows, shape (H, W), bool; apart from `known`.
    """

    camera: Camera
    pixels: np.ndarray
    depth: np.ndarray
    known: np.ndarray
    unseen: np.ndarray

    @cached_property
    def solid(self) -> np.ndarray:
        """Where the depth is believed, shape (H, W), bool: a surface, and not in what nobody saw."""
        return np.isfinite(self.depth) & (self.depth > 0.0) & ~self.unseen

    @cached_property
    def told(self) -> np.ndarray:
        """Where something is known of the depth, be it that nothing is there, shape (H, W), bool."""
        return (self.depth > 0.0) & ~self.unseen

    @cached_property
    def clear(self) -> np.ndarray:
        """Pixels whose neighbours are all known: samples between their centres mix nothing in."""
        import cv2

        return cv2.erode(self.known.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width [px]."""
        return self.camera.height, self.camera.width

    def length(self, length: float) -> int:
        """A length given at an image diagonal of 630 px, at least 1 [px]."""
        return max(1, round(length * float(np.hypot(*self.shape)) / DIAGONAL))
