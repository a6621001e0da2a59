"""Whether a calibration is plausible, and whether it fits the photographs.

What looks like another unit or origin is noted, never changed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera


@dataclass(frozen=True)
class PlausibleCalibration:
    """Limits of a plausible calibration; one beyond them is used, with a note. No benchmark capture is.

    Attributes:
        off_middle: Distance of the principal point from the middle of the image, in widths or heights
            [ratio]. Calibrated cameras stay below 0.05; windows cut out of photographs may lie farther off.
        widest, narrowest: Field of view of the longer side without a fisheye [degrees]. Lenses of 9 mm and of
            1600 mm on full format have 127 and 1.3.
        widest_fisheye: Field of view of the longer side with one [degrees]: lenses reach 280.
        stretch: Focal lengths along the two axes may differ by this share [ratio]. Pixels of digital cameras
            are square; those of anamorphic film are not, by up to 2.
        unreached: Share of the image that the lens model may not reach [ratio]. A calibrated lens reaches all
            of it, but for the corners of a circular fisheye; one of the wrong sign folds over.
    """

    off_middle: float = 0.25
    widest: float = 140.0
    narrowest: float = 0.5
    widest_fisheye: float = 300.0
    stretch: float = 0.05
    unreached: float = 0.005


@dataclass(frozen=True)
class SizeLimits:
    """Sizes of photographs as they are read.

    Attributes:
        aspect: A photograph may differ from its calibration in aspect ratio by this share [ratio]: rounding
            in images_8 of a 400 px image makes 1 %.
        rounding: Or by what this many pixels in width and height make [px]: sizes of copies are rounded.
        smallest: Smallest width and height of a view [px]: the window of structural similarity, of which each
            view must hold one.
    """

    aspect: float = 0.02
    rounding: float = 1.0
    smallest: int = 11


PLAUSIBLE = PlausibleCalibration()
SIZES = SizeLimits()

_SAMPLES = 64  # along each side of an image


def fits(camera: Camera, width: int, height: int) -> bool:
    """Whether a photograph of this size has the aspect ratio of a calibration, but for rounding."""
    if abs(width * camera.height / (height * camera.width) - 1.0) <= SIZES.aspect:
        return True
    # Some scale must round to the width, and to the height.
    least = max((width - SIZES.rounding) / camera.width, (height - SIZES.rounding) / camera.height)
    most = min((width + SIZES.rounding) / camera.width, (height + SIZES.rounding) / camera.height)
    return least <= most


def check_sizes(cameras: Mapping[str, Camera], image_scale: float) -> None:
    """Refuse views that are too small to fit.

    Args:
        cameras: Camera of each view at its size, by name.
        image_scale: Scale that was asked for.

    Raises:
        InputError: a view is smaller than `SIZES.smallest`.
    """
    name, camera = min(cameras.items(), key=lambda item: min(item[1].width, item[1].height))
    side = min(camera.width, camera.height)
    if side >= SIZES.smallest:
        return
    needed = math.ceil(100.0 * image_scale * SIZES.smallest / side) / 100.0
    remedy = f"--image-scale {needed:g} or more" if needed <= 1.0 else "larger photographs"
    raise InputError(
        f"image {name}: {camera.width} x {camera.height} px are too few to fit, {SIZES.smallest} a side are "
        f"needed; use {remedy}"
    )


def field_of_view(camera: Camera) -> float:
    """Angle of the longer side [degrees], distortion left out; equidistant for a fisheye."""
    half = 0.5 * max(camera.width / camera.fx, camera.height / camera.fy)
    fisheye = camera.distortion is not None and camera.distortion.kind == "fisheye"
    return 2.0 * math.degrees(half if fisheye else math.atan(half))


def _off_middle(camera: Camera) -> str | None:
    x, y = camera.cx / camera.width - 0.5, camera.cy / camera.height - 0.5
    if max(abs(x), abs(y)) <= PLAUSIBLE.off_middle:
        return None
    where = "outside" if max(abs(x), abs(y)) > 0.5 else "far from the middle of"
    return (
        f"the principal point ({camera.cx:g}, {camera.cy:g}) px lies {where} an image of {camera.width} x "
        f"{camera.height} px: cx and cy count pixels from the top left corner"
    )


def _odd_view(camera: Camera) -> str | None:
    angle = field_of_view(camera)
    fisheye = camera.distortion is not None and camera.distortion.kind == "fisheye"
    if PLAUSIBLE.narrowest <= angle <= (PLAUSIBLE.widest_fisheye if fisheye else PLAUSIBLE.widest):
        return None
    return (
        f"a focal length of {camera.fx:g} px gives {camera.width} x {camera.height} px a field of view of "
        f"{angle:.3g} degrees: focal lengths are in pixels"
    )


def _stretched(camera: Camera) -> str | None:
    if abs(camera.fx / camera.fy - 1.0) <= PLAUSIBLE.stretch:
        return None
    return f"focal lengths of {camera.fx:g} and {camera.fy:g} px mean pixels that are not square"


def _folded(camera: Camera) -> str | None:
    share = unreached_share(camera)
    if share <= PLAUSIBLE.unreached or _odd_view(camera) is not None:
        return None
    return (
        f"the lens model reaches no more than {1.0 - share:.0%} of the image, and the rest shows nothing: "
        "check its coefficients"
    )


def unreached_share(camera: Camera) -> float:
    """Share of the image that lies beyond the fold of the lens, or 90 degrees off the axis of a fisheye.

    Tangential distortion is left out.
    """
    from diga3d_warp.kernels.cameras import valid_radius

    lens = camera.distortion
    if lens is None:
        return 0.0
    radius = valid_radius(lens.kind, lens.coefficients)
    if lens.kind == "fisheye":
        radius, radial = math.atan(radius), lens.coefficients
    else:
        k1, k2, _, _, k3 = (*lens.coefficients, 0.0)[:5]
        radial = (k1, k2, k3)
    if not math.isfinite(radius):
        return 0.0
    farthest = radius * (1.0 + sum(k * radius ** (2 * power) for power, k in enumerate(radial, start=1)))
    samples = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    x = (samples * camera.width - camera.cx) / camera.fx
    y = (samples * camera.height - camera.cy) / camera.fy
    return float((np.hypot(x, y[:, None]) > farthest).mean())


_CHECKS: tuple[Callable[[Camera], str | None], ...] = (_off_middle, _odd_view, _stretched, _folded)


def calibration_notes(cameras: Mapping[str, Camera]) -> list[str]:
    """Notes on implausible cameras of a capture: one line for each kind, with an example."""
    notes = []
    for check in _CHECKS:
        odd = {name: said for name, camera in cameras.items() if (said := check(camera)) is not None}
        if odd:
            name, said = next(iter(odd.items()))
            others = f", and {len(odd) - 1} more of {len(cameras)} cameras likewise" if len(odd) > 1 else ""
            notes.append(f"{name}: {said}{others}")
    return notes
