"""The size of a capture, from camera centres and points, robust to outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ExtentSettings:
    """Thresholds for outliers among the cameras, and for the extent.

    Attributes:
        quantile: Quantile of the cameras' distances from the median centre taken as typical. Half of them may
            be close together, and up to a quarter may be registered wrongly.
        outlier: A camera further away than this many typical distances is an outlier [ratio]. In real
            captures the furthest one reaches 1.2 to 2; one that was registered wrongly lies hundreds away,
            and would determine the largest distance, which 3DGS takes.
        margin: The extent is the largest distance that counts times this [ratio], as in 3DGS
            (`getNerfppNorm`).
        depth_part: Least extent [median distances of points]. Cameras on one tripod have no extent of their
            own; LLFF's forward-facing ones reach a tenth of the depth of what they show.
    """

    quantile: float = 0.75
    outlier: float = 5.0
    margin: float = 1.1
    depth_part: float = 0.05


EXTENT = ExtentSettings()


def central_cameras(centers: np.ndarray) -> np.ndarray:
    """Cameras that are not far from all others, shape (N,), bool.

    Args:
        centers: Camera centres, shape (N, 3), at least one.
    """
    centers = np.asarray(centers, np.float64)
    distances = np.linalg.norm(centers - np.median(centers, axis=0), axis=1)
    usual = float(np.quantile(distances, EXTENT.quantile, method="lower"))
    return distances <= EXTENT.outlier * usual if usual > 0.0 else np.ones(len(centers), bool)


def middle_and_extent(centers: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, float]:
    """Mean of the central cameras, shape (3,), and radius of the capture around it [scene units].

    Both change with the frame as points do: they shift, turn and scale along with it.

    Args:
        centers: Camera centres, shape (N, 3), at least one.
        positions: Sparse points, shape (P, 3); there may be none.
    """
    centers = np.asarray(centers, np.float64)
    central = centers[central_cameras(centers)]
    middle = central.mean(axis=0)
    extent = EXTENT.margin * float(np.linalg.norm(central - middle, axis=1).max())
    finite = positions[np.isfinite(positions).all(axis=1)]
    if len(finite):
        depth = float(np.median(np.linalg.norm(finite - middle, axis=1)))
        extent = max(extent, EXTENT.depth_part * depth)
    return middle, extent if extent > 0.0 else 1.0
