"""A photograph as a material: its middle made seamless, so that it wraps around an object.

Opposite edges are laid over each other and cut along the path where they differ least (image quilting, Efros
and Freeman 2001), once to the sides and once up and down.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.random import Generator

from diga3d_warp.errors import InputError
from diga3d_warp.materials.prompt import material_of
from diga3d_warp.materials.vocabulary import Material
from diga3d_warp.scene.photographs.decoding import read_header
from diga3d_warp.scene.photographs.images import BACKGROUND, read_photograph, resize_image

SIDE_LEAST = 32
"""Shorter side of a usable picture [px]: less is a colour rather than a texture."""

OPAQUE = 128
"""Opacity from which the colour of a pixel is the material's, of 255."""

SIDE_MOST = 768
"""Edge at which a picture is made seamless [px]; textures on objects have up to 512 texels."""

OVERLAPS = np.linspace(0.14, 0.36, 27)
"""Parts of the edge that may be laid over the opposite one [1]. Where the ends agree best is taken, so that
bricks meet bricks. Width and height then differ by a third at most: by so much may a texture be stretched."""

SKETCH = 4
"""How much smaller the picture is in which the overlap is searched [1]."""

FEATHER = 1.5
"""Deviation of the blend across a cut [px]: hides that pixels on its sides differ, too narrow for ghosts."""


def chosen_material(prompt: str, exemplar: Path | None) -> Material:
    """The material that a picture shows or, without one, that a prompt names.

    Raises:
        InputError: the picture is not usable, or the prompt names no built-in material.
    """
    return material_of(prompt) if exemplar is None else picture_material(exemplar)


def picture_material(path: Path) -> Material:
    """The material that a picture shows, as large on an object as the square that is taken of it.

    Args:
        path: A photograph of the material, upright, such as a .jpg or .png. Of one with transparent pixels,
            the largest square without any is taken; else the one in the middle.

    Raises:
        InputError: the file is missing, not readable as an image, too large to decode, or too small.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such picture; give a photograph of the material to --exemplar")
    photograph = read_photograph(path, orientation=read_header(path).orientation)
    pixels, notes = photograph.pixels, []
    height, width = pixels.shape[:2]
    side = min(height, width)
    if side < SIDE_LEAST:
        raise InputError(f"{path}: {width} x {height} px; give at least {SIDE_LEAST} on the shorter side")
    square = (
        slice((height - side) // 2, (height + side) // 2),
        slice((width - side) // 2, (width + side) // 2),
    )
    if photograph.alpha is not None and not (photograph.alpha[square] >= OPAQUE).all():
        square = opaque_square(photograph.alpha)
        side = square[0].stop - square[0].start
        if side < SIDE_LEAST:
            raise InputError(
                f"{path}: its largest square without transparent pixels is {side} x {side} px; give a "
                f"picture with at least {SIDE_LEAST} x {SIDE_LEAST} opaque ones"
            )
        notes.append(f"{path.name}: {side} x {side} px of it are used, the largest opaque square")
    chosen = pixels[square].astype(np.float32)
    if photograph.alpha is not None:
        chosen = _uncovered(chosen, photograph.alpha[square])
    texture = seamless(resize_image(chosen, min(1.0, SIDE_MOST / side)) / 255.0)
    if float(texture.std(axis=(0, 1)).max()) < 1.0 / 255.0:
        notes.append(f"{path.name}: it shows one colour and no texture")

    def painter(_: Generator, side: int) -> np.ndarray:
        import cv2

        shrinks = side < len(texture)
        return cv2.resize(texture, (side, side), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)

    return Material(path.stem, painter, notes=tuple(notes))


def opaque_square(alpha: np.ndarray) -> tuple[slice, slice]:
    """The largest square without transparent pixels, the one nearest to the middle of several.

    Args:
        alpha: Opacity, shape (H, W), uint8.

    Returns:
        Its rows and columns; empty if no pixel is opaque.
    """
    import cv2

    padded = np.pad((alpha >= OPAQUE).astype(np.uint8), 1)
    # Steps of a king to the nearest transparent pixel: half the side of the square around each.
    reach = np.rint(cv2.distanceTransform(padded, cv2.DIST_C, 3)[1:-1, 1:-1]).astype(int)
    rows, columns = np.nonzero(reach == reach.max())
    away = np.hypot(rows - 0.5 * (alpha.shape[0] - 1), columns - 0.5 * (alpha.shape[1] - 1))
    row, column = int(rows[away.argmin()]), int(columns[away.argmin()])
    half = int(reach.max())
    return slice(row - half + 1, row + half), slice(column - half + 1, column + half)


def _uncovered(pixels: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """The colours of partly opaque pixels (H, W, 3) in [0, 255], which were composed over `BACKGROUND`."""
    share = np.maximum(alpha, 1)[..., None].astype(np.float32) / 255.0
    return np.clip((pixels - 255.0 * (1.0 - share) * np.array(BACKGROUND, np.float32)) / share, 0.0, 255.0)


def seamless(picture: np.ndarray) -> np.ndarray:
    """A repeating texture of a picture, display values: (S, S, 3) to a smaller (H, W, 3) in [0, 1]."""
    closed = _closed(_levelled(picture))
    return np.clip(_closed(closed.swapaxes(0, 1)).swapaxes(0, 1), 0.0, 1.0)


def _levelled(picture: np.ndarray) -> np.ndarray:
    """The picture without the slope that light from one side gives it: each repeat would start anew."""
    side = len(picture)
    y, x = np.mgrid[:side, :side] / side - 0.5 + 0.5 / side
    slopes = np.stack([x, y], -1).reshape(-1, 2)
    colors = picture.reshape(-1, 3)
    found = np.linalg.lstsq(slopes, colors - colors.mean(axis=0), rcond=None)[0]
    return (colors - slopes @ found).reshape(picture.shape)


def _closed(picture: np.ndarray) -> np.ndarray:
    """The picture (H, W, 3) with its right end cut into its left one, shape (H, narrower W, 3)."""
    from scipy.ndimage import gaussian_filter1d

    sketch = picture[::SKETCH, ::SKETCH] if min(picture.shape[:2]) >= SKETCH * SIDE_LEAST else picture
    part = min(OVERLAPS, key=lambda part: _cut(sketch, part)[1])
    cut, _ = _cut(picture, part)
    overlap = _width(picture, part)
    start, end = picture[:, :overlap], picture[:, -overlap:]
    # Columns before the cut go on from the right end, those behind it are the left one's own.
    own = gaussian_filter1d((np.arange(overlap) >= cut[:, None]).astype(float), FEATHER, axis=1)
    joined = own[..., None] * start + (1.0 - own[..., None]) * end
    return np.concatenate([joined, picture[:, overlap:-overlap]], axis=1)


def _width(picture: np.ndarray, part: float) -> int:
    """Columns of a picture that overlap."""
    return round(part * picture.shape[1])


def _cut(picture: np.ndarray, part: float) -> tuple[np.ndarray, float]:
    """The column of the cut in each row of the overlap, shape (H,), and how far the ends differ along it."""
    overlap = _width(picture, part)
    cost = ((picture[:, :overlap] - picture[:, -overlap:]) ** 2).sum(axis=2)
    cut = _cheapest_path(cost)
    return cut, float(cost[np.arange(len(cut)), cut].mean())


def _cheapest_path(cost: np.ndarray) -> np.ndarray:
    """A column for each row, neighbours at most one apart, at the least sum of cost (H, W); closes on itself.

    Computed over three repeats of the rows, of which the middle one is taken: it no longer knows where the
    path began.
    """
    height, width = cost.shape
    total = np.full((3 * height, width + 2), np.inf)
    total[:, 1:-1] = np.tile(cost, (3, 1))
    for row in range(1, len(total)):
        before = total[row - 1]
        total[row, 1:-1] += np.minimum(np.minimum(before[:-2], before[1:-1]), before[2:])
    path = np.empty(len(total), int)
    path[-1] = total[-1].argmin()
    for row in range(len(total) - 2, -1, -1):
        low = path[row + 1] - 1
        path[row] = low + total[row, low : low + 3].argmin()
    return path[height : 2 * height] - 1
