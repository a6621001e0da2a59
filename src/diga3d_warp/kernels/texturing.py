"""Colour of ray hits: a texture with its smaller copies (a mip pyramid), times the light at the corners.

Invariants
- Textures are square, their sides powers of two, and repeat in both directions. A pyramid lies in one array,
  largest level first, down to a single texel.
- A level is chosen by the distance alone, not by the slant of the surface: slanted surfaces come out a little
  sharper than a perfect filter would make them, and supersampling smooths the rest.
- Colours are linear. A ray that met nothing has colour zero.
"""

import numpy as np
import warp as wp

from diga3d_warp.kernels.launch import OPTIONS, launch
from diga3d_warp.kernels.raycast import Hits

wp.set_module_options(OPTIONS)


@wp.func
def texel(texels: wp.array(dtype=wp.vec3), level_start: int, side: int, x: int, y: int) -> wp.vec3:
    # The side is a power of two, so `&` wraps negative positions too.
    return texels[level_start + (y & (side - 1)) * side + (x & (side - 1))]


@wp.func
def level_color(texels: wp.array(dtype=wp.vec3), start: int, side: int, level: int, uv: wp.vec2) -> wp.vec3:
    """Bilinear colour at `uv` (1 = one repeat) in one level of the pyramid at `start`."""
    level_start = int(start)
    level_side = int(side)
    for _ in range(level):
        level_start += level_side * level_side
        level_side = level_side / 2
    x = uv[0] * float(level_side) - 0.5
    y = uv[1] * float(level_side) - 0.5
    left = wp.floor(x)
    top = wp.floor(y)
    across = x - left
    down = y - top
    column = int(left)
    row = int(top)
    upper = (
        texel(texels, level_start, level_side, column, row) * (1.0 - across)
        + texel(texels, level_start, level_side, column + 1, row) * across
    )
    lower = (
        texel(texels, level_start, level_side, column, row + 1) * (1.0 - across)
        + texel(texels, level_start, level_side, column + 1, row + 1) * across
    )
    return upper * (1.0 - down) + lower * down


@wp.kernel
def hit_colors_kernel(
    offset: int,
    face: wp.array(dtype=wp.int32),
    distance: wp.array(dtype=float),
    barycentric: wp.array(dtype=wp.vec2),
    indices: wp.array(dtype=wp.int32),
    light: wp.array(dtype=wp.vec3),
    uvs: wp.array(dtype=wp.vec2),
    face_texture: wp.array(dtype=wp.int32),
    texels: wp.array(dtype=wp.vec3),
    starts: wp.array(dtype=wp.int32),
    sides: wp.array(dtype=wp.int32),
    periods: wp.array(dtype=float),
    ray_spread: float,
    # outputs
    color: wp.array(dtype=wp.vec3),
):
    i = wp.tid() + offset
    f = face[i]
    if f < 0:
        color[i] = wp.vec3(0.0, 0.0, 0.0)
        return
    a = indices[3 * f]
    b = indices[3 * f + 1]
    c = indices[3 * f + 2]
    u = barycentric[i][0]
    v = barycentric[i][1]
    w = 1.0 - u - v
    uv = uvs[a] * u + uvs[b] * v + uvs[c] * w
    texture = face_texture[f]
    side = sides[texture]
    footprint = distance[i] * ray_spread * float(side) / periods[texture]
    exact_level = wp.max(wp.log2(footprint), 0.0)
    highest = wp.log2(float(side))
    fine = int(wp.min(exact_level, highest))
    coarse = wp.min(fine + 1, int(highest))
    share = wp.min(exact_level - float(fine), 1.0)
    start = starts[texture]
    albedo = (
        level_color(texels, start, side, fine, uv) * (1.0 - share)
        + level_color(texels, start, side, coarse, uv) * share
    )
    color[i] = wp.cw_mul(albedo, light[a] * u + light[b] * v + light[c] * w)


def pyramid(texture: np.ndarray) -> np.ndarray:
    """A texture and its halvings down to one texel, one after another.

    Args:
        texture: Linear RGB, shape (S, S, 3), S a power of two.

    Returns:
        Texels of all levels, shape (S^2 + (S/2)^2 + ... + 1, 3), float32.
    """
    levels = [texture]
    while len(levels[-1]) > 1:
        half = len(levels[-1]) // 2
        levels.append(levels[-1].reshape(half, 2, half, 2, 3).mean((1, 3)))
    return np.concatenate([level.reshape(-1, 3) for level in levels]).astype(np.float32)


def hit_colors(
    hits: Hits,
    indices: wp.array,
    light: wp.array,
    uvs: wp.array,
    face_texture: wp.array,
    textures: tuple[wp.array, wp.array, wp.array, wp.array],
    ray_spread: float,
) -> wp.array:
    """Linear colour of each hit, shape (R,), vec3.

    Args:
        hits: Where the rays met the mesh, R of them.
        indices: Corners of the faces, shape (3 F,), int32.
        light: Light at each corner, with its tint, shape (V,), vec3.
        uvs: Texture position of each corner, 1 = one repeat, shape (V,), vec2.
        face_texture: Texture of each face, shape (F,), int32.
        textures: The pyramids' texels one after another (vec3); start (int32), side [texels] (int32) and
            period [scene units] (float32) of each.
        ray_spread: Width of a ray's share of the image at distance 1 [scene units].
    """
    color = wp.empty(len(hits.face), dtype=wp.vec3, device=hits.face.device)
    arguments = [*hits, indices, light, uvs, face_texture, *textures, ray_spread]
    launch(hit_colors_kernel, len(color), arguments, [color], device=hits.face.device, work=5)
    return color
