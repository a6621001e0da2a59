"""Procedural materials: seamless square textures of matte surfaces, painted with seeded noise.

Colours here are display values in [0, 1]. A texture repeats in both directions; u runs along its columns, v
along its rows. Detail at every size gives a fitting something to hold on to.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

GAMMA = 2.2
"""Display value = linear light ** (1 / 2.2), the customary stand-in for the sRGB curve."""


@dataclass(frozen=True)
class Material:
    """One entry of the vocabulary.

    Attributes:
        period: Edge of one repeat on a surface [m].
        side: Edge of the texture [texels], a power of two; 2 to 3 mm a texel, finer than a pixel of the
            cameras at 640 px width.
        painter: Paints the texture, given a random generator and the side: shape (side, side, 3).
    """

    period: float
    side: int
    painter: Callable[[Generator, int], np.ndarray]


def texture(name: str, seed: int) -> np.ndarray:
    """The texture of a material in display values, shape (S, S, 3), float64 in [0, 1].

    Args:
        name: A key of `MATERIALS`.
        seed: Same seed, same texture.
    """
    material = MATERIALS[name]
    rng = np.random.default_rng([seed, *name.encode()])
    return np.clip(material.painter(rng, material.side), 0.0, 1.0)


def _noise(rng: Generator, side: int, slope: float = 1.5, along: tuple[float, float] = (1, 1)) -> np.ndarray:
    """Seamless fractal noise of mean 0 and deviation 1, shape (side, side).

    Args:
        rng: Where the randomness comes from.
        side: Edge [texels].
        slope: Amplitude falls as frequency ** -slope: 1 is rough, 2 is cloudy.
        along: Stretch of the features along u and v.
    """
    across = np.fft.rfftfreq(side, 1 / side) * along[0]
    down = np.fft.fftfreq(side, 1 / side)[:, None] * along[1]
    frequency = np.hypot(across, down)
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((side, side))) * frequency**-slope
    noise = np.fft.irfft2(spectrum, s=(side, side))
    return noise / noise.std()


def _grid(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Texel centres (u, v) in [0, 1], each of shape (side, side)."""
    centers = (np.arange(side) + 0.5) / side
    u, v = np.meshgrid(centers, centers)
    return u, v


def _color(code: str) -> np.ndarray:
    """Colour of a code such as "#8a5a2b", shape (3,)."""
    return np.array([int(code[k : k + 2], 16) for k in (1, 3, 5)]) / 255


def _mix(a: np.ndarray | str, b: np.ndarray | str, share: np.ndarray) -> np.ndarray:
    """From colour `a` to colour `b` as `share` (any shape) goes from 0 to 1."""
    a, b = (_color(c) if isinstance(c, str) else c for c in (a, b))
    return a + (b - a) * np.clip(share, 0, 1)[..., None]


def _edge(distance: np.ndarray, width: float) -> np.ndarray:
    """1 inside (positive distance), 0 outside, over a soft edge of `width`."""
    return np.clip(distance / width + 0.5, 0, 1)


def _grain(rng: Generator, side: int, dark: str, light: str) -> np.ndarray:
    """Wood with its fibres along u."""
    rings = _noise(rng, side, 1.8, (9, 1))
    fibre = _noise(rng, side, 0.9, (24, 1))
    pores = np.clip(_noise(rng, side, 0.6, (16, 1)) - 1.6, 0, 1)
    share = 0.5 + 0.22 * np.sin(7 * rings) + 0.16 * fibre
    return _mix(dark, light, share) * (1 - 0.35 * pores)[..., None]


def _planks(rng: Generator, side: int) -> np.ndarray:
    u, v = _grid(side)
    rows, joints = 16, 2
    row = (v * rows).astype(int)
    along = (u * joints + rng.random(rows)[row]) % joints
    plank = row * joints + along.astype(int)
    wood = _grain(rng, side, "#7d4d26", "#c08a50")
    shift = rng.integers(0, side, rows * joints)[plank]
    texel_u = ((u * side).astype(int) + shift) % side
    wood = wood[(v * side).astype(int), texel_u]
    wood = wood * (0.78 + 0.4 * rng.random(rows * joints)[plank])[..., None]
    across = np.abs(v * rows % 1 - 0.5) * 0.16  # [m] from the middle of a plank
    lengthwise = np.abs(along % 1 - 0.5) * 1.28
    gap = np.minimum(0.08 - across, 0.64 - lengthwise)
    return wood * (0.35 + 0.65 * _edge(gap - 0.003, 0.004))[..., None]


def _bricks(rng: Generator, side: int) -> np.ndarray:
    u, v = _grid(side)
    rows, columns, size = 12, 4, 0.96
    row = (v * rows).astype(int)
    along = (u * columns + 0.5 * (row % 2)) % columns
    brick = row * columns + along.astype(int)
    wobble = 0.0016 * _noise(rng, side, 1.3)
    distance = np.minimum(
        (0.5 - np.abs(v * rows % 1 - 0.5)) * size / rows, (0.5 - np.abs(along % 1 - 0.5)) * size / columns
    )
    rough = 0.5 + 0.22 * _noise(rng, side, 1.0)
    clay = _mix("#8a3d2a", "#b8694a", rough) * (0.75 + 0.45 * rng.random(rows * columns)[brick])[..., None]
    mortar = _mix("#a79f92", "#c9c2b4", 0.5 + 0.25 * _noise(rng, side, 0.7))
    return _mix(mortar, clay, _edge(distance + wobble - 0.006, 0.004))


def _wallpaper(rng: Generator, side: int) -> np.ndarray:
    u, v = _grid(side)
    paper = _mix("#93ab9c", "#a6bbab", 0.5 + 0.3 * np.sign(np.sin(8 * np.pi * u)))
    for shift, scale in ((0.0, 1.0), (0.5, 0.8)):
        x = (2 * u + shift) % 1 - 0.5
        y = (2 * v + shift) % 1 - 0.5
        radius, angle = np.hypot(x, y) / scale, np.arctan2(y, x)
        petals = 0.17 + 0.09 * np.cos(6 * angle)
        paper = _mix(paper, "#e9e3cc", _edge(petals - radius, 0.03))
        paper = _mix(paper, "#b5654f", _edge(0.06 - radius, 0.03))
    return paper + 0.018 * _noise(rng, side, 0.5)[..., None]


def _plaster(rng: Generator, side: int) -> np.ndarray:
    clouds = 0.5 + 0.22 * _noise(rng, side, 1.6) + 0.14 * _noise(rng, side, 0.6)
    return _mix("#c9a879", "#e6cfa6", clouds)


def _painted(rng: Generator, side: int) -> np.ndarray:
    return _color("#e8e4da") + 0.02 * _noise(rng, side, 0.9, (12, 1))[..., None]


def _cloth(rng: Generator, side: int) -> np.ndarray:
    u, v = _grid(side)
    threads = 0.04 * np.sin(2 * np.pi * 64 * u) * np.sin(2 * np.pi * 64 * v)
    return _color("#e0e0e0") + (threads + 0.04 * _noise(rng, side, 0.8))[..., None]


def _rug(rng: Generator, side: int) -> np.ndarray:
    u, v = _grid(side)
    x, y = (u - 0.5) * 1.9, (v - 0.5) * 1.5  # [m] from the middle
    inward = np.minimum(0.95 - np.abs(x), 0.75 - np.abs(y))
    rug = np.broadcast_to(_color("#8c2f2b"), (side, side, 3))
    cell_x, cell_y = (x / 0.19 + 0.5) % 1 - 0.5, (y / 0.19 + 0.5) % 1 - 0.5
    diamond = np.abs(cell_x) + np.abs(cell_y)
    rug = _mix(rug, "#d8b56a", _edge(0.40 - diamond, 0.04))
    rug = _mix(rug, "#27415f", _edge(0.28 - diamond, 0.04))
    rug = _mix(rug, "#e8dcc0", _edge(0.12 - diamond, 0.04))
    rug = _mix("#27415f", rug, _edge(inward - 0.20, 0.01))
    zigzag = np.abs((x + y) / 0.1 % 1 - 0.5) * 0.06
    rug = _mix(rug, "#d8b56a", _edge(0.012 - np.abs(inward - 0.105 - zigzag), 0.006))
    rug = _mix(rug, "#e8dcc0", _edge(0.012 - np.abs(inward - 0.19), 0.006))
    rug = _mix("#d9cfb4", rug, _edge(inward - 0.04, 0.01))
    wool = 1 + 0.09 * _noise(rng, side, 0.5) + 0.06 * _noise(rng, side, 1.5)
    return rug * wool[..., None]


def _picture(rng: Generator, side: int) -> np.ndarray:
    u, v = _grid(side)
    picture = _mix("#4f83b5", "#f2d7a6", v / 0.6)
    picture = _mix(picture, "#fff3c9", _edge(0.07 - np.hypot(u - 0.68, v - 0.30), 0.02))
    for horizon, height, color in ((0.50, 0.16, "#7487a0"), (0.66, 0.12, "#55794f"), (0.82, 0.07, "#35542f")):
        ridge = height * _noise(rng, side, 2.0)[0] * 0.5
        picture = _mix(picture, color, _edge(v - horizon - ridge, 0.01))
    return picture + 0.03 * _noise(rng, side, 0.8, (4, 1))[..., None]


def _porcelain(rng: Generator, side: int) -> np.ndarray:
    """Cream glaze with painted bands; a repeat is an eighth of a vase around, and all of it along."""
    u, v = _grid(side)
    glaze = _mix("#e6e0d0", "#f3eee2", 0.5 + 0.3 * _noise(rng, side, 1.5))
    blue = "#27508f"
    x = np.abs(u - 0.5)
    for middle, half in ((0.13, 0.016), (0.30, 0.010), (0.68, 0.010), (0.92, 0.030)):
        glaze = _mix(glaze, blue, _edge(half - np.abs(v - middle), 0.008))
    petal = 0.34 * np.sqrt(np.clip(1 - ((v - 0.49) / 0.165) ** 2, 0, 1))
    glaze = _mix(glaze, blue, _edge(petal - x - 0.02, 0.04))
    glaze = _mix(glaze, "#c9562e", _edge(petal * 0.55 - x - 0.02, 0.04))
    leaf = 0.5 * np.clip((0.90 - v) / 0.18, 0, 1) * (v > 0.70)
    glaze = _mix(glaze, "#3f7a4f", _edge(leaf - x - 0.02, 0.04))
    drops = np.hypot((u * 2 % 1 - 0.5) / 2 * 0.5, v - 0.22)
    glaze = _mix(glaze, "#c9562e", _edge(0.045 - drops, 0.01))
    return glaze + 0.02 * _noise(rng, side, 0.6)[..., None]


def _marble(rng: Generator, side: int) -> np.ndarray:
    veins = np.exp(-np.abs(_noise(rng, side, 1.7)) * 9)
    fine = np.exp(-np.abs(_noise(rng, side, 1.5)) * 14)
    stone = _mix("#cfccc6", "#efede8", 0.5 + 0.3 * _noise(rng, side, 1.4))
    return _mix(stone, "#4d5257", 0.85 * veins + 0.4 * fine)


def _gold(rng: Generator, side: int) -> np.ndarray:
    hammered = 0.5 + 0.25 * _noise(rng, side, 1.2)
    return _mix("#a8741a", "#f0c75a", hammered)


def _leaf(rng: Generator, side: int) -> np.ndarray:
    return _mix("#2f5a2a", "#6b9a45", 0.5 + 0.28 * _noise(rng, side, 1.1, (3, 1)))


def _terracotta(rng: Generator, side: int) -> np.ndarray:
    return _mix("#a5583a", "#c97f5a", 0.5 + 0.25 * _noise(rng, side, 1.0, (3, 1)))


def _beach_ball(rng: Generator, side: int) -> np.ndarray:
    u, v = _grid(side)
    colors = np.stack([_color(c) for c in ("#d94436", "#f1ece0", "#2d6fb0", "#f1ece0", "#e8b93a", "#f1ece0")])
    ball = colors[(u * 6).astype(int) % 6]
    ball = _mix(ball, "#f1ece0", _edge(np.abs(v - 0.5) - 0.44, 0.01))
    return ball + 0.02 * _noise(rng, side, 0.8)[..., None]


MATERIALS: dict[str, Material] = {
    "planks": Material(2.56, 1024, _planks),
    "bricks": Material(0.96, 512, _bricks),
    "wallpaper": Material(0.64, 256, _wallpaper),
    "plaster": Material(1.28, 512, _plaster),
    "painted wood": Material(0.64, 256, _painted),
    "oak": Material(0.8, 256, lambda rng, side: _grain(rng, side, "#8a5f34", "#c99a62")),
    "walnut": Material(0.8, 256, lambda rng, side: _grain(rng, side, "#3d2415", "#7a4f30")),
    "cloth": Material(0.32, 128, _cloth),
    "rug": Material(1.7, 512, _rug),
    "picture": Material(0.8, 256, _picture),
    "porcelain": Material(0.4, 256, _porcelain),
    "marble": Material(0.6, 256, _marble),
    "gold": Material(0.5, 256, _gold),
    "leaf": Material(0.2, 128, _leaf),
    "terracotta": Material(0.5, 256, _terracotta),
    "beach ball": Material(0.6, 256, _beach_ball),
}
"""The vocabulary, by the name that a prompt may use."""
