"""Rows of a splat file, as every format is read into and written from."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

DC_TO_COLOR = 0.28209479177387814
"""Value of the constant spherical harmonic, 1 / (2 sqrt(pi))."""


@dataclass(frozen=True, eq=False)
class SplatRows:
    """N gaussians.

    Attributes:
        means: World positions [scene units], shape (N, 3), float64: a .ply may hold doubles.
        log_scales: Logarithms of standard deviations along the axes, shape (N, 3), float32.
        quaternions: Rotations (w, x, y, z), not necessarily of unit length, shape (N, 4), float32.
        opacity_logits: Opacity is their sigmoid, shape (N,), float32.
        sh: Spherical harmonics, shape (N, K, 3) with K = 1, 4, 9 or 16, float32; colour is max(0, 0.5 + SH).
    """

    means: np.ndarray
    log_scales: np.ndarray
    quaternions: np.ndarray
    opacity_logits: np.ndarray
    sh: np.ndarray

    def __len__(self) -> int:
        return len(self.means)

    def select(self, rows: np.ndarray) -> SplatRows:
        """The rows of a boolean mask (N,) or an index (M,)."""
        return SplatRows(*(getattr(self, entry.name)[rows] for entry in fields(self)))

    @property
    def colors(self) -> np.ndarray:
        """Colour of the constant harmonic, shape (N, 3), uint8 RGB."""
        shades = np.nan_to_num(0.5 + DC_TO_COLOR * self.sh[:, 0])
        return np.rint(shades.clip(0, 1) * 255).astype(np.uint8)


@dataclass(frozen=True)
class Announced:
    """What the header of a splat file announces.

    Attributes:
        count: Number of gaussians.
        antialiased: Whether they were fitted with Mip-Splatting's 2D filter.
    """

    count: int
    antialiased: bool


@dataclass(frozen=True, eq=False)
class SplatContent:
    """What a splat file held.

    Attributes:
        rows: Its gaussians.
        antialiased: Whether they were fitted with Mip-Splatting's 2D filter, and must be drawn with it.
        notes: What was guessed, changed or left out, one line each.
        surround: How many rows at the end are the shell behind everything that this program writes.
    """

    rows: SplatRows
    antialiased: bool = False
    notes: list[str] = field(default_factory=list)
    surround: int = 0

    @property
    def scene(self) -> SplatRows:
        """The rows without the surround."""
        return self.rows.select(np.arange(len(self.rows) - self.surround))

    @property
    def shell(self) -> SplatRows:
        """The rows of the surround."""
        return self.rows.select(np.arange(len(self.rows) - self.surround, len(self.rows)))
