"""load_scene: recognise a capture by itself and read it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.calibration import calibration_notes, check_sizes, fits
from diga3d_warp.scene.capture import Capture, Shot
from diga3d_warp.scene.colmap import read_colmap
from diga3d_warp.scene.formats.read import read_splat_points
from diga3d_warp.scene.images import Photograph, read_photograph, read_photographs
from diga3d_warp.scene.llff import read_llff
from diga3d_warp.scene.masks import find_masks, mask_notes, read_mask, without_covering
from diga3d_warp.scene.names import view_names
from diga3d_warp.scene.nerfstudio import read_nerfstudio
from diga3d_warp.scene.photo_set import find_photographs
from diga3d_warp.scene.polycam import read_polycam
from diga3d_warp.scene.recognise import Recognised, no_photographs, recognise
from diga3d_warp.scene.scene import Points, Reading, Scene, View
from diga3d_warp.scene.sfm import map_images, shrink, triangulate
from diga3d_warp.scene.sources import Source, find_sources
from diga3d_warp.scene.splat import read_splat_cameras

T = TypeVar("T")

# With fewer views, holding one out costs the fit more than a test is worth.
_FEWEST_VIEWS_TO_HOLD_OUT = 4
# Reasons that a refusal for want of photographs gives.
_REASONS = 4


def load_scene(
    path: str | Path,
    *,
    image_scale: float = Reading.image_scale,
    masks: str | Path | None = None,
    hold_out: int = Reading.hold_out,
    progress: bool = False,
) -> Scene:
    """Read a capture, recognising its layout.

    The file that is named is the file that is read: a transforms.json, a cameras.json, a file of a COLMAP
    reconstruction, poses_bounds.npy, a splat .ply. In a folder, in this order: the cameras.json of a splat;
    nerfstudio (`transforms.json`); COLMAP (`sparse/0` or elsewhere, .bin or .txt); NeRF-synthetic
    (`transforms_train.json`); Polycam (`keyframes`); LLFF and SPIn-NeRF (`poses_bounds.npy`); a cameras.json
    without a splat; photographs only, whose poses are then recovered. Poses that are there and not read are
    named in a note. Photographs that are missing or damaged are left out with a note. Where there are no
    sparse points they are triangulated.

    Args:
        path: Scene folder, or the file in it that holds the poses or the splat.
        image_scale: Size of the views in (0, 1], relative to the largest images present. `images_N` is read
            where it is large enough.
        masks: Folder with masks named after the images; None looks for `images_N/label` and `masks`.
        hold_out: Every such view in sorted order, from the first, is held out for testing; 0 holds out none,
            and so do scenes of fewer than 4 views. A capture's own split is kept instead: of SPIn-NeRF,
            NeRF-synthetic, test_filenames in transforms.json, cameras.json of this program.
        progress: Show progress on the terminal.

    Returns:
        The scene, its views sorted by name.

    Raises:
        InputError: the input is not usable; one line says why and what would mend it.
    """
    path = Path(path)
    found = recognise(path)
    root, capture = found.root, _read(found, progress)
    if found.images is not None and (chosen := _only(capture.image_folders, found.images)):
        capture = replace(capture, image_folders=chosen)
    if not capture.image_folders:
        raise InputError(no_photographs(root))
    shots = _shots(capture, root)
    sources = find_sources(capture.image_folders, list(shots), image_scale)
    keys = _keys(sources.found)
    photographs, damaged = _read_photographs(sources.found, progress)
    notes = [*found.notes, *capture.notes, *sources.notes, *damaged]
    notes += calibration_notes({keys[name]: shots[name].camera for name in sources.found})
    if len(photographs) < 2:
        raise InputError(
            f"{root}: a scene needs at least two photographs with poses, not {len(photographs)}; "
            f"{'; '.join([*sources.notes, *damaged][:_REASONS]) or 'take or register more'}"
        )
    views = {
        keys[name]: _view(shots[name], keys[name], photograph) for name, photograph in photographs.items()
    }
    views = {key: views[key] for key in sorted(views)}
    check_sizes({key: view.camera for key, view in views.items()}, image_scale)
    held_out = capture.held_out and frozenset(keys[name] for name in capture.held_out if name in keys)

    mask_folder = Path(masks) if masks is not None else None
    mask_files = find_masks(root, capture.image_folders, mask_folder, list(views))
    for key, file in mask_files.files.items():
        height, width = views[key].pixels.shape[:2]
        views[key] = views[key].with_mask(read_mask(file, width, height))

    points = capture.points
    if points is None or not len(points):
        shown = [view for key, view in views.items() if key not in (held_out or ())]
        points = _triangulate(shown, progress)
        notes.append(f"the capture has no sparse points: triangulated {len(points)}")
    if not len(points):
        raise InputError(
            f"{root}: no sparse points, and none could be triangulated; check that poses and images match"
        )
    if mask_files.ground_truth:
        held_out = (held_out or frozenset()) | mask_files.ground_truth
    train, test = _split(views, held_out, hold_out)
    if not train:
        raise InputError(f"{root}: its split leaves no view for training; correct it, or restore the images")
    if mask_files.files:
        notes += mask_notes(train, mask_folder or root)
        train = without_covering(train)
    return Scene(
        path,
        capture.kind,
        train,
        test,
        points,
        tuple(notes),
        found.splat,
        ground_truth=bool(mask_files.ground_truth),
        reading=Reading(image_scale, mask_folder, hold_out),
    )


def _read(found: Recognised, progress: bool) -> Capture:
    """The calibration that was found."""
    root, poses = found.root, list(found.poses)
    if found.kind == "images":
        return _map_folder(root, progress)
    if found.kind == "cameras":
        capture = read_splat_cameras(root, poses[0])
    elif found.kind == "colmap":
        capture = read_colmap(root, poses[0])
    elif found.kind == "nerfstudio":
        capture = read_nerfstudio(root, poses)
    elif found.kind == "polycam":
        capture = read_polycam(poses[0])
    else:
        capture = read_llff(root, poses[0])
    if found.splat is not None:
        points, notes = read_splat_points(found.splat)
        capture = replace(capture, kind="splat", points=points, notes=[*capture.notes, *notes])
    return capture


def _only(folders: Mapping[int, Path], chosen: Path) -> dict[int, Path]:
    """The image folder that was named, by its factor; none if the capture does not have it."""
    return {factor: folder for factor, folder in folders.items() if folder.samefile(chosen)}


def _map_folder(root: Path, progress: bool) -> Capture:
    """Recover the poses of a folder that holds photographs only."""
    found = find_photographs(root)
    folder = found.folders[min(found.folders)]
    if not found.files:
        raise InputError(f"{'; '.join(found.notes) or root}: none is left; give the folder of photographs")
    images, notes = {}, list(found.notes)
    for file in found.files:
        try:
            images[file.relative_to(folder).as_posix()] = shrink(read_photograph(file).pixels)
        except InputError as error:
            notes.append(str(error))
    numbered = _numbered(list(images))
    cameras, points = map_images({number: images[name] for number, name in numbered.items()}, progress)
    shots = [Shot(numbered[number], camera) for number, camera in cameras.items()]
    notes.append(f"poses of {len(shots)} of {len(images)} images recovered with COLMAP's mapper")
    return Capture("images", shots, found.folders, points, notes)


def _triangulate(views: Sequence[View], progress: bool) -> Points:
    numbered = _numbered(views)
    pixels = {number: view.pixels for number, view in numbered.items()}
    return triangulate(pixels, {number: view.camera for number, view in numbered.items()}, progress)


def _numbered(items: Sequence[T]) -> dict[str, T]:
    """Items by names that COLMAP's lists can hold, in their order: names of users may hold spaces."""
    return {f"{index:06d}": item for index, item in enumerate(items)}


def _shots(capture: Capture, root: Path) -> dict[str, Shot]:
    """Shots by name.

    Raises:
        InputError: two shots of one image differ.
    """
    shots: dict[str, Shot] = {}
    for shot in sorted(capture.shots, key=lambda shot: shot.name):
        other = shots.setdefault(shot.name, shot)
        if other is not shot and not np.allclose(other.camera.pose, shot.camera.pose):
            raise InputError(f"{root}: two images are called {shot.name}; rename one of them")
    return shots


def _keys(found: Mapping[str, Source]) -> dict[str, str]:
    """Key of each image, by name: with its ending where two images differ in their endings only."""
    count = Counter(source.key for source in found.values())
    return {name: source.key if count[source.key] == 1 else name for name, source in found.items()}


def _read_photographs(
    sources: Mapping[str, Source], progress: bool
) -> tuple[dict[str, Photograph], list[str]]:
    """Photographs by name, and a note on each that is damaged."""
    photographs: dict[str, Photograph] = {}
    notes = []
    for scale in sorted({source.scale for source in sources.values()}):
        names = [name for name, source in sources.items() if source.scale == scale]
        read = read_photographs([sources[name].file for name in names], scale, progress)
        for name, photograph in zip(names, read, strict=True):
            if isinstance(photograph, InputError):
                notes.append(f"left out: {photograph}")
            else:
                photographs[name] = photograph
    return photographs, notes


def _view(shot: Shot, key: str, photograph: Photograph) -> View:
    height, width = photograph.pixels.shape[:2]
    camera = shot.camera
    if not fits(camera, width, height):
        raise InputError(
            f"image {key}: {width} x {height} px as read, but calibrated at {camera.width} x "
            f"{camera.height} px; use the photographs of the calibration"
        )
    return View(key, camera.resized(width, height), photograph.pixels, alpha=photograph.alpha)


def _split(
    views: Mapping[str, View], apart: frozenset[str] | None, hold_out: int
) -> tuple[list[View], list[View]]:
    """Training and test views, named; the latter are those that the capture keeps apart, if it says so."""
    names = view_names(list(views))
    train: list[View] = []
    test: list[View] = []
    for index, (key, view) in enumerate(views.items()):
        if apart is not None:
            held_out = key in apart
        else:
            held_out = hold_out > 0 and len(views) >= _FEWEST_VIEWS_TO_HOLD_OUT and index % hold_out == 0
        (test if held_out else train).append(replace(view, name=names[key]))
    return train, test
