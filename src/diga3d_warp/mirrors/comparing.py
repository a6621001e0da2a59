"""Photographs of a support against the mirror image that it would show.

A mirror adds its image to the support's own colours, whatever these are: in linear light a texel of colour b
shows b + gloss * (m - room) * cover, with m the colour of the mirrored object and `room` that of what the
object hides from the mirror. So the mean over photographs is taken from every texel first, and what is left
is explained by the mirror image, taken from its mean alike (a fit with fixed effects). A shadow, a stain or a
texture is the same in all photographs of a texel, and falls out.

What lies behind a pane moves like a mirror image, and may have an outline like the object's. It has not its
colours: so a mirror image must explain more than its outline does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diga3d_warp.materials.painting import GAMMA
from diga3d_warp.mirrors.reflection import Reflection
from diga3d_warp.mirrors.settings import MIRRORS, MirrorSettings
from diga3d_warp.surfaces.chart import Frame
from diga3d_warp.surfaces.look import Look, density_of, look, sampled
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.settings import SURFACES

GLOSSES = np.linspace(0.0, 1.0, 201)
"""Reflectances that are tried."""


@dataclass(frozen=True, eq=False)
class Seen:
    """Photographs of a support's texels.

    Attributes:
        colors: Linear colours, shape (V, H, W, 3), float32.
        shown: Where each photograph shows the support, shape (V, H, W), bool.
        looks: Where its texels lie in each photograph.
    """

    colors: np.ndarray
    shown: np.ndarray
    looks: list[Look]

    def under(self, reflections: Sequence[Reflection]) -> Covered:
        """The mirrored object at the texels."""
        import cv2

        def at(view: Look, image: np.ndarray) -> np.ndarray:
            return np.asarray(cv2.remap(image, view.column, view.row, cv2.INTER_LINEAR), np.float32)

        pairs = list(zip(self.looks, reflections, strict=True))
        return Covered(
            np.stack([at(view, image.cover) for view, image in pairs]),
            np.stack([at(view, image.color) for view, image in pairs]),
        )


@dataclass(frozen=True, eq=False)
class Covered:
    """The mirrored object at a support's texels.

    Attributes:
        cover: Part of it that the object takes in each photograph, shape (V, H, W), float32.
        color: Its linear colour times that part, shape (V, H, W, 3), float32.
    """

    cover: np.ndarray
    color: np.ndarray

    def told(self, seen: Seen, settings: MirrorSettings = MIRRORS) -> np.ndarray:
        """Texels that photographs show with the mirror image and without it, shape (H, W), bool."""
        with_it = (seen.shown & (self.cover > settings.covered)).any(axis=0)
        without = (seen.shown & (self.cover < settings.bare)).any(axis=0)
        return np.asarray(with_it & without & (seen.shown.sum(axis=0) >= settings.views_least))


@dataclass(frozen=True)
class Fitted:
    """A mirror image fitted to photographs.

    Attributes:
        gloss: Reflectance of the support [1].
        room: Linear colour of what the object hides from the mirror, three channels.
    """

    gloss: float
    room: tuple[float, float, float]


def see(
    photos: Sequence[Photo], frame: Frame, surface: np.ndarray, height: float,
    settings: MirrorSettings = MIRRORS,
) -> Seen:  # fmt: skip
    """Look at a support in all photographs.

    Args:
        photos: Views, the object taken out.
        frame: Chart of the support.
        surface: Its extent, shape (H, W), bool.
        height: Of the object [scene units].
        settings: What hides the support.
    """
    points = frame.points
    colors, shown, looks = [], [], []
    for photo in photos:
        view = look(photo, points, SURFACES, frame.axes[2])
        dense = density_of(frame, points, photo.camera, SURFACES) > 0.0
        before = stands_before(
            photo.depth[np.rint(view.row).astype(int), np.rint(view.column).astype(int)], view.z,
            float(frame.coordinates(photo.camera.center)[2]), height, settings,
        )  # fmt: skip
        colors.append(sampled(photo, view) ** np.float32(GAMMA))
        shown.append(view.clear & dense & surface & ~before)
        looks.append(view)
    return Seen(np.stack(colors), np.stack(shown), looks)


def stands_before(
    depth: np.ndarray, z: np.ndarray, above: float, height: float, settings: MirrorSettings = MIRRORS
) -> np.ndarray:
    """Where something stands on the support, before the place at depth `z`, bool.

    Args:
        depth: That is seen there [scene units]; zero or NaN where nothing is known.
        z: Of the support, of the same shape.
        above: Height of the camera over the support [scene units].
        height: Of the object [scene units].
        settings: How high it must stand.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((depth > 0.0) & ((1.0 - depth / z) * above > settings.hidden * height))


class Comparison:
    """Photographs of some texels, each without its mean.

    Args:
        seen: The photographs.
        domain: Texels that are compared, shape (H, W), bool.
        bare: Where no mirror image is, shape (V, H, W), bool: tones are evened there.
        settings: Noise, rounds, bounds.

    Attributes:
        view: Photograph of each sample, shape (S,).
    """

    def __init__(
        self, seen: Seen, domain: np.ndarray, bare: np.ndarray, settings: MirrorSettings = MIRRORS
    ) -> None:
        self._settings = settings
        self._used = seen.shown & domain
        texels = np.arange(domain.size).reshape(domain.shape)
        views = np.arange(len(self._used))[:, None, None]
        self._shape = domain.shape
        self._texel, self.view = (
            np.broadcast_to(each, self._used.shape)[self._used] for each in (texels, views)
        )
        colors = seen.colors[self._used].astype(np.float64)
        beside = bare[self._used]
        for _ in range(2):
            colors = self._without_mean(colors)
            for number in range(len(self._used)):
                own = self.view == number
                if (own & beside).sum() >= settings.texels_least:
                    colors[own] -= np.median(colors[own & beside], axis=0)
        self._colors = self._without_mean(colors)
        self._weight = np.ones(len(colors))

    def weigh(self, covered: Covered) -> None:
        """Give texels that a mirror image leaves unexplained less weight, such as edges and glints."""
        import cv2

        for _ in range(self._settings.rounds):
            left = (self.left(covered, self.fit(covered)) ** 2).mean(axis=1)
            total = np.bincount(self._texel, left, self._shape[0] * self._shape[1])
            count = np.bincount(self._texel, minlength=self._shape[0] * self._shape[1])
            around = [
                cv2.GaussianBlur(each.reshape(self._shape).astype(np.float32), (0, 0), 1.0)
                for each in (total, count)
            ]
            variance = around[0] / np.maximum(around[1], 1e-6)
            self._weight = 1.0 / (variance.ravel()[self._texel] + self._settings.noise**2)

    def fit(self, covered: Covered) -> Fitted:
        """The gloss and the room that explain the photographs best."""
        cover, color = self._parts(covered)
        weight, seen = self._weight, self._colors
        weighed = weight * cover
        own = float(weighed @ cover)
        if not own > 0.0:
            return Fitted(0.0, (0.0, 0.0, 0.0))
        # For a given gloss, the room of each channel has a closed form.
        across = weighed @ color
        light = (GLOSSES[:, None] * across - weighed @ seen) / own
        light = np.clip(light, 0.0, self._settings.brightest * GLOSSES[:, None])
        squares = (weight[:, None] * color**2).sum(axis=0)
        products = (weight[:, None] * color * seen).sum(axis=0)
        cost = (
            GLOSSES[:, None] ** 2 * squares
            - 2.0 * GLOSSES[:, None] * products
            - 2.0 * GLOSSES[:, None] * light * across
            + 2.0 * light * (weighed @ seen)
            + light**2 * own
        ).sum(axis=1)
        best = int(cost.argmin())
        gloss = float(GLOSSES[best])
        room = light[best] / max(gloss, 1e-9)
        return Fitted(gloss, (float(room[0]), float(room[1]), float(room[2])))

    def detail(self, covered: Covered, rows: np.ndarray) -> tuple[float, float]:
        """What the colours of the mirrored object explain beyond its outline, of any one colour.

        Args:
            covered: The mirrored object.
            rows: Samples to use.

        Returns:
            Gloss by that alone, and the part that it explains of what the outline leaves [1].
        """
        cover, color = self._parts(covered)
        weight, cover, color = self._weight[rows], cover[rows], color[rows]
        own = max(float((weight * cover) @ cover), 1e-12)

        def beyond_outline(values: np.ndarray) -> np.ndarray:
            return np.asarray(values - cover[:, None] * ((weight * cover) @ values) / own)

        seen, color = beyond_outline(self._colors[rows]), beyond_outline(color)
        squares, total = ((weight[:, None] * each**2).sum() for each in (color, seen))
        product = float((weight[:, None] * color * seen).sum())
        gloss = product / max(float(squares), 1e-12)
        return gloss, gloss * product / max(float(total), 1e-12)

    def made(self, covered: Covered, fitted: Fitted) -> np.ndarray:
        """What a mirror image makes of the samples, without its mean, shape (S, 3)."""
        cover, color = self._parts(covered)
        return fitted.gloss * (color - cover[:, None] * np.array(fitted.room))

    def left(self, covered: Covered, fitted: Fitted) -> np.ndarray:
        """What it leaves unexplained, shape (S, 3)."""
        return self._colors - self.made(covered, fitted)

    def explained(self, covered: Covered, fitted: Fitted, rows: np.ndarray | None = None) -> float:
        """Part of the weighted squares that it explains, of all samples or some [1]."""
        chosen = slice(None) if rows is None else rows
        weight = self._weight[chosen, None]
        before = float((weight * self._colors[chosen] ** 2).sum())
        after = float((weight * self.left(covered, fitted)[chosen] ** 2).sum())
        return 1.0 - after / max(before, 1e-12)

    def inside(self, covered: Covered) -> np.ndarray:
        """Samples that the mirror image covers, shape (S,), bool."""
        return np.asarray(covered.cover[self._used] > self._settings.covered)

    def _parts(self, covered: Covered) -> tuple[np.ndarray, np.ndarray]:
        cover = covered.cover[self._used].astype(np.float64)
        color = covered.color[self._used].astype(np.float64)
        return self._without_mean(cover[:, None])[:, 0], self._without_mean(color)

    def _without_mean(self, values: np.ndarray) -> np.ndarray:
        size = self._shape[0] * self._shape[1]
        count = np.maximum(np.bincount(self._texel, minlength=size), 1)
        means = np.stack([np.bincount(self._texel, channel, size) / count for channel in values.T], axis=1)
        return np.asarray(values - means[self._texel])
