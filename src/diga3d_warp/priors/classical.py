"""Filling without learned weights: shift-map inpainting, and two baselines to measure it against."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch

from diga3d_warp.files import to_bytes
from diga3d_warp.priors.protocol import check_fill


@dataclass(frozen=True)
class ClassicalSettings:
    """How shift maps are tried.

    Attributes:
        margins: Known surroundings that a candidate may copy from, each as a share of the hole's longer side.
            Near surroundings hold the right texture; a wider margin helps where the near one has too little
            of it. More than a half brought in far-off objects and doubled the time on the statue capture.
        margin_min: Least margin [px]: twice the 8 px patch that OpenCV matches.
        apart: Holes closer than this are filled together [px].
        rows_min: Least height and width of the cut-out that shift maps are tried on [px]: fewer hold too few
            8 px patches for offset statistics.
        known_min: Least share of known pixels in the cut-out; below, there is nothing to copy.
        largest: Longer and shorter side of a cut-out that is filled at full size [px]. Beyond
            both, OpenCV shrinks the image and refines by a second graph cut, whose table of neighbours is
            filled by wrong indices (xphoto/src/inpainting.cpp, `__backref(i, j)`); we shrink and enlarge.
        patch: Side of the patches that candidates are compared by, at half size [px].
        known_patches: Known patches compared with, drawn at random; more change the score by under 1 %.
        components: Principal components of a patch that are compared.
    """

    margins: tuple[float, ...] = (0.25, 0.5)
    margin_min: int = 16
    apart: int = 16
    rows_min: int = 24
    known_min: float = 0.15
    largest: tuple[int, int] = (800, 600)
    patch: int = 7
    known_patches: int = 8000
    components: int = 12


class ClassicalPrior:
    """Shift-map inpainting (He and Sun 2012, in OpenCV contrib's xphoto).

    Copies known parts of the image by their most frequent offsets and stitches them by graph cut: sharp, and
    true to the photograph's own textures. It knows no objects and no perspective. Each hole is cut out with
    several margins; the most coherent result is kept: the one whose patches resemble known patches most
    (Wexler et al. 2007). Telea's method fills what has too little surroundings.
    """

    name = "classical"

    def __init__(self, settings: ClassicalSettings | None = None) -> None:
        self.settings = settings or ClassicalSettings()

    def fill(self, image: torch.Tensor, mask: torch.Tensor, *, seed: int = 0) -> torch.Tensor:
        """Fill the masked pixels; see `Prior.fill`. The seed only draws the patches of the comparison."""
        check_fill(image, mask)
        holes = mask.cpu().numpy().astype(bool)
        pixels = to_bytes(image)
        remaining = holes.copy()
        for hole in _separate(holes, self.settings.apart):
            pixels = np.where(hole[..., None], self._fill_hole(pixels, hole, remaining, seed), pixels)
            remaining &= ~hole
        return _paste(image, mask, pixels)

    def _fill_hole(self, pixels: np.ndarray, hole: np.ndarray, unknown: np.ndarray, seed: int) -> np.ndarray:
        """An image that holds a fill in `hole`; `unknown` are all pixels not yet filled."""
        best, best_score = None, np.inf
        for window in _windows(hole, self.settings):
            part, missing = pixels[window], unknown[window]
            if min(missing.shape) < self.settings.rows_min or (~missing).mean() < self.settings.known_min:
                continue
            filled = _shift_map(part, missing, self.settings.largest)
            score = _incoherence(filled, missing, self.settings, seed)
            if score < best_score:
                best, best_score = pixels.copy(), score
                best[window] = filled
        return _telea(pixels, unknown) if best is None else best


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


def _separate(holes: np.ndarray, apart: int) -> Iterator[np.ndarray]:
    """Holes that are far from each other, one mask each, smallest first: it leaves the next more to copy."""
    import cv2

    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (apart + 1, apart + 1))
    count, label = cv2.connectedComponents(cv2.dilate(holes.astype(np.uint8), disc))
    parts = [holes & (label == k) for k in range(1, count)]
    yield from sorted(parts, key=lambda part: int(part.sum()))


def _windows(hole: np.ndarray, settings: ClassicalSettings) -> Iterator[tuple[slice, slice]]:
    """The hole's box with each margin, cut off at the image."""
    rows, columns = np.flatnonzero(hole.any(1)), np.flatnonzero(hole.any(0))
    longer = max(rows[-1] - rows[0], columns[-1] - columns[0]) + 1
    for margin in settings.margins:
        pad = max(int(margin * longer), settings.margin_min)
        yield (
            slice(max(rows[0] - pad, 0), rows[-1] + pad + 1),
            slice(max(columns[0] - pad, 0), columns[-1] + pad + 1),
        )


def _shift_map(pixels: np.ndarray, missing: np.ndarray, largest: tuple[int, int]) -> np.ndarray:
    """OpenCV's shift map on 8-bit RGB. It works in CIELab, and its mask is zero where to fill."""
    import cv2

    height, width = missing.shape
    shrink = min(max(height, width) / largest[0], min(height, width) / largest[1])
    if shrink > 1.0:
        size = (int(width / shrink), int(height / shrink))
        small = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        some_missing = cv2.resize(missing.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.0
        filled = _shift_map(small, some_missing, largest)
        enlarged = cv2.resize(filled, (width, height), interpolation=cv2.INTER_CUBIC)
        return np.where(missing[..., None], enlarged, pixels)
    lab = cv2.cvtColor(pixels, cv2.COLOR_RGB2Lab)
    filled = np.zeros_like(lab)
    cv2.xphoto.inpaint(lab, np.where(missing, 0, 255).astype(np.uint8), filled, cv2.xphoto.INPAINT_SHIFTMAP)
    left_out = missing & (filled == 0).all(-1)  # no offset reached a known pixel; no real colour is (0, 0, 0)
    result = np.where(missing[..., None], cv2.cvtColor(filled, cv2.COLOR_Lab2RGB), pixels)
    return _telea(result, left_out) if left_out.any() else result


def _telea(pixels: np.ndarray, missing: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.inpaint(pixels, missing.astype(np.uint8), 3, cv2.INPAINT_TELEA)


def _incoherence(pixels: np.ndarray, missing: np.ndarray, settings: ClassicalSettings, seed: int) -> float:
    """Mean distance of the patches that touch the fill to their nearest known patches."""
    import cv2
    from numpy.lib.stride_tricks import sliding_window_view
    from scipy.spatial import cKDTree

    n = settings.patch
    lab = cv2.cvtColor(pixels, cv2.COLOR_RGB2Lab)
    half = cv2.resize(lab, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA).astype(np.float32)
    hole = cv2.resize(missing.astype(np.uint8), half.shape[1::-1], interpolation=cv2.INTER_AREA) > 0
    patches = sliding_window_view(half, (n, n), (0, 1)).reshape(-1, 3 * n * n)
    touched = sliding_window_view(hole, (n, n)).any((-1, -2)).ravel()
    known = np.flatnonzero(~touched)
    if known.size <= settings.components:
        return np.inf
    drawn = np.random.default_rng(seed).permutation(known)[: settings.known_patches]
    middle = patches[drawn].mean(0)
    axes = np.linalg.svd(patches[drawn[:2000]] - middle, full_matrices=False)[2][: settings.components].T
    tree = cKDTree((patches[drawn] - middle) @ axes)
    return float(tree.query((patches[touched] - middle) @ axes)[0].mean())
