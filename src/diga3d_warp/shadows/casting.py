"""What an object hides of a light from each place of its support, worked out from its gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from diga3d_warp.surfaces.chart import Frame

LOWEST = 8.0
"""Least elevation of a light [degrees]: the shadow of a lower one is longer than any chart."""

DISC, FEW = ((0.0, 1), (0.5, 4), (0.9, 8)), ((0.0, 1), (0.7, 4))
"""Samples of a lamp: their radius [radii of the lamp] and number. A penumbra of 13 steps looks smooth; 5 tell
where a lamp is."""

RINGS = (12.0, 20.0, 30.0, 42.0, 55.0, 70.0, 85.0)
"""Elevations of the samples of a sky [degrees]."""

AROUND = 24
"""Samples of a sky on a ring at the horizon; those above hold fewer in proportion."""

NEAREST = 0.2
"""Least height of a lamp over what it lights, as a part of its height over the support [ratio]."""


class Lamp(NamedTuple):
    """A round lamp.

    Attributes:
        azimuth, elevation: Direction from the object's foot, in the axes of the chart [degrees].
        nearness: Height of the object over that of the lamp [ratio]; zero for the sun.
        radius: Its angular radius [degrees].
    """

    azimuth: float
    elevation: float
    nearness: float
    radius: float


class Caster:
    """An object that casts shadows.

    Args:
        frame: Chart of its support.
        points: Means of its gaussians [scene units], shape (P, 3).
        widths: Their middle standard deviations [scene units], shape (P,).
        floor: Height from which on they are no support [scene units].

    Attributes:
        frame: As above.
        height: Of the object over its support [scene units].
        foot: Middle of the object [u, v in scene units].
    """

    def __init__(self, frame: Frame, points: np.ndarray, widths: np.ndarray, floor: float) -> None:
        import cv2

        local = frame.coordinates(points)
        above = local[:, 2] > floor
        self.frame, self._local = frame, local[above]
        self.height = float(np.quantile(self._local[:, 2], 0.98))
        self.foot = np.median(self._local[:, :2], axis=0)
        radius = int(np.clip(np.ceil(2.0 * np.median(widths[above]) / frame.texel), 1, 4))
        self._disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)

    @property
    def away(self) -> np.ndarray:
        """Distance of texels from the object's foot [scene units], shape (H, W)."""
        rows, columns = np.indices(self.frame.size)
        column, row = self.frame.texels(*self.foot)
        return np.hypot(rows - row, columns - column) * self.frame.texel

    def hidden(self, direction: np.ndarray, nearness: float = 0.0) -> np.ndarray:
        """Where the object hides a point light, shape (H, W), float32 in [0, 1].

        Args:
            direction: Towards the light, in the axes of the chart with the third upwards, unit length.
            nearness: As in `Lamp`.
        """
        u, v, height = self._local.T
        slope = direction[:2] / direction[2]
        if nearness > 0.0:
            top = self.height / nearness
            x, y = self.foot + slope * top
            spread = top / np.maximum(top - height, NEAREST * top)
            u, v = x + (u - x) * spread, y + (v - y) * spread
        else:
            u, v = u - height * slope[0], v - height * slope[1]
        return self._outline(u, v)

    def _outline(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The area that points cover, without holes between them."""
        import cv2

        rows, columns = self.frame.size
        column, row = self.frame.texels(u, v)
        inside = (column >= -0.5) & (column < columns - 0.5) & (row >= -0.5) & (row < rows - 0.5)
        area: np.ndarray = np.zeros((rows, columns), np.uint8)
        area[np.rint(row[inside]).astype(int), np.rint(column[inside]).astype(int)] = 1
        area = cv2.dilate(area, self._disc)
        outlines, _ = cv2.findContours(area, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(area, outlines, -1, 1, -1)
        return cv2.GaussianBlur(cv2.erode(area, self._disc).astype(np.float32), (0, 0), 0.7)

    def shade(self, lamp: Lamp, disc: Sequence[tuple[float, int]] = DISC) -> np.ndarray:
        """Share of a lamp that the object hides, shape (H, W), float32, by samples of the lamp's disc."""
        elevation, azimuth = np.radians(np.clip(lamp.elevation, LOWEST, 89.9)), np.radians(lamp.azimuth)
        ahead = _direction(azimuth, elevation)
        aside = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        above = np.cross(ahead, aside)
        spread = np.tan(np.radians(np.clip(lamp.radius, 0.0, 45.0)))
        found, count = np.zeros(self.frame.size, np.float32), 0
        for radius, number in disc:
            for turn in 2.0 * np.pi * np.arange(number) / number:
                towards = ahead + spread * radius * (np.cos(turn) * aside + np.sin(turn) * above)
                towards[2] = max(towards[2], np.sin(np.radians(LOWEST)))
                found += self.hidden(towards / np.linalg.norm(towards), max(lamp.nearness, 0.0))
                count += 1
        return found / count

    def shade_of_sky(self) -> np.ndarray:
        """Share of the light of an even sky that the object hides, shape (H, W), float32."""
        found, total = np.zeros(self.frame.size, np.float32), 0.0
        for elevation in np.radians(RINGS):
            number = max(round(AROUND * float(np.cos(elevation))), 1)
            weight = float(np.cos(elevation) * np.sin(elevation)) / number
            for azimuth in 2.0 * np.pi * np.arange(number) / number:
                found += weight * self.hidden(_direction(azimuth, elevation))
            total += weight * number
        return found / total


def _direction(azimuth: float, elevation: float) -> np.ndarray:
    return np.array(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    )
