"""Structural similarity of two images (Wang et al. 2004) and its adjoint, with the window of 3DGS.

    S = (2 m_x m_y + C1) (2 s_xy + C2) / ((m_x^2 + m_y^2 + C1) (s_xx + s_yy + C2))

The five moments m_x, m_y, E[xx], E[yy], E[xy] are weighted by a gaussian window around each pixel, channel by
channel. A thread owns a run of one image row. It blurs the run down the columns into local arrays, halo
included, then along the row out of them; no blurred image is ever written.

Invariants
- Images are flat: a pixel's channel is `3 (y W + x) + c`, so a neighbour in the row is 3 floats away, and
  every inner loop runs over contiguous floats.
- Loops over lanes are `while`: a `range` whose length is a variable is not vectorised. Loops over taps inside
  them are unrolled.
- Memory is reached through `read` and `write`, which know that images are contiguous and cells not negative.
- Outside the image everything is zero, as with the zero padding of 3DGS's `conv2d`.
- A thread writes its own run alone, so results do not depend on the number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import warp as wp

from diga3d_warp.kernels.cells import cells_of
from diga3d_warp.kernels.launch import OPTIONS, launch

read, write, *_ = cells_of(wp.float32)

TAPS_UNROLLED = {**OPTIONS, "max_unroll": 11}
"""Module options that unroll loops over the window."""


@dataclass(frozen=True)
class Similarity:
    """The constants of 3DGS's loss, for images in [0, 1].

    Attributes:
        sigma: Standard deviation of the window [px]. Wang et al. 2004 and 3DGS: 1.5.
        reach: Pixels of the window on each side of its centre. 5 makes 3DGS's window of 11.
        luminance_floor: C1, keeps the means' ratio stable where both are dark. Wang et al. 2004: 0.01^2.
        contrast_floor: C2, keeps the variances' ratio stable where both are flat. Wang et al. 2004: 0.03^2.
    """

    sigma: float = 1.5
    reach: int = 5
    luminance_floor: float = 0.01**2
    contrast_floor: float = 0.03**2

    @property
    def window(self) -> tuple[float, ...]:
        """Weights of the window along one axis, their sum one."""
        steps = np.arange(-self.reach, self.reach + 1)
        weights = np.exp(-0.5 * (steps / self.sigma) ** 2)
        return tuple((weights / weights.sum()).tolist())


SIMILARITY = Similarity()

CPU_RUN = 384
"""Floats of a row that one index handles. The five local arrays (8 kB) stay in the first cache, and the halo
adds 8 %."""

CUDA_RUN = 16
"""Shorter on CUDA, where an image must fill tens of thousands of threads."""

_REACH = SIMILARITY.reach
_TAPS = 2 * _REACH + 1
_HALO = 3 * _REACH
_WINDOW = wp.constant(wp.types.vector(_TAPS, float)(*SIMILARITY.window))
_C1 = SIMILARITY.luminance_floor
_C2 = SIMILARITY.contrast_floor


def run_of(device: wp.Device) -> int:
    return CPU_RUN if device.is_cpu else CUDA_RUN


@wp.func
def tap_row(y: int, tap: int, height: int) -> int:
    """Row under a tap of the window, held inside the image where `tap_weight` is zero."""
    return wp.clamp(y + tap - wp.static(_REACH), 0, height - 1)


@wp.func
def tap_weight(y: int, tap: int, height: int) -> float:
    row = y + tap - wp.static(_REACH)
    return wp.where(row >= 0 and row < height, _WINDOW[tap], 0.0)


@cache
def similarity_kernel(run: int) -> wp.Kernel:
    """Similarity of runs of `run` floats, with its derivatives by m_x, E[xx] and E[xy]."""
    length = run + 2 * _HALO

    @wp.kernel(module="unique", module_options=TAPS_UNROLLED)
    def similarity(
        offset: int,
        image: wp.array(dtype=float),
        target: wp.array(dtype=float),
        row_length: int,
        height: int,
        # outputs
        similarities: wp.array(dtype=float),
        by_mean: wp.array(dtype=float),
        by_square: wp.array(dtype=float),
        by_product: wp.array(dtype=float),
    ):
        index = wp.tid() + offset
        runs = (row_length + wp.static(run - 1)) // wp.static(run)
        y = index // runs
        start = (index % runs) * wp.static(run)
        first = start - wp.static(_HALO)

        mean_x = wp.zeros(shape=wp.static(length), dtype=float)
        mean_y = wp.zeros(shape=wp.static(length), dtype=float)
        mean_xx = wp.zeros(shape=wp.static(length), dtype=float)
        mean_yy = wp.zeros(shape=wp.static(length), dtype=float)
        mean_xy = wp.zeros(shape=wp.static(length), dtype=float)
        q = wp.max(-first, 0)
        end = wp.min(row_length - first, wp.static(length))
        while q < end:
            s_x = float(0.0)
            s_y = float(0.0)
            s_xx = float(0.0)
            s_yy = float(0.0)
            s_xy = float(0.0)
            for tap in range(wp.static(_TAPS)):
                cell = tap_row(y, tap, height) * row_length + first + q
                weight = tap_weight(y, tap, height)
                value_x = read(image, cell)
                value_y = read(target, cell)
                s_x += weight * value_x
                s_y += weight * value_y
                s_xx += weight * value_x * value_x
                s_yy += weight * value_y * value_y
                s_xy += weight * value_x * value_y
            mean_x[q] = s_x
            mean_y[q] = s_y
            mean_xx[q] = s_xx
            mean_yy[q] = s_yy
            mean_xy[q] = s_xy
            q += 1

        lane = int(0)
        lanes = wp.min(row_length - start, wp.static(run))
        while lane < lanes:
            m_x = float(0.0)
            m_y = float(0.0)
            m_xx = float(0.0)
            m_yy = float(0.0)
            m_xy = float(0.0)
            for step in range(wp.static(_TAPS)):
                m_x += _WINDOW[step] * mean_x[lane + 3 * step]
                m_y += _WINDOW[step] * mean_y[lane + 3 * step]
                m_xx += _WINDOW[step] * mean_xx[lane + 3 * step]
                m_yy += _WINDOW[step] * mean_yy[lane + 3 * step]
                m_xy += _WINDOW[step] * mean_xy[lane + 3 * step]
            upper_mean = 2.0 * m_x * m_y + wp.static(_C1)
            upper_spread = 2.0 * (m_xy - m_x * m_y) + wp.static(_C2)
            lower_mean = 1.0 / (m_x * m_x + m_y * m_y + wp.static(_C1))
            lower_spread = 1.0 / (m_xx - m_x * m_x + m_yy - m_y * m_y + wp.static(_C2))
            lower = lower_mean * lower_spread
            s = upper_mean * upper_spread * lower
            by_m = 2.0 * (m_y * (upper_spread - upper_mean) * lower + s * m_x * (lower_spread - lower_mean))
            here = y * row_length + start + lane
            write(similarities, here, s)
            write(by_mean, here, by_m)
            write(by_square, here, -s * lower_spread)
            write(by_product, here, 2.0 * upper_mean * lower)
            lane += 1

    return similarity


@cache
def adjoint_kernel(run: int) -> wp.Kernel:
    """Gradient of the image: the window is symmetric, so derivatives are blurred like the moments were."""
    length = run + 2 * _HALO

    @wp.kernel(module="unique", module_options=TAPS_UNROLLED)
    def similarity_adjoint(
        offset: int,
        image: wp.array(dtype=float),
        target: wp.array(dtype=float),
        row_length: int,
        height: int,
        by_mean: wp.array(dtype=float),
        by_square: wp.array(dtype=float),
        by_product: wp.array(dtype=float),
        adj_similarities: wp.array(dtype=float),
        # outputs
        adj_image: wp.array(dtype=float),
    ):
        index = wp.tid() + offset
        runs = (row_length + wp.static(run - 1)) // wp.static(run)
        y = index // runs
        start = (index % runs) * wp.static(run)
        first = start - wp.static(_HALO)

        mean = wp.zeros(shape=wp.static(length), dtype=float)
        square = wp.zeros(shape=wp.static(length), dtype=float)
        product = wp.zeros(shape=wp.static(length), dtype=float)
        q = wp.max(-first, 0)
        end = wp.min(row_length - first, wp.static(length))
        while q < end:
            s_m = float(0.0)
            s_s = float(0.0)
            s_p = float(0.0)
            for tap in range(wp.static(_TAPS)):
                cell = tap_row(y, tap, height) * row_length + first + q
                weight = tap_weight(y, tap, height) * read(adj_similarities, cell)
                s_m += weight * read(by_mean, cell)
                s_s += weight * read(by_square, cell)
                s_p += weight * read(by_product, cell)
            mean[q] = s_m
            square[q] = s_s
            product[q] = s_p
            q += 1

        lane = int(0)
        lanes = wp.min(row_length - start, wp.static(run))
        while lane < lanes:
            m_m = float(0.0)
            m_s = float(0.0)
            m_p = float(0.0)
            for step in range(wp.static(_TAPS)):
                m_m += _WINDOW[step] * mean[lane + 3 * step]
                m_s += _WINDOW[step] * square[lane + 3 * step]
                m_p += _WINDOW[step] * product[lane + 3 * step]
            here = y * row_length + start + lane
            gradient = m_m + 2.0 * read(image, here) * m_s + read(target, here) * m_p
            write(adj_image, here, read(adj_image, here) + gradient)
            lane += 1

    return similarity_adjoint


def similarity(images: list[wp.array], width: int, height: int, outputs: list[wp.array]) -> None:
    """Compare two images channel by channel.

    All arrays have shape (H * W * 3,), float32, and are contiguous.

    Args:
        images: Image and target, RGB in [0, 1].
        width, height: Image size [px].
        outputs: Similarity, and its derivatives by m_x, E[xx] and E[xy] for `similarity_adjoint`.
    """
    device = images[0].device
    run = run_of(device)
    launch(
        similarity_kernel(run), height * -(-3 * width // run), [*images, 3 * width, height], outputs,
        device=device, work=2 * run,
    )  # fmt: skip


def similarity_adjoint(
    images: list[wp.array], width: int, height: int, derivatives: list[wp.array], adj_similarities: wp.array,
    adj_image: wp.array,
) -> None:  # fmt: skip
    """Add the gradient of the image.

    Args:
        images, width, height: As in `similarity`.
        derivatives: The last three of its outputs.
        adj_similarities: Gradient of its first.
        adj_image: Output, added to.
    """
    device = adj_image.device
    run = run_of(device)
    launch(
        adjoint_kernel(run), height * -(-3 * width // run),
        [*images, 3 * width, height, *derivatives, adj_similarities], [adj_image],
        device=device, work=2 * run,
    )  # fmt: skip
