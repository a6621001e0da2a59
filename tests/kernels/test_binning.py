"""Tile lists against a search over every tile, gaussian and pixel."""

from itertools import pairwise

import numpy as np
import pytest
import warp as wp

from diga3d_warp.config import TILE
from diga3d_warp.kernels.binning import Bins, bin_gaussians
from diga3d_warp.kernels.keyed_pairs import list_by_keys
from diga3d_warp.kernels.pair_scatter import list_by_scatter
from diga3d_warp.kernels.tiles import Lists

COUNT = 120


def boxes(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centers, depths and extents; many on pixel edges and centres, some of equal depth, some culled."""
    random = np.random.default_rng(seed)
    centers = random.uniform(-20, 70, (COUNT, 2)).astype(np.float32)
    extents = random.exponential(8, (COUNT, 2)).astype(np.float32)
    centers[::3] = np.round(centers[::3] * 2) / 2
    extents[::3] = np.round(extents[::3] * 2) / 2
    extents[5] = 1e30
    extents[7] = (40.0, 0.25)
    extents[::10] = 0.0
    depths = random.integers(1, 30, COUNT).astype(np.float32)
    return centers, depths, extents


def binned(centers, depths, extents, width: int, height: int, device: str = "cpu") -> Bins:
    return bin_gaussians(
        wp.array(centers, dtype=wp.vec2, device=device),
        wp.array(depths, dtype=float, device=device),
        wp.array(extents, dtype=wp.vec2, device=device),
        width,
        height,
    )


def holds_a_pixel(centers, extents) -> np.ndarray:
    """Whether a box holds the centre of any pixel, in the image or out of it, shape (N,)."""
    half = np.float32(0.5)
    return (np.ceil(centers - extents - half) <= np.floor(centers + extents - half)).all(1)


def searched(centers, depths, extents, width: int, height: int) -> list[list[int]]:
    """Gaussians of each tile by depth, then index, whose box holds the centre of one of its pixels.

    The last column and row of tiles reach beyond the image; what only touches them there is not listed.
    """
    half = np.float32(0.5)
    low, high = centers - extents - half, centers + extents - half
    in_image = (centers - extents <= [width, height]).all(1)
    lists = []
    for row in range(-(-height // TILE)):
        for column in range(-(-width // TILE)):
            x = np.arange(column * TILE, (column + 1) * TILE)
            y = np.arange(row * TILE, (row + 1) * TILE)
            in_x = ((x >= low[:, :1]) & (x <= high[:, :1])).any(1)
            in_y = ((y >= low[:, 1:]) & (y <= high[:, 1:])).any(1)
            listed = np.flatnonzero(in_image & in_x & in_y & (extents[:, 0] > 0))
            lists.append(sorted(listed, key=lambda i: (depths[i], i)))
    return lists


@pytest.mark.parametrize("width,height", [(64, 48), (37, 29), (1, 1)])
def test_every_tile_lists_its_gaussians_by_depth_then_index(width, height, device):
    scene = boxes()
    bins = binned(*scene, width, height, device)
    starts, gaussians = bins.starts.numpy(), bins.gaussians.numpy()
    holds = holds_a_pixel(scene[0], scene[2])  # a box between pixels may be listed: it blends nothing
    lists = [gaussians[a:b] for a, b in pairwise(starts)]
    found = [part[holds[part]].tolist() for part in lists]
    assert 3 <= (~holds).sum() < COUNT // 4
    assert found == searched(*scene, width, height)
    assert bins.pair_count == starts[-1] > 0


def test_emissions_number_the_pairs_gaussian_after_gaussian(device):
    bins = binned(*boxes(), 64, 48, device)
    first, emissions = bins.first.numpy(), bins.emissions.numpy()
    assert sorted(emissions) == list(range(bins.pair_count))
    emitter = np.repeat(np.arange(COUNT), np.diff(first))
    assert np.array_equal(emitter[emissions], bins.gaussians.numpy())
    assert first[0] == 0 and first[-1] == bins.pair_count


@pytest.mark.parametrize("seed", [0, 1])
def test_sorting_keys_gives_the_same_lists_as_the_scatter(seed):
    """The form for CUDA, on this machine's CPU."""
    centers, depths, extents = boxes(seed)
    arrays = [
        wp.array(centers, dtype=wp.vec2, device="cpu"),
        wp.array(extents, dtype=wp.vec2, device="cpu"),
        wp.array(depths, dtype=float, device="cpu").view(wp.int32),
    ]
    scattered, sorted_ = list_by_scatter(*arrays, 64, 48), list_by_keys(*arrays, 64, 48)
    assert scattered.gaussians.shape[0] > COUNT
    for name, one, other in zip(Lists._fields, scattered, sorted_, strict=True):
        assert np.array_equal(one.numpy(), other.numpy()), name


def test_lists_do_not_depend_on_the_number_of_threads(threads):
    random = np.random.default_rng(1)
    count = 3000
    scene = (
        random.uniform(0, 600, (count, 2)).astype(np.float32),
        random.integers(1, 50, count).astype(np.float32),
        random.exponential(10, (count, 2)).astype(np.float32),
    )
    results = []
    for number in (1, 2, 3):
        threads(number)
        bins = binned(*scene, 600, 600)
        results.append([a.numpy() for a in (bins.gaussians, bins.starts, bins.first, bins.emissions)])
    for other in results[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_float64_lists_the_same_and_orders_by_all_its_digits():
    centers, depths, extents = boxes()
    fine = depths.astype(np.float64) - 1e-12 * np.arange(COUNT)
    kinds = (wp.vec2d, wp.float64, wp.vec2d)
    arrays = [
        wp.array(part.astype(np.float64), dtype=kind, device="cpu")
        for part, kind in zip((centers, fine, extents), kinds, strict=True)
    ]
    bins = bin_gaussians(*arrays, 64, 48)
    starts, gaussians = bins.starts.numpy(), bins.gaussians.numpy()
    wanted = searched(centers, fine, extents, 64, 48)
    for (a, b), inside in zip(pairwise(starts), wanted, strict=True):
        listed = gaussians[a:b].tolist()
        assert set(inside) <= set(listed) and len(listed) <= len(inside) + COUNT // 4
        assert [i for i in listed if i in set(inside)] == inside


@pytest.mark.parametrize("count", [0, 1, COUNT])
def test_an_empty_view_has_empty_lists(count, device):
    centers, depths, extents = (part[:count] for part in boxes())
    bins = binned(centers - 1e4, depths, extents * (extents < 1e3), 64, 48, device)
    assert bins.pair_count == 0 and bins.first.numpy().tolist() == [0] * (count + 1)
    assert not bins.starts.numpy().any()
    assert len(bins.starts.numpy()) == 4 * 3 + 1


def test_more_pairs_than_32_bits_number_are_an_error():
    count = 200
    scene = (np.zeros((count, 2)), np.ones(count), np.full((count, 2), 1e9))
    with pytest.raises(ValueError, match=r"more than 2\^31 - 1"):
        binned(*scene, 65536, 65536)
