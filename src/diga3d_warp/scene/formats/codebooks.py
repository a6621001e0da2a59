"""Codebooks: few values that stand for many, found by k-means. All sums have a fixed order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class CodebookSettings:
    """How long k-means runs.

    Attributes:
        rounds: Rounds of Lloyd's algorithm. More change the error by less than a percent.
        bins: Of the histogram from which a codebook of numbers starts.
        even: Part of such a codebook that is spread evenly, so that rare values are not far from an entry.
        groups: Vectors are split into so many groups first, and each group gets its part of the codebook:
            comparing a million vectors with 65536 entries each would take hours.
        sample: Vectors from which the groups are found.
        block: Vectors that are compared with a codebook at once; 64 MB with 256 entries.
        seed: Of the choice of first entries.
    """

    rounds: int = 8
    bins: int = 4096
    even: float = 0.4
    groups: int = 256
    sample: int = 100_000
    block: int = 1 << 16
    seed: int = 0


CODEBOOKS = CodebookSettings()


def scalar_codebook(values: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The best `size` numbers for many, ascending, and the index of the nearest for each.

    Args:
        values: Finite, any shape.
        size: Number of entries, at most 256.

    Returns:
        The entries, float32, and indices of the shape of `values`, uint8.
    """
    ordered = np.sort(values, axis=None).astype(np.float64)
    sums = np.r_[0.0, np.cumsum(ordered)]
    # The best density of entries goes with the cube root of that of the values (Panter and Dite 1951).
    counts, edges = np.histogram(ordered, CODEBOOKS.bins)
    density = np.cbrt(counts)
    density = (1 - CODEBOOKS.even) * density + CODEBOOKS.even * density.mean()
    wanted = np.r_[0.0, np.cumsum(density)]
    entries = np.interp((np.arange(size) + 0.5) / size * wanted[-1], wanted, edges)
    for _ in range(CODEBOOKS.rounds):
        ends = np.r_[0, np.searchsorted(ordered, 0.5 * (entries[1:] + entries[:-1])), len(ordered)]
        counts = np.diff(ends)
        entries = np.where(counts > 0, np.diff(sums[ends]) / np.maximum(counts, 1), entries)
        entries.sort()
    book = entries.astype(np.float32)
    return book, np.searchsorted(0.5 * (book[1:] + book[:-1]), values).astype(np.uint8)


def vector_codebook(vectors: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """At most `size` vectors for many, and the index of the one that stands for each.

    Args:
        vectors: Shape (N, D), float32.
        size: Largest number of entries.

    Returns:
        The entries, shape (M, D), and indices, shape (N,).
    """
    if len(vectors) <= size:
        return vectors, np.arange(len(vectors))
    generator = np.random.default_rng(CODEBOOKS.seed)
    chosen = generator.permutation(len(vectors))[: CODEBOOKS.sample]
    groups = _nearest(vectors, _lloyd(vectors[np.sort(chosen)], min(CODEBOOKS.groups, size), generator))
    entries, indices, used = [], np.empty(len(vectors), np.int64), 0
    for group in range(groups.max() + 1):
        rows = np.flatnonzero(groups == group)
        part = max(1, len(rows) * size // len(vectors))
        if len(rows) and used < size:
            entries.append(_lloyd(vectors[rows], min(part, len(rows), size - used), generator))
            indices[rows] = used + _nearest(vectors[rows], entries[-1])
            used += len(entries[-1])
        else:
            indices[rows] = 0
    return np.concatenate(entries), indices


def _lloyd(vectors: np.ndarray, size: int, generator: np.random.Generator) -> np.ndarray:
    """Entries that k-means finds, shape (size, D)."""
    entries = vectors[np.sort(generator.permutation(len(vectors))[:size])]
    for _ in range(CODEBOOKS.rounds if size < len(vectors) else 0):
        nearest = _nearest(vectors, entries)
        order = np.argsort(nearest, kind="stable")
        present, first, counts = np.unique(nearest[order], return_index=True, return_counts=True)
        entries[present] = np.add.reduceat(vectors[order], first, axis=0) / counts[:, None]
    return entries


def _nearest(vectors: np.ndarray, entries: np.ndarray) -> np.ndarray:
    """Index of the nearest entry for each vector, shape (N,)."""
    norms = (entries**2).sum(axis=1)
    blocks = range(0, len(vectors), CODEBOOKS.block)
    return np.concatenate(
        [(norms - 2.0 * vectors[k : k + CODEBOOKS.block] @ entries.T).argmin(axis=1) for k in blocks]
    )
