"""load_scene: recognise a capture by itself and read it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.capture import Capture, Shot
from diga3d_warp.scene.checks.calibration import calibration_notes, check_sizes, fits
from diga3d_warp.scene.checks.frame import check_frame, likely_poses
from diga3d_warp.scene.checks.frame_suspects import CONVENTIONS
from diga3d_warp.scene.colmap.reconstruction import read_colmap
from diga3d_warp.scene.formats.read import read_splat_points
from diga3d_warp.scene.layouts.data_sets import find_data_set
from diga3d_warp.scene.layouts.llff import read_llff
from diga3d_warp.scene.layouts.nerfstudio import read_nerfstudio
from diga3d_warp.scene.layouts.polycam import read_polycam
from diga3d_warp.scene.layouts.recognise import Recognised, no_photographs, recognise
from diga3d_warp.scene.layouts.splat import other_formats, read_splat_cameras
from diga3d_warp.scene.mapping.sfm import map_images, shrink, triangulate
from diga3d_warp.scene.masks.find import find_masks, mask_views
from diga3d_warp.scene.photographs.images import (
    Photograph,
    Wanted,
    check_memory,
    read_photograph,
    read_photographs,
)
from diga3d_warp.scene.photographs.names import view_names
from diga3d_warp.scene.photographs.orientation import (
    Turns,
    find_turns,
    fit_upright,
    more_points,
    turn_notes,
    turned_view,
)
from diga3d_warp.scene.photographs.sources import Source, find_sources
from diga3d_warp.scene.photographs.unposed import find_photographs
from diga3d_warp.scene.scene import Points, Reading, Scene, View
from diga3d_warp.scene.working_frame import WorkingFrame, with_near_planes

T = TypeVar("T")

# With fewer views than this, none is held out: the fit needs all of them.
_FEWEST_VIEWS_TO_HOLD_OUT = 4
# Most images whose reason for being left out is noted one by one; the others are counted.
_REASONS = 4


def load_scene(
    path: str | Path,
    *,
    image_scale: float = Reading.image_scale,
    masks: str | Path | None = None,
    mask_ids: Sequence[int] = Reading.mask_ids,
    hold_out: int = Reading.hold_out,
    progress: bool = False,
) -> Scene:
    """Read a capture, recognising its layout.

    A file is read as given: a transforms.json, a cameras.json, a file of a COLMAP reconstruction,
    poses_bounds.npy, a splat .ply. In a folder the first of these is read: the cameras.json of a splat;
    nerfstudio (`transforms.json`); COLMAP (`sparse/0` or elsewhere, .bin or .txt); NeRF-synthetic
    (`transforms_train.json`); Polycam (`keyframes`); LLFF and SPIn-NeRF (`poses_bounds.npy`); a cameras.json
    without a splat; photographs only, whose poses are then recovered. Poses that are present but not read are
    named in a note. Photographs that are missing or damaged are left out with a note. Where there are no
    sparse points they are triangulated.

    Args:
        path: Scene folder, or the file in it that holds the poses or the splat.
        image_scale: Size of the views in (0, 1], relative to the largest images present. `images_N` is read
            where it is large enough.
        masks: Folder with masks named after the images; None looks for `images_N/label`, masks that
            transforms.json names, and `masks`. Unusable masks among them are noted and left out.
        mask_ids: Numbers of the objects that are meant, where masks hold several; all if empty.
        hold_out: Every such view in sorted order, from the first, is held out for testing; 0 holds out none,
            and so do scenes of fewer than 4 views. A capture's own split is kept instead: of SPIn-NeRF,
            360-USID, Inpaint360GS, NeRF-synthetic, test_filenames in transforms.json, cameras.json of this
            program.
        progress: Show progress on the terminal.

    Returns:
        The scene, its views sorted by name.

    Raises:
        InputError: the input is not usable; one line says why and what would mend it.
    """
    path = Path(path)
    found = recognise(path)
    root, capture = found.root, read_capture(found, progress)
    if found.images is not None and (chosen := _only(capture.image_folders, found.images)):
        capture = replace(capture, image_folders=chosen)
    if not capture.image_folders:
        raise InputError(no_photographs(root))
    shots = _shots(capture, root)
    data_set = find_data_set(root, capture)
    beside = None if data_set is None else data_set.beside
    sources = find_sources(capture.image_folders, list(shots), image_scale, beside)
    keys = _keys(sources.found)
    files = {keys[name]: source.file for name, source in sources.found.items()}
    turns = find_turns({keys[name]: shots[name].camera for name in sources.found}, files)
    photographs, damaged = _read_photographs(sources.found, keys, turns, progress)
    notes = [*found.notes, *capture.notes, *sources.notes, *damaged]
    if data_set is not None:
        notes.insert(0, data_set.data_set.line(root, image_scale, hold_out, capture.image_folders))
    notes += calibration_notes({keys[name]: shots[name].camera for name in sources.found})
    if len(photographs) < 2:
        raise InputError(
            f"{root}: a scene needs at least two photographs with poses, not {len(photographs)}; "
            f"{'; '.join([*sources.notes, *damaged][:_REASONS]) or 'take or register more'}"
        )
    read = {
        keys[name]: _view(shots[name], keys[name], photograph, turns.left(keys[name]))
        for name, photograph in photographs.items()
    }
    views: Mapping[str, View] = {key: read[key] for key in sorted(read)}
    check_sizes({key: view.camera for key, view in views.items()}, image_scale)
    held_out = capture.held_out and frozenset(keys[name] for name in capture.held_out if name in keys)

    mask_folder = Path(masks) if masks is not None else None
    named = {keys[name]: file for name, shot in shots.items() if (file := shot.mask) and name in photographs}
    mask_files = find_masks(root, capture.image_folders, mask_folder, list(views), named)
    truth = mask_files.ground_truth
    if data_set is not None:
        truth |= {keys[name] for name in data_set.without_object if name in photographs}
    if truth:
        held_out = (held_out or frozenset()) | truth
        mask_files = replace(mask_files, ground_truth=truth)
    test_keys = _held_out(list(views), held_out, hold_out)
    if test_keys.issuperset(views):
        raise InputError(f"{root}: its split leaves no view for training; correct it, or restore the images")

    given = capture.points
    if given is not None and given.tracks and test_keys:
        given, note = _of_training(given, {name for name, key in keys.items() if key in test_keys})
        notes.append(note)
    views, turns, points, said = _with_points(views, turns, given, test_keys, progress)
    notes += said
    seen = {key: view for key, view in views.items() if key not in test_keys}
    if given is None or not len(given):
        _check_triangulated(seen, points, found, progress)
    elif found.kind in CONVENTIONS:  # else poses and points are our own
        name = "the sparse points" if found.splat is None else f"the gaussians of {found.splat.name}"
        notes += check_frame(seen, points, _pose_source(found), name, CONVENTIONS[found.kind])
    may_be_seen = found.splat is not None and held_out is None and bool(test_keys)
    if may_be_seen:
        notes.append("the held-out views may be among those that the given splat was trained on")
    names = view_names(list(views))
    views = {key: replace(view, name=names[key]) for key, view in views.items()}
    masked = mask_views(views, mask_files, mask_ids, turns.masks(views), test_keys, progress)
    notes += masked.notes
    train, test = (
        [masked.views[key] for key in views if (key in test_keys) == held] for held in (False, True)
    )
    scene = Scene(
        path,
        capture.kind,
        train,
        test,
        points,
        tuple(notes),
        found.splat,
        ground_truth=bool(truth),
        reading=Reading(image_scale, mask_folder, hold_out, tuple(mask_ids)),
        mask_problem=masked.problem,
        may_be_seen=may_be_seen,
    )
    return with_near_planes(scene)


def read_capture(found: Recognised, progress: bool) -> Capture:
    """Read the calibration that was recognised."""
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
        if others := other_formats(found.splat):
            notes.append(f"{found.splat.name} is read, not {', '.join(path.name for path in others)}")
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
    images, damaged = {}, []
    for file in found.files:
        try:
            images[file.relative_to(folder).as_posix()] = shrink(read_photograph(file).pixels)
        except InputError as error:
            damaged.append(error)
    numbered = _numbered(list(images))
    cameras, points = map_images({number: images[name] for number, name in numbered.items()}, progress)
    shots = [Shot(numbered[number], camera) for number, camera in cameras.items()]
    tracks = [frozenset(numbered[number] for number in track) for track in points.tracks]
    recovered = f"poses of {len(shots)} of {len(images)} images recovered with COLMAP's mapper"
    notes = [*found.notes, *_damage_notes(damaged), recovered]
    return Capture("images", shots, found.folders, replace(points, tracks=tracks), notes)


def _of_training(points: Points, test: Set[str]) -> tuple[Points, str]:
    """Mapped points that at least two training photographs show, and notes on the others."""
    kept = points.without(test)
    return kept, (
        "the poses were found from all photographs, those held out too; "
        f"{len(points) - len(kept)} of {len(points)} points that only they add are left out"
    )


def _with_points(
    views: Mapping[str, View], turns: Turns, given: Points | None, test: frozenset[str], progress: bool
) -> tuple[Mapping[str, View], Turns, Points, list[str]]:
    """Views in the orientation of their calibration, sparse points, and notes on both.

    Missing points are triangulated from training views only, so that held-out views do not influence the
    fit.
    """
    doubtful, notes = turns.doubtful, []
    upright = {
        key: turned_view(view, doubtful[key]) if key in doubtful else view for key, view in views.items()
    }
    if given is not None and len(given):
        points, better = given, fit_upright(views, doubtful, given)
    else:
        points, better = _triangulate(views, test, progress), False
        if doubtful:
            others = _triangulate(upright, test, progress)
            better = more_points(len(points), len(others))
            points = others if better else points
        notes.append(f"the capture has no sparse points: triangulated {len(points)}")
    notes += turn_notes(turns, better)
    return upright if better else views, turns.settled(bool(better)), points, notes


def _check_triangulated(views: Mapping[str, View], points: Points, found: Recognised, progress: bool) -> None:
    """Refuse poses under which photographs agree in no points, or in far fewer than after a usual correction.

    Raises:
        InputError: they do.
    """

    def count(changed: Mapping[str, View]) -> int:
        return len(_triangulate(changed, frozenset(), progress))

    suspect = likely_poses(views, len(points), count)
    if suspect is not None:
        raise InputError(
            f"{_pose_source(found)}: the poses do not fit the photographs, {len(points)} points agree; they "
            f"fit if {suspect.fault}; {CONVENTIONS[found.kind]}"
        )
    if not len(points):
        raise InputError(
            f"{found.root}: no sparse points, and none could be triangulated; check that poses and images "
            "match"
        )


def _pose_source(found: Recognised) -> Path:
    """The path that errors about poses name: their file or folder if there is one, or else the capture."""
    return found.poses[0] if len(found.poses) == 1 else found.root


def _triangulate(views: Mapping[str, View], test: frozenset[str], progress: bool) -> Points:
    """Points of the training views, triangulated around the origin: far from it, float64 is too coarse."""
    numbered = _numbered([view for key, view in views.items() if key not in test])
    frame = WorkingFrame.of_cameras([view.camera for view in numbered.values()])
    pixels = {number: view.pixels for number, view in numbered.items()}
    cameras = {number: frame.working_camera(view.camera) for number, view in numbered.items()}
    found = triangulate(pixels, cameras, progress)
    return Points(frame.to_user(found.positions), found.colors)


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
    sources: Mapping[str, Source], keys: Mapping[str, str], turns: Turns, progress: bool
) -> tuple[dict[str, Photograph], list[str]]:
    """Photographs by name, and a note on each that is damaged."""
    photographs: dict[str, Photograph] = {}
    damaged = []
    wanted = [Wanted(source.file, source.scale, turns.of(keys[name])) for name, source in sources.items()]
    check_memory(wanted)
    for name, photograph in zip(sources, read_photographs(wanted, progress), strict=True):
        if isinstance(photograph, InputError):
            damaged.append(photograph)
        else:
            photographs[name] = photograph
    return photographs, _damage_notes(damaged)


def _damage_notes(errors: Sequence[InputError]) -> list[str]:
    """Notes on the images that are left out: one for each of the first few, and the number of others."""
    notes = [f"left out: {error}" for error in errors[:_REASONS]]
    rest = len(errors) - len(notes)
    return [*notes, f"left out: {rest} more images that cannot be read"] if rest else notes


def _view(shot: Shot, key: str, photograph: Photograph, orientation: int) -> View:
    height, width = photograph.pixels.shape[:2]
    camera = shot.camera
    if not fits(camera, width, height):
        turned = "" if orientation == 1 else f", also turned by its EXIF orientation {orientation}"
        raise InputError(
            f"image {key}: {width} x {height} px as read{turned}, but calibrated at {camera.width} x "
            f"{camera.height} px; use the photographs of the calibration"
        )
    resized = camera.resized(width, height)
    return View(key, resized, photograph.pixels, alpha=photograph.alpha, orientation=orientation)


def _held_out(keys: Sequence[str], apart: frozenset[str] | None, hold_out: int) -> frozenset[str]:
    """Keys of the test views: the capture's own split if it has one, else every `hold_out`th."""
    if apart is not None:
        return apart
    if hold_out <= 0 or len(keys) < _FEWEST_VIEWS_TO_HOLD_OUT:
        return frozenset()
    return frozenset(keys[::hold_out])
