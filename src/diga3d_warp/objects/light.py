"""The light that falls on an object, estimated from how bright its surface is in each direction.

On a matte surface under distant light, brightness is a smooth function of the normal that nine spherical
harmonics describe (Ramamoorthi and Hanrahan 2001). Here they describe its logarithm, in which light and paint
add up: paint does not follow the normal, so a fit over all of the surface keeps the light and averages the
paint out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.objects.surface import Surface

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear RGB (ITU-R BT.709)."""


@dataclass(frozen=True)
class LightSettings:
    """Thresholds of separating light from texture.

    Attributes:
        ridge: Weight that pulls each harmonic to zero [share of the surface], by degree. A surface seen from
            one side only does not determine the light of the others.
        black: Luminance under which a pixel is black [1], one step of 8 bits: its logarithm is not used.
        darkest, brightest: Bounds of the shading [times its mean]: beyond them the fit follows texture.
        shoulder: Linear brightness from which on highlights are compressed [1], as cameras do: white marble
            in the sun keeps its veins.
        blur: Radius over which brightness is averaged that does not follow the normal: shade in hollows and
            cast shadows, which are kept [spacings of the surface]. A seventieth of an object: four times as
            much took eyes and mouth out of a stone bear.
        kept: Part of that brightness that is kept on an object of one hue [1].
        hues: Deviation of chromaticity at which an object is painted in several hues: then broad brightness
            tells of paint, and only exp(-1) of `kept` is kept, falling on as a gaussian. A weathered stone
            figure outdoors had 0.05, the painted vase of the synthetic room has 0.19.
        deepest: Bound of it [logarithm].
        albedo: What share of the light the surfaces of a scene send back on average: photographers' grey is
            0.18; rooms and streets measured come to 0.2 to 0.4.
        level_bounds: Bounds of the light [albedo 1 = white], against captures of one colour.
    """

    ridge: tuple[float, float, float] = (0.0, 0.01, 0.04)
    black: float = 5e-4
    darkest: float = 0.35
    brightest: float = 1.9
    shoulder: float = 0.55
    blur: float = 1.0
    kept: float = 1.0
    hues: float = 0.1
    deepest: float = 1.0
    albedo: float = 0.3
    level_bounds: tuple[float, float] = (0.35, 0.95)


LIGHT = LightSettings()


@dataclass(frozen=True, eq=False)
class Light:
    """Light by the direction that a surface faces.

    Attributes:
        coefficients: Of the nine harmonics of `basis`, whose sum is the logarithm of the light relative to
            `level`, shape (9,).
        level: Mean light on the object: 1 shows a white surface as white.
    """

    coefficients: np.ndarray
    level: float

    def shading(self, normals: np.ndarray) -> np.ndarray:
        """Light on surfaces with these unit normals (P, 3), relative to the mean, shape (P,)."""
        return np.clip(np.exp(basis(normals) @ self.coefficients), LIGHT.darkest, LIGHT.brightest)

    def on(self, normals: np.ndarray) -> np.ndarray:
        """Light on surfaces with these unit normals (P, 3): linear colour = albedo * this, shape (P,)."""
        return self.level * self.shading(normals)


def basis(normals: np.ndarray) -> np.ndarray:
    """The real harmonics of degree 0, 1 and 2 without their factors, shape (P, 9)."""
    x, y, z = normals[:, 0], normals[:, 1], normals[:, 2]
    one = np.ones_like(x)
    return np.stack([one, x, y, z, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1], axis=1)


def brightness(colors: np.ndarray) -> np.ndarray:
    """Logarithm of the luminance of display colours (P, 3), shape (P,)."""
    return np.log(np.maximum(np.maximum(colors, 0.0) ** GAMMA @ LUMINANCE, LIGHT.black))


def shade_beyond(light: Light, surface: Surface) -> np.ndarray:
    """Light at the points of a surface relative to that by normals, shape (M,): hollows, shadows."""
    left = brightness(surface.colors) - np.log(light.on(surface.normals))
    broad = surface.blurred(left, LIGHT.blur)
    broad = broad - np.median(broad)
    linear = np.maximum(surface.colors, 1e-3) ** GAMMA
    chromaticity = linear / linear.sum(axis=1, keepdims=True)
    kept = LIGHT.kept * np.exp(-((chromaticity.std(axis=0).max() / LIGHT.hues) ** 2))
    return np.exp(kept * np.clip(broad, -LIGHT.deepest, LIGHT.deepest))


def exposed(linear: np.ndarray) -> np.ndarray:
    """Display values in [0, 1] of linear light, of any shape, with compressed highlights."""
    room = 1.0 - LIGHT.shoulder
    over = np.maximum(linear - LIGHT.shoulder, 0.0)
    compressed = np.minimum(linear, LIGHT.shoulder) + room * (1.0 - np.exp(-over / room))
    return np.clip(compressed, 0.0, 1.0) ** (1.0 / GAMMA)


def estimate_light(normals: np.ndarray, colors: np.ndarray, surroundings: np.ndarray) -> Light:
    """The light on an object.

    Args:
        normals: Of points of its surface, shape (M, 3).
        colors: Their display RGB, shape (M, 3).
        surroundings: Display RGB of pixels around the object and of the object, shape (S, 3): their mean
            brightness over `LIGHT.albedo` is the level.
    """
    bright = brightness(colors)
    harmonics = basis(normals)
    ridge = np.repeat(LIGHT.ridge, (1, 3, 5)) * len(normals)
    solution = np.linalg.solve(harmonics.T @ harmonics + np.diag(ridge + 1e-9), harmonics.T @ bright)
    solution[0] -= np.log(np.exp(harmonics @ solution).mean())
    around = float((surroundings**GAMMA @ LUMINANCE).mean())
    level = float(np.clip(around / LIGHT.albedo, *LIGHT.level_bounds))
    return Light(solution, level)
