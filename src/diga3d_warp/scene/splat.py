"""Splat captures: a 3DGS .ply with the cameras.json that 3DGS training writes beside it."""

from __future__ import annotations

from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.scene.cameras_file import load_cameras
from diga3d_warp.scene.capture import Capture, Shot, image_folders, image_key, inside
from diga3d_warp.scene.ply import property_names

# What tells a splat from a point cloud.
_SPLAT_PROPERTIES = frozenset({"x", "y", "z", "f_dc_0", "opacity", "scale_0", "rot_0"})
# Files that hold poses, and how far above the .ply they may lie: 3DGS writes
# RUN/point_cloud/iteration_30000/point_cloud.ply and RUN/cameras.json.
_POSES = ("cameras.json", "transforms.json", "transforms_train.json", "sparse", "poses_bounds.npy")
_LEVELS = 3


def is_splat(path: Path) -> bool:
    """Whether a .ply holds gaussians in the 3DGS form.

    Raises:
        InputError: the file is not a .ply.
    """
    return property_names(path) >= _SPLAT_PROPERTIES


def find_splat(root: Path) -> Path | None:
    """The splat .ply of a scene folder: in the folder itself, or the latest iteration of a 3DGS run.

    Raises:
        InputError: there are several, and nothing says which one is meant.
    """
    splats = [path for path in sorted(root.glob("*.ply")) if is_splat(path)]
    if len(splats) > 1:
        raise InputError(
            f"{root}: several splats ({', '.join(p.name for p in splats)}); give the path of one"
        )
    if splats:
        return splats[0]
    iterations = {}
    for path in root.glob("point_cloud/iteration_*/point_cloud.ply"):
        number = path.parent.name.removeprefix("iteration_")
        if number.isdecimal():
            iterations[int(number)] = path
    return iterations[max(iterations)] if iterations else None


def find_cameras_root(splat: Path) -> Path:
    """The folder with the poses of a splat: its own, or one of those above.

    Raises:
        InputError: none of them holds poses.
    """
    folders = splat.absolute().parents[:_LEVELS]
    for folder in folders:
        if any((folder / name).exists() for name in _POSES):
            return folder
    raise InputError(f"{splat}: no cameras file; put the cameras.json of its training into {folders[0]}")


def read_splat_cameras(root: Path) -> Capture:
    """Read the cameras.json of a splat.

    The photographs are looked for in `images` or `images_N` of the same folder.

    Raises:
        InputError: the file is damaged, or the photographs are missing.
    """
    path = root / "cameras.json"
    cameras = load_cameras(path)
    shots = [
        Shot(image_key(inside(root, name, path)), camera)
        for name, camera in {**cameras.train, **cameras.test}.items()
    ]
    folders = image_folders(root)
    if not folders:
        raise InputError(
            f"{path}: it lists {len(shots)} cameras but {root / 'images'} holds no photographs; "
            "copy or link them there"
        )
    return Capture("splat", shots, folders, None)
