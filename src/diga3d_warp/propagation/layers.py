"""Two surfaces behind one object: its support, and the background far behind that.

A figure on a plinth hides the plinth's top and the lawn beyond. Filled in one go, the lawn runs into the
plinth. Where the rim of a hole lies partly on a surface that is clearly nearer than the rest, that surface is
assumed convex: its convex hull gives the part of the hole that it continues into.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diga3d_warp.propagation.depth import complete_depth


@dataclass(frozen=True)
class LayerSettings:
    """Thresholds for splitting a hole into two surfaces.

    Attributes:
        step: Ratio of depths between neighbouring pixels from which they lie on two surfaces [1]. A fitted
            surface wavers by some percent; an object's edge is a step of ten and more.
        nearer: Ratio of depths from which a surface is clearly nearer than the others at the rim [1].
        rim: Width of the rim that is examined [px].
        rim_share: Part of the rim that the near surface must hold; less is a floater or a twig.
        hull_share: Largest part of the hole that the near surface may continue into: one that encloses the
            hole is not a second surface but the only one.
        margin: Surroundings that are examined [hole sizes]. Further out the near surface meets the ground
            that it stands on, and the two can no longer be separated.
        source_margin: Surroundings from which the background is filled [hole sizes]. Further away other
            surfaces begin: with the whole image as margin, a lawn was filled with the road.
    """

    step: float = 1.08
    nearer: float = 1.3
    rim: int = 4
    rim_share: float = 0.08
    hull_share: float = 0.4
    margin: float = 0.08
    source_margin: float = 0.5


@dataclass(frozen=True, eq=False)
class NearLayer:
    """The nearer of two surfaces at a hole.

    Attributes:
        surface: Where it is known, near the hole, shape (H, W), bool.
        part: The part of the hole that it continues into, shape (H, W), bool.
        front: Known pixels of the whole image that do not lie behind it, shape (H, W), bool: what the rest of
            the hole must not be filled with.
    """

    surface: np.ndarray
    part: np.ndarray
    front: np.ndarray

    @property
    def window(self) -> tuple[slice, slice]:
        """The box around surface and part."""
        return _box(self.surface | self.part, 0)


def near_layer(
    depth: np.ndarray, hole: np.ndarray, settings: LayerSettings | None = None
) -> NearLayer | None:
    """The surface that the hole's object stood on, if it stands out from the background.

    Args:
        depth: z along the camera axis [scene units], shape (H, W); 0 where unknown.
        hole: What is to be filled, shape (H, W), bool, not empty.
        settings: Thresholds of depth steps and of the rim.

    Returns:
        None where the rim is one surface, or several at similar depths.
    """
    import cv2

    s = settings or LayerSettings()
    window = _box(hole, int(s.margin * max(np.ptp(np.nonzero(hole), axis=1))) + s.rim)
    inside = hole[window]
    known = ~inside & (depth[window] > 0.0)
    if not known.any():
        return None
    logs = np.log(np.where(known, depth[window], depth[window][known].max())).astype(np.float32)
    log_depth = np.asarray(cv2.medianBlur(logs, 5))
    box3 = np.ones((3, 3), np.uint8)
    smooth = known & (cv2.dilate(log_depth, box3) - cv2.erode(log_depth, box3) < np.log(s.step))
    count, labels = cv2.connectedComponents(smooth.astype(np.uint8), connectivity=4)
    disc = np.ones((2 * s.rim + 1, 2 * s.rim + 1), np.uint8)
    rim = known & (cv2.dilate(inside.astype(np.uint8), disc) > 0)
    held = np.bincount(labels[rim], minlength=count)
    large = [k for k in range(1, count) if held[k] >= s.rim_share * rim.sum()]
    if len(large) < 2:
        return None
    depths = {k: float(np.median(log_depth[rim & (labels == k)])) for k in large}
    nearest = min(large, key=depths.__getitem__)
    others = rim & (labels != nearest)
    if np.median(log_depth[others]) - depths[nearest] < np.log(s.nearer):
        return None
    # Where the edge has gaps, the surface runs on into what lies behind it.
    front_log = depths[nearest] + 0.5 * np.log(s.nearer)
    near = (labels == nearest) & (log_depth < front_log)
    part = _hull(near) & inside
    if not 0 < part.sum() <= s.hull_share * inside.sum():
        return None
    surface, continued = np.zeros_like(hole), np.zeros_like(hole)
    surface[window], continued[window] = near, part
    # Pixels at the edge of a fitted surface have depths of neither side.
    edge = cv2.dilate(surface.astype(np.uint8), disc) > 0
    front = ~hole & (edge | ((depth > 0.0) & (depth < np.exp(front_log))))
    return NearLayer(surface, continued, front)


def surroundings(hole: np.ndarray, settings: LayerSettings | None = None) -> tuple[slice, slice]:
    """The box around a hole from which the background is filled."""
    s = settings or LayerSettings()
    return _box(hole, int(s.source_margin * max(np.ptp(np.nonzero(hole), axis=1))))


def complete_layers(depth: np.ndarray, hole: np.ndarray, near: NearLayer | None) -> np.ndarray:
    """Depth of a hole of one or two surfaces, each continued by itself.

    Args:
        depth: z along the camera axis [scene units], shape (H, W); 0 where unknown.
        hole: What is to be filled, shape (H, W), bool.
        near: The nearer surface, if there is one.

    Returns:
        Depth, positive everywhere, shape (H, W), float32; see `complete_depth`.
    """
    if near is None:
        return complete_depth(depth, hole)
    completed = complete_depth(np.where(near.front, 0.0, depth), hole)
    window = near.window
    front = complete_depth(np.where(near.surface, depth, 0.0)[window], near.part[window])
    completed[window] = np.where(near.part[window], front, completed[window])
    return np.where(hole | ~(depth > 0.0), completed, depth).astype(np.float32)


def _box(mask: np.ndarray, pad: int) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        slice(max(rows[0] - pad, 0), rows[-1] + pad + 1),
        slice(max(columns[0] - pad, 0), columns[-1] + pad + 1),
    )


def _hull(mask: np.ndarray) -> np.ndarray:
    """Convex hull of a mask, shape (H, W), bool."""
    import cv2

    corners = cv2.convexHull(np.argwhere(mask)[:, ::-1].astype(np.int32))
    filled = np.zeros(mask.shape, np.uint8)
    cv2.fillConvexPoly(filled, corners, 1)
    return filled > 0
