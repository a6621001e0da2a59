"""SIFT matches between images, the same for any number of threads.

pycolmap's CPU matcher searches an approximate index and does not promise the same matches twice. Here
distances are exact: SIFT descriptors hold integers up to 255, so a product of two rows stays below 2^24,
where float32 is exact in any order of summation.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import torch

if TYPE_CHECKING:
    import pycolmap

Pair = tuple[str, str]


@dataclass(frozen=True)
class MatchSettings:
    """When two features match, and which images of a film are compared.

    Attributes:
        ratio: Largest ratio of the angle to the nearest feature and to the second. COLMAP: 0.8.
        angle: Largest angle between two descriptors [rad]. COLMAP: 0.7.
        norm: Length of a descriptor as COLMAP stores it.
        overlap: Images of a film are matched with this many next ones. COLMAP: 10.
        jumps: And with those at these distances, which tie a film together. COLMAP: powers of two.
    """

    ratio: float = 0.8
    angle: float = 0.7
    norm: float = 512.0
    overlap: int = 10
    jumps: tuple[int, ...] = (16, 32, 64, 128, 256, 512)


SETTINGS = MatchSettings()


def match_pairs(
    database: pycolmap.Database, pairs: Iterable[Pair], settings: MatchSettings = SETTINGS
) -> None:
    """Match the features of image pairs and write the matches, in the order of the pairs.

    Args:
        database: Holds images with features; gets a row of matches for each pair.
        pairs: Names of two images each.
        settings: When two features match.
    """
    images = {image.name: image.image_id for image in database.read_all_images()}
    descriptors: dict[int, torch.Tensor] = {}
    for pair in pairs:
        first, second = (images[name] for name in pair)
        for image in (first, second):
            if image not in descriptors:
                descriptors[image] = torch.from_numpy(
                    database.read_descriptors(image).data.astype(np.float32)
                )
        database.write_matches(first, second, matches(descriptors[first], descriptors[second], settings))


def matches(first: torch.Tensor, second: torch.Tensor, settings: MatchSettings = SETTINGS) -> np.ndarray:
    """Features of two images that are each other's nearest, and clearly nearer than the next.

    Args:
        first, second: Descriptors with whole values up to 255, shapes (N, 128) and (M, 128), float32.
        settings: When two features match.

    Returns:
        Rows of both, shape (K, 2), uint32, in the order of `first`.
    """
    if not len(first) or not len(second):
        return np.zeros((0, 2), np.uint32)
    products = first @ second.T
    forward, chosen = _nearest(products, settings)
    backward, back = _nearest(products.T, settings)
    rows = torch.arange(len(first))
    mutual = forward & backward[chosen] & (back[chosen] == rows)
    return torch.stack([rows[mutual], chosen[mutual]], dim=1).numpy().astype(np.uint32)


def _nearest(products: torch.Tensor, settings: MatchSettings) -> tuple[torch.Tensor, torch.Tensor]:
    """Whether the nearest column of each row is near and distinct enough, and which it is."""
    value, chosen = products.max(dim=1)
    others = products.scatter(1, chosen[:, None], -1.0).amax(dim=1)
    angle, next_angle = (
        torch.arccos((product.double() / settings.norm**2).clamp(0.0, 1.0)) for product in (value, others)
    )
    return (angle <= settings.angle) & (angle < settings.ratio * next_angle), chosen


def film_pairs(names: Sequence[str], settings: MatchSettings = SETTINGS) -> list[Pair]:
    """Pairs of images of a film: each with those that follow, and a few farther on."""
    steps = [*range(1, settings.overlap + 1), *settings.jumps]
    return [
        (name, names[i + step]) for i, name in enumerate(names) for step in steps if i + step < len(names)
    ]


def all_pairs(names: Sequence[str]) -> list[Pair]:
    """Every pair of images."""
    return list(combinations(names, 2))
