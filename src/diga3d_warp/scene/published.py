"""Image sizes of a capture, without reading its photographs: the largest, and that of published figures."""

from __future__ import annotations

from pathlib import Path

import imagesize

from diga3d_warp.errors import InputError
from diga3d_warp.scene.layouts.data_sets import find_data_set
from diga3d_warp.scene.layouts.recognise import recognise
from diga3d_warp.scene.load import read_capture
from diga3d_warp.scene.photographs.folders import image_folders, image_siblings, images_below


def published_scale(path: str | Path) -> float:
    """The image scale on which the figures of a scene's data set are measured; 1 if it is of none.

    Raises:
        InputError: the capture is not recognised, or its calibration is damaged.
    """
    found = recognise(Path(path))
    if found.kind == "images":  # no data set; finding poses takes minutes
        return 1.0
    capture = read_capture(found, progress=False)
    data_set = find_data_set(found.root, capture)
    return 1.0 if data_set is None else data_set.data_set.scale(capture.image_folders)


def image_size(path: str | Path) -> tuple[int, int]:
    """Width and height of the largest photographs of a capture, of the first of them [px].

    Raises:
        InputError: the capture is not recognised, or has no photographs in image folders.
    """
    root = recognise(Path(path)).root
    folders = image_folders(root)
    folder = folders[min(folders)] if folders else root
    for file in image_siblings(folder / "_") or images_below(folder):  # masks may lie below
        width, height = imagesize.get(file)
        if width > 0:
            return int(width), int(height)
    raise InputError(f"{root}: no photograph tells its size: give the folder of a capture")
