"""Exact matches: against every angle in float64, and the pairs that are compared."""

from __future__ import annotations

import numpy as np
import torch

from diga3d_warp.scene.mapping.matching import SETTINGS, all_pairs, film_pairs, matches


def descriptors(count: int, seed: int) -> np.ndarray:
    """Random descriptors as COLMAP stores them: whole numbers, of length 512."""
    raw = np.random.default_rng(seed).random((count, 128)) ** 3
    return np.rint(512.0 * raw / np.linalg.norm(raw, axis=1, keepdims=True)).clip(0, 255)


def expected(first: np.ndarray, second: np.ndarray) -> list[tuple[int, int]]:
    """Mutual nearest neighbours within the limits, by the definition."""
    angles = np.arccos((first @ second.T / SETTINGS.norm**2).clip(0.0, 1.0))

    def nearest(row: np.ndarray) -> int | None:
        order = np.argsort(row, kind="stable")
        near = row[order[0]] <= SETTINGS.angle and row[order[0]] < SETTINGS.ratio * row[order[1]]
        return int(order[0]) if near else None

    forward = [nearest(row) for row in angles]
    backward = [nearest(row) for row in angles.T]
    return [(i, j) for i, j in enumerate(forward) if j is not None and backward[j] == i]


def test_matches_are_mutual_nearest_neighbours():
    first = descriptors(60, 0)
    noise = np.random.default_rng(1).integers(-6, 7, (60, 128))
    second = np.concatenate([(first + noise).clip(0, 255)[::-1], descriptors(30, 2)])
    second[5] = second[4]  # two equal candidates: neither is distinct
    rough = first[0] + 0.5 * first[1]
    rough = np.rint(512.0 * rough / np.linalg.norm(rough))
    first = np.concatenate([first, [rough]])  # near one that has a nearer one
    found = matches(torch.from_numpy(first).float(), torch.from_numpy(second).float())
    assert found.dtype == np.uint32 and len(found) == 58
    assert [tuple(row) for row in found.tolist()] == expected(first, second)


def test_images_without_features_match_nothing():
    some = torch.from_numpy(descriptors(3, 0)).float()
    assert matches(some, torch.zeros(0, 128)).shape == (0, 2)
    assert matches(some, some[:1]).shape == (1, 2)


def test_pairs_of_a_film_and_of_few_images():
    names = [f"{i:03d}" for i in range(40)]
    pairs = film_pairs(names)
    assert len(set(pairs)) == len(pairs)
    assert {("000", "010"), ("000", "016"), ("000", "032"), ("038", "039")} <= set(pairs)
    assert ("000", "011") not in pairs
    assert all_pairs(["a", "b", "c"]) == [("a", "b"), ("a", "c"), ("b", "c")]
