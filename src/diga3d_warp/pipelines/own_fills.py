"""Reference views as a user filled them in another program: read, checked and taken over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.photographs.folders import image_files
from diga3d_warp.scene.photographs.images import read_photograph
from diga3d_warp.scene.photographs.names import composed, listed
from diga3d_warp.scene.scene import Scene, View

Fills = Mapping[str, np.ndarray]
"""Filled views: RGB (H, W, 3), uint8, by the name of the view."""

NO_FILLS: Fills = MappingProxyType({})


def by_index(fills: Fills, views: Sequence[View]) -> dict[int, np.ndarray]:
    """The filled ones of some views, RGB (H, W, 3), float32 in [0, 1], by index."""
    return {i: fills[view.name] / np.float32(255.0) for i, view in enumerate(views) if view.name in fills}


@dataclass(frozen=True)
class FillCheck:
    """When a filled image is that of a view.

    Attributes:
        side: Longer side at which both are compared, at most [px].
        averaged: Least pixels across one of those that are compared [px]: grain and the blocks of a JPEG
            average out. At 96 x 72 px a JPEG of quality 60 is off by 8 levels, averaged over four by 3.
        around: Width of the band around the mask that is not compared [parts of the diagonal]: programs fill
            a little more than the mask, and soften its border.
        difference: Mean absolute difference of the pixels outside the mask [levels of 255]. A JPEG of
            quality 50 reaches 3, another white balance 10.
        clearer: How many times smaller the difference must become under another view, turn or shift for that
            to be named [ratio].
        shift: Least shift that is named [px at `side`].
        contrast: Largest change of contrast that is named as one of colours [ratio]. Programs set less; with
            more, any image becomes a flat one.
        dark: Mean level below which an image is called black [levels of 255].
        unchanged: Largest difference inside the mask of a photograph that was not filled [ratio to that
            outside, with a level added to both]: a JPEG changes both alike.
        plain: Share of a hole that has one colour where it was left empty [1], within the difference that is
            allowed outside: a JPEG frays the rim.
        apart: Least difference of such a hole from the band around it [levels of 255]: a plain wall goes on
            in its own colour.
        least_known: Share of the pixels that must be outside the mask for a comparison.
    """

    side: int = 256
    averaged: int = 4
    around: float = 0.03
    difference: float = 8.0
    clearer: float = 3.0
    shift: float = 0.7
    contrast: float = 2.0
    dark: float = 2.0
    unchanged: float = 1.2
    plain: float = 0.9
    apart: float = 24.0
    least_known: float = 0.02


CHECK = FillCheck()

_TURNS: Mapping[str, int] = {
    "turned by 180 degrees": 2,
    "turned by 90 degrees to the left": 1,
    "turned by 90 degrees to the right": 3,
}


def read_fills(given: Sequence[str | Path], scene: Scene) -> dict[str, np.ndarray]:
    """Read filled views, and hold them against the photographs.

    Args:
        given: Each VIEW=IMAGE, or a folder of images named after views.
        scene: Views, with masks where the user gave them.

    Returns:
        RGB (H, W, 3), uint8, by the name of the view, in the order of the views.

    Raises:
        InputError: a view or file does not exist, two images are of one view, an image is not that view
            (another size, turned, shifted, of other colours, black, or changed outside the mask), or its hole
            is not filled.
    """
    views = {view.name: view for view in scene.views}
    files = _files(given, views, {view.name for view in scene.test_views})
    fills = {}
    for name in views:
        if name in files:
            photograph = read_photograph(files[name], orientation=views[name].orientation)
            fills[name] = _checked(photograph.pixels, files[name], views[name], views)
    return fills


def _files(given: Sequence[str | Path], views: Mapping[str, View], test: set[str]) -> dict[str, Path]:
    """The file of each view that was filled."""
    files: dict[str, Path] = {}
    for entry in given:
        for name, file in _named(entry, views):
            if name in test:
                raise InputError(f"{file}: {name} is held out for testing; fill a training view")
            if name not in views:
                raise InputError(f"{file}: there is no view {name}; views are {listed(list(views))}")
            if files.setdefault(name, file) != file:
                raise InputError(f"{name} is filled twice, by {files[name]} and {file}: leave one out")
            if not file.is_file():
                raise InputError(f"{file}: no such file; give the filled image of {name}")
    return files


def _named(entry: str | Path, views: Mapping[str, View]) -> list[tuple[str, Path]]:
    """Names of views and their files, of one argument."""
    folder = Path(entry).expanduser()
    if folder.is_dir():
        images = {composed(name): file for name, file in image_files(folder).items()}
        if not images:
            raise InputError(f"{folder}: holds no images; name filled images after their views")
        return list(images.items())
    name, separator, file = str(entry).partition("=")
    if not separator or not name or not file:
        raise InputError(f"--fill {entry}: no such folder, and not of the form VIEW=IMAGE")
    known = composed(name) if composed(name) in views else composed(Path(name).stem)
    return [(known if known in views else name, Path(file).expanduser())]


def _checked(pixels: np.ndarray, file: Path, view: View, views: Mapping[str, View]) -> np.ndarray:
    """The image, if it is the view's photograph outside the mask."""
    height, width = view.pixels.shape[:2]
    if pixels.shape != view.pixels.shape:
        rows, columns = pixels.shape[:2]
        turned = ", which is turned by 90 degrees" if (rows, columns) == (width, height) else ""
        raise InputError(
            f"{file}: {columns} x {rows} px{turned}, but {view.name} is read at {width} x {height} px; "
            "export it at that size"
        )
    compared = _known(view)
    if compared.mean() < CHECK.least_known:
        return pixels
    difference = _difference(pixels, view.pixels, compared)
    if difference > CHECK.difference:  # not where it is NaN
        raise InputError(f"{file}: {_what_differs(pixels, view, views, compared, difference)}")
    if view.mask is not None and view.mask.any():
        _check_hole(pixels, file, view, view.mask)
    return pixels


def _check_hole(pixels: np.ndarray, file: Path, view: View, mask: np.ndarray) -> None:
    """Refuse an image whose hole was not filled.

    Raises:
        InputError: the object is still there, or one colour that is not that around it.
    """
    import cv2

    outside = _difference(pixels, view.pixels, _known(view))
    inside = _difference(pixels, view.pixels, mask)
    if inside <= CHECK.unchanged * (outside + 1.0) - 1.0:
        raise InputError(f"{file}: is {view.name} with the object still there; give the image without it")
    core = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) > 0
    around = ~mask & (cv2.dilate(mask.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0)
    if not core.any() or not around.any():
        return
    color = np.median(pixels[core], axis=0)
    plain = (np.abs(pixels[core] - color).max(axis=1) <= CHECK.difference).mean() >= CHECK.plain
    if plain and np.abs(color - np.median(pixels[around], axis=0)).max() >= CHECK.apart:
        raise InputError(f"{file}: one colour fills its mask; give the image with the hole filled")


def _what_differs(
    pixels: np.ndarray, view: View, views: Mapping[str, View], compared: np.ndarray, difference: float
) -> str:
    """Why an image is not the view's, in words."""
    if pixels.mean() < CHECK.dark:
        return "is black; export the filled image again"
    close = difference / CHECK.clearer
    for words, quarter in _TURNS.items():
        undone = np.rot90(pixels, -quarter)
        if undone.shape == view.pixels.shape and _difference(undone, view.pixels, compared) < close:
            return f"is {view.name} {words}; turn it back"
    for words, axis in (("left to right", 1), ("upside down", 0)):
        if _difference(np.flip(pixels, axis), view.pixels, compared) < close:
            return f"is {view.name} mirrored {words}; mirror it back"
    for other in views.values():
        same = other is not view and other.pixels.shape == pixels.shape
        if same and _difference(pixels, other.pixels, _known(other)) < min(close, CHECK.difference):
            return f"shows {other.name}, not {view.name}: name it after the view that it shows"
    across, down = _shift(pixels, view.pixels, compared)
    if max(abs(across), abs(down)) * CHECK.side / max(pixels.shape[:2]) >= CHECK.shift:
        moved = _moved(pixels, -across, -down)
        if _difference(moved, view.pixels, compared) < close:
            return (
                f"is shifted against {view.name} by {across:.0f} px across and {down:.0f} px down; "
                "export it in place"
            )
    level = pixels[compared].mean(axis=0) - view.pixels[compared].mean(axis=0)
    if _difference(_evened(pixels, view.pixels, compared), view.pixels, compared) < close:
        red, green, blue = (f"{part:+.0f}" for part in level)
        return (
            f"has other colours than {view.name} outside the mask: {red}, {green}, {blue} levels of red, "
            "green and blue; export it without changing them"
        )
    return (
        f"differs from {view.name} outside the mask by {difference:.0f} levels in the mean; only pixels "
        "inside the mask may change"
    )


def _known(view: View) -> np.ndarray:
    """Pixels outside the mask and a band around it; all where there is no mask."""
    import cv2

    if view.mask is None:
        return np.ones(view.pixels.shape[:2], bool)
    band = int(CHECK.around * np.hypot(*view.mask.shape)) * 2 + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (band, band))
    return cv2.dilate(view.mask.astype(np.uint8), disc) == 0


def _difference(pixels: np.ndarray, photograph: np.ndarray, compared: np.ndarray) -> float:
    """Difference of two images where they are compared [levels]: the mean, or the median without a mask.

    NaN where nothing is left of that at the size at which they are.

    Without a mask the filled part is among what is compared; it covers less than half.
    """
    import cv2

    height, width = compared.shape
    scale = min(1.0 / CHECK.averaged, CHECK.side / max(height, width))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    first, second = (
        cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for image in (pixels, photograph)
    )
    weight = cv2.resize(compared.astype(np.float32), size, interpolation=cv2.INTER_AREA) == 1.0
    if not weight.any():
        return float("nan")
    levels = np.abs(first - second).mean(axis=2)[weight]
    return float(np.median(levels) if compared.all() else levels.mean())


def _shift(pixels: np.ndarray, photograph: np.ndarray, compared: np.ndarray) -> tuple[float, float]:
    """By how much an image lies further right and further down than a photograph [px]."""
    import cv2

    grey = [
        np.where(compared, image.astype(np.float64).mean(axis=2) - image[compared].mean(), 0.0)
        for image in (photograph, pixels)
    ]
    window = cv2.createHanningWindow(compared.shape[::-1], cv2.CV_64F)
    (across, down), _ = cv2.phaseCorrelate(grey[0], grey[1], window)
    return across, down


def _evened(pixels: np.ndarray, photograph: np.ndarray, compared: np.ndarray) -> np.ndarray:
    """An image with the brightness and contrast of a photograph in each channel, within `contrast`."""
    result = np.empty(pixels.shape, np.float32)
    for channel in range(3):
        own, wanted = (each[..., channel][compared].astype(np.float64) for each in (pixels, photograph))
        spread = float(own.std())
        gain = float(((own - own.mean()) * (wanted - wanted.mean())).mean()) / max(spread**2, 1e-12)
        gain = float(np.clip(gain, 1.0 / CHECK.contrast, CHECK.contrast))
        result[..., channel] = np.clip(gain * (pixels[..., channel] - own.mean()) + wanted.mean(), 0.0, 255.0)
    return result


def _moved(pixels: np.ndarray, across: float, down: float) -> np.ndarray:
    import cv2

    matrix = np.array([[1.0, 0.0, across], [0.0, 1.0, down]])
    return cv2.warpAffine(pixels, matrix, pixels.shape[1::-1], borderMode=cv2.BORDER_REFLECT)
