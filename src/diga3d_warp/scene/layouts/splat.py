"""Splat captures: a splat with the cameras.json that 3DGS training writes beside it."""

from __future__ import annotations

from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.scene.capture import Capture, Shot
from diga3d_warp.scene.formats.recognise import FORMATS, find_splats, splat_format
from diga3d_warp.scene.layouts.cameras_file import load_cameras
from diga3d_warp.scene.photographs.find_images import name_images
from diga3d_warp.scene.photographs.folders import entries

# Files that hold poses, and how far above the splat they may lie: 3DGS writes
# RUN/point_cloud/iteration_30000/point_cloud.ply and RUN/cameras.json.
_POSES = frozenset(
    (
        "cameras.json",
        "transforms.json",
        "transforms_train.json",
        "poses_bounds.npy",
        "cameras.txt",
        "cameras.bin",
    )
    + ("sparse", "colmap", "keyframes")
)
_LEVELS = 3


def find_splat(root: Path) -> Path | None:
    """The splat of a scene folder: in the folder itself, or the latest iteration of a 3DGS run.

    Where one splat lies there in several formats, files of one stem, the most exact is meant.

    Raises:
        InputError: there are several, and nothing says which one is meant.
    """
    splats = find_splats(root)
    if len({stem(path) for path in splats}) > 1:
        raise InputError(
            f"{root}: several splats ({', '.join(p.name for p in splats)}); give the path of one"
        )
    if splats:
        return min(splats, key=lambda path: FORMATS.index(splat_format(path) or FORMATS[-1]))
    iterations = {}
    for path in root.glob("point_cloud/iteration_*/point_cloud.ply"):
        number = path.parent.name.removeprefix("iteration_")
        if number.isdecimal():
            iterations[int(number)] = path
    return iterations[max(iterations)] if iterations else None


def stem(splat: Path) -> str:
    """Name of a splat file without the endings of its format."""
    return splat.stem.removesuffix(".compressed")


def other_formats(splat: Path) -> list[Path]:
    """Files beside a splat of the same name in other formats."""
    return [path for path in find_splats(splat.parent) if path != splat and stem(path) == stem(splat)]


def has_poses(folder: Path) -> bool:
    """Whether a folder holds poses in the usual places, by their names."""
    return any(path.name.lower() in _POSES for path in entries(folder))


def find_cameras_root(splat: Path) -> Path:
    """The folder with the poses of a splat: its own, or one of those above.

    Raises:
        InputError: none of them holds poses.
    """
    folders = splat.absolute().parents[:_LEVELS]
    for folder in folders:
        if has_poses(folder):
            return folder
    raise InputError(f"{splat}: no cameras file; put the cameras.json of its training into {folders[0]}")


def read_splat_cameras(root: Path, path: Path) -> Capture:
    """Read the cameras.json of a splat.

    The photographs are looked for in `images` or `images_N` of the same folder.

    Args:
        root: Scene folder.
        path: The file.

    Raises:
        InputError: the file is damaged, or the photographs are missing.
    """
    cameras = load_cameras(path)
    every = {**cameras.train, **cameras.test}
    named = name_images(root, list(every), path)
    if not named.folders:
        raise InputError(
            f"{path}: it lists {len(every)} cameras but {root / 'images'} holds no photographs; "
            "copy or link them there"
        )
    shots = [Shot(named.names[name], camera) for name, camera in every.items()]
    held_out = frozenset(named.names[name] for name in cameras.test) if cameras.split else None
    return Capture("splat", shots, named.folders, None, named.notes, held_out)
