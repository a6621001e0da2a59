"""Masks: where they lie, which image each belongs to, and how they are stored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.decoding import decode, read_bytes
from diga3d_warp.scene.folders import image_files
from diga3d_warp.scene.names import image_key, listed
from diga3d_warp.scene.scene import View


@dataclass(frozen=True)
class MaskTolerance:
    """What a mask may be off by.

    Attributes:
        aspect: Largest deviation of a mask's aspect ratio from its image's, as a fraction. SPIn-NeRF's masks
            are 576 px high for images of 567 px, which is 1.6 %.
        covering: Share of the pixels from which on a mask covers everything, so that nothing is left to
            learn the scene from. Objects in captures cover up to about half; chosen, not measured.
        levels: Up to this many grey levels any level above zero belongs to the mask: 0/1, 0/255, 0/38. Masks
            with more levels (JPEG, soft edges) are cut at 127 of 255.
    """

    aspect: float = 0.02
    covering: float = 0.95
    levels: int = 2


TOLERANCE = MaskTolerance()


@dataclass(frozen=True)
class MaskFiles:
    """The masks of a scene.

    Attributes:
        files: Mask file of each image that has one, by image key.
        ground_truth: Keys of the images that show the scene without the object (SPIn-NeRF), or empty.
    """

    files: Mapping[str, Path]
    ground_truth: frozenset[str] = frozenset()


def _by_key(folder: Path) -> dict[str, Path]:
    # A mask may be called after the whole image name: IMG_1.jpg.png.
    return {image_key(key): path for key, path in image_files(folder).items()}


def _match(keys: Sequence[str], masks: Mapping[str, Path]) -> dict[str, Path]:
    """Mask of each image by its key, or else by its last part."""
    by_name = {key: masks.get(key) or masks.get(key.rsplit("/", 1)[-1]) for key in keys}
    return {key: path for key, path in by_name.items() if path is not None}


def given_masks(folder: Path, keys: Sequence[str]) -> dict[str, Path]:
    """Masks in a folder that the user named.

    Raises:
        InputError: the folder is missing or empty, or no mask has the name of an image.
    """
    masks = _by_key(folder) if folder.is_dir() else {}
    if not masks:
        raise InputError(
            f"{folder}: there are no mask images in this folder; name the folder that holds them"
        )
    matched = _match(keys, masks)
    if not matched:
        raise InputError(
            f"{folder}: no mask has the name of an image (mask {next(iter(masks))!r}, image {keys[0]!r}); "
            "rename the masks after the images"
        )
    return matched


def find_masks(
    root: Path, image_folders: Mapping[int, Path], given: Path | None, keys: Sequence[str]
) -> MaskFiles:
    """The masks of a scene: those that the user named, else SPIn-NeRF's labels, else `masks`.

    In a SPIn-NeRF scene the images with a mask in `images_N/label` are for training; the rest show the scene
    without the object, and their masks lie in `images_N/test_label` in sorted order.

    Args:
        root: Scene folder.
        image_folders: Image folders of the scene by factor.
        given: Folder named by the user, whose masks take the place of those found.
        keys: Keys of the calibrated images.

    Raises:
        InputError: as `given_masks`.
    """
    found = MaskFiles({})
    labelled = next((f for f in image_folders.values() if image_files(f / "label")), None)
    if labelled is not None:
        found = _spin_nerf_masks(labelled, keys)
    elif (root / "masks").is_dir():
        found = MaskFiles(given_masks(root / "masks", keys))
    if given is None:
        return found
    chosen = given_masks(given, [key for key in keys if key not in found.ground_truth])
    truth = {key: path for key, path in found.files.items() if key in found.ground_truth}
    return MaskFiles({**truth, **chosen}, found.ground_truth)


def _spin_nerf_masks(folder: Path, keys: Sequence[str]) -> MaskFiles:
    training = given_masks(folder / "label", keys)
    test_masks = image_files(folder / "test_label")
    if not test_masks:
        return MaskFiles(training)
    labels = _by_key(folder / "label")
    # Sorted order runs over all images of the folder, also those without a pose.
    rest = [key for key in image_files(folder) if "/" not in key and not _match([key], labels)]
    test = _match(rest, test_masks)
    if len(test) < len(rest) and len(test_masks) == len(rest):
        test = dict(zip(rest, test_masks.values(), strict=True))
    return MaskFiles({**test, **training}, frozenset(rest) & frozenset(keys))


def read_mask(path: Path, width: int, height: int) -> np.ndarray:
    """A mask at the size of its image, shape (H, W), bool.

    Alpha is used where it varies, else the brightest channel. Rows that a mask has too many are cut off at
    the bottom; another size of the same aspect ratio is resized without interpolation.

    Raises:
        InputError: the file is no image, or its aspect ratio is not that of the image.
    """
    import cv2

    stored = decode(read_bytes(path), path)
    if stored.dtype.kind != "u":
        raise InputError(f"{path}: not readable as an image of whole numbers; write the mask again as .png")
    mask = _binary(stored)
    expected_height = round(mask.shape[1] * height / width)
    if abs(mask.shape[0] / expected_height - 1) > TOLERANCE.aspect:
        raise InputError(
            f"{path}: the mask is {mask.shape[1]} x {mask.shape[0]} px for an image of {width} x {height} "
            "px; write it with the aspect ratio of the image"
        )
    mask = mask[:expected_height]
    if mask.shape != (height, width):
        resized = cv2.resize(mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST_EXACT)
        mask = resized.astype(bool)
    return mask


def _binary(stored: np.ndarray) -> np.ndarray:
    if stored.ndim == 3 and stored.shape[2] == 4 and np.ptp(stored[..., 3]) > 0:
        grey = stored[..., 3]
    else:
        grey = stored if stored.ndim == 2 else stored[..., :3].max(axis=2)
    half = np.iinfo(grey.dtype).max // 2
    # A file whose brightest level is dark holds numbers of objects, not shades.
    levels = len(np.unique(grey)) <= TOLERANCE.levels or grey.max() <= half
    return grey > 0 if levels else grey > half


def without_covering(views: Sequence[View]) -> list[View]:
    """The views, those whose mask covers everything without it: it tells nothing of the object."""
    return [
        view.with_mask(None) if view.mask is not None and view.mask.mean() > TOLERANCE.covering else view
        for view in views
    ]


def mask_notes(views: Sequence[View], source: Path) -> list[str]:
    """Notes on training views whose mask is missing, empty, or covers everything.

    Args:
        views: Training views of a scene that came with masks.
        source: Folder to name in an error.

    Raises:
        InputError: every mask is empty, or every mask covers everything.
    """
    share = {view.name: float(view.mask.mean()) for view in views if view.mask is not None}
    absent = [view.name for view in views if view.mask is None]
    empty = [name for name, value in share.items() if value == 0]
    covering = [name for name, value in share.items() if value > TOLERANCE.covering]
    if not share:
        return [f"the masks in {source} belong to held-out views only: no training view has one"]
    if len(empty) == len(share):
        raise InputError(f"{source}: every mask is empty; mark the object in white")
    if len(covering) == len(share):
        raise InputError(f"{source}: every mask covers its whole image; mark the object only, in white")
    what = (
        ("no mask", absent),
        ("an empty mask", empty),
        ("a mask that covers everything and is not used", covering),
    )
    return [f"{len(names)} views have {text}: {listed(names)}" for text, names in what if names]
