"""Data sets of the field: recognised by their folders, each with its protocol of views, masks and size.

Two things depend on it. In 360-USID and Inpaint360GS, as in SPIn-NeRF, some photographs show the scene
without the object: they are held out and compared with. And one line says which data set was recognised, and
what its figures are measured on.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from diga3d_warp.scene.capture import Capture
from diga3d_warp.scene.photographs.folders import entry, has_images, image_folders, image_siblings
from diga3d_warp.scene.photographs.names import image_key

TEST_IMAGES = "test_images"
"""Folder of 360-USID with the photographs without the object."""

TEST_PREFIX = "test_"
"""What the names of Inpaint360GS' photographs without the object begin with, in `images`."""

FORWARD = 0.8
"""Length of the mean viewing direction from which on a capture faces forward: a half turn of level cameras
around the object has 2/pi = 0.64, cameras within 30 degrees of their middle have more than 0.86."""

INDOORS = frozenset({"room", "counter", "kitchen", "bonsai"})
"""Scenes of Mip-NeRF 360 that are measured at images_2; the others at images_4."""

NERFSTUDIO_FRAME = re.compile(r"frame_\d{5}")
"""Names that nerfstudio's ns-process-data gives, as in the scenes of Instruct-NeRF2NeRF."""


@dataclass(frozen=True)
class DataSet:
    """A data set and its protocol.

    Attributes:
        name: Name of the data set.
        views: Test views, in words.
        masks: Masks, in words.
        factor: The N of the images_N on which its figures are measured; None if no folder has that size.
        size: Size of the images there, in words; empty if it differs from scene to scene.
        hold_out: Every such view is a test view; None if the data set chooses them in another way.
    """

    name: str
    views: str
    masks: str
    factor: int | None
    size: str = ""
    hold_out: int | None = None

    def scale(self, folders: Collection[int]) -> float:
        """The image scale on which its figures are measured; 1 if no folder has that size.

        Args:
            folders: Factors of the image folders that are there.
        """
        return 1.0 if self.factor is None else min(min(folders, default=1) / self.factor, 1.0)

    def line(self, root: Path, image_scale: float, hold_out: int, folders: Collection[int]) -> str:
        """The line that says which was recognised.

        Args:
            root: Scene folder.
            image_scale: Scale at which the scene is read.
            hold_out: Every such view is held out.
            folders: Factors of the image folders that are there.
        """
        views, measured = self.views, ""
        if self.hold_out not in (None, hold_out):
            views += f", which --hold-out {self.hold_out} gives"
        if self.factor is not None:
            scale = self.scale(folders)
            place = f"images_{self.factor}" if self.factor > 1 else "the images at full size"
            measured = f"; its figures are measured on {place}{self.size and f' ({self.size})'}"
            if abs(scale - image_scale) > 1e-6 * scale:
                measured += f", which --image-scale {scale:.6g} gives"
        elif self.size:
            measured = f"; its images are {self.size}"
        return f"{root}: the layout of {self.name}: {views}; {self.masks}{measured}"


EVERY_EIGHTH = "test views are every 8th, the first included"
NO_MASKS = "the data set brings no masks"

SPIN_NERF = DataSet(
    "SPIn-NeRF",
    "test views are those without the object",
    "masks are those of label and test_label",
    4,
    "1008 x 567 px",
)
LABELLED = DataSet("SPIn-NeRF, without test_label", EVERY_EIGHTH, "masks are those of label", 4, hold_out=8)
USID = DataSet(
    "360-USID",
    f"test views are those of {TEST_IMAGES}, without the object",
    "masks are those of object_masks, unseen_masks are not read",
    1,
)
INPAINT360GS = DataSet(
    "Inpaint360GS",
    f"test views are those called {TEST_PREFIX}*, without the object",
    f"{NO_MASKS}: give --masks or --mask-box",
    2,
)
LLFF = DataSet("LLFF", EVERY_EIGHTH, NO_MASKS, 4, "1008 x 756 px", hold_out=8)
OUTDOORS_360 = DataSet("Mip-NeRF 360", EVERY_EIGHTH, NO_MASKS, 4, hold_out=8)
INDOORS_360 = DataSet("Mip-NeRF 360", EVERY_EIGHTH, NO_MASKS, 2, hold_out=8)
IN2N = DataSet(
    "Instruct-NeRF2NeRF (nerfstudio's)",
    "it edits every view, and measures rendered ones",
    NO_MASKS,
    None,
    "edited at 512 px at most",
)


@dataclass(frozen=True)
class FoundDataSet:
    """The data set of a capture.

    Attributes:
        data_set: Which it is.
        without_object: Names of the shots that show the scene without the object, as the calibration has
            them; empty where other files tell, as SPIn-NeRF's labels, or none does.
        beside: Folder in which these photographs are, if it is none of the capture's image folders.
    """

    data_set: DataSet
    without_object: frozenset[str] = frozenset()
    beside: Path | None = None


def find_data_set(root: Path, capture: Capture) -> FoundDataSet | None:
    """The data set whose layout a capture has; None if it has that of none.

    Args:
        root: Scene folder.
        capture: What was read of it.
    """
    names = [shot.name for shot in capture.shots]
    folders = capture.image_folders
    if any(has_images(folder / "label") and has_images(folder / "test_label") for folder in folders.values()):
        return FoundDataSet(SPIN_NERF)
    if capture.kind == "colmap":
        if (beside := entry(root, TEST_IMAGES)) is not None and (test := _only_in(beside, names, folders)):
            return FoundDataSet(USID, test, beside)
        if test := _test_named(names):
            return FoundDataSet(INPAINT360GS, test)
    bounds = capture.kind in ("colmap", "llff") and entry(root, "poses_bounds.npy") is not None
    if bounds and any(has_images(folder / "label") for folder in folders.values()):
        return FoundDataSet(LABELLED)
    if bounds and 2 not in folders and _faces_forward(capture):
        return FoundDataSet(LLFF)
    if bounds or (capture.kind == "colmap" and _resized(root, folders)):
        return FoundDataSet(INDOORS_360 if root.resolve().name.lower() in INDOORS else OUTDOORS_360)
    frames = all(NERFSTUDIO_FRAME.fullmatch(PurePosixPath(image_key(name)).name) for name in names)
    if capture.kind == "nerfstudio" and frames and {2, 4} <= image_folders(root).keys():
        return FoundDataSet(IN2N)
    return None


def _only_in(beside: Path, names: Sequence[str], folders: Mapping[int, Path]) -> frozenset[str]:
    """The names of photographs that are in a folder beside the image folders, and in none of these."""
    there = {image_key(path.name) for path in image_siblings(beside / "_")}
    own = {image_key(path.name) for folder in folders.values() for path in image_siblings(folder / "_")}
    last = {name: image_key(PurePosixPath(name).name) for name in names}
    test = frozenset(name for name, key in last.items() if key in there and key not in own)
    return test if any(key in own for key in last.values()) else frozenset()


def _test_named(names: Sequence[str]) -> frozenset[str]:
    """The names that are like the others but for `test_`: test_IMG_0051.JPG beside IMG_0001.JPG."""
    shapes = {_shape(name) for name in names if not _is_test(name)}
    test = frozenset(name for name in names if _is_test(name))
    return test if test and all(_shape(name[len(TEST_PREFIX) :]) in shapes for name in test) else frozenset()


def _is_test(name: str) -> bool:
    return name.lower().startswith(TEST_PREFIX)


def _shape(name: str) -> str:
    return re.sub(r"\d+", "0", image_key(name)).casefold()


def _resized(root: Path, folders: Mapping[int, Path]) -> bool:
    """Whether images have the sizes of Mip-NeRF 360, and not from 3DGS' convert.py, which keeps `input`."""
    return {1, 2, 4, 8} <= folders.keys() and not any(entry(root, name) for name in ("input", "distorted"))


def _faces_forward(capture: Capture) -> bool:
    directions = np.stack([np.asarray(shot.camera.pose, float)[2, :3] for shot in capture.shots])
    return float(np.linalg.norm(directions.mean(0))) > FORWARD
