"""Reading the file of anchors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.scaffold.anchors import BY_ROW, Scaffold
from diga3d_warp.gaussians.scaffold.decoder import Decoder
from diga3d_warp.state import compute_again, read_arrays


def load_anchors(path: Path) -> Scaffold:
    """The anchors that `Scaffold.save` wrote.

    Raises:
        InputError: the file is missing, damaged, or holds numbers that are no anchors.
    """
    arrays = dict(read_arrays(path))
    try:
        parts, closed = (torch.from_numpy(arrays.pop(name)) for name in ("parts", "closed"))
        reach, voxel = (float(arrays.pop(name)) for name in ("reach", "voxel"))
        whole = all(np.isfinite(array).all() for array in arrays.values())
        named = {name: torch.from_numpy(array) for name, array in arrays.items()}
        weights = {name.removeprefix("decoder."): weight for name, weight in named.items()}
        rows = {name: named[name] for name in BY_ROW}
        found = Scaffold(
            **rows, parts=parts, closed=closed, decoder=Decoder.of(weights), reach=reach, voxel=voxel
        )
        whole &= all(len(row) == len(parts) for row in rows.values()) and len(closed) == len(parts)
        whole &= bool(((parts >= 0) & (parts < len(found.decoder))).all()) and min(reach, voxel) > 0.0
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path} is damaged (not the arrays of anchors): {compute_again(path)}") from error
    if not whole:
        raise InputError(f"{path} is damaged (numbers that are no anchors): {compute_again(path)}")
    return found
