"""Look of polished metal, which mirrors its surroundings.

Gaussians fitted to views that agree show a surface whose colour does not turn with the viewer. So each point
shows what a viewer right in front of it, looking level, would see mirrored there: the room as it mostly is,
bright above, darkest where the floor ends, some light back from the floor, and a window behind the viewers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diga3d_warp.materials.painting import GAMMA


@dataclass(frozen=True)
class Surroundings:
    """Reflected surroundings of a metal, as a factor on its own linear colour.

    Attributes:
        elevations: At which the surroundings are given, from straight down to straight up [degrees].
        brightness: There. Its mean over a ball is about 1, so that a metal is no brighter than it was matte.
        window: Direction of the normal that mirrors the window, in the object's frame: up and to the left of
            the viewers, who stand at -y.
        window_size: Concentration of its highlight about that normal [1]: half as bright 13 degrees off.
        window_brightness: Share of white in its middle.
    """

    elevations: tuple[float, ...] = (-90.0, -45.0, -14.0, 2.0, 25.0, 60.0, 90.0)
    brightness: tuple[float, ...] = (0.65, 0.85, 0.3, 0.5, 1.1, 1.5, 1.25)
    window: tuple[float, float, float] = (-0.36, -0.72, 0.6)
    window_size: float = 25.0
    window_brightness: float = 0.75


SURROUNDINGS = Surroundings()


def polished(colors: np.ndarray, normals: np.ndarray, polish: float) -> np.ndarray:
    """Colours of a surface that mirrors its surroundings.

    Args:
        colors: Colours of the metal, display RGB in [0, 1], shape (P, 3).
        normals: Unit length, in the object's frame, z upwards, shape (P, 3).
        polish: Share of the mirror reflection, in [0, 1].

    Returns:
        Display RGB in [0, 1], shape (P, 3), still without the light on the object.
    """
    if polish == 0.0:
        return colors
    s = SURROUNDINGS
    # A level ray that meets a surface tilted up by some angle leaves it tilted by twice that.
    elevation = np.clip(2.0 * np.degrees(np.arcsin(np.clip(normals[:, 2], -1.0, 1.0))), -90.0, 90.0)
    mirrored = np.interp(elevation, s.elevations, s.brightness)[:, None]
    towards = np.array(s.window) / np.linalg.norm(s.window)
    window = s.window_brightness * np.exp(s.window_size * (normals @ towards - 1.0))[:, None]
    linear = colors**GAMMA
    shown = linear * mirrored
    shown += window * np.maximum(1.0 - shown, 0.0)
    return np.clip(linear + polish * (shown - linear), 0.0, 1.0) ** (1.0 / GAMMA)
