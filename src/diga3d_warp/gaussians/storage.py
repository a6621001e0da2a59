"""The splat of a stage: gaussians in `point_cloud.ply`, or anchors in `scaffold.npz`."""

from __future__ import annotations

from pathlib import Path

from diga3d_warp.gaussians.parameters import PLY, Gaussians
from diga3d_warp.gaussians.representation import Representation
from diga3d_warp.gaussians.scaffold.anchors import ANCHORS
from diga3d_warp.gaussians.scaffold.storage import load_anchors


def load(folder: Path) -> Representation:
    """What `Representation.save` wrote into a folder.

    Raises:
        InputError: the file is missing or damaged.
    """
    if (folder / ANCHORS).is_file():
        return load_anchors(folder / ANCHORS)
    return Gaussians.load_ply(folder / PLY, every_row=True)
