"""Finding masks: their files, the image of each, and whether they can mark an object.

Unusable masks do not make a capture unusable: only an edit that needs masks refuses it. So the problem is
kept as a message, `Scene.mask_problem`.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.masks.labels import Labels, read_labels
from diga3d_warp.scene.masks.objects import object_masks
from diga3d_warp.scene.photographs.decoding import turned
from diga3d_warp.scene.photographs.folders import image_files
from diga3d_warp.scene.photographs.images import read_in_parallel
from diga3d_warp.scene.photographs.names import image_key, listed
from diga3d_warp.scene.photographs.orientation import masks_turned
from diga3d_warp.scene.scene import View

MASK_FOLDERS = ("masks", "mask", "object_masks")
"""Folders of a scene in which masks are looked for, in this order; the last is 360-USID's."""

# What people and tools add to the name of an image for the name of its mask.
_AFFIX = re.compile(
    r"^(?:mask|matte|label|seg)s?[._ -]+|[._ -]+(?:mask|matte|label|seg|segmentation|alpha)s?$", re.IGNORECASE
)


@dataclass(frozen=True)
class MaskTolerance:
    """Limits of the area that masks may cover; chosen, not measured.

    Attributes:
        covering: Share of the pixels from which on a mask covers everything, so that nothing is left to learn
            the scene from.
        rim: Mean share of the images' borders, with
        most: this mean share of their pixels, from which on masks are taken for inverted: they go around the
            object. A floor from side to side takes up to 0.6 of the borders.
    """

    covering: float = 0.95
    rim: float = 0.7
    most: float = 0.3


TOLERANCE = MaskTolerance()


@dataclass(frozen=True)
class MaskFiles:
    """The masks of a scene.

    Attributes:
        files: Mask file of each image that has one, by image key.
        ground_truth: Keys of the images that show the scene without the object, or empty.
        notes: What was guessed, one line each.
        problem: Why the masks found are not used; None if they are usable.
        folder: Folder that was named by the user.
    """

    files: Mapping[str, Path] = field(default_factory=dict)
    ground_truth: frozenset[str] = frozenset()
    notes: Sequence[str] = ()
    problem: str | None = None
    folder: Path | None = None


def find_masks(
    root: Path,
    image_folders: Mapping[int, Path],
    given: Path | None,
    keys: Sequence[str],
    named: Mapping[str, Path] | None = None,
) -> MaskFiles:
    """The masks of a scene: those that the user named, else SPIn-NeRF's labels, else those that the
    calibration names, else a folder `masks`.

    In a SPIn-NeRF scene the images with a mask in `images_N/label` are for training; the rest show the scene
    without the object, and their masks lie in `images_N/test_label` in sorted order.

    Args:
        root: Scene folder.
        image_folders: Image folders of the scene by factor.
        given: Folder named by the user, whose masks take the place of those found.
        keys: Keys of the calibrated images.
        named: Mask files that the calibration names, by key.

    Raises:
        InputError: `given` is missing or empty, or its masks cannot be assigned to images.
    """
    found = MaskFiles()
    labelled = next((f for f in image_folders.values() if image_files(f / "label")), None)
    folder = next((root / name for name in MASK_FOLDERS if (root / name).is_dir()), None)
    try:
        if labelled is not None:
            found = _spin_nerf_masks(labelled, keys)
        elif named:
            found = _named_masks(named)
        elif folder is not None:
            found = match_masks(folder, keys)
    except InputError as error:
        found = MaskFiles(problem=str(error))
    if given is None:
        return found
    chosen = match_masks(given, [key for key in keys if key not in found.ground_truth])
    truth = {key: path for key, path in found.files.items() if key in found.ground_truth}
    return MaskFiles({**truth, **chosen.files}, found.ground_truth, chosen.notes, folder=given)


def match_masks(folder: Path, keys: Sequence[str]) -> MaskFiles:
    """Masks of a folder by the images that they are called after.

    A mask has the path of its image, or that path with "_" for "/", or the name without folders, or one of
    these with an addition such as "_mask"; the latter two only where one image and one mask have the name.

    Raises:
        InputError: the folder is missing or empty, no mask has the name of an image, or one mask has the name
            of several.
    """
    # A mask may be called after the whole image name: IMG_1.jpg.png.
    masks = {image_key(key): path for key, path in image_files(folder).items()} if folder.is_dir() else {}
    if not masks:
        raise InputError(
            f"{folder}: there are no mask images in this folder; name the folder that holds them"
        )
    found = {key: masks.get(key) or masks.get(key.replace("/", "_")) for key in keys}
    files = {key: path for key, path in found.items() if path is not None}
    by_name, shared = _match(keys, masks, files, lambda name: name)
    by_part, _ = _match(keys, masks, {**files, **by_name}, lambda name: image_key(_AFFIX.sub("", name)))
    if shared:
        name, several = next(iter(shared.items()))
        raise InputError(
            f"{masks[name]}: the images {' and '.join(several[:2])} both have the name of this mask; put the "
            "masks into folders like those of the images"
        )
    notes = []
    if by_part:
        key, path = next(iter(by_part.items()))
        notes.append(
            f"{folder}: {len(by_part)} masks are matched by a part of their names, as {path.name} to {key}"
        )
    files = {**files, **by_name, **by_part}
    if not files:
        if several := _of_one_image(keys, masks):
            raise InputError(
                f"{folder}: several masks have the name of one image ({' and '.join(several[:2])}); name one "
                "of their folders with --masks"
            )
        raise InputError(
            f"{folder}: no mask has the name of an image (mask {next(iter(masks))!r}, image {keys[0]!r}); "
            "rename the masks after the images"
        )
    return MaskFiles({key: files[key] for key in keys if key in files}, notes=notes)


def _match(
    keys: Sequence[str], masks: Mapping[str, Path], files: Mapping[str, Path], spelled: Callable[[str], str]
) -> tuple[dict[str, Path], dict[str, list[str]]]:
    """Masks for keys that have none yet, by names without folders, and masks that several keys could have."""
    images, named = defaultdict(list), defaultdict(list)
    for key in keys:
        if key not in files:
            images[key.rsplit("/", 1)[-1].casefold()].append(key)
    for name, path in masks.items():
        if path not in files.values():
            named[spelled(name.rsplit("/", 1)[-1]).casefold()].append(name)
    alone = {word: names[0] for word, names in named.items() if len(names) == 1 and word in images}
    found = {images[word][0]: masks[name] for word, name in alone.items() if len(images[word]) == 1}
    return found, {name: images[word] for word, name in alone.items() if len(images[word]) > 1}


def _of_one_image(keys: Sequence[str], masks: Mapping[str, Path]) -> list[str]:
    """Masks in different folders that have the name of one image: one folder for each object."""
    for key in keys:
        last = key.rsplit("/", 1)[-1]
        if len(several := [name for name in masks if name.rsplit("/", 1)[-1] == last]) > 1:
            return several
    return []


def _named_masks(named: Mapping[str, Path]) -> MaskFiles:
    there = {key: path for key, path in named.items() if path.is_file()}
    absent = [path for key, path in named.items() if key not in there]
    if not there:
        raise InputError(f"{absent[0]}: the mask that the calibration names is missing; put it there")
    notes = [f"{absent[0]} and {len(absent) - 1} other masks are missing"] if absent else []
    return MaskFiles(there, notes=notes)


def _spin_nerf_masks(folder: Path, keys: Sequence[str]) -> MaskFiles:
    training = match_masks(folder / "label", keys)
    test_masks = image_files(folder / "test_label")
    if not test_masks:
        return training
    # Sorted order runs over all images of the folder, also those without a pose.
    images = [key for key in image_files(folder) if "/" not in key]
    labels = match_masks(folder / "label", images).files
    rest = [key for key in images if key not in labels]
    test = {key: test_masks[key] for key in rest if key in test_masks}
    if len(test) < len(rest) and len(test_masks) == len(rest):
        test = dict(zip(rest, test_masks.values(), strict=True))
    truth = frozenset(rest) & frozenset(keys)
    files = {**{key: path for key, path in test.items() if key in truth}, **training.files}
    return MaskFiles(files, truth, training.notes)


@dataclass(frozen=True)
class Masked:
    """Views with their masks.

    Attributes:
        views: Views, those that have a usable mask with it.
        notes: What was guessed or left out, one line each.
        problem: Why no mask is used; None if masks are used.
    """

    views: Mapping[str, View]
    notes: Sequence[str]
    problem: str | None = None


def mask_views(
    views: Mapping[str, View],
    found: MaskFiles,
    ids: Sequence[int],
    turns: Mapping[str, int],
    test: frozenset[str],
    progress: bool = False,
) -> Masked:
    """Attach the masks that were found to their views; none if they are not usable.

    Args:
        views: By image key.
        found: From `find_masks`.
        ids: Numbers of the objects that are meant; all if empty.
        turns: Of views with an EXIF orientation, the one to turn a mask by that is not turned as its view is.
        test: Keys of the views that are held out.
        progress: Show progress on the terminal.

    Raises:
        InputError: ids are given, and no mask holds one of them, or masks are of no use.
    """
    if not found.files:
        if ids:
            raise InputError(
                found.problem or "there are no masks to choose objects from: leave --mask-ids out"
            )
        return _without_masks(views, found.notes, found.problem)
    try:
        masks, said = object_masks(_labels(views, found.files, turns, progress), ids)
    except InputError as error:
        if ids:
            raise
        return _without_masks(views, found.notes, str(error))
    masked = {key: view.with_mask(masks.get(key)) for key, view in views.items()}
    masked, turned_notes = _turned_masks(masked, turns)
    train = [key for key in views if key not in test]
    source = found.folder or next(iter(found.files.values())).parent
    kept, judged, problem = judge_masks([masked[key] for key in train], source)
    if problem is not None and not found.ground_truth:
        return _without_masks(views, found.notes, problem)
    masked |= dict(zip(train, kept, strict=True))
    notes = [*found.notes, *said, *turned_notes, *judged]
    return Masked(masked, [*notes, *_unused(problem)], problem)


def _labels(
    views: Mapping[str, View], files: Mapping[str, Path], turns: Mapping[str, int], progress: bool
) -> dict[str, Labels]:
    """Labels of masks at the sizes of their views.

    Raises:
        InputError: one cannot be read.
    """
    reads = []
    for key, file in files.items():
        camera = views[key].camera
        reads.append((file, partial(read_labels, file, camera.width, camera.height, turns.get(key, 1))))
    labels = {}
    for key, found in zip(files, read_in_parallel(reads, "reading masks", progress), strict=True):
        if isinstance(found, InputError):
            raise found
        labels[key] = found
    return labels


def _without_masks(views: Mapping[str, View], notes: Sequence[str], problem: str | None) -> Masked:
    return Masked(views, [*notes, *_unused(problem)], problem)


def _unused(problem: str | None) -> list[str]:
    return [] if problem is None else [f"masks are not used: {problem}"]


def _turned_masks(views: Mapping[str, View], turns: Mapping[str, int]) -> tuple[dict[str, View], list[str]]:
    """Turn masks whose outlines, but not sizes, show their orientation; returns views and notes."""
    doubtful = {
        key: turned(mask, turn)
        for key, turn in turns.items()
        if (mask := views[key].mask) is not None and mask.any() and turned(mask, turn).shape == mask.shape
    }
    if not doubtful:
        return dict(views), []
    better = masks_turned((views[key], mask) for key, mask in doubtful.items())
    notes = [] if better is False else [_turned_note(views, list(doubtful), better)]
    changed = doubtful if better else {}
    return {key: view.with_mask(changed.get(key, view.mask)) for key, view in views.items()}, notes


def _turned_note(views: Mapping[str, View], doubtful: Sequence[str], better: bool | None) -> str:
    names = f"{len(doubtful)} photographs have an EXIF orientation ({listed(doubtful)})"
    if better:
        how = "shown" if views[doubtful[0]].orientation != 1 else "stored"
        return f"{names}; their masks are taken to be made on them as {how}: so their outlines fit"
    return f"{names}; their masks are taken to be turned as the photographs here: nothing tells otherwise"


def judge_masks(views: Sequence[View], source: Path) -> tuple[list[View], list[str], str | None]:
    """Drop the masks of training views that are not usable.

    Args:
        views: Training views of a scene that came with masks.
        source: Folder to name.

    Returns:
        The views, those whose mask covers everything without it; notes on views whose mask is missing, empty
        or not used; and why no mask is of use, or None.
    """
    share = {view.name: float(view.mask.mean()) for view in views if view.mask is not None}
    empty = [name for name, value in share.items() if value == 0]
    covering = [name for name, value in share.items() if value > TOLERANCE.covering]
    problem = None
    if not share:
        problem = f"{source}: the masks are those of held-out views only; add others, or use --hold-out 0"
    elif len(empty) == len(share):
        problem = f"{source}: every mask is empty; mark the object in white"
    elif all(value == 1 for value in share.values()):
        problem = f"{source}: every mask covers its whole image; mark the object only, in white"
    elif _are_inverted(views):
        mean = np.mean([value for value in share.values() if value > 0])
        problem = (
            f"{source}: the masks cover {100 * mean:.0f} % of the images and most of their borders, as if "
            "inverted; make the object white and all else black"
        )
    if problem is not None:
        return [view.with_mask(None) for view in views], [], problem
    what = (
        ("no mask", [view.name for view in views if view.mask is None]),
        ("an empty mask", empty),
        ("a mask that covers everything and is not used", covering),
    )
    notes = [f"{len(names)} views have {text}: {listed(names)}" for text, names in what if names]
    return [view.with_mask(None) if view.name in covering else view for view in views], notes, None


def _are_inverted(views: Sequence[View]) -> bool:
    """Whether the masks are inverted: they surround the object."""
    masks = [view.mask for view in views if view.mask is not None and view.mask.any()]
    rims = [np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]]).mean() for mask in masks]
    covered = float(np.mean([mask.mean() for mask in masks]))
    return covered > TOLERANCE.most and float(np.mean(rims)) > TOLERANCE.rim
