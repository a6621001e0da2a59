"""load_scene: recognise a capture by itself and read it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.scene.capture import Capture, Shot, image_files, image_folders
from diga3d_warp.scene.colmap import find_reconstruction, read_colmap
from diga3d_warp.scene.formats.read import read_splat_points
from diga3d_warp.scene.formats.recognise import SPLAT_ENDINGS, splat_format
from diga3d_warp.scene.images import Photograph, choose_folder, read_photograph, read_photographs
from diga3d_warp.scene.llff import read_llff
from diga3d_warp.scene.masks import find_masks, mask_notes, read_mask, without_covering
from diga3d_warp.scene.nerfstudio import find_transforms, read_nerfstudio
from diga3d_warp.scene.scene import Reading, Scene, View
from diga3d_warp.scene.sfm import map_images, shrink, triangulate
from diga3d_warp.scene.splat import find_cameras_root, find_splat, read_splat_cameras

# With fewer views, holding one out costs the fit more than a test is worth.
_FEWEST_VIEWS_TO_HOLD_OUT = 4
# An image may differ from its calibration in aspect ratio by this fraction: rounding in images_8 of a
# 400 px image makes 1 %.
_ASPECT_TOLERANCE = 0.02
# Images that a note names. NeRF-synthetic has some 400 without a pose: depth, normals, a further split.
_NAMES_LISTED = 8


def load_scene(
    path: str | Path,
    *,
    image_scale: float = Reading.image_scale,
    masks: str | Path | None = None,
    hold_out: int = Reading.hold_out,
    progress: bool = False,
) -> Scene:
    """Read a capture, recognising its layout.

    In this order: a splat .ply with a cameras file; COLMAP (`sparse/0`, `sparse` or `colmap/sparse/0`, .bin
    or .txt); nerfstudio (`transforms.json`) and NeRF-synthetic (`transforms_train.json`); LLFF and SPIn-NeRF
    (`poses_bounds.npy`); a folder with images only, whose poses are then recovered. Photographs that are
    missing or damaged are left out with a note. Where there are no sparse points they are triangulated.

    Args:
        path: Scene folder, splat .ply or transforms.json.
        image_scale: Size of the views in (0, 1], relative to the largest images present. `images_N` is read
            where it is large enough.
        masks: Folder with masks named after the images; None looks for `images_N/label` and `masks`.
        hold_out: Every such view in sorted order, from the first, is held out for testing; 0 holds out none,
            and so do scenes of fewer than 4 views. SPIn-NeRF and NeRF-synthetic scenes have their own test
            views instead.
        progress: Show progress on the terminal.

    Returns:
        The scene, its views sorted by name.

    Raises:
        InputError: the input is not usable; one line says why and what would mend it.
    """
    path = Path(path)
    root, capture, splat = _recognise(path, progress)
    if not capture.image_folders:
        raise InputError(f"{root}: no photographs found; put them into {root / 'images'}")
    shots = _sorted_shots(capture, root)
    folder, scale = choose_folder(capture.image_folders, image_scale)
    photographs, missing = _read_photographs(folder, shots, scale, progress)
    if len(photographs) < 2:
        raise InputError(
            f"{folder}: a scene needs at least two photographs with poses, not {len(photographs)}; "
            f"{'; '.join(missing[:_NAMES_LISTED]) or 'take or register more'}"
        )
    views = {shot.key: _view(shot, photographs[shot.key]) for shot in shots if shot.key in photographs}
    notes = [*capture.notes, *missing, *_unposed(folder, shots)]

    mask_folder = Path(masks) if masks is not None else None
    mask_files = find_masks(root, capture.image_folders, mask_folder, list(views))
    for key, file in mask_files.files.items():
        height, width = views[key].pixels.shape[:2]
        views[key] = views[key].with_mask(read_mask(file, width, height))

    points = capture.points
    if points is None or not len(points):
        pixels = {key: view.pixels for key, view in views.items() if key not in capture.held_out}
        points = triangulate(pixels, {key: views[key].camera for key in pixels}, progress)
        notes.append(f"the capture has no sparse points: triangulated {len(points)}")
    if not len(points):
        raise InputError(
            f"{root}: no sparse points, and none could be triangulated; check that poses and images match"
        )
    train, test = _split(views, capture.held_out | mask_files.ground_truth, hold_out)
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
        splat,
        ground_truth=bool(mask_files.ground_truth),
        reading=Reading(image_scale, mask_folder, hold_out),
    )


def _recognise(path: Path, progress: bool) -> tuple[Path, Capture, Path | None]:
    """Scene folder, calibration and splat of a capture."""
    if not path.exists():
        raise InputError(f"{path}: there is no such file or folder; give the folder of a capture")
    splat = None
    if path.suffix.lower() in SPLAT_ENDINGS and path.is_file():
        if splat_format(path) is None:
            raise InputError(f"{path}: a .ply without gaussians; give the folder of the capture instead")
        root, splat = find_cameras_root(path), path
    else:
        root = path if path.is_dir() else path.parent
        splat = find_splat(root)
    if splat is not None and (root / "cameras.json").is_file():
        capture = read_splat_cameras(root)
    elif (reconstruction := find_reconstruction(root)) is not None:
        capture = read_colmap(root, reconstruction)
    elif transforms := find_transforms(root):
        capture = read_nerfstudio(root, transforms)
    elif (root / "poses_bounds.npy").is_file():
        capture = read_llff(root)
    elif splat is not None:
        raise InputError(f"{splat}: no cameras file; put the cameras.json of its training into {root}")
    else:
        capture = _map_folder(root, progress)
    if splat is not None:
        points, notes = read_splat_points(splat)
        capture = replace(capture, kind="splat", points=points, notes=[*capture.notes, *notes])
    return root, capture, splat


def _map_folder(root: Path, progress: bool) -> Capture:
    """Recover the poses of a folder that holds images only: in `images`, or in the folder itself."""
    folders = image_folders(root) or ({1: root} if image_files(root) else {})
    if not folders or (root / "sparse").exists():
        raise InputError(
            f"{root}: no capture recognised; expected sparse/0 with cameras and images files (COLMAP), "
            "transforms.json or transforms_train.json, poses_bounds.npy, a splat .ply with cameras.json, or "
            "photographs only"
        )
    images, notes = {}, []
    for key, file in image_files(folders[min(folders)]).items():
        try:
            images[key] = shrink(read_photograph(file).pixels)
        except InputError as error:
            notes.append(str(error))
    cameras, points = map_images(images, progress)
    shots = [Shot(key, camera) for key, camera in cameras.items()]
    notes.append(f"poses of {len(shots)} of {len(images)} images recovered with COLMAP's mapper")
    return Capture("images", shots, folders, points, notes)


def _sorted_shots(capture: Capture, root: Path) -> list[Shot]:
    shots = sorted(capture.shots, key=lambda shot: shot.key)
    keys = [shot.key for shot in shots]
    if len(set(keys)) < len(keys):
        twice = next(key for key, next_key in pairwise(keys) if key == next_key)
        raise InputError(f"{root}: two images are called {twice}; rename one of them")
    return shots


def _read_photographs(
    folder: Path, shots: Sequence[Shot], scale: float, progress: bool
) -> tuple[dict[str, Photograph], list[str]]:
    """Photographs by key, and a note on the images that are missing and one on each that is damaged."""
    files = image_files(folder)
    missing = [shot.key for shot in shots if shot.key not in files]
    notes = [f"{folder}: {len(missing)} images are missing: {_listed(missing)}"] if missing else []
    present = [shot.key for shot in shots if shot.key in files]
    photographs = {}
    found = read_photographs([files[k] for k in present], scale, progress)
    for key, photograph in zip(present, found, strict=True):
        if isinstance(photograph, InputError):
            notes.append(f"left out: {photograph}")
        else:
            photographs[key] = photograph
    return photographs, notes


def _unposed(folder: Path, shots: Sequence[Shot]) -> list[str]:
    """A note on images without a pose; masks kept in subfolders are not meant."""
    known = {shot.key for shot in shots}
    top = any("/" not in key for key in known)
    extra = [key for key in image_files(folder) if key not in known and not (top and "/" in key)]
    return [f"{folder}: {len(extra)} images have no pose and are left out: {_listed(extra)}"] if extra else []


def _listed(names: Sequence[str]) -> str:
    """Names in one line that can be read."""
    rest = f" and {len(names) - _NAMES_LISTED} more" if len(names) > _NAMES_LISTED else ""
    return ", ".join(names[:_NAMES_LISTED]) + rest


def _view(shot: Shot, photograph: Photograph) -> View:
    height, width = photograph.pixels.shape[:2]
    camera = shot.camera
    if abs(width * camera.height / (height * camera.width) - 1) > _ASPECT_TOLERANCE:
        raise InputError(
            f"image {shot.key}: {width} x {height} px as read, but calibrated at {camera.width} x "
            f"{camera.height} px; use the photographs of the calibration"
        )
    return View(shot.key, camera.resized(width, height), photograph.pixels, alpha=photograph.alpha)


def _split(views: Mapping[str, View], apart: frozenset[str], hold_out: int) -> tuple[list[View], list[View]]:
    """Training and test views, named; the latter are those that the capture keeps apart, if it does."""
    plain = Counter(key.rsplit("/", 1)[-1] for key in views)
    train: list[View] = []
    test: list[View] = []
    for index, (key, view) in enumerate(views.items()):
        stem = key.rsplit("/", 1)[-1]
        named = replace(view, name=stem if plain[stem] == 1 else key.replace("/", "_"))
        if apart:
            held_out = key in apart
        else:
            held_out = hold_out > 0 and len(views) >= _FEWEST_VIEWS_TO_HOLD_OUT and index % hold_out == 0
        (test if held_out else train).append(named)
    return train, test
