"""Names of images: as calibrations write them, as files bear them, and as views are called."""

from __future__ import annotations

import posixpath
import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
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

# Names that a line lists before it says how many more there are.
_NAMES_LISTED = 8
# Bytes of a file's name and letters of its path that systems take.
_LONGEST_PART, _LONGEST_PATH = 255, 4096
# Bytes of a view's name: file systems take 255, and outputs add endings to it.
_LONGEST_NAME = 160
# Code pages that names which are not UTF-8 may be in: Windows and DOS of western Europe, Windows of central
# Europe and in Cyrillic, Japanese, Chinese, Korean. Of those that fit equally many files, the first is taken.
_CODE_PAGES = ("cp1252", "cp850", "cp1250", "cp1251", "cp932", "gbk", "cp949", "mac_roman")
# Of several files that an image named without its ending may be: photographs are mostly JPEG, while a .png
# of the same name is more often its mask or its depth.
_ENDINGS_BY_LIKELIHOOD = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp")


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


def listed(names: Sequence[str]) -> str:
    """Names in one line that can be read."""
    rest = f" and {len(names) - _NAMES_LISTED} more" if len(names) > _NAMES_LISTED else ""
    return ", ".join(map(shown, names[:_NAMES_LISTED])) + rest


def shown(name: str) -> str:
    """A name as it can be printed: bytes that are not UTF-8 as Windows means them, no control characters."""
    raw = _bytes(name)
    try:
        text = raw.decode()
    except UnicodeDecodeError:
        text = raw.decode(_CODE_PAGES[0], "replace")
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
    too_long = max(map(len, map(_bytes, re.split(r"[/\\]", name)))) > _LONGEST_PART
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


@dataclass(frozen=True)
class Found:
    """Files that names mean.

    Attributes:
        files: File of each name that has one.
        notes: What was guessed, one line each.
    """

    files: Mapping[str, Path]
    notes: Sequence[str]


def find_images(names: Sequence[str], folder: Path, files: Sequence[Path]) -> Found:
    """The files that a calibration's names mean, each file for one name at most.

    A name that is a file's own is that file, whatever lies beside it. For names that no file bears, in this
    order: accents composed or apart and other code pages; upper and lower case; another ending, or none; the
    file name without its folders, where only one file has it. The latter two are noted.

    Args:
        names: Paths below `folder`, with forward slashes, with or without an ending. Bytes that are not
            UTF-8 as `surrogateescape` keeps them.
        folder: Where the files lie.
        files: Image files below it.
    """
    relative = {path.relative_to(folder).as_posix(): path for path in files}
    found = {name: relative[name] for name in names if name in relative}
    notes = []
    text, page = _readable([*names, *relative])
    if page:
        notes.append(f"{folder}: image names that are not UTF-8 are read as {page}")

    def plain(name: str) -> str:
        return composed(text.get(name, name))

    def match(spelled: Callable[[str], str]) -> dict[str, list[str]]:
        """Names left, and the files left that are spelled alike; none where two names are."""
        used = set(found.values())
        free = [name for name, path in relative.items() if path not in used]
        left = [name for name in names if name not in found]
        spellings = Counter(spelled(name) for name in dict.fromkeys(left))
        alike: dict[str, list[str]] = {}
        for name in sorted(free, key=likelihood):
            alike.setdefault(spelled(name), []).append(name)
        return {name: alike.get(spelled(name), []) for name in left if spellings[spelled(name)] == 1}

    for spelled in (plain, lambda name: plain(name).casefold()):
        found |= {name: relative[some[0]] for name, some in match(spelled).items() if len(some) == 1}
    for spelled in (lambda name: image_key(plain(name)), lambda name: image_key(plain(name)).casefold()):
        chosen = {name: some for name, some in match(spelled).items() if some and not _are_one(some, plain)}
        found |= {name: relative[some[0]] for name, some in chosen.items()}
        notes += _ending_notes(folder, chosen)
    for spelled in (
        lambda name: PurePosixPath(plain(name)).name.casefold(),
        lambda name: PurePosixPath(image_key(plain(name))).name.casefold(),
        # 3DGS cuts names at their first dot.
        lambda name: PurePosixPath(plain(name)).name.casefold().split(".")[0],
    ):
        only = {name: some[0] for name, some in match(spelled).items() if len(some) == 1}
        found |= {name: relative[file] for name, file in only.items()}
        if only:
            notes.append(
                f"{folder}: {len(only)} images are found by a part of their names only: {_pairs(only)}"
            )
    return Found(found, notes)


def _are_one(names: Sequence[str], plain: Callable[[str], str]) -> bool:
    """Whether the likeliest of several names differs from another in upper and lower case only."""
    return plain(names[0]).casefold() in {plain(name).casefold() for name in names[1:]}


def likelihood(name: str) -> tuple[int, str]:
    """Sorts files of one name by how likely they are to be the photograph."""
    suffix = PurePosixPath(name).suffix.lower()
    order = _ENDINGS_BY_LIKELIHOOD
    return (order.index(suffix) if suffix in order else len(order), name)


def _pairs(pairs: Mapping[str, str]) -> str:
    return listed([f"{name} -> {file}" for name, file in list(pairs.items())[:1]]) + (
        f" and {len(pairs) - 1} more" if len(pairs) > 1 else ""
    )


def _ending_notes(folder: Path, chosen: Mapping[str, Sequence[str]]) -> list[str]:
    """What to say of images that were found under another ending, or under one of several."""
    notes = []
    other = {name: some[0] for name, some in chosen.items() if image_key(name) != composed(name)}
    several = {name: some for name, some in chosen.items() if name not in other and len(some) > 1}
    if other:
        notes.append(
            f"{folder}: {len(other)} images have another ending than the calibration says: {_pairs(other)}"
        )
    if several:
        some = next(iter(several.values()))
        notes.append(
            f"{folder}: {len(several)} images are named without an ending, and several files fit: of "
            f"{listed(some)} the first is read"
        )
    return notes


def _readable(names: Iterable[str]) -> tuple[dict[str, str], str | None]:
    """Names that are not UTF-8 in the code page in which most of them are names of the others, and which."""
    every = set(names)
    odd = {name for name in every if not is_utf8(name)}
    wanted = {image_key(name).casefold() for name in every - odd}
    best: tuple[int, dict[str, str], str | None] = (0, {}, None)
    for page in _CODE_PAGES:
        try:
            decoded = {name: _bytes(name).decode(page) for name in odd}
        except UnicodeDecodeError:
            continue
        hits = sum(image_key(text).casefold() in wanted for text in decoded.values())
        if hits > best[0]:
            best = (hits, decoded, page)
    return best[1], best[2]


def is_utf8(name: str) -> bool:
    """Whether a name holds no bytes that `surrogateescape` kept."""
    return not any("\udc80" <= letter <= "\udcff" for letter in name)


def _bytes(name: str) -> bytes:
    try:
        return name.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:  # half a pair of UTF-16, which JSON can hold and no file name can
        return name.encode("utf-8", "backslashreplace")


def view_names(keys: Sequence[str]) -> dict[str, str]:
    """What the views of a scene are called, by key: names of files without folder and ending.

    Where two have one file name, folders are joined to it with "_". Names are told apart without regard to
    upper and lower case, as the file systems of Windows and macOS do.
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
