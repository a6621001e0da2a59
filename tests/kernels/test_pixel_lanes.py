"""What compositing kernels share: which pixels a thread takes, and which of them a gaussian reaches."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from diga3d_warp.config import TILE, Accuracy, Effects
from diga3d_warp.kernels.blending import Blending
from diga3d_warp.kernels.lanes import total_function
from diga3d_warp.kernels.launch import OPTIONS
from diga3d_warp.kernels.pixel_lanes import (
    CPU_LANES,
    CUDA_LANES,
    PixelLanes,
    lanes_for,
    lowest_bit,
    reached_function,
)
from diga3d_warp.kernels.precision import types_of

COUNT = 4000
LEVEL = 2.0 * np.log(0.9 * 255)
"""Squared standard deviations at which a gaussian of opacity 0.9 falls to 1/255."""


def test_a_fixed_order_on_cuda_takes_one_thread_a_tile():
    cuda = SimpleNamespace(is_cpu=False)
    fixed = Blending.of(Accuracy.STANDARD, Effects(deterministic=True))
    free = Blending.of(Accuracy.STANDARD, Effects())
    assert lanes_for(cuda, fixed).region == TILE and lanes_for(cuda, free).region == 1
    assert fixed == free, "the same kernels on CPU"


Ellipses = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Centres (N, 2), extents (N, 2) and factors (N, 3)."""


def ellipses(axes: np.ndarray, centers: np.ndarray, angle: np.ndarray) -> Ellipses:
    """Ellipses of standard deviations `axes` [px], turned by an angle."""
    turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], -1).reshape(-1, 2, 2)
    covariance = turn @ (axes[:, :, None] ** 2 * np.eye(2)) @ turn.transpose(0, 2, 1)
    factor = np.linalg.cholesky(np.linalg.inv(covariance))
    factors = np.stack([factor[:, 0, 0], factor[:, 1, 0], factor[:, 1, 1]], -1)
    return centers, np.sqrt(LEVEL * covariance[:, [0, 1], [0, 1]]), factors


def all_sizes() -> Ellipses:
    """From specks to gaussians 3000 px wide, needles among them, in or beside the first tile."""
    random = np.random.default_rng(5)
    axes = np.exp(random.uniform(np.log(0.3), np.log(1000.0), (COUNT, 2)))
    _, extents, factors = ellipses(axes, np.zeros((COUNT, 2)), random.uniform(0.0, np.pi, COUNT))
    return 8.0 + random.uniform(-1.0, 1.0, (COUNT, 2)) * (extents + 12.0), extents, factors


def far_needles() -> Ellipses:
    """Needles through the first tile whose centres lie thousands of pixels away."""
    random = np.random.default_rng(6)
    angle = random.uniform(0.0, np.pi, COUNT)
    along = np.stack([np.cos(angle), np.sin(angle)], -1)
    centers = random.uniform(0.0, 16.0, (COUNT, 2)) + random.uniform(2e3, 8e3, (COUNT, 1)) * along
    return ellipses(np.tile([3000.0, 0.3], (COUNT, 1)), centers, angle)


def reached(blending: Blending, lanes: PixelLanes, x: int, y: int, *fields: np.ndarray) -> np.ndarray:
    """Which blocks each gaussian reaches, shape (N, blocks)."""
    vec2, vec3, *_ = types_of(blending.real)
    find = reached_function(blending, lanes)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def find_each(
        x: int,
        y: int,
        centers: wp.array(dtype=vec2),
        extents: wp.array(dtype=vec2),
        factors: wp.array(dtype=vec3),
        # outputs
        bits: wp.array(dtype=int),
    ):
        i = wp.tid()
        bits[i] = find(i, centers, extents, factors, x, y)

    arrays = [
        wp.array(field, dtype=dtype, device="cpu")
        for field, dtype in zip(fields, (vec2, vec2, vec3), strict=True)
    ]
    bits = wp.zeros(COUNT, dtype=int, device="cpu")
    wp.launch(find_each, COUNT, [x, y, *arrays], [bits], device="cpu")
    return (bits.numpy()[:, None] >> np.arange(lanes.blocks)) & 1 == 1


def pixels(lanes: PixelLanes, x: int, y: int) -> np.ndarray:
    """Centres of the pixels of each block, shape (blocks, pixels of a block, 2)."""
    block, lane = np.arange(lanes.blocks)[:, None], np.arange(lanes.size)[None]
    column = x + block % lanes.across * lanes.block_width + lane % lanes.block_width
    row = y + block // lanes.across * lanes.block_height + lane // lanes.block_width
    return np.stack([column, row], -1) + 0.5


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("lanes", [CPU_LANES, CUDA_LANES], ids=["tile", "pixel"])
@pytest.mark.parametrize("scene", [all_sizes, far_needles])
@pytest.mark.parametrize("x,y", [(0, 0), (4096, 8192)])
def test_every_block_with_a_pixel_of_the_ellipse_is_reached(scene, lanes, precision, x, y):
    centers, extents, factors = scene()
    centers = centers + [x, y]
    if precision == "float32":
        centers, extents, factors = (part.astype(np.float32) for part in (centers, extents, factors))
    found = reached(Blending(precision=precision), lanes, x, y, centers, extents, factors)
    d = centers.astype(float)[:, None, None] - pixels(lanes, x, y)
    u = factors[:, 0, None, None] * d[..., 0] + factors[:, 1, None, None] * d[..., 1]
    v = factors[:, 2, None, None] * d[..., 1]
    hits = (u**2 + v**2 <= (1.0 - 1e-6) * LEVEL).any(-1)
    assert hits.mean() > 0.05 and (~hits).mean() > 0.1
    assert not (hits & ~found).any()
    assert found.sum() < 1.1 * hits.sum(), "few blocks are visited in vain"


def test_a_gaussian_that_ends_at_its_box_reaches_by_its_box():
    centers, extents, factors = (part.astype(np.float32) for part in all_sizes())
    extents *= 0.5
    found = reached(Blending(boxed=True), CPU_LANES, 0, 0, centers, extents, factors)
    offsets = np.abs(centers[:, None, None] - pixels(CPU_LANES, 0, 0))
    hits = (offsets <= extents[:, None, None]).all(-1).any(-1)
    assert 0.1 < hits.mean() < 0.9
    assert not (hits & ~found).any()


@pytest.mark.parametrize("real,dtype", [(wp.float32, np.float32), (wp.float64, np.float64)])
@pytest.mark.parametrize("size", [1, 16])
def test_total_adds_all_lanes(size, real, dtype):
    vec = wp.types.vector(size, real)
    total = total_function(size, real)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def add(values: wp.array(dtype=vec), sums: wp.array(dtype=real)):
        i = wp.tid()
        sums[i] = total(values[i])

    values = np.random.default_rng(0).integers(-1000, 1000, (50, size)).astype(dtype)
    sums = wp.zeros(50, dtype=real, device="cpu")
    wp.launch(add, 50, [wp.array(values, dtype=vec, device="cpu")], [sums], device="cpu")
    assert np.array_equal(sums.numpy(), values.sum(1)), "whole numbers add up exactly in any order"


def test_lowest_bit():
    @wp.kernel(module="unique", module_options=OPTIONS)
    def find(bits: wp.array(dtype=int), found: wp.array(dtype=int)):
        i = wp.tid()
        found[i] = lowest_bit(bits[i])

    bits = np.array([1, 2, 6, 0x8000, 0xF0], np.int32)
    found = wp.zeros(len(bits), dtype=int, device="cpu")
    wp.launch(find, len(bits), [wp.array(bits, dtype=int, device="cpu")], [found], device="cpu")
    assert found.numpy().tolist() == [0, 1, 1, 15, 4]
