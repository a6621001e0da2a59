"""Attribution: the gaussians with the largest weights in a pixel, and the share of each gaussian in an image.

Blocks, lanes and rounds are those of `compositing` and `ordering`; colours are not needed. Nothing here has a
gradient.

Invariants
- Weights are those of compositing: the same rules in the same order.
- Pixels of a tile beyond the image's border do not count: like finished ones they have a negative
  transmittance.
- Among equal weights the gaussian in front counts as stronger.
- A pair belongs to one tile, which one thread of a CPU owns; rows of one gaussian are added in the order of
  its emissions.
"""

from functools import cache
from typing import Any, NamedTuple

import warp as wp

from diga3d_warp.kernels.binning import Bins
from diga3d_warp.kernels.blending import Blending, rules
from diga3d_warp.kernels.lanes import total_function
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.ordering import WINDOW, nearest_function
from diga3d_warp.kernels.pixel_lanes import (
    PixelLanes,
    lanes_for,
    lowest_bit,
    reached_function,
    region_function,
)
from diga3d_warp.kernels.precision import types_of
from diga3d_warp.kernels.splats import Splats


def share_row(blending: Blending) -> Any:
    """What one (tile, gaussian) pair takes: weight, weight times three values, number of pixels."""
    return wp.types.vector(length=5, dtype=blending.real)


@cache
def attribution_kernel(blending: Blending, lanes: PixelLanes, strongest: int, shares: bool) -> wp.Kernel:
    """Find the `strongest` gaussians of each pixel, and with `shares` the share of each pair in the image."""
    width, height, across = lanes.block_width, lanes.block_height, lanes.across
    blocks, size = lanes.blocks, lanes.size
    real = blending.real
    vec2, vec3, *_ = types_of(real)
    vec = wp.types.vector(size, real)
    ints = wp.types.vector(size, int)
    row_of = share_row(blending)
    unit, response, clipped, survives, _ = rules(blending)
    region_of, reached = region_function(lanes.region), reached_function(blending, lanes)
    total = total_function(size, real)
    value_planes = 3 * blocks if shares else 1
    kept_planes = max(1, strongest * blocks)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def attribute(
        offset: int,
        columns: int,
        image_width: int,
        image_height: int,
        starts: wp.array(dtype=int),
        gaussians: wp.array(dtype=int),
        emissions: wp.array(dtype=int),
        centers: wp.array(dtype=vec2),
        extents: wp.array(dtype=vec2),
        factors: wp.array(dtype=vec3),
        opacities: wp.array(dtype=real),
        depths: wp.array(dtype=real),
        slopes: wp.array(dtype=vec2),
        values: wp.array(dtype=vec3),
        # outputs
        ids: wp.array2d(dtype=int),
        weights: wp.array2d(dtype=real),
        rows: wp.array(dtype=row_of),
    ):
        tile, x0, y0 = region_of(wp.tid() + offset, columns)

        T = wp.zeros(shape=wp.static(blocks), dtype=vec)
        v = wp.zeros(shape=wp.static(value_planes), dtype=vec)
        top_ids = wp.zeros(shape=wp.static(kept_planes), dtype=ints)
        top = wp.zeros(shape=wp.static(kept_planes), dtype=vec)
        live = int(0)
        for block in range(wp.static(blocks)):
            T_b = vec(real(-1.0))
            inside = int(0)
            for q in range(size):
                x = x0 + (block % across) * width + q % width
                y = y0 + (block // across) * height + q // width
                if x < image_width and y < image_height:
                    T_b[q] = real(1.0)
                    inside = 1
                    if wp.static(shares):
                        value = values[y * image_width + x]
                        for k in range(3):
                            v[k * blocks + block][q] = value[k]
            T[block] = T_b
            live = live | (inside << block)
            for s in range(strongest):
                top_ids[s * blocks + block] = ints(-1)

        for j in range(starts[tile], starts[tile + 1]):
            if live == 0:
                break
            i = gaussians[j]
            center = centers[i]
            extent = extents[i]
            factor = real(wp.static(unit)) * factors[i]
            opacity = opacities[i]
            gx = center[0] - real(x0) - real(0.5)
            gy = center[1] - real(y0) - real(0.5)
            taken = vec(real(0.0))
            taken_red = vec(real(0.0))
            taken_green = vec(real(0.0))
            taken_blue = vec(real(0.0))
            hits = vec(real(0.0))
            remaining = live & reached(i, centers, extents, factors, x0, y0)
            while remaining != 0:
                block = lowest_bit(remaining)
                remaining = remaining & (remaining - 1)
                bgx = gx - real((block % across) * width)
                bgy = gy - real((block // across) * height)
                T_b = T[block]
                left = vec(real(0.0))
                weight = vec(real(0.0))
                any_live = int(0)
                for q in range(size):
                    dx = bgx - real(q % width)
                    dy = bgy - real(q // width)
                    w = clipped(response(opacity, factor, dx, dy, extent)) * T_b[q]
                    alive = survives(T_b[q] - w, 1)
                    left[q] = wp.where(alive > 0, T_b[q] - w, -wp.abs(T_b[q]))
                    weight[q] = wp.where(alive > 0, w, real(0.0))
                    any_live = any_live | alive
                T[block] = left
                if wp.static(shares):
                    taken = taken + weight
                    taken_red = taken_red + wp.cw_mul(weight, v[block])
                    taken_green = taken_green + wp.cw_mul(weight, v[wp.static(blocks) + block])
                    taken_blue = taken_blue + wp.cw_mul(weight, v[wp.static(2 * blocks) + block])
                    for q in range(size):
                        hits[q] = hits[q] + wp.where(weight[q] > real(0.0), real(1.0), real(0.0))
                if wp.static(strongest > 0):
                    moved = weight
                    moved_ids = ints(i)
                    for s in range(strongest):
                        plane = wp.static(s * blocks) + block
                        kept = top[plane]
                        kept_ids = top_ids[plane]
                        for q in range(size):
                            old = kept[q]
                            old_id = kept_ids[q]
                            new = moved[q]
                            new_id = moved_ids[q]
                            kept[q] = wp.where(new > old, new, old)
                            kept_ids[q] = wp.where(new > old, new_id, old_id)
                            moved[q] = wp.where(new > old, old, new)
                            moved_ids[q] = wp.where(new > old, old_id, new_id)
                        top[plane] = kept
                        top_ids[plane] = kept_ids
                if any_live == 0:
                    live = live & ~(1 << block)
            if wp.static(shares):
                row = row_of(
                    total(taken), total(taken_red), total(taken_green), total(taken_blue), total(hits)
                )  # fmt: skip
                wp.atomic_add(rows, emissions[j], row)

        for block in range(wp.static(blocks)):
            for q in range(size):
                x = x0 + (block % across) * width + q % width
                y = y0 + (block // across) * height + q // width
                if x < image_width and y < image_height:
                    for s in range(strongest):
                        ids[y * image_width + x, s] = top_ids[s * blocks + block][q]
                        weights[y * image_width + x, s] = top[s * blocks + block][q]

    return attribute


@cache
def ordered_attribution_kernel(blending: Blending, region: int, strongest: int, shares: bool) -> wp.Kernel:
    """The same with each pixel in its own order; one index for each square of `region` px."""
    real = blending.real
    vec2, vec3, *_ = types_of(real)
    row_of = share_row(blending)
    _, _, clipped, survives, _ = rules(blending)
    nearest = nearest_function(blending)
    region_of = region_function(region)
    tops = wp.types.vector(length=max(1, strongest), dtype=real)
    top_indices = wp.types.vector(length=max(1, strongest), dtype=int)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def attribute_ordered(
        offset: int,
        columns: int,
        width: int,
        height: int,
        starts: wp.array(dtype=int),
        gaussians: wp.array(dtype=int),
        emissions: wp.array(dtype=int),
        centers: wp.array(dtype=vec2),
        extents: wp.array(dtype=vec2),
        factors: wp.array(dtype=vec3),
        opacities: wp.array(dtype=real),
        depths: wp.array(dtype=real),
        slopes: wp.array(dtype=vec2),
        values: wp.array(dtype=vec3),
        # outputs
        ids: wp.array2d(dtype=int),
        weights: wp.array2d(dtype=real),
        rows: wp.array(dtype=row_of),
    ):
        tile, x0, y0 = region_of(wp.tid() + offset, columns)
        for q in range(wp.static(region * region)):
            x = x0 + q % region
            y = y0 + q // region
            if x < width and y < height:
                index = y * width + x
                through = real(1.0)
                top = tops(real(0.0))
                top_ids = top_indices(-1)
                last_depth = -real(wp.inf)
                last_pair = int(-1)
                live = int(1)
                pixel = vec2(real(x) + real(0.5), real(y) + real(0.5))
                while live != 0:
                    js, zs, raws = nearest(
                        starts[tile], starts[tile + 1], gaussians, centers, extents, factors, opacities,
                        depths, slopes, pixel, last_depth, last_pair,
                    )  # fmt: skip
                    last_depth = zs[WINDOW - 1]
                    last_pair = js[WINDOW - 1]
                    for s in range(WINDOW):
                        if live != 0:
                            if js[s] < 0:
                                live = 0
                            else:
                                w = clipped(raws[s]) * through
                                live = survives(through - w, live)
                                if live != 0:
                                    through -= w
                                    if wp.static(shares):
                                        value = values[index]
                                        row = row_of(w, w * value[0], w * value[1], w * value[2], real(1.0))
                                        wp.atomic_add(rows, emissions[js[s]], row)
                                    moved = real(w)
                                    moved_id = int(gaussians[js[s]])
                                    for k in range(strongest):
                                        if moved > top[k]:
                                            old = real(top[k])
                                            old_id = int(top_ids[k])
                                            top[k] = moved
                                            top_ids[k] = moved_id
                                            moved = old
                                            moved_id = old_id
                for k in range(strongest):
                    ids[index, k] = top_ids[k]
                    weights[index, k] = top[k]

    return attribute_ordered


@cache
def share_kernel(blending: Blending) -> wp.Kernel:
    """Add the rows of each gaussian's pairs."""
    real = blending.real
    vec3 = types_of(real).vec3
    row_of = share_row(blending)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def add_shares(
        offset: int,
        first: wp.array(dtype=int),
        rows: wp.array(dtype=row_of),
        # outputs
        weights: wp.array(dtype=real),
        sums: wp.array(dtype=vec3),
        hits: wp.array(dtype=int),
    ):
        i = wp.tid() + offset
        row = row_of(real(0.0))
        count = int(0)
        for emission in range(first[i], first[i + 1]):
            pair = rows[emission]
            row = row + pair
            count += int(pair[4])
        weights[i] = row[0]
        sums[i] = vec3(row[1], row[2], row[3])
        hits[i] = count

    return add_shares


class Strongest(NamedTuple):
    """The gaussians that weigh most in each pixel.

    Attributes:
        gaussians: Their indices, -1 where fewer show, shape (H * W, count), int32.
        weights: Their weights, shape (H * W, count).
    """

    gaussians: wp.array
    weights: wp.array


class Shares(NamedTuple):
    """What each gaussian takes of an image; 0 for gaussians that no tile lists.

    Attributes:
        weights: Sum of weights, shape (N,).
        sums: Sum of weights times values, shape (N,), vec3.
        hits: Number of pixels, shape (N,), int32.
    """

    weights: wp.array
    sums: wp.array
    hits: wp.array


def strongest(
    bins: Bins, width: int, height: int, splats: Splats, result: Strongest, blending: Blending
) -> None:
    """Find the gaussians that weigh most in each pixel.

    Args:
        bins: Pairs of this image.
        width, height: Image size [px].
        splats: N gaussians; depths and slopes are read with `blending.pixel_order` alone.
        result: Output; its width says how many gaussians a pixel has.
        blending: Cut-offs and order; features are not read.
    """
    real, device = blending.real, bins.starts.device
    values = wp.empty(0, dtype=types_of(real).vec3, device=device)
    rows = wp.empty(0, dtype=share_row(blending), device=device)
    _attribute(bins, width, height, splats, values, result, rows, blending)


def shares(
    bins: Bins, width: int, height: int, splats: Splats, values: wp.array, result: Shares, blending: Blending
) -> None:
    """Sum up what each gaussian takes of the image.

    Args:
        bins, width, height, splats, blending: As in `strongest`.
        values: Three numbers per pixel, shape (H * W,), vec3.
        result: Output.
    """
    device, real = bins.starts.device, blending.real
    nothing = Strongest(
        wp.empty((0, 0), dtype=int, device=device), wp.empty((0, 0), dtype=real, device=device)
    )
    rows = wp.zeros(bins.pair_count, dtype=share_row(blending), device=device)
    _attribute(bins, width, height, splats, values, nothing, rows, blending)
    launch(
        share_kernel(blending), bins.first.shape[0] - 1, [bins.first, rows], result,
        device=device, work=2,
    )  # fmt: skip


def _attribute(
    bins: Bins, width: int, height: int, splats: Splats, values: wp.array, result: Strongest, rows: wp.array,
    blending: Blending,
) -> None:  # fmt: skip
    """Run the kernel for the strongest gaussians and, where there are values, the shares of all pairs."""
    device = bins.starts.device
    lanes = lanes_for(device, blending)
    count, with_shares = result.gaussians.shape[1], values.shape[0] > 0
    if blending.pixel_order:
        kernel = ordered_attribution_kernel(blending, lanes.region, count, with_shares)
    else:
        kernel = attribution_kernel(blending, lanes, count, with_shares)
    launch(
        kernel, bins.regions(lanes.region),
        [
            bins.columns, width, height, bins.starts, bins.gaussians, bins.emissions, splats.centers,
            splats.extents, splats.factors, splats.opacities, splats.depths, splats.slopes, values,
        ],
        [*result, rows],
        device=device, work=100, uneven=True,
    )  # fmt: skip
