"""Recognise: which of the files at a path hold the poses of a capture, and which splat belongs to it.

A file is read as given. In a folder, the poses beside a splat come first, then transforms.json, which users
edit, then COLMAP's. A note names the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.files import read_json
from diga3d_warp.scene.colmap.files import find_file, is_model
from diga3d_warp.scene.colmap.reconstruction import choose_reconstruction
from diga3d_warp.scene.formats.recognise import splat_format
from diga3d_warp.scene.layouts.nerfstudio import find_transforms
from diga3d_warp.scene.layouts.polycam import find_polycam
from diga3d_warp.scene.layouts.pose_files import DEPTH, PoseFile, pose_files
from diga3d_warp.scene.layouts.splat import find_cameras_root, find_splat, has_poses
from diga3d_warp.scene.photographs.folders import (
    entries,
    entry,
    has_images,
    image_folders,
    unread_images,
    unread_line,
    walk,
)
from diga3d_warp.scene.photographs.names import IMAGE_SUFFIXES, UNREAD_IMAGES, listed

EXPECTED = (
    "expected sparse/0 with cameras and images files (COLMAP), transforms.json or transforms_train.json, "
    "poses_bounds.npy, a splat .ply with cameras.json, or photographs only"
)
_VIDEOS = (
    ".mp4",
    ".mov",
    ".avi",
    ".mkv",
    ".webm",
    ".m4v",
    ".mts",
    ".insv",
    ".360",
    ".wmv",
    ".mpg",
    ".mpeg",
    ".3gp",
)
ARCHIVES = (".zip", ".r3d", ".7z", ".rar", ".tar", ".gz", ".tgz", ".bz2", ".xz", ".zst")
_MODEL_FILES = ("cameras", "images", "points3D", "frames", "rigs")
_LEVELS_UP = 3  # from colmap/sparse/0 to the scene


@dataclass(frozen=True)
class Recognised:
    """The layout recognised at a path.

    Attributes:
        root: Scene folder.
        kind: "cameras" (of a splat), "nerfstudio", "colmap", "polycam", "llff"; "images" without poses.
        poses: The files with the poses; of COLMAP and Polycam, their folder.
        splat: The splat that belongs to them.
        notes: What was chosen and what is not used, one line each.
        also: Further files with poses that are read as well, or that the notes name.
        images: The image folder that was named, if one was.
    """

    root: Path
    kind: str
    poses: Sequence[Path] = ()
    splat: Path | None = None
    notes: Sequence[str] = ()
    also: Sequence[Path] = ()
    images: Path | None = None


def recognise(path: Path) -> Recognised:
    """Recognise the capture at a path: a scene folder, one of the folders in it, or one of its files.

    Raises:
        InputError: nothing that can be read; the message names what there is instead.
    """
    try:
        there = path.exists()
    except OSError:  # a name that no file can have
        there = False
    if not there:
        raise InputError(f"{path}: there is no such file or folder; give the folder of a capture")
    if path.is_file():
        return _file(path)
    if not path.is_dir():
        raise InputError(f"{path}: neither a file nor a folder; give the folder of a capture")
    if not has_images(path):
        if is_model(path):
            return _model(path, path)
        if path.name.lower() == "sparse" and (chosen := choose_reconstruction(path.parent, path)):
            return replace(_model(chosen.folder, path), notes=chosen.notes)
    elif _is_part(path):
        found = _folder(_parent(path))
        note = f"{path} is a part of {found.root}, whose poses are read"
        return replace(found, notes=[note, *found.notes], images=path)
    return _folder(path)


def _is_part(path: Path) -> bool:
    """Whether a folder holds the photographs of a capture whose poses lie beside it."""
    base = path.absolute().name.lower().split("_")[0]
    return base in ("images", "input") and has_poses(_parent(path)) and not has_poses(path)


def _parent(folder: Path) -> Path:
    """The folder above, relative as long as it is."""
    return folder.parent if folder.name else folder.absolute().parent


def _file(path: Path) -> Recognised:
    """A capture by one of its files."""
    if splat_format(path) is not None:
        return _folder(find_cameras_root(path), path)
    if path.suffix.lower() == ".ply":
        raise InputError(f"{path}: a .ply without gaussians; give the folder of the capture instead")
    if path.suffix.lower() == ".json":
        return _json(path)
    if path.name.lower() == "poses_bounds.npy":
        return Recognised(path.parent, "llff", [path])
    if path.suffix.lower() in (".bin", ".txt") and path.stem.lower() in map(str.lower, _MODEL_FILES):
        return _model(path.parent, path)
    raise InputError(f"{path}: {_what_else(path)}")


def _json(path: Path) -> Recognised:
    """A capture by a JSON file, known by its contents."""
    contents = read_json(path, "name the transforms.json or cameras.json of a capture")
    if isinstance(contents, dict) and "frames" in contents:
        poses = find_transforms(path.parent, path.name) or [path]
        return Recognised(path.parent, "nerfstudio", poses, find_splat(path.parent))
    if (
        isinstance(contents, list)
        and contents
        and isinstance(contents[0], dict)
        and "rotation" in contents[0]
    ):
        return Recognised(path.parent, "cameras", [path], find_splat(path.parent))
    raise InputError(f"{path}: {_what_else(path)}")


def _model(folder: Path, named: Path) -> Recognised:
    """The capture of a COLMAP reconstruction that was named, by its folder or one of its files."""
    if not (find_file(folder, "cameras") and find_file(folder, "images")):
        raise InputError(
            f"{named}: cameras and images files belong together, and one is missing; rerun COLMAP"
        )
    root = next((above for above in _and_above(folder, _LEVELS_UP) if _may_hold_images(above, folder)), None)
    if root is None:
        raise InputError(f"{named}: no photographs beside or above it; give the folder of the capture")
    return Recognised(root, "colmap", [folder], find_splat(root))


def _and_above(folder: Path, levels: int) -> Iterator[Path]:
    """A folder and those above it."""
    yield folder
    for _ in range(levels):
        folder = _parent(folder)
        yield folder


def _may_hold_images(folder: Path, model: Path) -> bool:
    return bool(image_folders(folder)) or (folder == model and has_images(folder))


def _folder(root: Path, splat: Path | None = None) -> Recognised:
    """A capture by its folder."""
    splat = splat or find_splat(root)
    others = pose_files(root)
    own = [each for each in others if each.path.parent == root and each.path.name.lower() == "cameras.json"]
    cameras = [Recognised(root, "cameras", [each.path]) for each in own]
    found = next(iter([*(cameras if splat else []), *_posed(root), *cameras]), None)
    if found is None:
        if splat is not None:
            raise InputError(f"{splat}: no cameras file; put the cameras.json of its training into {root}")
        return _photographs(root, others)
    used = {*found.poses, *found.also}
    unused = [each.path for each in others if each.path not in used]
    notes = [*found.notes]
    if unused:
        notes.append(
            f"{root}: poses are those of {', '.join(_short(path, root) for path in found.poses)}; not used: "
            f"{listed([_short(path, root) for path in unused])}"
        )
    return replace(found, splat=splat, notes=notes)


def _short(path: Path, root: Path) -> str:
    return path.relative_to(root).as_posix() if path.is_relative_to(root) and path != root else str(path)


def _posed(root: Path) -> Iterator[Recognised]:
    """Poses of a folder that are read, the capture's own first."""
    if transforms := find_transforms(root, "transforms.json"):
        yield Recognised(root, "nerfstudio", transforms)
    if chosen := choose_reconstruction(root):
        above = [each for each in _and_above(chosen.folder, DEPTH) if each.is_relative_to(root)]
        inner = next((each for each in above if _may_hold_images(each, chosen.folder)), root)
        yield Recognised(inner, "colmap", [chosen.folder], notes=chosen.notes, also=chosen.others)
    if transforms := find_transforms(root, "transforms_train.json"):
        yield Recognised(root, "nerfstudio", transforms)
    if (cameras := find_polycam(root)) is not None:
        yield Recognised(cameras.parent, "polycam", [cameras])
    if (bounds := entry(root, "poses_bounds.npy")) is not None:
        # Its lens and points are those of COLMAP's reconstruction.
        yield Recognised(root, "llff", [bounds], also=[root / "sparse" / "0"])


def _photographs(root: Path, others: Sequence[PoseFile]) -> Recognised:
    """A folder without poses that are read: photographs only, or nothing."""
    if others:
        first = others[0]
        if first.readable:
            raise InputError(
                f"{root}: no capture itself, but {first.path.parent} looks like one; give that folder"
            )
        raise InputError(
            f"{first.path}: {_unread_poses(first)}; or move it out of {root} to have the poses recovered anew"
        )
    parts = [
        folder for folder, _ in walk(root, DEPTH) if any(find_file(folder, stem) for stem in _MODEL_FILES)
    ]
    if not has_images(root) or parts or (root / "sparse").exists():
        raise InputError(f"{root}: no capture recognised; {_what_there_is(root)}{EXPECTED}")
    above = next((each for each in _and_above(root, _LEVELS_UP) if each != root and has_poses(each)), None)
    notes = [f"{above} holds poses, which are not used: give that folder if they are of these images"]
    return Recognised(root, "images", notes=notes if above else [])


def no_photographs(root: Path) -> str:
    """The line for a capture whose photographs are not there, or are of a kind that is not read."""
    return f"{root}: no photographs found; {_what_there_is(root)}put them into {root / 'images'}"


def _what_there_is(root: Path) -> str:
    """Description of a folder without photographs, as part of an error."""
    if unread := unread_images(root):
        return f"{unread_line(unread)}; "
    for path in entries(root):
        if path.suffix.lower() in _VIDEOS + ARCHIVES:
            return f"{path.name} is {_what_else(path)}; "
    return ""


def _what_else(path: Path) -> str:
    """Description and remedy of a file that is no capture."""
    suffix = path.suffix.lower()
    if suffix in _VIDEOS:
        return (
            "a video; extract photographs, for example with "
            f"`ffmpeg -i {path.name} -vf fps=2 images/%05d.jpg`, and give their folder"
        )
    if suffix in ARCHIVES:
        return "an archive; unpack it and give its folder"
    if suffix in IMAGE_SUFFIXES or suffix in UNREAD_IMAGES:
        return "one image; give the folder of a capture"
    poses = next((each for each in pose_files(path.parent) if each.path == path and not each.readable), None)
    return _unread_poses(poses) if poses else f"no capture; {EXPECTED}"


def _unread_poses(poses: PoseFile) -> str:
    return f"poses of {poses.what} are not read; export them in COLMAP's form or as transforms.json"
