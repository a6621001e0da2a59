"""Which part of each surface becomes a chart: what the hole may show of it, and known surroundings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diga3d_warp.scene.camera import Camera
from diga3d_warp.surfaces.chart import Frame, frame_on, sized
from diga3d_warp.surfaces.occupancy import occupancy
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.planes import Plane
from diga3d_warp.surfaces.settings import LAYOUT, SURFACES, SurfaceSettings
from diga3d_warp.surfaces.votes import poll


@dataclass(frozen=True, eq=False)
class Candidate:
    """A surface at a coarse resolution.

    Attributes:
        frame: Over all of the surface's support, and a margin.
        solid: Where it may be: known, and what its boundaries leave of the unknown, shape (H, W), bool.
        density: Pixels per texel of the photograph that sees it finest, shape (H, W).
    """

    frame: Frame
    solid: np.ndarray
    density: np.ndarray


def lay_out(
    planes: Sequence[Plane], photos: Sequence[Photo], seed: int, settings: SurfaceSettings = SURFACES
) -> list[Frame]:
    """Frames of charts, for the surfaces that the hole shows.

    Coarse charts over each surface's whole support come first. What of each is in front, seen through the
    hole, is what its frame has to hold, with surroundings to continue from, at the sampling of the
    photograph that sees it finest.
    """
    seeing = [photo for photo in photos if photo.unseen.any()]
    if not seeing:
        return []
    camera = max(seeing, key=lambda photo: int(photo.unseen.sum())).camera
    found = [_candidate(plane, camera, photos, seed, settings) for plane in planes]
    candidates = [each for each in found if each is not None]
    hits = in_front([(each.frame, each.solid) for each in candidates], seeing, settings)
    frames = []
    for candidate, hit in zip(candidates, hits, strict=True):
        if len(hit) >= LAYOUT.least:
            frames.append(_framed(candidate, hit, settings))
    return frames


def _candidate(
    plane: Plane, camera: Camera, photos: Sequence[Photo], seed: int, settings: SurfaceSettings
) -> Candidate | None:
    if len(plane.support) == 0:
        return None
    first = frame_on(plane, camera, settings=settings)
    across = np.array(first.size[::-1]) * first.texel
    pad = LAYOUT.beyond * across
    frame = frame_on(plane, camera, first.low - pad, first.low + across + pad, settings=settings)
    polled = poll(photos, frame, settings)
    known, through = polled.occupied, polled.through
    if not known.any():
        return None
    wanted = polled.unseen & ~known & ~through
    solid = occupancy(known, through, wanted, seed, settings.trusted, frame.agreed, polled.covered).solid
    return Candidate(frame, solid, polled.finest)


def in_front(
    surfaces: Sequence[tuple[Frame, np.ndarray]],
    photos: Sequence[Photo],
    settings: SurfaceSettings = SURFACES,
) -> list[np.ndarray]:
    """Texels of each surface that unseen pixels show: those of the nearest that may be there.

    Args:
        surfaces: The frame of each, and where it may be, bool.
        photos: Views with unseen pixels.
        settings: Grazing angles.

    Returns:
        Rows and columns of each surface, shape (P, 2), one for each pixel that shows it.
    """
    hits: list[list[np.ndarray]] = [[np.zeros((0, 2), int)] for _ in surfaces]
    for photo in photos:
        rows, columns = np.nonzero(photo.unseen)
        nearest = np.full(len(rows), np.inf)
        number = np.full(len(rows), -1)
        places = np.zeros((len(rows), 2), int)
        for k, (frame, solid) in enumerate(surfaces):
            column, row, z = frame.meet(photo.camera, settings, (rows, columns))
            with np.errstate(invalid="ignore"):
                inside = (column > -0.5) & (column < frame.size[1] - 0.5)
                inside &= (row > -0.5) & (row < frame.size[0] - 0.5)
            at = np.rint(np.where(inside, [row, column], 0.0)).astype(int).T
            front = inside & solid[at[:, 0], at[:, 1]] & (np.where(inside, z, np.inf) < nearest)
            nearest[front], number[front], places[front] = z[front], k, at[front]
        for k in range(len(surfaces)):
            hits[k].append(places[number == k])
    return [np.concatenate(each) for each in hits]


def _framed(candidate: Candidate, hit: np.ndarray, settings: SurfaceSettings) -> Frame:
    frame = candidate.frame
    size = np.array(frame.size[::-1], np.float64)
    first = np.quantile(hit, LAYOUT.outlying, axis=0)[::-1] - 1.0
    last = np.quantile(hit, 1.0 - LAYOUT.outlying, axis=0)[::-1] + 2.0
    finest = float(np.sqrt(np.quantile(candidate.density[hit[:, 0], hit[:, 1]], 0.8)))  # pixels along it
    texel = frame.texel / max(finest, 1e-3)
    margin = max(settings.margin * float((last - first).max()), settings.margin_min * texel / frame.texel)
    first, last = np.maximum(first - margin, 0.0), np.minimum(last + margin, size)
    low, high = frame.low + first * frame.texel, frame.low + last * frame.texel
    texel = min(texel, float((high - low).max()) / settings.texels_min)
    return sized(frame, low, high, texel, settings)
