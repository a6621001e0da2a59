"""Attention over patches: the nearest patches of a source for each query, and the mean that they vote for.

A query is a patch of one image, a key a patch of another (or of the same). Their distance is

    d(i, j) = scale_j (sum over pixels and channels of W_i (q_i - k_j)^2 + a_x dx^2 + a_y dy^2 + b n_ij)

with dx, dy the way between their centres, and n the share of the query's neighbours whose nearest key lies
another way. The last term favours pieces that are copied whole: without it, textures drown in the mean of
overlapping patches that do not fit each other. W belongs to the query: 1 / (2 s^2) where the query holds
noise of variance s^2, more where it is known, zero outside its image. So softmax(-d) is the posterior over
keys that may have given rise to the query, and `vote` takes its mean; see `priors.exemplar.posterior`. Each
query looks at few candidates: those it has, those of its neighbours, moved along, and random ones around its
best (PatchMatch, Barnes et al. 2009).

Invariants
- Images are flat, channels innermost. The query and its weights are padded by the patch radius on all sides;
  the source is not, and a key's centre lies at least the radius inside it.
- Rows of a patch are read in whole vectors of `LANES`, with weight zero for what lies beyond. So a source
  has `LANES` more floats at its end.
- `scale` is positive for keys and zero for pixels that are none; a candidate is a key or -1. No query has a
  candidate twice, and its candidates are sorted: the nearest comes first, -1 last.
- A search reads the candidates of the step before and writes new ones, so that the result does not depend on
  the order of queries. Without the term for neighbours it never loses the nearest candidate, unless the query
  has changed.
- Random numbers depend on seed and query alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import warp as wp

from diga3d_warp.kernels.cells import cells_of
from diga3d_warp.kernels.launch import OPTIONS, launch

read, *_ = cells_of(wp.float32)

LANES = 16
"""Floats of a vector with AVX-512. Rows of a patch are filled up to whole vectors: a remainder of 5 in 21
floats takes longer than the 16 together."""

FAR = wp.constant(1.0e30)
"""Distance of a candidate that is none."""


@dataclass(frozen=True)
class PatchForm:
    """What a patch kernel is compiled for.

    Attributes:
        radius: Of a patch [px]; its side is 2 radius + 1.
        channels: Of query, weights and source. The first three are the colours that `vote` takes.
        kept: Candidates kept for each query.
    """

    radius: int = 3
    channels: int = 3
    kept: int = 4

    @property
    def side(self) -> int:
        """Side of a patch [px]."""
        return 2 * self.radius + 1


@wp.func
def moved(key: int, dx: int, dy: int, width: int, pixels: int) -> int:
    """A pixel of an image moved by (dx, dy); -1 outside the image, and for -1."""
    x = key % width + dx
    y = key // width + dy
    if key < 0 or x < 0 or x >= width or y < 0 or y >= pixels // width:
        return -1
    return y * width + x


@cache
def search_kernel(form: PatchForm) -> wp.Kernel:
    """Kernel over queries: their nearest candidates, sorted, with distances."""
    radius, side, channels, kept = form.radius, form.side, form.channels, form.kept
    row_floats = -(-side * channels // LANES) * LANES

    @wp.kernel(module="unique", module_options=OPTIONS)
    def search(
        offset: int,
        pixels: wp.array(dtype=int),
        slots: wp.array(dtype=int),
        query: wp.array(dtype=float),
        weights: wp.array(dtype=float),
        width: int,
        source: wp.array(dtype=float),
        scale: wp.array(dtype=float),
        source_width: int,
        along: wp.vec4,
        apart: float,
        candidates: wp.array(dtype=int),
        draws: int,
        spread: float,
        seed: int,
        # outputs
        found: wp.array(dtype=int),
        distances: wp.array(dtype=float),
    ):
        i = wp.tid() + offset
        pixel = pixels[i]
        x = pixel % width
        y = pixel // width
        padded_width = width + 2 * radius
        corner = y * padded_width + x
        random = wp.rand_init(seed, i)

        # A copy of the query, its rows filled up by zero weights to whole vectors.
        patch = wp.zeros(shape=wp.static(side * row_floats), dtype=float)
        weight = wp.zeros(shape=wp.static(side * row_floats), dtype=float)
        for row in range(side):
            for lane in range(wp.static(side * channels)):
                cell = (corner + row * padded_width) * channels + lane
                patch[row * row_floats + lane] = query[cell]
                weight[row * row_floats + lane] = weights[cell]

        # The keys that lie the same way from here as the eight neighbours' nearest lie from them.
        led = wp.zeros(shape=8, dtype=int)
        present = float(0.0)
        for place in range(8):
            cell = place + wp.where(place > 3, 1, 0)
            dx = cell % 3 - 1
            dy = cell // 3 - 1
            led[place] = -1
            neighbour = moved(pixel, dx, dy, width, slots.shape[0])
            if neighbour >= 0:
                if slots[neighbour] >= 0:
                    led[place] = moved(
                        candidates[slots[neighbour] * kept], -dx, -dy, source_width, scale.shape[0]
                    )
            if led[place] >= 0:
                present += 1.0
        apart_each = apart / wp.max(present, 1.0)

        best = wp.zeros(shape=wp.static(kept), dtype=int)
        nearest = wp.zeros(shape=wp.static(kept), dtype=float)
        for slot in range(kept):
            best[slot] = -1
            nearest[slot] = FAR
        radius_now = spread
        for trial in range(wp.static(kept + 8) + draws):
            key = int(-1)
            if trial < kept:
                key = candidates[i * kept + trial]
            elif trial < wp.static(kept + 8):
                key = led[trial - kept]
            else:
                if best[0] < 0:
                    # Nothing was found yet: anywhere.
                    key = wp.randi(random, 0, scale.shape[0])
                else:
                    dx = int(wp.round(wp.randf(random, -radius_now, radius_now)))
                    dy = int(wp.round(wp.randf(random, -radius_now, radius_now)))
                    key = moved(best[0], dx, dy, source_width, scale.shape[0])
                    radius_now = wp.max(0.5 * radius_now, 1.0)
            worth = float(0.0)
            if key >= 0:
                worth = scale[key]
                for slot in range(kept):
                    if best[slot] == key:
                        worth = float(0.0)
            if worth > 0.0:
                dx_key = float(key % source_width - x) - along[2]
                dy_key = float(key // source_width - y) - along[3]
                agreed = float(0.0)
                for place in range(8):
                    if led[place] == key:
                        agreed += 1.0
                way = (
                    along[0] * dx_key * dx_key + along[1] * dy_key * dy_key + apart_each * (present - agreed)
                )
                last = nearest[kept - 1]
                if way * worth < last:
                    total = float(0.0)
                    first = key - radius * (source_width + 1)
                    row = int(0)
                    # Past the last candidate's distance the rest of the patch does not matter.
                    while row < side and (way + total) * worth < last:
                        start = (first + row * source_width) * channels
                        part = float(0.0)
                        lane = int(0)
                        while lane < wp.static(row_floats):
                            difference = patch[row * row_floats + lane] - read(source, start + lane)
                            part += weight[row * row_floats + lane] * difference * difference
                            lane += 1
                        total += part
                        row += 1
                    d = (way + total) * worth
                    if d < last:
                        rank = int(kept - 1)
                        while rank > 0 and nearest[wp.max(rank - 1, 0)] > d:
                            nearest[rank] = nearest[rank - 1]
                            best[rank] = best[rank - 1]
                            rank -= 1
                        nearest[rank] = d
                        best[rank] = key
        for slot in range(kept):
            found[i * kept + slot] = best[slot]
            distances[i * kept + slot] = nearest[slot]

    return search


@cache
def vote_kernel(form: PatchForm) -> wp.Kernel:
    """Kernel over pixels: the mean colour that the patches of all queries around give them."""
    radius, side, channels, kept = form.radius, form.side, form.channels, form.kept

    @wp.kernel(module="unique", module_options=OPTIONS)
    def vote(
        offset: int,
        targets: wp.array(dtype=int),
        slots: wp.array(dtype=int),
        width: int,
        source: wp.array(dtype=float),
        source_width: int,
        candidates: wp.array(dtype=int),
        attention: wp.array(dtype=float),
        window: wp.array(dtype=float),
        # outputs
        colors: wp.array(dtype=wp.vec3),
    ):
        i = wp.tid() + offset
        pixel = targets[i]
        total = float(0.0)
        color = wp.vec3(0.0, 0.0, 0.0)
        for row in range(side):
            for column in range(side):
                # The query whose patch shows the pixel at (column, row).
                centre = moved(pixel, radius - column, radius - row, width, slots.shape[0])
                slot = int(-1)
                if centre >= 0:
                    slot = slots[centre]
                if slot >= 0:
                    step = (row - radius) * source_width + column - radius
                    for rank in range(kept):
                        weight = attention[slot * kept + rank] * window[row * side + column]
                        key = candidates[slot * kept + rank]
                        if weight > 0.0 and key >= 0:
                            cell = (key + step) * channels
                            color += weight * wp.vec3(
                                read(source, cell), read(source, cell + 1), read(source, cell + 2)
                            )
                            total += weight
        if total > 0.0:
            colors[i] = color / total

    return vote


@dataclass(frozen=True, eq=False)
class Queries:
    """Patches that look for others.

    Attributes:
        pixels: Centres of the patches as pixels of their image, shape [N], int32.
        slots: Index into `pixels` of every pixel, -1 where there is none, shape [H * W], int32.
        image: shape [(H + 2 radius) * (W + 2 radius) * channels], float32.
        weights: W, the same shape.
        width: W of the image [px].
    """

    pixels: wp.array
    slots: wp.array
    image: wp.array
    weights: wp.array
    width: int


@dataclass(frozen=True, eq=False)
class Keys:
    """Patches that are looked for.

    Attributes:
        image: shape [H * W * channels + LANES], float32, its last floats finite.
        scale: Factor on distances to the key centred there, 0 where there is none, shape [H * W], float32.
        width: W of the image [px].
    """

    image: wp.array
    scale: wp.array
    width: int


def search(
    form: PatchForm, queries: Queries, keys: Keys, along: Sequence[float], candidates: wp.array,
    outputs: list[wp.array], *, apart: float, draws: int, spread: float, seed: int,
) -> None:  # fmt: skip
    """One step of the search: each query's nearest among known, neighbours' and random candidates.

    Args:
        form: Of the patches.
        queries, keys: Patches; all arrays on one device.
        along: Cost of the way between centres, per px^2 across and down, and the way that costs nothing [px]:
            (a_x, a_y, s_x, s_y).
        candidates: Of the step before, shape [N * kept], int32; -1 for none.
        outputs: Candidates, int32, and their distances, float32, shape [N * kept].
        apart: Cost b of a candidate that no neighbour agrees with.
        draws: Number of random candidates.
        spread: Radius of the first random candidate [px]; each next one's is half, at least 1.
        seed: Of the random candidates.
    """
    launch(
        search_kernel(form), queries.pixels.size,
        [
            queries.pixels, queries.slots, queries.image, queries.weights, queries.width, keys.image,
            keys.scale, keys.width, wp.vec4(*along), apart, candidates, draws, spread, seed,
        ],
        outputs, device=queries.pixels.device, work=10 * (form.kept + 8 + draws), uneven=True,
    )  # fmt: skip


def vote(
    form: PatchForm, queries: Queries, keys: Keys, targets: wp.array, candidates: wp.array,
    attention: wp.array, window: wp.array, colors: wp.array,
) -> None:  # fmt: skip
    """Mean colour of each target pixel over the patches that show it.

    Args:
        form: Of the patches.
        queries, keys: As in `search`.
        targets: Pixels of the queries' image, shape [M], int32.
        candidates, attention: Keys of each query and their share, shape [N * kept].
        window: Share of each pixel of a patch, shape [side * side], float32.
        colors: Output, shape [M], vec3. A pixel that no patch shows keeps its value.
    """
    launch(
        vote_kernel(form), targets.size,
        [targets, queries.slots, queries.width, keys.image, keys.width, candidates, attention, window],
        [colors], device=targets.device, work=20,
    )  # fmt: skip
