"""Rows that cannot be drawn as they are: some are mended, some left out, each with a note.

Editors write an opaque gaussian as an opacity logit of +infinity and a flat one as a log scale of -infinity.
Both are kept with finite values that draw the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from diga3d_warp.config import SPLATTING
from diga3d_warp.scene.formats.rows import SplatRows


@dataclass(frozen=True)
class Limits:
    """Finite stand-ins for infinite parameters.

    Attributes:
        opaque_logit: For +infinity. The smallest integer whose sigmoid is 1 in float32.
        flatness: Thickness of a flat gaussian [its widest standard deviation]. Far below a pixel for anything
            that fits into an image, and its square is well above float32's rounding of 1e-7 squared.
    """

    opaque_logit: float = 17.0
    flatness: float = 1e-4


LIMITS = Limits()


def usable_rows(rows: SplatRows, name: str) -> tuple[SplatRows, list[str]]:
    """Rows that can be drawn, and notes on those that were changed or left out.

    Args:
        rows: As they were read.
        name: Of the file, for the notes.
    """
    notes: list[str] = []

    def tell(which: Any, what: str) -> None:
        if which.any():
            notes.append(f"{name}: {what.format(int(which.sum()))}")

    opaque = np.isposinf(rows.opacity_logits)
    logits = np.where(opaque, np.float32(LIMITS.opaque_logit), rows.opacity_logits)
    tell(opaque, "{} gaussians of infinite opacity logit are opaque")

    flat = rows.log_scales < -SPLATTING.log_scale_max
    widest = np.where(flat, -np.inf, rows.log_scales).max(axis=1, initial=-np.inf)
    points = np.isneginf(widest)
    typical = np.median(widest[np.isfinite(widest)]) if np.isfinite(widest).any() else 0.0
    thin = (np.where(points, typical, widest) + np.log(LIMITS.flatness)).astype(np.float32)
    log_scales = np.where(flat, thin[:, None], rows.log_scales)
    tell(flat.any(axis=1), "{} gaussians of zero scale are flat")

    quaternions = rows.quaternions.copy()
    squares = (quaternions.astype(np.float64) ** 2).sum(axis=1)
    undirected = squares < SPLATTING.quaternion_min
    round_ones = undirected & (log_scales == log_scales[:, :1]).all(axis=1)
    quaternions[round_ones] = (1.0, 0.0, 0.0, 0.0)

    mended = replace(rows, log_scales=log_scales, quaternions=quaternions, opacity_logits=logits)
    invisible = np.isneginf(rows.opacity_logits)
    finite = (np.abs(rows.means) < SPLATTING.coordinate_max).all(axis=1)
    finite &= (log_scales <= SPLATTING.log_scale_max).all(axis=1)
    finite &= np.isfinite(logits) | invisible
    for values in (quaternions, rows.sh.reshape(len(rows), -1)):
        finite &= np.isfinite(values).all(axis=1)
    tell(~finite, "left out {} gaussians with NaN or infinite values")
    tell(invisible & finite, "left out {} gaussians that are fully transparent")
    lost = undirected & ~round_ones
    keep = finite & ~invisible
    tell(lost & keep, "left out {} gaussians whose quaternion is zero")
    return mended.select(keep & ~lost), notes
