"""COLMAP reconstructions: `sparse/` folders in and out."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.process import load_pycolmap
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.capture import Capture, Shot
from diga3d_warp.scene.colmap.files import find_file, read_cameras, read_images, read_points
from diga3d_warp.scene.colmap.models import colmap_lens
from diga3d_warp.scene.photographs.find_images import name_images
from diga3d_warp.scene.photographs.folders import walk
from diga3d_warp.scene.photographs.names import listed
from diga3d_warp.scene.scene import Points

if TYPE_CHECKING:
    import pycolmap


# Levels below the scene folder at which reconstructions are looked for: colmap/sparse/0, dense/0/sparse.
_DEPTH = 3


class Reconstruction(NamedTuple):
    """A COLMAP reconstruction that was chosen.

    Attributes:
        folder: Folder of its files.
        notes: Why it was chosen, if there was a choice; one line each.
        others: Those that were not chosen, of the same place.
    """

    folder: Path
    notes: Sequence[str] = ()
    others: Sequence[Path] = ()


def choose_reconstruction(root: Path, below: Path | None = None) -> Reconstruction | None:
    """The COLMAP reconstruction of a scene folder, or None.

    Those of `sparse` come first, then one in the folder itself, as RealityScan writes it, then those of
    `colmap/sparse`, then others, last those of distorted images, which 3DGS keeps. Of several in one place,
    the one with the most images is chosen: COLMAP writes one for each part of the images that it could join.

    Args:
        root: Scene folder.
        below: Choose among those at and below this folder only.
    """
    folders = [
        here for here, _ in walk(root, _DEPTH) if find_file(here, "cameras") and find_file(here, "images")
    ]
    folders = sorted(
        (f for f in folders if f.is_relative_to(below or root)), key=lambda f: (_place(root, f), f)
    )
    together = [folder for folder in folders if _place(root, folder) == _place(root, folders[0])]
    if len(together) < 2:
        return Reconstruction(folders[0]) if folders else None
    sizes = {folder: _registered(folder) for folder in together}
    chosen = max(together, key=lambda folder: sizes[folder])
    named = {folder: folder.relative_to(root).as_posix() for folder in together}
    others = [folder for folder in together if folder != chosen]
    sizes_of_others = listed([f"{named[folder]} has {sizes[folder]}" for folder in others])
    note = (
        f"{root}: {named[chosen]} is read, with {sizes[chosen]} images the largest model: {sizes_of_others}"
    )
    return Reconstruction(chosen, [note], others)


def _place(root: Path, folder: Path) -> int:
    parts = [part.lower() for part in folder.relative_to(root).parts]
    if "distorted" in parts:
        return 4
    return {"": 1, "sparse": 0, "colmap": 2}.get(parts[0] if parts else "", 3)


def _registered(folder: Path) -> int:
    """How many images a reconstruction has; none if its file is damaged."""
    file = find_file(folder, "images")
    try:
        return len(read_images(file)) if file else 0
    except InputError:
        return 0


def read_colmap(root: Path, reconstruction: Path) -> Capture:
    """Read a COLMAP scene.

    Args:
        root: Scene folder with `images` or `images_N`; or else with the images themselves.
        reconstruction: Folder with the cameras, images and points3D files, .bin or .txt; points3D may be
            missing.

    Raises:
        InputError: a file is missing or damaged, an image names a camera that is not there, or a camera
            model is not supported.
    """
    cameras_file, images_file = find_file(reconstruction, "cameras"), find_file(reconstruction, "images")
    if cameras_file is None or images_file is None:
        raise InputError(f"{reconstruction}: the cameras or images file is missing; rerun COLMAP")
    images = read_images(images_file)
    cameras = read_cameras(cameras_file, {number for _, number, _ in images})
    named = name_images(root, [name for name, _, _ in images], images_file)
    shots = []
    for name, number, pose in images:
        if number not in cameras:
            raise InputError(
                f"{images_file}: {name!r} was taken with camera {number}, which {cameras_file.name} lacks; "
                "use the files of one COLMAP run"
            )
        try:
            shots.append(Shot(named.names[name], cameras[number].with_pose(pose)))
        except InputError as error:
            raise InputError(f"{images_file}: {name!r}: {error}") from None
    points_file = find_file(reconstruction, "points3D")
    points, notes = read_points(points_file) if points_file else (None, [])
    return Capture("colmap", shots, named.folders, points, [*named.notes, *notes])


def posed_reconstruction(cameras: Mapping[str, Camera]) -> pycolmap.Reconstruction:
    """A pycolmap reconstruction of posed images without points.

    Args:
        cameras: Camera of each image, keyed by image name with its ending. Identifiers count from 1 in
            sorted order of the names.
    """
    pycolmap = load_pycolmap()

    reconstruction = pycolmap.Reconstruction()
    for number, name in enumerate(sorted(cameras), start=1):
        camera = cameras[name]
        model, parameters = colmap_lens(camera)
        reconstruction.add_camera_with_trivial_rig(
            pycolmap.Camera(
                camera_id=number, model=model, width=camera.width, height=camera.height, params=parameters
            )
        )
        image = pycolmap.Image(name=name, camera_id=number, image_id=number)
        reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d(camera.pose[:3]))
    return reconstruction


def write_colmap(folder: Path, cameras: Mapping[str, Camera], points: Points, suffix: str = ".png") -> None:
    """Write `folder`/sparse/0 in COLMAP's binary form, replacing one that is there.

    Args:
        folder: Scene folder; made if missing. The images themselves are the caller's.
        cameras: Camera of each image, keyed by image name without ending.
        points: Sparse points; written without tracks.
        suffix: Ending of the image files.
    """
    pycolmap = load_pycolmap()

    reconstruction = posed_reconstruction({name + suffix: camera for name, camera in cameras.items()})
    for position, color in zip(points.positions, points.colors, strict=True):
        reconstruction.add_point3D(np.asarray(position, np.float64), pycolmap.Track(), color)
    finished = Path(folder) / "sparse" / "0"
    partial = finished.with_name("0.partial")
    if partial.exists():
        shutil.rmtree(partial)
    partial.mkdir(parents=True)
    reconstruction.write_binary(partial)
    if finished.exists():
        shutil.rmtree(finished)
    partial.rename(finished)
