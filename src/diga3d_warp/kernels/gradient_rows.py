"""Rows of gradients: one for each pair of a tile and a gaussian, added up for each gaussian in a fixed order.

Invariants
- A row belongs to one tile, which one thread of a CPU owns; on CUDA pixels add to it atomically.
- Rows of one gaussian are added in the order of its emissions, so that the sum does not depend on threads.
"""

from functools import cache
from typing import Any

import warp as wp

from diga3d_warp.kernels.binning import Bins
from diga3d_warp.kernels.blending import Blending
from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.precision import types_of
from diga3d_warp.kernels.splats import BlendGradients

GEOMETRY = 6
"""Numbers of a gradient row before those of the features: centre (2), factor (3), opacity."""


def gradient_row(blending: Blending) -> Any:
    """Gradient of one (tile, gaussian) pair: geometry, features, then the depth's through the median."""
    return wp.types.vector(GEOMETRY + blending.features + blending.median, blending.real)


@cache
def gather_kernel(blending: Blending) -> wp.Kernel:
    """Add the rows of each gaussian's pairs to its gradients."""
    real = blending.real
    vec2, vec3, *_ = types_of(real)
    row_of = gradient_row(blending)
    depth = GEOMETRY + 3
    normal = GEOMETRY + blending.normal_at
    median = GEOMETRY + blending.features

    @wp.kernel(module="unique", module_options=OPTIONS)
    def gather_gradients(
        offset: int,
        first: wp.array(dtype=int),
        gradients: wp.array(dtype=row_of),
        # outputs
        adj_centers: wp.array(dtype=vec2),
        adj_factors: wp.array(dtype=vec3),
        adj_opacities: wp.array(dtype=real),
        adj_colors: wp.array(dtype=vec3),
        adj_depths: wp.array(dtype=real),
        adj_normals: wp.array(dtype=vec3),
    ):
        i = wp.tid() + offset
        row = row_of(real(0.0))
        for emission in range(first[i], first[i + 1]):
            row = row + gradients[emission]
        adj_centers[i] = adj_centers[i] + vec2(row[0], row[1])
        adj_factors[i] = adj_factors[i] + vec3(row[2], row[3], row[4])
        adj_opacities[i] = adj_opacities[i] + row[5]
        adj_colors[i] = adj_colors[i] + vec3(row[6], row[7], row[8])
        if wp.static(blending.depth):
            adj_depths[i] = adj_depths[i] + row[wp.static(depth)]
        if wp.static(blending.median):
            adj_depths[i] = adj_depths[i] + row[wp.static(median)]
        if wp.static(blending.normals):
            adj_normals[i] = adj_normals[i] + vec3(
                row[wp.static(normal)], row[wp.static(normal + 1)], row[wp.static(normal + 2)]
            )

    return gather_gradients


def gather(bins: Bins, rows: wp.array, gradients: BlendGradients, blending: Blending) -> None:
    """Add all rows to the gradients of the gaussians that they belong to."""
    launch(
        gather_kernel(blending), bins.first.shape[0] - 1,
        [bins.first, rows],
        [
            gradients.centers, gradients.factors, gradients.opacities, gradients.colors, gradients.depths,
            gradients.normals,
        ],
        device=rows.device, work=2,
    )  # fmt: skip
