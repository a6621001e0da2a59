"""First anchors of a fit, on the voxels that hold sparse points."""

from __future__ import annotations

import numpy as np

from diga3d_warp.gaussians.initialise import initialise
from diga3d_warp.gaussians.scaffold.anchors import Scaffold
from diga3d_warp.gaussians.scaffold.encode import encoded
from diga3d_warp.gaussians.scaffold.settings import SCAFFOLD, ScaffoldSettings
from diga3d_warp.gaussians.scaffold.voxels import grouped, voxel_size, voxels_of
from diga3d_warp.scene.scene import Points


def initial_anchors(
    points: Points, extent: float, budget: int, settings: ScaffoldSettings = SCAFFOLD
) -> Scaffold:
    """One anchor for each voxel that holds a point, with the points' mean colour.

    Args:
        points: P points, at least one.
        extent: Extent of the capture [scene units].
        budget: Gaussians at the end of the fit.
        settings: Size of features and anchors, and how many there are.

    Raises:
        InputError: there is no point, or none with finite coordinates.
    """
    finite = np.isfinite(points.positions).all(axis=1)
    kept = Points(points.positions[finite], points.colors[finite])
    most = max(1, round(settings.first * settings.most(budget)))
    if len(kept) == 0:
        initialise(kept)  # which says what is missing
    size = voxel_size(kept.positions, most)
    _, voxel = grouped(voxels_of(kept.positions, size))
    counts = np.bincount(voxel)[:, None]

    def mean(values: np.ndarray) -> np.ndarray:
        sums = [np.bincount(voxel, weights=values[:, axis].astype(np.float64)) for axis in range(3)]
        return np.stack(sums, axis=1) / counts

    gathered = Points(mean(kept.positions), mean(kept.colors).round().astype(np.uint8))
    return encoded(initialise(gathered, 1), extent, settings.slots, settings.width, size)
