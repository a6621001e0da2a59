"""Tone: differences at a rim continued into the hole."""

from __future__ import annotations

import numpy as np
import pytest

from diga3d_warp.propagation.tone import rim_of, tone_between
from diga3d_warp.surfaces.membrane import membrane

HEIGHT, WIDTH = 120, 160


@pytest.fixture
def hole() -> np.ndarray:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return (rows - 60) ** 2 + (columns - 80) ** 2 < 30**2


def test_the_membrane_continues_an_affine_function_exactly(hole):
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    plane = np.stack([0.3 + 0.01 * rows, 2.0 - 0.02 * columns], -1)
    np.testing.assert_allclose(membrane(plane, ~hole, hole), plane[hole], atol=1e-9)


def test_a_drifting_difference_is_continued(hole):
    rng = np.random.default_rng(0)
    columns = np.arange(WIDTH, dtype=np.float32) / WIDTH
    light = np.broadcast_to(0.1 + 0.2 * columns[None, :, None], (HEIGHT, WIDTH, 3)).astype(np.float32)
    own = rng.uniform(0.2, 0.4, (HEIGHT, WIDTH, 3)).astype(np.float32)
    shown = own + rng.normal(0.0, 0.02, own.shape).astype(np.float32) - light
    added = tone_between(own, shown, rim_of(hole), hole)
    assert np.abs(added - light)[hole].max() < 0.06
    assert np.abs(added - light)[hole].mean() < 0.01
    assert not added[~hole].any()


def test_a_part_without_a_rim_is_left_alone(hole):
    corner = np.zeros_like(hole)
    corner[:8, :8] = True
    own = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    added = tone_between(own, own - 0.1, rim_of(hole), hole | corner)
    np.testing.assert_allclose(added[hole], 0.1, atol=1e-6)
    assert not added[corner].any()


def test_without_any_rim_nothing_is_added(hole):
    own = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    assert not tone_between(own, own - 0.1, np.zeros_like(hole), hole).any()
    assert not tone_between(own, own - 0.1, rim_of(hole), np.zeros_like(hole)).any()
