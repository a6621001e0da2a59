"""What participants see: views as JPEG, or a flight through the scene as video; the same size for all.

Names of encoded files are digests of their bytes, so that no name tells which run is which.
"""

from __future__ import annotations

import base64
import hashlib
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.photographs.images import read_image
from diga3d_warp.state import read_plane

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Pixels = NDArray[np.uint8]
    """A picture, RGB, shape (H, W, 3)."""

MOST_VIEWS = 24
"""Views of a question, spread evenly over all: a turn around the object in six seconds."""

LONGEST = 720
"""Longest side of a picture [px]: two of them side by side fill a laptop's screen."""

JPEG_QUALITY = 90

INSET = 360
"""Longest side of the picture with the object outlined [px]."""

OUTLINE = (255, 64, 160)
"""Colour of the object's outline, RGB: rare in photographs."""

RATIO_OFF = 0.02
"""Relative difference of width / height within which pictures count as of one shape: image scales round."""

TYPES = {".jpg": "image/jpeg", ".webm": "video/webm"}


@dataclass(frozen=True)
class Medium:
    """An encoded picture or video.

    Attributes:
        data: Its bytes.
        ending: ".jpg" or ".webm".
    """

    data: bytes
    ending: str

    @property
    def name(self) -> str:
        """File name: a digest of the bytes."""
        return hashlib.sha256(self.data).hexdigest()[:20] + self.ending

    @property
    def url(self) -> str:
        """The whole of it as a data URL."""
        return f"data:{TYPES[self.ending]};base64,{base64.b64encode(self.data).decode()}"


def spread(names: Sequence[str]) -> list[str]:
    """At most `MOST_VIEWS` of the names, evenly spread, in order."""
    places = np.linspace(0, len(names) - 1, min(len(names), MOST_VIEWS)).round().astype(int)
    return [names[place] for place in places]


def common_size(first_pictures: Mapping[str, Path]) -> tuple[int, int]:
    """Width and height [px] to which the pictures of a question are brought: those of the smallest.

    Args:
        first_pictures: A picture of each candidate and of the source, by what it is.

    Raises:
        InputError: their shapes differ, so that one would be stretched.
    """
    sizes = {what: read_image(path).shape[1::-1] for what, path in first_pictures.items()}
    (what, (width, height)), *others = sorted(sizes.items(), key=lambda entry: entry[1])
    for other, (w, h) in others:
        if abs(w * height / (h * width) - 1) > RATIO_OFF:
            raise InputError(
                f"pictures of {what} are {width} x {height} px and those of {other} {w} x {h}: compare "
                "pictures of one shape"
            )
    scale = min(1.0, LONGEST / max(width, height))
    return max(round(width * scale), 1), max(round(height * scale), 1)


def encoded(pixels: Any, size: tuple[int, int]) -> Medium:
    """A picture as JPEG of this size."""
    import cv2

    if pixels.shape[1::-1] != size:
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(
        ".jpg", np.ascontiguousarray(pixels[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    )
    return Medium(data.tobytes(), ".jpg")


def views_of(pictures: Mapping[str, Path], names: Sequence[str], size: tuple[int, int]) -> list[Medium]:
    """Views as JPEG, in the order of the names."""
    return [encoded(read_image(pictures[name]), size) for name in names]


def video_of(pictures: Sequence[Any]) -> Medium:
    """Frames as a VP8 video, which every browser plays."""
    from diga3d_warp.pipelines.render import write_video

    height, width = pictures[0].shape[:2]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frames.webm"
        write_video(path, pictures, len(pictures), width, height)
        return Medium(path.read_bytes(), ".webm")


def outlined(pictures: Mapping[str, Path], masks: Mapping[str, Path]) -> Medium | None:
    """The view that shows most of the object, with its outline; None if there is no mask of these views.

    Args:
        pictures: Views before the edit, by name.
        masks: Masks of the object, white, by name of the view.
    """
    import cv2

    marked = {name: read_plane(path) for name, path in masks.items() if name in pictures}
    if not any(mask.any() for mask in marked.values()):
        return None
    name = max(marked, key=lambda each: float((marked[each] > 0).mean()))
    pixels = read_image(pictures[name])
    scale = min(1.0, INSET / max(pixels.shape[:2]))
    size = max(round(pixels.shape[1] * scale), 1), max(round(pixels.shape[0] * scale), 1)
    small = np.ascontiguousarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
    mask = cv2.resize(marked[name], size, interpolation=cv2.INTER_NEAREST)
    lines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return encoded(cv2.drawContours(small, lines, -1, OUTLINE, 2), size)
