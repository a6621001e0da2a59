"""Find the mirror image of an object in its support."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diga3d_warp.mirrors.comparing import Comparison, Covered, Seen, see
from diga3d_warp.mirrors.reflection import MIRROR, Placing, Reflection
from diga3d_warp.mirrors.settings import MIRRORS, MirrorSettings
from diga3d_warp.scene.camera import Camera
from diga3d_warp.shadows.support import Solid, Support
from diga3d_warp.surfaces.chart import Chart, Frame, sized
from diga3d_warp.surfaces.photo import Photo
from diga3d_warp.surfaces.texture import textured

UNRIVALLED = 1e3
"""Ratio where the object explains nothing elsewhere."""

Reflect = Callable[[Placing], Sequence[Reflection]]
"""The mirror images of the object in all photographs, for a place of the mirrored object."""


@dataclass(frozen=True, eq=False)
class Mirror:
    """A support that mirrors an object.

    Attributes:
        frame: Its chart.
        surface: Its extent, shape (H, W), bool.
        height: Of the object [scene units].
        floor: Depth under it down to which a gaussian lies on it [scene units].
    """

    frame: Frame
    surface: np.ndarray
    height: float
    floor: float


@dataclass(frozen=True)
class MirrorEvidence:
    """What speaks for a mirror image.

    Attributes:
        gloss: Reflectance of the support, by the colours of the mirrored object [1].
        detail: Part that these explain of what its outline leaves unexplained [1].
        strength: Deviation that the mirror image makes where it lies [linear light].
        explained: Part that colours and outline explain of how photographs differ there [1].
        beyond: Ratio of `detail` to that of the object elsewhere under the support [1]; None where the rest
            is not enough to ask.
        alike: Part of the photographs that show half the least gloss on their own [1].
    """

    gloss: float
    detail: float
    strength: float
    explained: float
    beyond: float | None
    alike: float

    def suffices(self, settings: MirrorSettings = MIRRORS) -> bool:
        """Whether this is a mirror image."""
        return (
            self.gloss >= settings.gloss
            and self.detail >= settings.detail
            and self.strength >= settings.strength
            and self.explained >= settings.explained
            and (self.beyond is None or self.beyond >= settings.beyond)
            and self.alike >= settings.alike
        )


def find_mirror(
    photos: Sequence[Photo], solid: Solid, support: Support, reflect: Reflect,
    settings: MirrorSettings = MIRRORS,
) -> tuple[Mirror, MirrorEvidence] | None:  # fmt: skip
    """The mirror image of an object, with what speaks for it; None where there is nothing to tell it by.

    Args:
        photos: Views, the object taken out.
        solid: The object's gaussians.
        support: What it stands on.
        reflect: Renders the mirrored object.
        settings: Thresholds.
    """
    frame = framed(solid, support, [photo.camera for photo in photos], settings)
    if frame is None:
        return None
    surface = extent(textured(photos, frame), settings)
    seen = see(photos, frame, surface, support.height, settings)
    here = seen.under(reflect(MIRROR))
    domain = here.told(seen, settings)
    if domain.sum() < settings.texels_least:
        return None
    comparison = Comparison(seen, domain, here.cover < settings.bare, settings)
    comparison.weigh(here)
    fitted, inside = comparison.fit(here), comparison.inside(here)
    made = comparison.made(here, fitted)[inside]
    gloss, detail = comparison.detail(here, inside)
    evidence = MirrorEvidence(
        gloss=gloss,
        detail=detail,
        strength=float(np.sqrt((made**2).mean())),
        explained=comparison.explained(here, fitted, inside),
        beyond=None,
        alike=_alike(comparison, here, inside, settings),
    )
    mirror = Mirror(frame, surface, support.height, support.floor)
    if evidence.suffices(settings):
        beyond = _beyond(solid, support, seen, here, reflect, settings)
        evidence = replace(evidence, beyond=beyond)
    return mirror, evidence


def framed(
    solid: Solid, support: Support, cameras: Sequence[Camera], settings: MirrorSettings = MIRRORS
) -> Frame | None:
    """A chart of the support wherever cameras see the mirrored object through it; None if none does."""
    frame = support.frame
    local = frame.coordinates(solid.points[solid.opacities > settings.covered])
    local = local[local[:, 2] > support.floor]
    if len(local) < 4:
        return None
    deepest = max(settings.stretches) * local[:, 2]
    foot, places = np.median(local[:, :2], axis=0), [local[:, :2]]
    for camera in cameras:
        eye = frame.coordinates(camera.center)
        if eye[2] > support.floor:
            share = (eye[2] / (eye[2] + deepest))[:, None]
            places.append(eye[:2] + share * (local[:, :2] - eye[:2]))
    most = settings.reach * support.height
    low, high = (np.quantile(np.concatenate(places), share, axis=0) for share in (0.01, 0.99))
    margin = 0.1 * support.height
    low, high = np.maximum(low - margin, foot - most), np.minimum(high + margin, foot + most)
    # Depth shows what lies behind a mirror: photographs that agree tell how far the support reaches.
    agreed = replace(frame, agreed=True)
    return sized(agreed, low, high, float((high - low).max()) / settings.texels)


def extent(chart: Chart, settings: MirrorSettings = MIRRORS) -> np.ndarray:
    """How far a support reaches, without the gaps where depth shows what it mirrors, shape (H, W), bool."""
    import cv2
    from scipy.ndimage import binary_fill_holes

    radius = max(1, round(settings.closed * max(chart.frame.size)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
    return np.asarray(
        binary_fill_holes(cv2.morphologyEx(chart.known.astype(np.uint8), cv2.MORPH_CLOSE, disc)), bool
    )


def _alike(comparison: Comparison, here: Covered, inside: np.ndarray, settings: MirrorSettings) -> float:
    """Part of the photographs, of those that show enough, that show half the least gloss."""
    found = []
    for number in np.unique(comparison.view[inside]):
        own = inside & (comparison.view == number)
        if own.sum() >= settings.texels_least:
            found.append(comparison.detail(here, own)[0] >= 0.5 * settings.gloss)
    return float(np.mean(found)) if found else 0.0


def _beyond(
    solid: Solid, support: Support, seen: Seen, here: Covered, reflect: Reflect, settings: MirrorSettings
) -> float:
    """What its colours explain, against the most that they do elsewhere under the support."""
    local = support.frame.coordinates(solid.points)
    width = settings.aside * float(np.ptp(np.quantile(local[:, :2], (0.05, 0.95), axis=0), axis=0).max())
    others = [Placing(stretch) for stretch in settings.stretches]
    others += [Placing(1.0, (a * width, b * width)) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    least = UNRIVALLED
    for placing in others:
        there = seen.under(reflect(placing))
        domain = here.told(seen, settings) | there.told(seen, settings)
        bare = (here.cover < settings.bare) & (there.cover < settings.bare)
        comparison = Comparison(seen, domain, bare, settings)
        comparison.weigh(here)
        either = comparison.inside(here) | comparison.inside(there)
        own, other = (comparison.detail(at, either) for at in (here, there))
        if other[0] > 0.0:
            least = min(least, own[1] / max(other[1], 1e-6))
    return float(least)
