"""Filling without learned weights: shift-map inpainting, and two baselines to measure it against."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch

from diga3d_warp.files import to_bytes
from diga3d_warp.priors.protocol import check_fill
from diga3d_warp.priors.surroundings import separate, stretch


@dataclass(frozen=True)
class ClassicalSettings:
    """Sizes of the cut-outs that shift maps are computed on.

    Attributes:
        strip: Height of the strips in which a hole is filled [image diagonals]. Pixels at one height of a
            photograph mostly have similar depths: filled whole, a hole in a lawn received bushes and road.
        margin: Surroundings that a strip may copy from, to the left and right [hole widths].
        margin_min: Least margin, and the one above and below [px]: twice the 8 px patch that OpenCV matches.
        apart: Holes closer than this are filled together [px].
        side_min: Least height and width of a cut-out [px]; a smaller image is continued by its mirror image.
            With fewer than 60 frequent offsets, OpenCV (4.14, 5.0) reads past its table of them and no longer
            holds the rim of the hole fixed. Of 12 photographs all did so at 56 px, two at 72, none at 96.
        known_min: Least share of known pixels in the cut-out; below, there is nothing to copy.
        largest: Longer and shorter side of a cut-out that is filled at full size [px]. Beyond
            both, OpenCV shrinks the image and refines by a second graph cut, whose table of neighbours is
            filled by wrong indices (xphoto/src/inpainting.cpp, `__backref(i, j)`); we shrink and enlarge.
    """

    strip: float = 0.095
    margin: float = 0.8
    margin_min: int = 16
    apart: int = 16
    side_min: int = 128
    known_min: float = 0.15
    largest: tuple[int, int] = (800, 600)


class ClassicalPrior:
    """Shift-map inpainting (He and Sun 2012, in OpenCV contrib's xphoto).

    Copies known parts of the image by their most frequent offsets and stitches them by graph cut: sharp, and
    true to the photograph's own textures. It models neither objects nor perspective; filling a hole strip
    by strip from the top limits it to surroundings of the same height. Telea's method fills holes that have
    too little surroundings.
    """

    name = "classical"

    def __init__(self, settings: ClassicalSettings | None = None) -> None:
        self.settings = settings or ClassicalSettings()

    def fill(
        self, image: torch.Tensor, mask: torch.Tensor, *, seed: int = 0, depth: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Fill the masked pixels; see `Prior.fill`. Seed and depth change nothing."""
        check_fill(image, mask)
        holes = mask.cpu().numpy().astype(bool)
        pixels = to_bytes(image)
        remaining = holes.copy()
        for hole in separate(holes, self.settings.apart):
            for strip in _strips(hole, self.settings):
                window = _window(strip, hole, self.settings)
                if remaining[window].all():
                    window = (slice(None), slice(None))
                filled = self._fill_window(pixels[window], remaining[window])
                pixels = pixels.copy()
                pixels[window] = np.where(strip[window][..., None], filled, pixels[window])
                remaining &= ~strip
        return _paste(image, mask, pixels)

    def _fill_window(self, pixels: np.ndarray, missing: np.ndarray) -> np.ndarray:
        filled = None
        if (~missing).mean() >= self.settings.known_min:
            filled = _shift_map(pixels, missing, self.settings)
        return _telea(pixels, missing) if filled is None else filled


def telea_fill(image: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Telea's fast marching: smooth, without texture. A baseline; arguments and errors as `Prior.fill`."""
    check_fill(image, mask)
    return _paste(image, mask, _telea(to_bytes(image), mask.cpu().numpy().astype(bool)))


def mean_color_fill(image: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """The mean of the unmasked pixels. A baseline; arguments and errors as `Prior.fill`."""
    check_fill(image, mask)
    return torch.where(mask[..., None], image[~mask].mean(0), image)


def _paste(image: torch.Tensor, mask: torch.Tensor, pixels: np.ndarray) -> torch.Tensor:
    filled = torch.from_numpy(pixels.astype(np.float32) / 255.0).to(image.device)
    return torch.where(mask[..., None], filled, image)


def _strips(hole: np.ndarray, settings: ClassicalSettings) -> Iterator[np.ndarray]:
    """The hole in parts of about equal height, from the top."""
    rows = np.flatnonzero(hole.any(1))
    height = settings.strip * float(np.hypot(*hole.shape))
    count = max(1, round((rows[-1] + 1 - rows[0]) / height))
    for start, end in pairwise(np.linspace(rows[0], rows[-1] + 1, count + 1).astype(int)):
        strip = np.zeros_like(hole)
        strip[start:end] = hole[start:end]
        if strip.any():
            yield strip


def _window(strip: np.ndarray, hole: np.ndarray, settings: ClassicalSettings) -> tuple[slice, slice]:
    """The part of the image that a strip of a hole is filled from."""
    rows, columns = np.flatnonzero(strip.any(1)), np.flatnonzero(hole.any(0))
    least = settings.margin_min
    pad = max(int(settings.margin * (columns[-1] + 1 - columns[0])), least)
    across = stretch(int(columns[0]) - pad, int(columns[-1]) + 1 + pad, settings.side_min, hole.shape[1])
    return slice(max(int(rows[0]) - least, 0), int(rows[-1]) + 1 + least), across


def _shift_map(pixels: np.ndarray, missing: np.ndarray, settings: ClassicalSettings) -> np.ndarray | None:
    """Shift map of a cut-out at a size that OpenCV handles; None where it fails."""
    import cv2

    height, width = missing.shape
    shrink = min(max(height, width) / settings.largest[0], min(height, width) / settings.largest[1])
    if shrink > 1.0:
        size = (int(width / shrink), int(height / shrink))
        some_missing = cv2.resize(missing.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.0
        filled = _shift_map(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), some_missing, settings)
        return None if filled is None else cv2.resize(filled, (width, height), interpolation=cv2.INTER_CUBIC)
    below, right = max(settings.side_min - height, 0), max(settings.side_min - width, 0)
    mirror = (0, below, 0, right, cv2.BORDER_REFLECT_101)
    filled = _opencv_shift_map(
        cv2.copyMakeBorder(pixels, *mirror), cv2.copyMakeBorder(missing.astype(np.uint8), *mirror) > 0
    )
    return None if filled is None else filled[:height, :width]


def _opencv_shift_map(pixels: np.ndarray, missing: np.ndarray) -> np.ndarray | None:
    """OpenCV's shift map on 8-bit RGB; None if it moved the rim of the hole, which it must hold fixed.

    It works in CIELab, and its mask is zero where to fill. The rim, on which the fill is anchored, are the
    pixels 3 and 4 px outside the hole.
    """
    import cv2

    lab = cv2.cvtColor(pixels, cv2.COLOR_RGB2Lab)
    filled = np.zeros_like(lab)
    cv2.xphoto.inpaint(lab, np.where(missing, 0, 255).astype(np.uint8), filled, cv2.xphoto.INPAINT_SHIFTMAP)
    near, far = (cv2.dilate(missing.astype(np.uint8), np.ones((n, n), np.uint8)) > 0 for n in (5, 9))
    if (filled != lab)[far & ~near].any():
        return None
    left_out = missing & (filled == 0).all(-1)  # no offset reached a known pixel; no real colour is (0, 0, 0)
    result = np.where(missing[..., None], cv2.cvtColor(filled, cv2.COLOR_Lab2RGB), pixels)
    return _telea(result, left_out) if left_out.any() else result


def _telea(pixels: np.ndarray, missing: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.inpaint(pixels, missing.astype(np.uint8), 3, cv2.INPAINT_TELEA)
