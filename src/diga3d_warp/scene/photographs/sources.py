"""Sources: the file of each calibrated photograph, and the scale by which it is resized."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from diga3d_warp.scene.photographs.copies import COPIES, likeness
from diga3d_warp.scene.photographs.find_images import find_images
from diga3d_warp.scene.photographs.folders import images_below, unread_images, unread_line
from diga3d_warp.scene.photographs.images import choose_folder
from diga3d_warp.scene.photographs.names import image_key, is_utf8, listed

# Pairs of images that are compared, spread over a folder, before two folders are matched by their order.
_PAIRS_COMPARED = 5


@dataclass(frozen=True)
class Source:
    """File and scale of a photograph.

    Attributes:
        file: The file.
        scale: Scale by which the file is resized, in (0, 1].
        key: Its path below its image folder, without ending: masks are named like it.
    """

    file: Path
    scale: float
    key: str


@dataclass(frozen=True)
class Sources:
    """Sources of all photographs of a capture.

    Attributes:
        found: By the names of the calibration; names without a file are absent.
        notes: What was guessed, what is missing and what is left out, one line each.
    """

    found: Mapping[str, Source]
    notes: Sequence[str]


def find_sources(
    folders: Mapping[int, Path], names: Sequence[str], image_scale: float, beside: Path | None = None
) -> Sources:
    """The files that the names of a calibration mean, in the folder that fits the wanted scale.

    An image that is missing there is taken from a folder with larger ones, and made smaller. A folder whose
    images have other names is used if it holds as many as the originals and shows the same in sorted order,
    as LLFF's `images_4/image000.png` do.

    Args:
        folders: Image folders by the factor by which they are smaller, as `Capture.image_folders`.
        names: Paths below the image folder, with or without endings.
        image_scale: Wanted scale in (0, 1], relative to the largest images present.
        beside: Folder with further photographs, as large as the largest images.

    Raises:
        InputError: the scale is outside (0, 1].
    """
    chosen, _ = choose_folder(folders, image_scale)
    largest = min(folders)
    originals = images_below(folders[largest])
    by_name = find_images(names, folders[largest], originals)
    found: dict[str, Source] = {}
    notes: list[str] = []
    for factor in dict.fromkeys((next(f for f in folders if folders[f] == chosen), largest)):
        folder, scale = folders[factor], min(image_scale * factor / largest, 1.0)
        left = [name for name in names if name not in found]
        files = images_below(folder)
        match = by_name if factor == largest else find_images(left, folder, files)
        ordered = {} if match.files or factor == 1 else _by_order(names, files, originals, by_name.files)
        notes += match.notes if not ordered else [_order_note(folder, ordered)]
        for name, file in (ordered or match.files).items():
            if name in found:
                continue
            key = image_key(name)
            if name in by_name.files:
                key = image_key(by_name.files[name].relative_to(folders[largest]).as_posix())
            found[name] = Source(file, scale, key)
        if factor == largest and folder != chosen and (late := [name for name in left if name in found]):
            notes.append(
                f"{chosen}: {len(late)} images are missing there and read from {folder.name}: {listed(late)}"
            )
    if beside is not None:
        left = [name for name in names if name not in found]
        for name, file in find_images(left, beside, images_below(beside)).files.items():
            found[name] = Source(file, image_scale, image_key(name))
    if missing := [name for name in names if name not in found]:
        notes.append(_missing_note(chosen, missing))
    return Sources(found, [*notes, *_unposed_note(chosen, found)])


def _by_order(
    names: Sequence[str], files: Sequence[Path], originals: Sequence[Path], by_name: Mapping[str, Path]
) -> dict[str, Path]:
    """Images of other names, by the names of the calibration; empty where their order is no guide.

    Args:
        names: Of the calibration.
        files: The images of other names.
        originals: The largest images present, in sorted order: `files` where no others are there.
        by_name: Those that names were found for.
    """
    top = [path for path in files if path.parent == min(files).parent]
    if not by_name:
        alone = files == originals and len(top) == len(names)
        return dict(zip(sorted(names), top, strict=True)) if alone else {}
    if len(top) != len(originals) or not _same_pictures(originals, top):
        return {}
    place = {path: index for index, path in enumerate(originals)}
    return {name: top[place[path]] for name, path in by_name.items()}


def _same_pictures(originals: Sequence[Path], files: Sequence[Path]) -> bool:
    """Whether two lists show the same in the same order: each image is most similar to its counterpart."""
    last = len(files) - 1
    for index in {round(step * last / (_PAIRS_COMPARED - 1)) for step in range(_PAIRS_COMPARED)}:
        near = range(max(index - 1, 0), min(index + 1, last) + 1)
        alike = {other: likeness(originals[index], files[other]) for other in near}
        if alike[index] < max(alike.values()) or alike[index] < COPIES.likeness:
            return False
    return True


def _order_note(folder: Path, ordered: Mapping[str, Path]) -> str:
    name, file = next(iter(ordered.items()))
    return (
        f"{folder}: the images are not called as in the calibration and are matched by sorted order: "
        f"{name} -> {file.name} and so on"
    )


def _missing_note(folder: Path, missing: Sequence[str]) -> str:
    note = f"{folder}: {len(missing)} images are missing: {listed([image_key(name) for name in missing])}"
    unread = unread_images(folder)
    stems = {image_key(path.name) for path in unread}
    if any(PurePosixPath(image_key(name)).name in stems for name in missing):
        note += f"; {unread_line(unread)}"
    elif not any(map(is_utf8, missing)):
        note += "; their names in the calibration are not UTF-8: rename the images and rerun COLMAP"
    return note


def _unposed_note(folder: Path, found: Mapping[str, Source]) -> list[str]:
    """A note on images without a pose; masks kept in subfolders are not meant."""
    used = {source.file for source in found.values()}
    top = any(path.parent == folder for path in used)
    extra = [
        path for path in images_below(folder) if path not in used and not (top and path.parent != folder)
    ]
    if not extra:
        return []
    named = listed([path.relative_to(folder).as_posix() for path in extra])
    return [f"{folder}: {len(extra)} images have no pose and are left out: {named}"]
