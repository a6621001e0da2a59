"""Surfaces that planes do not explain: a height over a plane, quadratic in the plane's coordinates.

It holds a lawn's slope, a mound, and over the reach of a hole a wide cylinder.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diga3d_warp.surfaces.settings import BENDS


@dataclass(frozen=True, eq=False)
class Bend:
    """A height over a plane; beyond the points that it was fitted to it stays as at their border.

    Attributes:
        origin: On the plane [scene units], shape (3,).
        axes: Two unit vectors in the plane, shape (2, 3).
        reach: How far the points reach from the origin [scene units]: the unit of its coordinates.
        coefficients: Of 1, x, y, x^2, x y, y^2 [scene units], shape (6,).
    """

    origin: np.ndarray
    axes: np.ndarray
    reach: float
    coefficients: np.ndarray

    def height(self, points: np.ndarray) -> np.ndarray:
        """Height over the plane's foot of world positions (..., 3) [scene units]."""
        return _terms(self._places(points)) @ self.coefficients

    def _places(self, points: np.ndarray) -> np.ndarray:
        return np.clip((points - self.origin) @ self.axes.T / self.reach, -1.0, 1.0)


def _terms(places: np.ndarray) -> np.ndarray:
    x, y = places[..., 0], places[..., 1]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)


def fit_bend(points: np.ndarray, heights: np.ndarray, scales: np.ndarray, normal: np.ndarray) -> Bend:
    """The quadratic height that most points lie on, by iteratively reweighted least squares.

    Args:
        points: Near the surface [scene units], shape (P, 3).
        heights: Their distance from its plane [scene units], shape (P,).
        scales: Distance that counts as none, of each [scene units], shape (P,).
        normal: Of the plane, shape (3,).
    """
    origin = np.median(points, axis=0)
    axes = np.linalg.svd(normal[None])[2][1:]
    places = (points - origin) @ axes.T
    reach = max(float(np.quantile(np.abs(places), 0.98)), 1e-300)
    bend = Bend(origin, axes, reach, np.zeros(6))
    terms = _terms(bend._places(points))
    solution = np.zeros(6)
    for _ in range(BENDS.rounds):
        off = np.abs(heights - terms @ solution) / scales
        weights = 1.0 / (scales * np.maximum(off / BENDS.huber, 1.0) ** 2)
        weights /= weights.max()
        solution = np.linalg.lstsq(terms * weights[:, None], heights * weights, rcond=1e-9)[0]
    return Bend(origin, axes, reach, solution)
