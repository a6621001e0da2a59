"""EXIF orientation: whether calibration and masks refer to photographs as stored or upright.

Viewers and most editors show photographs upright. COLMAP calibrates them as stored (only between 3.7's pull
requests 1318 and 1406 it turned them), and so does 3DGS; nerfstudio's `ns-process-data` turns what it
re-encodes and leaves what it copies. Where a quarter turn changes the size, the size of calibration and of
masks decides. Where it does not, as for a photograph upside down, the colours of the sparse points decide for
the calibration, and edges along their outlines for masks.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.checks.calibration import fits
from diga3d_warp.scene.photographs.decoding import Header, read_header, turned
from diga3d_warp.scene.photographs.names import listed
from diga3d_warp.scene.scene import Points, View
from diga3d_warp.scene.visible_points import visible_points


@dataclass(frozen=True)
class OrientationSettings:
    """Thresholds for clear evidence of an orientation.

    Attributes:
        colors: How much smaller the mean colour difference between points and pixels must be one way than the
            other, as a fraction. Of a room upside down, it is 0.7.
        points: How many more points must be triangulated one way, as a fraction.
        outlines: How much stronger edges along the outlines of masks must be one way, as a fraction, and
        views: in what part of the views. Of a vase near the middle of its photographs, it is 0.25 and all.
    """

    colors: float = 0.15
    points: float = 0.5
    outlines: float = 0.08
    views: float = 0.75


SETTINGS = OrientationSettings()

_INVERSE = {6: 8, 8: 6}


def inverse(orientation: int) -> int:
    """The orientation that undoes another; all but quarter turns undo themselves."""
    return _INVERSE.get(orientation, orientation)


def is_upright(camera: Camera, header: Header) -> bool | None:
    """Whether a calibration means a photograph turned upright; None where its size does not tell.

    A photograph that needs no turn, or fits neither way, is taken as stored.
    """
    if header.orientation == 1:
        return False
    if header.orientation < 5:
        return None if fits(camera, header.width, header.height) else False
    stored, upright = (fits(camera, *size) for size in (header[:2], header[1::-1]))
    return None if stored and upright else upright


def turned_view(view: View, orientation: int) -> View:
    """A view without a mask, turned upright, with the camera of its calibration at that size."""
    pixels, alpha = turned(view.pixels, orientation), view.alpha
    height, width = pixels.shape[:2]
    return replace(
        view,
        camera=view.camera.resized(width, height),
        pixels=pixels,
        alpha=None if alpha is None else turned(alpha, orientation),
        orientation=1,
    )


@dataclass(frozen=True)
class Turns:
    """How photographs with an EXIF orientation are read.

    Attributes:
        orientations: EXIF orientation of each of them, by image.
        upright: Whether it is turned upright; None where its size does not tell what its calibration means.
    """

    orientations: Mapping[str, int]
    upright: Mapping[str, bool | None]

    def of(self, key: str) -> int:
        """The orientation that a photograph is turned by as it is read; 1 where that is in doubt."""
        return self.orientations[key] if self.upright.get(key) else 1

    def left(self, key: str) -> int:
        """The orientation that viewers turn a photograph by as it is read; 1 if it is upright."""
        return 1 if self.upright.get(key) else self.orientations.get(key, 1)

    @property
    def doubtful(self) -> dict[str, int]:
        """Orientations of the photographs whose size does not tell."""
        return {key: self.orientations[key] for key, upright in self.upright.items() if upright is None}

    def settled(self, upright: bool) -> Turns:
        """The same with the doubtful ones decided."""
        return replace(self, upright={key: upright if u is None else u for key, u in self.upright.items()})

    def masks(self, keys: Iterable[str]) -> dict[str, int]:
        """Of those in `keys`: the orientation to turn a mask by that is not turned as the photograph is."""
        return {
            key: self.orientations[key] if self.upright[key] else inverse(self.orientations[key])
            for key in keys
            if key in self.orientations
        }


def find_turns(cameras: Mapping[str, Camera], files: Mapping[str, Path]) -> Turns:
    """How to read photographs, by their calibration and the headers of their files."""
    orientations, upright = {}, {}
    for key, file in files.items():
        try:
            header = read_header(file)
        except InputError:
            continue  # who reads the file says so
        if header.orientation != 1:
            orientations[key], upright[key] = header.orientation, is_upright(cameras[key], header)
    return Turns(orientations, upright)


def fit_upright(views: Mapping[str, View], orientations: Mapping[str, int], points: Points) -> bool | None:
    """Whether the colours of sparse points are those of photographs turned upright, or as stored.

    Args:
        views: As stored, by image key.
        orientations: EXIF orientation of those that are in doubt.
        points: Sparse points.

    Returns:
        None where neither is clearly better.
    """
    if not orientations:
        return False
    stored = upright = 0.0
    for key, orientation in orientations.items():
        view = views[key]
        stored += _color_difference(view, points)
        upright += _color_difference(turned_view(view, orientation), points)
    if min(stored, upright) > (1.0 - SETTINGS.colors) * max(stored, upright):
        return None
    return upright < stored


def more_points(stored: int, upright: int) -> bool | None:
    """Whether photographs turned upright agree in clearly more points than as stored; None if in neither."""
    if min(stored, upright) > (1.0 - SETTINGS.points) * max(stored, upright):
        return None
    return upright > stored


def turn_notes(turns: Turns, better: bool | None) -> list[str]:
    """Notes on photographs that are turned, or may have to be.

    Args:
        turns: As they follow from sizes.
        better: Whether those in doubt fit upright; None if undecided.
    """
    notes = []
    by_size = [key for key, upright in turns.upright.items() if upright]
    doubtful = list(turns.doubtful)
    if by_size:
        notes.append(
            f"{len(by_size)} photographs are turned upright by their EXIF orientation, as the size of their "
            f"calibration asks: {listed(by_size)}"
        )
    if doubtful and better:
        notes.append(
            f"{len(doubtful)} photographs are turned upright by their EXIF orientation, as the sparse points "
            f"ask: {listed(doubtful)}"
        )
    if doubtful and better is None:
        notes.append(
            f"{len(doubtful)} photographs have an EXIF orientation, and nothing tells whether they were "
            f"calibrated upright: they are taken as stored, as COLMAP does: {listed(doubtful)}"
        )
    return notes


def _color_difference(view: View, points: Points) -> float:
    """Mean difference of the colours of points and of the pixels that they project to [levels]."""
    visible = visible_points(view.camera, points.positions)
    column, row = visible.place.astype(int).T
    difference = np.abs(view.pixels[row, column].astype(np.float64) - points.colors[visible.index])
    return float(difference.mean()) if len(difference) else 0.0


def masks_turned(views: Iterable[tuple[View, np.ndarray]]) -> bool | None:
    """Whether masks fit their photographs when they are turned; None where neither way is clearly better.

    Args:
        views: Views with masks, each beside its mask turned, of the same size.
    """
    kept, changed, alike = [], [], True
    for view, other in views:
        assert view.mask is not None
        kept.append(_outline_contrast(view.pixels, view.mask))
        changed.append(_outline_contrast(view.pixels, other))
        alike &= bool((other == view.mask).all())
    if alike:
        return False
    better, worse = (changed, kept) if sum(changed) > sum(kept) else (kept, changed)
    agree = float(np.mean([one > other for one, other in zip(better, worse, strict=True)]))
    if sum(worse) > (1.0 - SETTINGS.outlines) * sum(better) or agree < SETTINGS.views:
        return None
    return better is changed


def _outline_contrast(pixels: np.ndarray, mask: np.ndarray) -> float:
    """Mean gradient of an image along the outline of a mask, in units of that of the whole image."""
    import cv2

    stored, around = mask.astype(np.uint8), np.ones((3, 3), np.uint8)
    outline = cv2.dilate(stored, around) != cv2.erode(stored, around)
    if not outline.any():
        return 0.0
    slopes = [cv2.Sobel(pixels, cv2.CV_32F, 1 - axis, axis) for axis in (0, 1)]
    strength = np.hypot(*slopes).max(axis=2)
    return float(strength[outline].mean() / max(strength.mean(), 1e-6))
