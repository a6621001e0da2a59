"""The plain rasteriser that others are compared with: a pixel a thread, one core, written as it is read.

The form in which most splatting kernels begin: a scalar loop with an early end, `wp.exp`, and gradients
added straight to the gaussians. It is the yardstick of `diga3d bench kernels`, and tests hold the fast
kernels against it.

Invariants
- Both kernels run as one serial launch: their additions to shared gradients are none otherwise on CPU.
- Both skip, clamp and stop as `kernels.compositing` does, and read the same bins.
"""

from __future__ import annotations

import warp as wp

from diga3d_warp.config import SPLATTING, TILE
from diga3d_warp.kernels.binning import Bins

_S = SPLATTING

wp.set_module_options({"enable_backward": False})


@wp.func
def power_at(center: wp.vec2, root: wp.vec3, x: int, y: int) -> float:
    dx = center[0] - float(x) - 0.5
    dy = center[1] - float(y) - 0.5
    u = root[0] * dx + root[1] * dy
    v = root[2] * dy
    return -0.5 * (u * u + v * v)


@wp.kernel
def blend(
    width: int,
    columns: int,
    starts: wp.array(dtype=int),
    gaussians: wp.array(dtype=int),
    centers: wp.array(dtype=wp.vec2),
    roots: wp.array(dtype=wp.vec3),
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
        alpha = wp.min(opacities[i] * wp.exp(power_at(centers[i], roots[i], x, y)), wp.static(_S.alpha_max))
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
    roots: wp.array(dtype=wp.vec3),
    opacities: wp.array(dtype=float),
    colors: wp.array(dtype=wp.vec3),
    image: wp.array(dtype=wp.vec3),
    transmittance: wp.array(dtype=float),
    adj_image: wp.array(dtype=wp.vec3),
    adj_transmittance: wp.array(dtype=float),
    # outputs
    adj_centers: wp.array(dtype=wp.vec2),
    adj_roots: wp.array(dtype=wp.vec3),
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
        root = roots[i]
        raw = opacities[i] * wp.exp(power_at(centers[i], root, x, y))
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
            u = root[0] * dx + root[1] * dy
            v = root[2] * dy
            wp.atomic_add(adj_centers, i, -g_power * wp.vec2(root[0] * u, root[1] * u + root[2] * v))
            wp.atomic_add(adj_roots, i, -g_power * wp.vec3(u * dx, u * dy, v * dy))
            wp.atomic_add(adj_opacities, i, g_power / opacities[i])
        T *= 1.0 - alpha


def composite(bins: Bins, width: int, height: int, splats: list, outputs: list) -> None:
    """Blend a binned image on one thread.

    Args:
        bins: Pairs of this image.
        width, height: Image size [px].
        splats: centers (N,) vec2, roots (N,) vec3, opacities (N,), colors (N,) vec3.
        outputs: image (H*W,) vec3 and transmittance (H*W,).
    """
    wp.launch(
        blend, width * height, [width, bins.columns, bins.starts, bins.gaussians, *splats], outputs,
        device="cpu",
    )  # fmt: skip


def composite_adjoint(
    bins: Bins, width: int, height: int, splats: list, outputs: list, adj_outputs: list, adj_splats: list
) -> None:
    """Add the gradients of the splats on one thread.

    Args:
        bins, width, height, splats, outputs: As in `composite`, after it ran.
        adj_outputs: Gradients of image and transmittance.
        adj_splats: Gradients of the splats, added to.
    """
    wp.launch(
        blend_adjoint, width * height,
        [width, bins.columns, bins.starts, bins.gaussians, *splats, *outputs, *adj_outputs], adj_splats,
        device="cpu",
    )  # fmt: skip
