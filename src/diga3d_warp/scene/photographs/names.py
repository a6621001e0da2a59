"""Image names: in calibrations, on disk, and of views."""

from __future__ import annotations

import posixpath
import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from diga3d_warp.errors import InputError

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp"})
"""Endings of the images that are read."""

UNREAD_IMAGES = {
    ".heic": "HEIC", ".heif": "HEIC", ".hif": "HEIC", ".avif": "AVIF", ".jxl": "JPEG XL", ".jp2": "JPEG 2000",
    ".exr": "OpenEXR", ".hdr": "HDR", ".gif": "GIF", ".psd": "Photoshop", ".tga": "Targa", ".ppm": "PPM",
    ".dng": "raw", ".cr2": "raw", ".cr3": "raw", ".nef": "raw", ".arw": "raw", ".raf": "raw", ".orf": "raw",
    ".rw2": "raw", ".pef": "raw", ".srw": "raw",
}  # fmt: skip
"""Endings of images that are not read, with what they are called."""

# Most names in one message; the others are counted.
_NAMES_LISTED = 8
# Bytes of a file's name and letters of its path that systems take.
_LONGEST_PART, _LONGEST_PATH = 255, 4096
# Bytes of a view's name: file systems take 255, and outputs add endings to it.
_LONGEST_NAME = 160
# Code pages that names which are not UTF-8 may be in: Windows and DOS of western Europe, Windows of central
# Europe and in Cyrillic, Japanese, Chinese, Korean. Of those that fit equally many files, the first is taken.
CODE_PAGES = ("cp1252", "cp850", "cp1250", "cp1251", "cp932", "gbk", "cp949", "mac_roman")

# Folders of images that are no photographs, as scanning apps, COLMAP, nerfstudio and data sets name them.
_DERIVED = frozenset({
    "alpha", "alphas", "annotations", "colmap", "conf", "confidence", "dense", "depth", "depth_maps",
    "depths", "disparity", "flow", "label", "labels", "mask", "masks", "normal", "normals", "preview",
    "previews", "rendered", "renders", "sam", "seg", "segmentation", "semantic", "sparse", "stereo",
    "test_label", "thumb", "thumbnail", "thumbnails", "thumbs",
})  # fmt: skip


def composed(name: str) -> str:
    """A name with its accents composed (NFC): macOS writes them apart (NFD)."""
    return unicodedata.normalize("NFC", name)


def image_key(name: str) -> str:
    """Name of an image without its ending, accents composed.

    Other dots stay: "IMG.2.jpg" and "IMG.2" are both "IMG.2".
    """
    path = PurePosixPath(composed(name))
    ends = path.suffix.lower() in IMAGE_SUFFIXES or path.suffix.lower() in UNREAD_IMAGES
    return str(path.with_suffix("") if ends else path)


def is_derived(path: str | PurePosixPath) -> bool:
    """Whether a path leads through a folder of masks, depth, previews and the like, by its name."""
    return not _DERIVED.isdisjoint(part.lower() for part in PurePosixPath(path).parts)


def listed(names: Sequence[str]) -> str:
    """The first names as one line for a message, with the number of the others."""
    rest = f" and {len(names) - _NAMES_LISTED} more" if len(names) > _NAMES_LISTED else ""
    return ", ".join(map(shown, names[:_NAMES_LISTED])) + rest


def shown(name: str) -> str:
    """A name as it can be printed: bytes that are not UTF-8 as Windows means them, no control characters."""
    raw = name_bytes(name)
    try:
        text = raw.decode()
    except UnicodeDecodeError:
        text = raw.decode(CODE_PAGES[0], "replace")
    return "".join(letter if letter.isprintable() and letter != "\ufffd" else "_" for letter in text)


def inside(root: Path, name: str, source: Path, folders: Sequence[Path] = ()) -> str:
    """A path named by a file of the scene, relative to the scene, normalised, with forward slashes.

    Links are not followed, so an `images` folder may be a link to another disk. Of a path that leads outside,
    as files written on another machine hold them, the longest end that is a file of the scene is taken.

    Args:
        root: Scene folder.
        name: Path as written in `source`.
        source: File that names it, for the error line.
        folders: Further folders of the scene that the path may be relative to.

    Raises:
        InputError: the path leaves the scene, or no file can be called so.
    """
    too_long = max(map(len, map(name_bytes, re.split(r"[/\\]", name)))) > _LONGEST_PART
    if not name.strip() or "\0" in name or too_long or len(name) > _LONGEST_PATH:
        raise InputError(f"{source}: {name[:80]!r} is no name of a file; export it again")
    written = PurePosixPath(posixpath.normpath(name.replace("\\", "/")))
    if not leads_outside(name):
        return written.as_posix()
    parts = [part for part in written.parts if part not in ("..", "/", "//")]
    for start in range(len(parts)):
        tail = PurePosixPath(*parts[start:])
        if any(_is_named(folder / tail) for folder in (root, *folders)):
            return tail.as_posix()
    raise InputError(f"{source}: the path {name!r} leaves the scene folder; name files inside {root}")


def leads_outside(name: str) -> bool:
    """Whether a path is absolute, also one of Windows, or begins above the folder it is relative to."""
    written = posixpath.normpath(name.replace("\\", "/"))
    return (
        written.startswith("/") or written.split("/")[0] == ".." or re.match("[A-Za-z]:", written) is not None
    )


def _is_named(path: Path) -> bool:
    """Whether a path is an image or a point cloud, or an image without its ending."""
    endings = ("",) if path.suffix.lower() in IMAGE_SUFFIXES | {".ply"} else tuple(IMAGE_SUFFIXES)
    try:
        return any(path.with_name(path.name + ending).is_file() for ending in endings)
    except OSError:  # a name that no file can have
        return False


def is_utf8(name: str) -> bool:
    """Whether a name holds no bytes that `surrogateescape` kept."""
    return not any("\udc80" <= letter <= "\udcff" for letter in name)


def name_bytes(name: str) -> bytes:
    try:
        return name.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:  # half a pair of UTF-16, which JSON can hold and no file name can
        return name.encode("utf-8", "backslashreplace")


def view_names(keys: Sequence[str]) -> dict[str, str]:
    """What the views of a scene are called, by key: names of files without folder and ending.

    Where two have one file name, folders are joined to it with "_". Upper and lower case are not
    distinguished, as on the file systems of Windows and macOS.
    """
    last = Counter(key.rsplit("/", 1)[-1].casefold() for key in keys)
    names: dict[str, str] = {}
    taken: set[str] = set()
    for key in keys:
        stem = key.rsplit("/", 1)[-1]
        wanted = _file_name(stem if last[stem.casefold()] == 1 else key.replace("/", "_"))
        name, number = wanted, 2
        while name.casefold() in taken:
            name, number = f"{wanted}_{number}", number + 1
        taken.add(name.casefold())
        names[key] = name
    return names


def _file_name(name: str) -> str:
    """A name that every file system takes: printable, and short enough."""
    text = shown(name)
    short = text.encode()[-_LONGEST_NAME:].decode("utf-8", "ignore")
    return short.lstrip(".") or "_"
