"""Polycam's raw export: keyframes/ with images and one JSON file of ARKit's camera each.

Two pairs of folders may be there: images with cameras as tracked on the phone, corrected_images with
corrected_cameras after Polycam's own adjustment. The latter are read where both are.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.files import read_json
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.capture import Capture, Shot
from diga3d_warp.scene.photographs.folders import entries, entry, has_images
from diga3d_warp.scene.poses import world_to_camera

_PAIRS = {"corrected_cameras": "corrected_images", "cameras": "images"}
_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0])
# Rows of the matrix in the order that turns ARKit's y up into nerfstudio's z up, as its converter has it.
_ROWS = (2, 0, 1)


def find_polycam(root: Path) -> Path | None:
    """The folder with the cameras of a Polycam export: in keyframes/ or in the folder itself."""
    for folder in filter(None, (entry(root, "keyframes"), root)):
        for cameras, images in _PAIRS.items():
            files = entries(folder / cameras)
            if any(path.suffix == ".json" for path in files) and has_images(folder / images):
                return folder / cameras
    return None


def read_polycam(cameras: Path) -> Capture:
    """Read a Polycam export.

    Args:
        cameras: From `find_polycam`.

    Raises:
        InputError: a camera file is damaged.
    """
    images = cameras.parent / _PAIRS[cameras.name]
    shots = []
    for path in entries(cameras):
        if path.suffix != ".json":
            continue
        contents = read_json(path, "export the capture again")
        try:
            table = np.array([[float(contents[f"t_{row}{column}"]) for column in range(4)] for row in _ROWS])
            size = int(contents["width"]), int(contents["height"])
            fx, fy, cx, cy = (float(contents[name]) for name in ("fx", "fy", "cx", "cy"))
            pose = world_to_camera(table[:, :3] @ _OPENGL_TO_OPENCV, table[:, 3])
            camera = Camera(*size, fx, fy, cx, cy, torch.from_numpy(pose))
        except KeyError as error:
            raise InputError(f"{path}: {error} is missing; export the capture again") from None
        except (TypeError, ValueError, InputError) as error:
            raise InputError(f"{path}: {error}; export the capture again") from None
        shots.append(Shot(path.stem, camera))
    return Capture("polycam", shots, {1: images}, None)
