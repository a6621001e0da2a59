"""Corrs: how many points of one rendered frame are found again in another.

Frames that show one scene have many correspondences; fills that differ from view to view, or are blurred,
have few. The paper counts LoFTR's matches (Sun et al. 2021) of confidence 0.8 and more between fixed pairs of
frames of a video along new views. SIFT (Lowe 2004) needs no weights; its counts go by their own name, since
the two do not compare. Counts grow with the number of pixels: compare them at one size only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import torch

from diga3d_warp.evaluation.weights import WeightsFile, fill, read_tensors
from diga3d_warp.files import to_bytes

LOFTR = WeightsFile("loftr_outdoor.ckpt", "https://huggingface.co/kornia/loftr/resolve/main/", 46)
"""kornia's copy of the weights for outdoor scenes, which its examples and the field use."""

CONFIDENCE = 0.8
"""Least confidence of a LoFTR match that counts: the paper's."""

RATIO = 0.8
"""Largest distance to the nearest descriptor, relative to the second nearest: Lowe 2004, section 7.1."""


Frames = Sequence[torch.Tensor] | Mapping[int, torch.Tensor]
Masks = Sequence[np.ndarray] | Mapping[int, np.ndarray]


@dataclass(frozen=True)
class Matches:
    """Points found in two images.

    Attributes:
        first, second: Positions (x, y) in each [px], shape (N, 2), float64.
    """

    first: np.ndarray
    second: np.ndarray

    def touching(self, first: np.ndarray, second: np.ndarray) -> int:
        """How many have an end in the mask of its image, each of shape (H, W), bool."""
        inside = _inside(self.first, first) | _inside(self.second, second)
        return int(inside.sum())


class Matcher(Protocol):
    """Finds correspondences between two images."""

    title: str

    def match(self, first: torch.Tensor, second: torch.Tensor) -> Matches:
        """Match two images in RGB in [0, 1], shape (H, W, 3)."""
        ...


class SiftMatcher:
    """SIFT features that are nearest to each other both ways and clearly nearer than the second."""

    title = "SIFT matches"

    def __init__(self) -> None:
        import cv2

        self.detector = cv2.SIFT.create()
        self.matcher = cv2.BFMatcher(cv2.NORM_L2)

    def match(self, first: torch.Tensor, second: torch.Tensor) -> Matches:
        """See `Matcher.match`."""
        import cv2

        found = [
            self.detector.detectAndCompute(cv2.cvtColor(to_bytes(image), cv2.COLOR_RGB2GRAY), None)
            for image in (first, second)
        ]
        (points, descriptors), (others, targets) = found
        if len(points) < 2 or len(others) < 2:
            return Matches(np.zeros((0, 2)), np.zeros((0, 2)))
        there, back = self._nearest(descriptors, targets), self._nearest(targets, descriptors)
        pairs = [(one, other) for one, other in there.items() if back.get(other) == one]
        return Matches(
            np.array([points[one].pt for one, _ in pairs], np.float64).reshape(-1, 2),
            np.array([others[other].pt for _, other in pairs], np.float64).reshape(-1, 2),
        )

    def _nearest(self, descriptors: np.ndarray, targets: np.ndarray) -> dict[int, int]:
        return {
            best.queryIdx: best.trainIdx
            for best, second in self.matcher.knnMatch(descriptors, targets, k=2)
            if best.distance < RATIO * second.distance
        }


class LoftrMatcher:
    """LoFTR matches of confidence `CONFIDENCE` and more."""

    title = "LoFTR matches"

    def __init__(self, weights: Path | None = None, device: str = "cpu") -> None:
        """Load kornia's network.

        Args:
            weights: Folder with the file; torch.hub's cache if None or not there.
            device: Where it runs.

        Raises:
            InputError: the file is missing or damaged.
        """
        from kornia.feature import LoFTR

        path = LOFTR.find(weights)
        state = read_tensors(path, "state_dict")
        self.network, self.device = LoFTR(pretrained=None), device
        fill(self.network, state, path)
        self.network.to(device)

    @torch.no_grad()
    def match(self, first: torch.Tensor, second: torch.Tensor) -> Matches:
        """See `Matcher.match`."""
        from kornia.color import rgb_to_grayscale

        one, other = (
            rgb_to_grayscale(image.to(self.device, torch.float32).permute(2, 0, 1)[None])
            for image in (first, second)
        )
        found = self.network({"image0": one, "image1": other})
        sure = found["confidence"] >= CONFIDENCE
        # kornia puts the centre of the first pixel at (0.5, 0.5) here, OpenCV at (0, 0).
        ends = [found[f"keypoints{side}"][sure].double().cpu().numpy() - 0.5 for side in (0, 1)]
        return Matches(*ends)


@dataclass(frozen=True)
class Corrs:
    """Correspondences of pairs of frames.

    Attributes:
        whole: Mean number of matches over the pairs.
        masked: Mean number of those with an end in a mask; None without masks.
        pairs: Number of pairs.
    """

    whole: float
    masked: float | None
    pairs: int


def count_matches(
    matcher: Matcher,
    pairs: Sequence[tuple[int, int]],
    frames: Frames,
    masks: Masks | None = None,
) -> Corrs:
    """Count the matches of pairs of frames.

    Args:
        matcher: Finds them.
        pairs: Indices of the frames of each pair, at least one.
        frames: RGB in [0, 1] by index, shape (H, W, 3).
        masks: True where the edit was, one for each frame, shape (H, W), bool; None if unknown.
    """
    whole, masked = [], []
    for first, second in pairs:
        matches = matcher.match(frames[first], frames[second])
        whole.append(len(matches.first))
        if masks is not None:
            masked.append(matches.touching(masks[first], masks[second]))
    return Corrs(float(np.mean(whole)), float(np.mean(masked)) if masks is not None else None, len(pairs))


def _inside(points: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Whether each point lies on a True pixel, shape (N,), bool."""
    height, width = mask.shape
    columns, rows = np.rint(points).astype(int).T
    return mask[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
