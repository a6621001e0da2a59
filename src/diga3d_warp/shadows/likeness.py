"""How much darker each place of a surface is than places like it.

Two places are alike if the patches around them have the same texture once their mean is taken out, and about
the same hue: neither changes in a shadow of one ratio. Of the places that are alike, those in the light tell
what a place in the shadow would look like there (nonlocal texture constraints of Retinex; Zhao et al. 2012,
"A closed-form solution to Retinex with nonlocal texture constraints").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RADIUS = 3
"""Patches are 7 x 7 texels, as in the exemplar prior."""

DARKEST = 2e-3
"""Least linear colour [1]: below, 8 bits hold no ratio."""

COMPONENTS = 14
"""Principal components of patches that are compared: nine tenths of the variance of most textures."""

ALIKE = 8
"""Places that are compared with each; their median stands a few that are not alike."""

LIT_MOST = 3000
"""Places in the light that are searched; more of the same texture tell nothing new."""

HUE, HUE_OWN = 1.0, 0.3
"""Weight of a patch's mean hue, and of its hue at the middle against that mean, beside its contrast."""

FAR, CLOSE = 0.2, 0.2
"""Weight of the squared distance between places, and the distance up to which it does not count [half
charts]: the light changes over a room, and of what is near no part is preferred, be it in the shadow."""

JITTER = 0.01
"""Noise that is added to patches [log units]: of a plain surface all are alike, and any may be compared."""

BLOCK = 1000
"""Places that are compared at a time; bounds memory."""


@dataclass(frozen=True, eq=False)
class Places:
    """Places of a chart with their patches.

    Attributes:
        index: Flat index of each place in the chart, shape (P,).
        patches: Descriptors without the mean brightness, shape (P, C), float32.
        logs: Log of the linear colours, shape (P, 3), float32.
        at: Position, -1 to 1 over the chart, shape (P, 2), float32.
    """

    index: np.ndarray
    patches: np.ndarray
    logs: np.ndarray
    at: np.ndarray

    def __len__(self) -> int:
        return len(self.index)

    def ratios(self, lit: np.ndarray, ratio: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Log ratio of the light at each place to that of places like it in the light.

        Args:
            lit: Places that are lit, shape (P,), bool.
            ratio: What is taken for the ratio there, shape (P,): they may lie in a weak penumbra.
            seed: Of the choice of lit places.

        Returns:
            Log ratios, shape (P, 3), and the squared distance of the patches that were compared, shape (P,).
        """
        rng = np.random.default_rng(seed)
        rows = _some(np.flatnonzero(lit), LIT_MOST, rng)
        every = self.patches + np.float32(JITTER) * rng.standard_normal(self.patches.shape, np.float32)
        others = every[rows]
        own = self.logs[rows] - np.log(ratio[rows])[:, None].astype(np.float32)
        squares = (others**2).sum(axis=1)
        count = min(ALIKE, max(len(rows) - 1, 1))
        found, apart = np.zeros((len(self), 3), np.float32), np.zeros(len(self), np.float32)
        for first in range(0, len(self), BLOCK):
            part = slice(first, min(first + BLOCK, len(self)))
            distance = (every[part] ** 2).sum(axis=1)[:, None] + squares - 2.0 * (every[part] @ others.T)
            distance += self._apart(part, rows)
            distance[rows[None] == np.arange(part.start, part.stop)[:, None]] = np.inf
            nearest = np.argpartition(distance, count - 1, axis=1)[:, :count]
            found[part] = np.median(self.logs[part, None] - own[nearest], axis=1)
            apart[part] = np.take_along_axis(distance, nearest, axis=1).mean(axis=1)
        return found, np.maximum(apart, 0.0)

    def _apart(self, part: slice, rows: np.ndarray) -> np.ndarray:
        """Penalty of places that are far from each other, shape (part, rows), float32."""
        at, others = self.at[part], self.at[rows]
        square = (at**2).sum(axis=1)[:, None] + (others**2).sum(axis=1) - 2.0 * (at @ others.T)
        return np.float32(FAR) * np.maximum(np.sqrt(np.maximum(square, 0.0)) - CLOSE, 0.0) ** 2


def places_of(linear: np.ndarray, known: np.ndarray, near: np.ndarray, most: int, seed: int) -> Places:
    """Places of a chart, drawn from what is known: half of them near the object, as far as there are as many.

    Args:
        linear: Linear colours, shape (H, W, 3).
        known: Where they are known, shape (H, W), bool.
        near: What is near the object, shape (H, W), bool.
        most: Number of places.
        seed: Of the draw.
    """
    import cv2

    inner = cv2.erode(known.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    rng = np.random.default_rng(seed)
    close = _some(np.flatnonzero(inner & near), most // 2, rng)
    index = np.sort(np.concatenate([close, _some(np.flatnonzero(inner & ~near), most - len(close), rng)]))
    logs = np.log(np.maximum(linear, DARKEST)).astype(np.float32)
    mean = _mean(logs, known, RADIUS)
    contrast = np.where(known[..., None], logs - mean, 0.0)
    grey = np.pad(contrast.mean(axis=2), RADIUS)
    side = 2 * RADIUS + 1
    windows = np.lib.stride_tricks.sliding_window_view(grey, (side, side)).reshape(-1, side * side)
    hue, own = (_hue(part).reshape(-1, 2)[index] for part in (mean, contrast))
    patches = np.concatenate([windows[index] / side, HUE * hue, HUE_OWN * own], axis=1).astype(np.float32)
    if len(patches):
        patches -= patches.mean(axis=0)
        axes = np.linalg.svd(patches, full_matrices=False)[2][:COMPONENTS]
        patches = patches @ axes.T
    rows, columns = np.unravel_index(index, known.shape)
    at = np.stack([columns / known.shape[1], rows / known.shape[0]], axis=1) * 2.0 - 1.0
    smooth = _mean(logs, known, 1).reshape(-1, 3)[index]
    return Places(index, patches, smooth, at.astype(np.float32))


def _some(index: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    return index if len(index) <= most else rng.choice(index, most, replace=False)


def _mean(logs: np.ndarray, known: np.ndarray, radius: int) -> np.ndarray:
    import cv2

    side = (2 * radius + 1,) * 2
    weight = known.astype(np.float32)
    total = cv2.blur(weight, side)[..., None]
    return cv2.blur(logs * weight[..., None], side) / np.maximum(total, 1e-6)


def _hue(logs: np.ndarray) -> np.ndarray:
    return np.stack([logs[..., 0] - logs[..., 1], logs[..., 2] - logs[..., 1]], axis=-1)
