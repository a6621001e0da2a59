"""A plain rasteriser as a baseline: one thread for each pixel, on one core.

It is the textbook form: a scalar loop with an early exit, `wp.exp`, and gradients added straight to the
gaussians. `diga3d bench kernels` compares the fast kernels with it in speed, tests compare the results.

Invariants
- Both kernels run as one serial launch: on CPU, parallel additions to shared gradients would lose some.
- Both skip, clamp and stop as `kernels.compositing` does, and read the same bins.
"""

from __future__ import annotations

from typing import NamedTuple

import warp as wp

from diga3d_warp.config import SPLATTING, TILE
from diga3d_warp.kernels.binning import Bins

_S = SPLATTING

wp.set_module_options({"enable_backward": False})


@wp.func
def power_at(center: wp.vec2, factor: wp.vec3, x: int, y: int) -> float:
    dx = center[0] - float(x) - 0.5
    dy = center[1] - float(y) - 0.5
    u = factor[0] * dx + factor[1] * dy
    v = factor[2] * dy
    return -0.5 * (u * u + v * v)


@wp.kernel
def blend(
    width: int,
    columns: int,
    starts: wp.array(dtype=int),
    gaussians: wp.array(dtype=int),
    centers: wp.array(dtype=wp.vec2),
    factors: wp.array(dtype=wp.vec3),
    opacities: wp.array(dtype=float),
    colors: wp.array(dtype=wp.vec3),
    # outputs
    image: wp.array(dtype=wp.vec3),
    transmittance: wp.array(dtype=float),
):
    pixel = wp.tid()
    x = pixel % width
    y = pixel // width
    tile = (y // wp.static(TILE)) * columns + x // wp.static(TILE)
    color = wp.vec3(0.0, 0.0, 0.0)
    T = float(1.0)
    for j in range(starts[tile], starts[tile + 1]):
        i = gaussians[j]
        alpha = wp.min(opacities[i] * wp.exp(power_at(centers[i], factors[i], x, y)), wp.static(_S.alpha_max))
        if alpha < wp.static(_S.alpha_min):
            continue
        if T * (1.0 - alpha) < wp.static(_S.transmittance_min):
            break
        color += (alpha * T) * colors[i]
        T *= 1.0 - alpha
    image[pixel] = color
    transmittance[pixel] = T


@wp.kernel
def blend_adjoint(
    width: int,
    columns: int,
    starts: wp.array(dtype=int),
    gaussians: wp.array(dtype=int),
    centers: wp.array(dtype=wp.vec2),
    factors: wp.array(dtype=wp.vec3),
    opacities: wp.array(dtype=float),
    colors: wp.array(dtype=wp.vec3),
    image: wp.array(dtype=wp.vec3),
    transmittance: wp.array(dtype=float),
    adj_image: wp.array(dtype=wp.vec3),
    adj_transmittance: wp.array(dtype=float),
    # outputs
    adj_centers: wp.array(dtype=wp.vec2),
    adj_factors: wp.array(dtype=wp.vec3),
    adj_opacities: wp.array(dtype=float),
    adj_colors: wp.array(dtype=wp.vec3),
):
    pixel = wp.tid()
    x = pixel % width
    y = pixel // width
    tile = (y // wp.static(TILE)) * columns + x // wp.static(TILE)
    g = adj_image[pixel]
    T = float(1.0)
    behind = wp.dot(image[pixel], g) + transmittance[pixel] * adj_transmittance[pixel]
    for j in range(starts[tile], starts[tile + 1]):
        i = gaussians[j]
        factor = factors[i]
        raw = opacities[i] * wp.exp(power_at(centers[i], factor, x, y))
        alpha = wp.min(raw, wp.static(_S.alpha_max))
        if alpha < wp.static(_S.alpha_min):
            continue
        if T * (1.0 - alpha) < wp.static(_S.transmittance_min):
            break
        w = alpha * T
        along = wp.dot(colors[i], g)
        behind -= w * along
        wp.atomic_add(adj_colors, i, w * g)
        if raw < wp.static(_S.alpha_max):
            g_power = raw * (T * along - behind / (1.0 - alpha))
            dx = centers[i][0] - float(x) - 0.5
            dy = centers[i][1] - float(y) - 0.5
            u = factor[0] * dx + factor[1] * dy
            v = factor[2] * dy
            wp.atomic_add(adj_centers, i, -g_power * wp.vec2(factor[0] * u, factor[1] * u + factor[2] * v))
            wp.atomic_add(adj_factors, i, -g_power * wp.vec3(u * dx, u * dy, v * dy))
            wp.atomic_add(adj_opacities, i, g_power / opacities[i])
        T *= 1.0 - alpha


class Blended(NamedTuple):
    """What the plain rasteriser blends, or the gradients of it: (N,) arrays as in `splats.BlendGradients`."""

    centers: wp.array
    factors: wp.array
    opacities: wp.array
    colors: wp.array


class Image(NamedTuple):
    """Colour (H * W,), vec3, and transmittance (H * W,), or their gradients."""

    color: wp.array
    transmittance: wp.array


def composite(bins: Bins, width: int, height: int, splats: Blended, image: Image) -> None:
    """Blend a binned image on one thread.

    Args:
        bins: Pairs of this image.
        width, height: Image size [px].
        splats: What to blend.
        image: Output.
    """
    wp.launch(
        blend, width * height, [width, bins.columns, bins.starts, bins.gaussians, *splats], [*image],
        device="cpu",
    )  # fmt: skip


def composite_adjoint(
    bins: Bins, width: int, height: int, splats: Blended, image: Image, adj_image: Image, adj_splats: Blended
) -> None:
    """Add the gradients of the splats on one thread.

    Args:
        bins, width, height, splats, image: As in `composite`, after it ran.
        adj_image: Gradients of the image.
        adj_splats: Outputs, added to.
    """
    wp.launch(
        blend_adjoint, width * height,
        [width, bins.columns, bins.starts, bins.gaussians, *splats, *image, *adj_image], [*adj_splats],
        device="cpu",
    )  # fmt: skip
