"""Decoding of image files: format, size in the header, completeness, and pixels.

Nothing is decoded before the announced size is checked: a PNG of 3 MB can announce 30000 x 30000 pixels,
which take gigabytes and half a minute to decode.
"""

from __future__ import annotations

import io
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from diga3d_warp.errors import InputError


@dataclass(frozen=True)
class DecodingLimits:
    """What bounds the memory of reading images.

    Attributes:
        pixels: Largest image that is decoded [px]. The largest single exposures of phones and of medium
            format have 200 and 150 million; decoded, this limit takes 0.75 GB.
        at_once: Images that are decoded at the same time hold at most so many pixels together, unless a
            single one holds more [px]. 12 photographs of 5 million each, or one of 108 million alone; 0.2 GB.
        file: Largest file [bytes]. An uncompressed image of 16 bits in four channels with `pixels`.
    """

    pixels: int = 250_000_000
    at_once: int = 64_000_000
    file: int = 2_000_000_000


LIMITS = DecodingLimits()


class Header(NamedTuple):
    """Size and orientation in the header of an image file.

    Attributes:
        width, height: Size of the pixels that `decode` gives [px].
        orientation: EXIF orientation, 1 to 8, of the pixels that `decode` gives: 1 is upright, 3 turned by
            180 degrees, 6 and 8 by 90; the others are mirrored. Always 1 for TIFF, which comes upright.
    """

    width: int
    height: int
    orientation: int


# A marker that ends the entropy-coded part of a JPEG: 0xff, not stuffed, no restart, no fill byte.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
_PNG_END = b"IEND\xaeB`\x82"
_PREFIX = 4096
# OpenCV's flags for decoding a JPEG smaller, which takes the memory of the smaller image only.
_REDUCED = {8: "IMREAD_REDUCED_COLOR_8", 4: "IMREAD_REDUCED_COLOR_4", 2: "IMREAD_REDUCED_COLOR_2"}
_EXIF_MOST = 1 << 20
_ORIENTATION, _SHORT = 0x0112, 3  # tag and type of TIFF

# First bytes of the formats that OpenCV decodes.
_DECODED = re.compile(
    rb"\xff\xd8\xff|\x89PNG\r\n\x1a\n|GIF8|BM|II\*\0|MM\0\*|II\+\0|MM\0\+|RIFF....WEBP|P[1-6]\s"
    rb"|\0\0\0\x0cjP  |\xff\x4f\xff\x51|....ftyp(?:avi[fs]|(?:mif1|msf1).{0,64}avi[fs])",
    re.DOTALL,
)
_CONVERT = "convert it to .jpg or .png"
# First bytes of files that are often found in place of an image, their format, and the remedy.
_FOREIGN = (
    (rb"....ftyp(?:he[iv]|mif1|msf1)", "HEIC", f"{_CONVERT}, as heif-convert and ImageMagick do"),
    (rb"\x76\x2f\x31\x01", "OpenEXR", f"{_CONVERT} with sRGB colours, as oiiotool and ImageMagick do"),
    (rb"\xff\x0a|\0\0\0\x0cJXL ", "JPEG XL", f"{_CONVERT}, as djxl and ImageMagick do"),
    (rb"#\?R", "Radiance HDR", f"{_CONVERT} with sRGB colours"),
    (rb"8BPS", "Photoshop", f"{_CONVERT}"),
    (rb"....ftypcrx|FUJIFILMCCD", "camera raw", f"{_CONVERT}, as darktable and dcraw do"),
    (rb"....ftyp|RIFF....AVI |\x1aE\xdf\xa3", "video", "cut it into frames, as ffmpeg does"),
    (rb"version https://git-lfs", "a pointer of Git LFS, not the image", "fetch it with git lfs pull"),
    (rb"\s*<(?:!doctype html|html)", "a web page, not the image", "download the image itself"),
    (rb"\s*<(?:\?xml|svg)", "SVG or XML", _CONVERT),
    (rb"%PDF", "PDF", _CONVERT),
    (rb"PK\x03\x04", "ZIP archive", "unpack it"),
)


def read_header(source: Path | bytes, name: str | Path | None = None) -> Header:
    """Size and orientation that an image announces, from its first bytes.

    Args:
        source: The file, or all of its bytes.
        name: What to call it in an error; the path if None.

    Raises:
        InputError: it is no image that can be decoded (its format is named where it is known), or its size is
            beyond `LIMITS`.
    """
    if isinstance(source, bytes):
        return _header(io.BytesIO(source), name or "image")
    try:
        with source.open("rb") as file:
            return _header(file, name or source)
    except OSError as error:
        raise _unreadable(source, error) from error


def _header(file: BinaryIO, name: str | Path) -> Header:
    import imagesize

    start = file.read(_PREFIX)
    if _DECODED.match(start) is None:
        for pattern, what, remedy in _FOREIGN:
            if re.match(pattern, start, re.DOTALL | re.IGNORECASE):
                raise InputError(f"{name}: the file is {what}, which is not read; {remedy}")
        raise InputError(f"{name}: not readable as an image; copy it again")
    file.seek(0)
    try:
        info = imagesize.get_info(file, dpi=False, colors=False, channels=False, exif_rotation=False)
    except (ValueError, ArithmeticError, LookupError, struct.error) as error:
        raise InputError(f"{name}: not readable as an image; copy it again") from error
    if info.width < 1 or info.height < 1:
        raise InputError(f"{name}: not readable as an image; copy it again")
    if info.width * info.height > LIMITS.pixels:
        raise InputError(
            f"{name}: {info.width} x {info.height} px; images of more than {LIMITS.pixels // 10**6} million "
            "pixels are not read: scale it down"
        )
    chunk = _exif_chunk(file)
    rotation = info.rotation if chunk is None else _orientation(chunk)  # 0 where a camera does not know
    width, height, orientation = info.width, info.height, rotation if 1 <= rotation <= 8 else 1
    if start[:2] in (b"II", b"MM"):  # OpenCV, as Pillow, turns a TIFF while it decodes
        return Header(*((height, width) if orientation >= 5 else (width, height)), 1)
    return Header(width, height, orientation)


def _exif_chunk(file: BinaryIO) -> bytes | None:
    """The EXIF block of a PNG or WebP, where imagesize does not look for it."""
    file.seek(0)
    start = file.read(12)
    png = start[:4] == b"\x89PNG"
    if not png and start[:4] != b"RIFF":
        return None
    wanted, place = (b"eXIf", 8) if png else (b"EXIF", 12)
    while True:
        file.seek(place)
        head = file.read(8)
        if len(head) < 8:
            return None
        size = int.from_bytes(head[:4], "big") if png else int.from_bytes(head[4:], "little")
        if (head[4:] if png else head[:4]) == wanted:
            return file.read(min(size, _EXIF_MOST)).removeprefix(b"Exif\0\0")
        place += 12 + size if png else 8 + size + size % 2  # a PNG's chunks end with a checksum


def _orientation(exif: bytes) -> int:
    """The orientation that an EXIF block holds, a TIFF directory without an image; 0 if it holds none."""
    order = {b"II": "<", b"MM": ">"}.get(exif[:2])
    if order is None or len(exif) < 8:
        return 0
    (place,) = struct.unpack_from(f"{order}I", exif, 4)
    for entry in range(place + 2, len(exif) - 11, 12):
        tag, kind, _, value = struct.unpack_from(f"{order}HHIH", exif, entry)
        if (tag, kind) == (_ORIENTATION, _SHORT):
            return value
    return 0


def read_bytes(path: Path) -> bytes:
    """All of an image file.

    Raises:
        InputError: the file cannot be read, is larger than any image that is decoded, or is cut short.
    """
    try:
        if path.stat().st_size > LIMITS.file:
            raise InputError(f"{path}: {path.stat().st_size / 1e9:.1f} GB are too much for an image")
        data = path.read_bytes()
    except OSError as error:
        raise _unreadable(path, error) from error
    # Older OpenCV fills the missing part of a truncated file with grey and reports success.
    truncated = (data[:2] == b"\xff\xd8" and not _jpeg_is_whole(data)) or (
        data[:4] == b"\x89PNG" and _PNG_END not in data
    )
    if truncated:
        raise InputError(f"{path}: the image is cut short; copy it again")
    return data


def decode(data: bytes, name: str | Path, scale: float = 1.0) -> np.ndarray:
    """Pixels as the file stores them, not turned: (H, W) or (H, W, 3 or 4), BGR, of the file's own type.

    Args:
        data: All of the file.
        name: What to call it in an error.
        scale: Size that is wanted, in (0, 1]. A JPEG of more than `LIMITS.at_once` pixels is decoded at a
            half, a quarter or an eighth of its size where that divides it evenly and is not smaller than
            wanted; everything else is decoded whole.

    Raises:
        InputError: as `read_header`, or the data are damaged.
    """
    import cv2

    width, height, _ = read_header(data, name)
    flags = cv2.IMREAD_UNCHANGED
    if data[:2] == b"\xff\xd8" and width * height > LIMITS.at_once:
        for factor, reduced in _REDUCED.items():
            if factor * scale <= 1.0 and width % factor == 0 and height % factor == 0:
                flags = getattr(cv2, reduced) | cv2.IMREAD_IGNORE_ORIENTATION
                break
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise InputError(f"{name}: not readable as an image; copy it again")
    return pixels


def turned(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Stored pixels (H, W, ...) upright, as their EXIF orientation says."""
    if orientation >= 5:
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return np.ascontiguousarray(pixels)


def _unreadable(path: Path, error: OSError) -> InputError:
    reason = (error.strerror or str(error)).lower()
    return InputError(f"{path}: not readable ({reason}); give the path of an image")


def _jpeg_is_whole(data: bytes) -> bool:
    """Whether a JPEG reaches its end marker; what follows it (a film, a second image) does not count."""
    position = 2
    while (marker := _JPEG_MARKER.search(data, position)) is not None:
        code, position = data[marker.start() + 1], marker.end()
        if code == 0xD9:
            return True
        position += int.from_bytes(data[position : position + 2], "big")
    return False
