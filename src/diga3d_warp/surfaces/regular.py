"""Regular textures go on by their dominant offsets."""

from __future__ import annotations

import numpy as np

from diga3d_warp.surfaces.offsets import OFFSETS, OffsetSettings, dominant_offsets, flattened
from diga3d_warp.surfaces.parts import parts_of, surroundings_of


def continue_regular(
    image: np.ndarray, known: np.ndarray, wanted: np.ndarray, settings: OffsetSettings = OFFSETS
) -> tuple[np.ndarray, np.ndarray]:
    """Copy what is wanted from where the texture repeats.

    An offset is judged by the surroundings of each texel: where the known texture there equals itself under
    the offset, colour and light included, it is taken to go on so. Of the offsets that land on known texels
    the best is used, if it is good enough, and others about as good are averaged with it.

    Args:
        image: RGB in [0, 1], shape (H, W, 3), float32; read where known.
        known: shape (H, W), bool.
        wanted: shape (H, W), bool; apart from `known`.
        settings: Range, number and use of offsets.

    Returns:
        The image with what is copied, and where that is, shape (H, W), bool.
    """
    copied = np.zeros_like(wanted)
    result = image.copy()
    for part in parts_of(wanted, settings.apart):
        window = surroundings_of(part, settings.margin, settings.margin_min)
        colors, found = _continue(image[window], known[window], part[window], settings)
        result[window][found] = colors[found]
        copied[window] |= found
    return result, copied


def _continue(
    image: np.ndarray, known: np.ndarray, wanted: np.ndarray, settings: OffsetSettings
) -> tuple[np.ndarray, np.ndarray]:
    """`continue_regular` of one part and its surroundings."""
    offsets = dominant_offsets(image, known, settings)
    if len(offsets.steps) == 0:
        return image, np.zeros_like(wanted)
    detail = flattened(image, known, settings)
    usual = 2.0 * float((detail**2).sum()) / max(int(known.sum()), 1)
    deviation = max(settings.reach * float(np.sqrt(wanted.sum())), 4.0)
    rows, columns = np.nonzero(wanted)
    unlike = np.full((len(offsets.steps), len(rows)), np.inf, np.float32)
    colors = np.zeros((len(offsets.steps), len(rows), 3), np.float32)
    for number, step in enumerate(offsets.steps):
        moved, there = shifted(image, known, step)
        both = (known & there).astype(np.float32)
        off = ((image - moved) ** 2).sum(axis=2) * both
        near = _around(both, deviation)
        told = _around(off, deviation) / np.maximum(near, 1e-6) / max(usual, 1e-12)
        usable = (there & (near > 0.02))[rows, columns]
        unlike[number, usable] = told[rows, columns][usable]
        colors[number] = moved[rows, columns]
    best = unlike.min(axis=0)
    found = best < settings.alike
    # Copies that are as good as the best one differ by noise, which their mean has less of.
    with np.errstate(invalid="ignore"):
        share = np.where(np.isfinite(unlike), np.exp((best - unlike) / settings.equal), 0.0)
    mean = (share[..., None] * colors).sum(axis=0) / np.maximum(share.sum(axis=0), 1e-12)[:, None]
    result, copied = image.copy(), np.zeros_like(wanted)
    copied[rows[found], columns[found]] = True
    result[copied] = mean[found]
    return result, copied


def shifted(image: np.ndarray, known: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An image seen through an offset: what lies at the offset from each texel, and where that is known.

    Args:
        image: shape (H, W, C), float32.
        known: shape (H, W), bool.
        step: Rows and columns [texels]; between texels, it is interpolated.
    """
    import cv2

    height, width = known.shape
    move = np.array([[1.0, 0.0, step[1]], [0.0, 1.0, step[0]]])
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    moved = cv2.warpAffine(image, move, (width, height), flags=how, borderMode=cv2.BORDER_CONSTANT)
    there = cv2.warpAffine(known.astype(np.float32), move, (width, height), flags=how)
    return moved.reshape(height, width, -1), there > 0.999


def _around(values: np.ndarray, deviation: float) -> np.ndarray:
    """Gaussian means, taken of a smaller copy where these are wide."""
    import cv2

    height, width = values.shape
    shrink = max(deviation / 4.0, 1.0)
    size = (max(round(width / shrink), 1), max(round(height / shrink), 1))
    small = cv2.GaussianBlur(
        cv2.resize(values, size, interpolation=cv2.INTER_AREA), (0, 0), deviation / shrink
    )
    return cv2.resize(small, (width, height))
