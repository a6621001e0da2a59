"""Codebooks: near the data, the same at each call, and as large as asked for at most."""

from __future__ import annotations

import numpy as np
import pytest

from diga3d_warp.scene.formats import sog_writer
from diga3d_warp.scene.formats.codebooks import scalar_codebook, vector_codebook
from diga3d_warp.scene.formats.read import read_splat
from diga3d_warp.scene.formats.write import write_splat
from scenes import random_gaussians


def test_a_scalar_codebook_stands_for_its_values():
    values = np.random.default_rng(0).normal(size=(5000, 3)).astype(np.float32)
    book, indices = scalar_codebook(values, 256)
    assert indices.shape == values.shape and (np.diff(book) >= 0).all()
    np.testing.assert_array_equal(indices, np.abs(values[..., None] - book).argmin(axis=-1))
    uniform = np.abs(values - np.linspace(values.min(), values.max(), 256)[
        np.abs(values[..., None] - np.linspace(values.min(), values.max(), 256)).argmin(axis=-1)
    ]).mean()  # fmt: skip
    assert np.abs(book[indices] - values).mean() < 0.9 * uniform


@pytest.mark.parametrize("values", [[1.5], [0.0, 0.0], [3.0, 1.0, 2.0]])
def test_few_values_are_exact(values):
    book, indices = scalar_codebook(np.array(values, np.float32), 256)
    np.testing.assert_array_equal(book[indices], np.array(values, np.float32))
    assert len(book) == 256 and np.isfinite(book).all()


def test_a_vector_codebook_finds_clusters():
    generator = np.random.default_rng(1)
    centers = generator.normal(size=(40, 24)).astype(np.float32)
    member = generator.integers(0, 40, 6000)
    vectors = centers[member] + 0.01 * generator.normal(size=(6000, 24)).astype(np.float32)
    book, indices = vector_codebook(vectors, 1000)
    assert len(book) <= 1000 and indices.max() < len(book)
    assert np.abs(book[indices] - vectors).max() < 0.1
    again, _ = vector_codebook(vectors, 1000)
    np.testing.assert_array_equal(book, again)


def test_more_groups_than_entries():
    vectors = np.random.default_rng(2).normal(size=(300, 9)).astype(np.float32)
    book, indices = vector_codebook(vectors, 7)
    assert len(book) <= 7 and indices.max() < len(book)
    error = ((book[indices] - vectors) ** 2).sum()
    assert error < ((vectors - vectors.mean(axis=0)) ** 2).sum(), "better than one entry for all"


def test_a_sog_with_more_harmonics_than_its_palette_holds(tmp_path, monkeypatch):
    pytest.importorskip("gaussforge")
    monkeypatch.setattr(sog_writer, "PALETTE", 128)
    gaussians = random_gaussians(700, seed=3, degree=2)
    gaussians.sh[:, 1:] = gaussians.sh[:20, 1:].repeat(35, 1, 1)
    rows = gaussians.rows()
    assert write_splat(tmp_path / "splat.sog", rows, "sog") == []
    read = read_splat(tmp_path / "splat.sog").rows
    nearest = ((read.means[None] - rows.means[:, None]) ** 2).sum(axis=2).argmin(axis=1)
    error = np.abs(read.sh[nearest, 1:] - rows.sh[:, 1:])
    assert error.max() < 0.05, "twenty different harmonics fit into a palette of 128"
