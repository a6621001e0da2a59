"""Colours by name, and textures tinted with them.

A tint moves the mean of a texture to a colour in Oklab (Ottosson 2020), in which equal steps look equal:
grain, veins and joints stay as variations of lightness about it. Multiplied in RGB, a dark wood would stay
dark.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diga3d_warp.materials.painting import GAMMA, color

COLORS: dict[str, str] = {
    "red": "#b3261e", "crimson": "#a01c2c", "scarlet": "#c7301c", "ruby": "#8f1231", "maroon": "#5e1a1f",
    "burgundy": "#5a1a2a", "orange": "#d9761a", "coral": "#e0745c", "salmon": "#e39080", "peach": "#f0b590",
    "yellow": "#dfc02c", "amber": "#d39316", "beige": "#d9c7a3", "cream": "#efe4c8", "ivory": "#efe9d7",
    "khaki": "#a89b6b", "tan": "#c19f74", "brown": "#6b4327", "olive": "#6f7032", "green": "#2e7d32",
    "lime": "#93b82e", "mint": "#a4d8b8", "emerald": "#1f8a5b", "teal": "#19757a", "turquoise": "#2fa9a4",
    "cyan": "#2ab0c5", "blue": "#1f4fa3", "navy": "#1c2b57", "sapphire": "#1f3f8f", "indigo": "#3a2f86",
    "purple": "#6d2c91", "violet": "#6f45ad", "lavender": "#b5a3d9", "lilac": "#b79ac9",
    "magenta": "#b3258a", "pink": "#e08aa9", "rose": "#cf7385", "black": "#232325", "charcoal": "#38393c",
    "grey": "#808285", "white": "#ecebe7",
    "snow white": "#f0f1f2", "jet black": "#18181a", "sky blue": "#79b4dd", "royal blue": "#2c4fb8",
    "navy blue": "#1c2b57", "forest green": "#24532d", "olive green": "#6f7032", "lime green": "#93b82e",
    "jade green": "#3f9a72", "brick red": "#93402f", "blood red": "#7c1015", "ruby red": "#8f1231",
    "wine red": "#5a1a2a", "chocolate brown": "#47291b",
}  # fmt: skip
"""Colours of paint, display values; purer ones are met in lamps only."""

ALSO_COLORS = {
    "gray": "grey", "reddish": "red", "orangish": "orange", "yellowish": "yellow", "brownish": "brown",
    "greenish": "green", "bluish": "blue", "purplish": "purple", "pinkish": "pink", "greyish": "grey",
    "grayish": "grey", "whitish": "white", "blackish": "black", "golden yellow": "yellow",
}  # fmt: skip
"""Other words for them."""

SHADES = {
    "dark": 0.62, "deep": 0.75, "light": 1.5, "pale": 1.6, "bright": 1.25,
}  # fmt: skip
"""Factors on lightness; above 1, the distance to white is divided by them."""

DETAIL = 0.35
"""Least part of a texture's variation of lightness that is kept, near black and near white [1]."""

HUES = 0.3
"""Part of a texture's variation of hue that is kept [1]."""

_TO_LMS = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_TO_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


@dataclass(frozen=True)
class Tint:
    """The colour that a prompt gives to a material.

    Attributes:
        color: A name of `COLORS`; None for the material's own.
        shade: Factor on lightness, see `SHADES`.
    """

    color: str | None = None
    shade: float = 1.0

    def on(self, texture: np.ndarray) -> np.ndarray:
        """A texture in this colour, display values in [0, 1], shape (H, W, 3), float32."""
        lab = oklab(np.asarray(texture, np.float64))
        mean = lab.mean(axis=(0, 1))
        goal = mean if self.color is None else oklab(color(COLORS[self.color]))
        lightness = goal[0] * self.shade if self.shade <= 1.0 else 1.0 - (1.0 - goal[0]) / self.shade
        room = min(lightness / max(mean[0], 1e-3), (1.0 - lightness) / max(1.0 - mean[0], 1e-3))
        kept = float(np.clip(room, DETAIL, 1.0))
        hues = 1.0 if self.color is None else HUES
        shift = (lab - mean) * np.array([kept, hues, hues])
        moved = np.array([lightness, goal[1], goal[2]]) + shift
        return np.clip(from_oklab(moved), 0.0, 1.0).astype(np.float32)


def oklab(display: np.ndarray) -> np.ndarray:
    """Lightness, green to red and blue to yellow of display values (..., 3) in [0, 1]."""
    return np.cbrt(np.maximum(display, 0.0) ** GAMMA @ _TO_LMS.T) @ _TO_LAB.T


def from_oklab(lab: np.ndarray) -> np.ndarray:
    """Display values of Oklab (..., 3); outside [0, 1] where no display shows the colour."""
    linear = (lab @ np.linalg.inv(_TO_LAB).T) ** 3 @ np.linalg.inv(_TO_LMS).T
    return np.maximum(linear, 0.0) ** (1.0 / GAMMA)
