"""Dominant offsets of a chart: the displacements under which its known part looks like itself.

He and Sun 2012, "Statistics of patch offsets for image completion": few offsets dominate, those of a
texture's regularity and those along its edges, and what is missing is copied by them. Huang et al. 2014,
"Image completion using planar structure guidance", find them in the rectified plane, where a pattern that
shrinks with distance in every photograph is regular; a chart is that plane. Here the mean square difference
under *every* offset is measured at once, by Fourier transforms, instead of by a histogram of nearest patches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class OffsetSettings:
    """How offsets are found and used.

    Attributes:
        most: Offsets that are kept, each with its opposite; He and Sun keep 60.
        least: Shortest offset [texels]; a shorter one only says that the texture is smooth.
        overlap: Least part of the known texels that an offset lays on known ones [1].
        smooth: Deviation of the blur by which slow changes of light are taken off before [chart diagonals].
        reach: Deviation of the surroundings over which an offset must hold to be used at a texel [roots of
            the wanted area].
        alike: Difference under an offset up to which the texture counts as repeated [ratio to the difference
            of random texels]. A printed pattern has 0.05 to 0.2, planks along their grain 0.3, grass 0.9.
        equal: How much more than the best offset another may differ to count a third [ratio].
        coarse: Longer side at which all offsets are compared [texels].
        apart: Parts of a hole closer than this are continued together [texels].
        margin: Surroundings that a part is continued from [sizes of the part]; farther away other patterns
            begin, a rug's border beside its field. On the demo's rug: 22.4 dB at 0.6, 25.1 at 1, 23.8 at 1.5.
        margin_min: Least surroundings [texels]: three patches.
    """

    most: int = 60
    least: float = 6.0
    overlap: float = 0.15
    smooth: float = 0.08
    reach: float = 0.35
    alike: float = 0.4
    equal: float = 0.03
    coarse: int = 320
    apart: int = 9
    margin: float = 1.0
    margin_min: int = 24


OFFSETS = OffsetSettings()


@dataclass(frozen=True, eq=False)
class Offsets:
    """Dominant offsets.

    Attributes:
        steps: Rows and columns [texels], to a part of a texel, shape (K, 2), float64, the best first.
        unlike: Mean square difference under each, as a ratio to that of random texels, shape (K,).
    """

    steps: np.ndarray
    unlike: np.ndarray


def dominant_offsets(image: np.ndarray, known: np.ndarray, settings: OffsetSettings = OFFSETS) -> Offsets:
    """The offsets under which an image looks most like itself.

    Args:
        image: shape (H, W, C), float32.
        known: Which texels count, shape (H, W), bool.
        settings: Range and number of offsets.
    """
    import cv2

    nothing = Offsets(np.zeros((0, 2)), np.zeros(0))
    height, width = known.shape
    shrink = max(max(height, width) / settings.coarse, 1.0)
    size = (max(round(width / shrink), 1), max(round(height / shrink), 1))
    weight = cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    colors = cv2.resize(np.where(known[..., None], image, 0.0), size, interpolation=cv2.INTER_AREA)
    colors = colors.reshape(size[1], size[0], -1) / np.maximum(weight, 1e-6)[..., None]
    seen = weight > 0.9
    if seen.sum() < 64:
        return nothing
    detail = flattened(colors, seen, settings)
    unlike = _difference(detail, seen, settings)
    row, column = np.ogrid[: unlike.shape[0], : unlike.shape[1]]
    row, column = row - unlike.shape[0] // 2, column - unlike.shape[1] // 2
    unlike[(row * shrink) ** 2 + (column * shrink) ** 2 < settings.least**2] = np.inf
    lowest = unlike <= cv2.erode(unlike.astype(np.float32), np.ones((5, 5), np.uint8)) + 1e-9
    rows, columns = np.nonzero(lowest & np.isfinite(unlike))
    order = np.argsort(unlike[rows, columns], kind="stable")[: settings.most]
    rows, columns = rows[order], columns[order]
    places = np.stack([rows, columns], axis=1)
    steps = places - np.array(unlike.shape) // 2 + _between(unlike, places)
    return Offsets(steps * np.array([height / size[1], width / size[0]]), unlike[rows, columns])


def _between(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """How far beside a minimum the bottom of the parabola through its neighbours lies, along each axis."""
    found = np.zeros(places.shape)
    for axis, unit in enumerate(((1, 0), (0, 1))):
        before, after = places - unit, places + unit
        inside = (before.min(axis=1) >= 0) & (after < values.shape).all(axis=1)
        low, high = (values[tuple(np.clip(at, 0, np.array(values.shape) - 1).T)] for at in (before, after))
        here = values[tuple(places.T)]
        with np.errstate(invalid="ignore", divide="ignore"):
            off = 0.5 * (low - high) / (low + high - 2.0 * here)
        found[:, axis] = np.where(inside & np.isfinite(off), np.clip(off, -0.5, 0.5), 0.0)
    return found


def flattened(image: np.ndarray, known: np.ndarray, settings: OffsetSettings = OFFSETS) -> np.ndarray:
    """An image without slow changes of light; zero where not known."""
    import cv2

    deviation = max(settings.smooth * float(np.hypot(*known.shape)), 1.0)
    weight = known.astype(np.float32)
    around = cv2.GaussianBlur(image * weight[..., None], (0, 0), deviation).reshape(image.shape)
    share = cv2.GaussianBlur(weight, (0, 0), deviation)
    return (image - around / np.maximum(share, 1e-6)[..., None]) * weight[..., None]


def _difference(detail: np.ndarray, known: np.ndarray, settings: OffsetSettings) -> np.ndarray:
    """Mean square difference under every offset, as a ratio to that of random texels; the middle is zero."""
    from scipy import fft

    height, width, channels = detail.shape
    size = (fft.next_fast_len(2 * height - 1), fft.next_fast_len(2 * width - 1))

    def transform(plane: np.ndarray) -> np.ndarray:
        return fft.rfft2(plane.astype(np.float64), size)

    mask, square = transform(known), transform((detail**2).sum(axis=2))
    cross = sum(np.abs(transform(detail[..., k])) ** 2 for k in range(channels))
    both = fft.irfft2(np.abs(mask) ** 2, size)
    apart = fft.irfft2(2.0 * (np.conj(mask) * square).real - 2.0 * cross, size)
    usual = 2.0 * float((detail**2).sum()) / max(int(known.sum()), 1)
    enough = both > settings.overlap * known.sum()
    ratio = np.where(enough, apart / np.maximum(both, 1.0) / max(usual, 1e-12), np.inf)
    middle = np.fft.fftshift(ratio)
    top, left = size[0] // 2 - (height - 1), size[1] // 2 - (width - 1)
    return np.maximum(middle[top : top + 2 * height - 1, left : left + 2 * width - 1], 0.0)
