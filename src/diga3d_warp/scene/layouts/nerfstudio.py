"""nerfstudio captures: transforms.json, with poses in OpenGL axes (x right, y up, z backwards).

NeRF-synthetic and other exports of Blender have transforms_train.json instead, with the held-out views in
transforms_test.json. They name images without their ending and give a field of view but no size.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

from diga3d_warp.errors import InputError
from diga3d_warp.files import read_json
from diga3d_warp.scene.capture import Capture, Shot
from diga3d_warp.scene.formats.read import read_splat_points
from diga3d_warp.scene.formats.recognise import splat_format
from diga3d_warp.scene.layouts.entries import Entries
from diga3d_warp.scene.layouts.split import read_split
from diga3d_warp.scene.layouts.transforms import read_frames
from diga3d_warp.scene.photographs.decoding import read_header
from diga3d_warp.scene.photographs.find_images import find_images, name_images
from diga3d_warp.scene.photographs.folders import entry, image_folders, image_siblings
from diga3d_warp.scene.photographs.names import inside, leads_outside
from diga3d_warp.scene.point_cloud import read_points

_TRAIN = "transforms_train.json"


def find_transforms(root: Path, name: str) -> list[Path]:
    """The files that name the frames of a scene folder; empty if there are none.

    Args:
        root: Scene folder.
        name: "transforms.json"; or "transforms_train.json", which comes with the
            file of the frames for testing, or else of those for validation, if it is there.
    """
    first = entry(root, name)
    if first is None or not first.is_file():
        return []
    if name.lower() != _TRAIN:
        return [first]
    others = (entry(root, other) for other in ("transforms_test.json", "transforms_val.json"))
    return [first, *[path for path in others if path is not None][:1]]


def read_nerfstudio(root: Path, paths: Sequence[Path]) -> Capture:
    """Read a nerfstudio scene. Intrinsics may be given for each frame or once for all.

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
        read_frames(root, path, each, lambda files: _sizes(root, files))
        for path, each in zip(paths, contents, strict=True)
    ]
    written = [[str(Entries(frame).text("file_path")) for frame in each["frames"]] for each in contents]
    named = name_images(root, [name for each in written for name in each], paths[0], from_root=True)
    notes = [*named.notes, *(note for each in read for note in each.notes)]
    shots = [
        (name, Shot(named.names[name], frame.camera, frame.mask))
        for names, each in zip(written, read, strict=True)
        for name, frame in zip(names, each.frames, strict=True)
    ]
    held_out: frozenset[str] | None = None
    if len(read) > 1:
        held_out = frozenset(named.names[name] for names in written[1:] for name in names)
    else:
        split = read_split(paths[0], contents[0], written[0])
        shots = [(name, shot) for name, shot in shots if name not in split.left_out]
        held_out = None if split.test is None else frozenset(named.names[name] for name in split.test)
        notes += split.notes
    points = None
    if cloud_name := _cloud_name(paths[0], contents[0]):
        cloud = root / inside(root, cloud_name, paths[0])
        if leads_outside(cloud_name):
            notes.append(f"{paths[0]}: {cloud_name!r} leads out of the scene: {cloud} is read")
        if cloud.is_file():
            points, said = read_points(cloud) if splat_format(cloud) is None else read_splat_points(cloud)
            notes += said
        else:
            notes.append(f"{cloud} is missing: points are triangulated instead")
    return Capture("nerfstudio", [shot for _, shot in shots], named.folders, points, notes, held_out)


def _cloud_name(path: Path, contents: Any) -> str | None:
    try:
        return Entries(contents).text("ply_file_path")
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _sizes(root: Path, files: Sequence[PurePosixPath]) -> dict[PurePosixPath, tuple[int, int]]:
    """Width and height [px] of images that may be named without their ending; those not found are absent.

    Where there are only smaller copies, in `images_N`, it is N times theirs.
    """
    sizes: dict[PurePosixPath, tuple[int, int]] = {}
    for parent in dict.fromkeys(file.parent for file in files):
        first, *below = parent.parts or (".",)
        copies = {1: root / first} if first == "." else image_folders(root, first)
        for factor, copy in copies.items():
            names = {file.name: file for file in files if file.parent == parent and file not in sizes}
            folder = copy.joinpath(*below)
            for name, path in find_images(list(names), folder, image_siblings(folder / "any")).files.items():
                with suppress(InputError):  # damaged: left out when it is read
                    header = read_header(path)
                    sizes[names[name]] = (factor * header.width, factor * header.height)
    return sizes
