"""nerfstudio captures: transforms.json, with poses in OpenGL axes (x right, y up, z backwards).

NeRF-synthetic and other exports of Blender have transforms_train.json instead, with the held-out views in
transforms_test.json. They name images without their ending and give a field of view but no size.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from diga3d_warp.errors import InputError
from diga3d_warp.files import read_json
from diga3d_warp.scene.capture import IMAGE_SUFFIXES, Capture, Shot, image_folders, image_key, inside
from diga3d_warp.scene.entries import Entries
from diga3d_warp.scene.formats.read import read_splat_points
from diga3d_warp.scene.formats.recognise import splat_format
from diga3d_warp.scene.images import read_image
from diga3d_warp.scene.point_cloud import read_points
from diga3d_warp.scene.transforms import read_frames


def find_transforms(root: Path) -> list[Path]:
    """The files of a scene folder that name its frames, first those for training; empty if there are none."""
    if (root / "transforms.json").is_file():
        return [root / "transforms.json"]
    split = [root / "transforms_train.json", root / "transforms_test.json"]
    return [path for path in split if path.is_file()] if split[0].is_file() else []


def read_nerfstudio(root: Path, paths: Sequence[Path]) -> Capture:
    """Read a nerfstudio scene. Intrinsics may stand in each frame or once for all.

    The poses and the points named by `ply_file_path` share one frame: nerfstudio applies
    `applied_transform` to both before writing them, so neither is changed here.

    Args:
        root: Scene folder, to which the paths in the files are relative.
        paths: From `find_transforms`; the frames of a second one are held out.

    Raises:
        InputError: a file is damaged, lacks an entry, names a file outside the scene, or uses a camera model
            that is not supported.
    """
    contents = [read_json(path, "export it again") for path in paths]
    read = [
        read_frames(root, path, each, lambda file: _size_of(root / file))
        for path, each in zip(paths, contents, strict=True)
    ]
    files = [frame.file for each in read for frame in each.frames]
    bases = {file.parts[0] if len(file.parts) > 1 else "" for file in files}
    base = bases.pop() if len(bases) == 1 else ""

    def key(file: PurePosixPath) -> str:
        return image_key(file.relative_to(base).as_posix())

    shots = [Shot(key(frame.file), frame.camera, frame.mask) for each in read for frame in each.frames]
    held_out = frozenset(key(frame.file) for each in read[1:] for frame in each.frames)
    folders = image_folders(root, base) if base else {1: root}
    notes = [note for each in read for note in each.notes]
    points = None
    if named := _cloud_name(paths[0], contents[0]):
        cloud = root / inside(root, named, paths[0])
        if cloud.is_file():
            points, said = read_points(cloud) if splat_format(cloud) is None else read_splat_points(cloud)
            notes += said
        else:
            notes.append(f"{cloud} is missing: points are triangulated instead")
    return Capture("nerfstudio", shots, folders, points, notes, held_out)


def _cloud_name(path: Path, contents: Any) -> str | None:
    try:
        return Entries(contents).text("ply_file_path")
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _size_of(file: Path) -> tuple[int, int] | None:
    """Width and height of an image that may be named without its ending [px]; None if there is none."""
    named = [file, *(file.with_name(file.name + suffix) for suffix in sorted(IMAGE_SUFFIXES))]
    found = next((path for path in named if path.is_file()), None)
    if found is None:
        return None
    height, width = read_image(found).shape[:2]
    return width, height
