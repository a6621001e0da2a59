"""nerfstudio captures: transforms.json, with poses in OpenGL axes (x right, y up, z backwards).

NeRF-synthetic and other exports of Blender have transforms_train.json instead, with the held-out views in
transforms_test.json. They name images without their ending and give a field of view but no size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.files import read_json
from diga3d_warp.scene.camera import Camera, Distortion
from diga3d_warp.scene.capture import IMAGE_SUFFIXES, Capture, Shot, image_folders, image_key, inside
from diga3d_warp.scene.images import read_image
from diga3d_warp.scene.ply import read_points

_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
# A rotation may be off by this much after passing through text with few digits, unitless.
_ROTATION_TOLERANCE = 1e-2


def _inverse(camera_to_world: np.ndarray) -> torch.Tensor:
    """World-to-camera transform of a camera-to-world one, shape (4, 4), float64.

    Raises:
        InputError: it is not a rotation with a translation.
    """
    rotation = camera_to_world[:3, :3]
    deviation = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if not (deviation < _ROTATION_TOLERANCE and np.linalg.det(rotation) > 0):
        raise InputError("the pose is not a rotation with a translation; export it again")
    return torch.from_numpy(np.linalg.inv(camera_to_world))


def _lens(frame: dict[str, Any]) -> Distortion | None:
    model = frame.get("camera_model", "OPENCV")
    k1, k2, k3, k4, p1, p2 = (float(frame.get(name) or 0.0) for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    if model == "OPENCV_FISHEYE":
        return Distortion("fisheye", (k1, k2, k3, k4))
    if model not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE"):
        raise InputError(
            f"camera_model {model} is not supported; undistort the images, or use PINHOLE, OPENCV or "
            "OPENCV_FISHEYE"
        )
    if k3 or k4:
        raise InputError("k3 and k4 are supported for OPENCV_FISHEYE only; undistort the images")
    if model == "OPENCV" and any((k1, k2, p1, p2)):
        return Distortion("brown", (k1, k2, p1, p2))
    return None


def _camera(frame: dict[str, Any]) -> Camera:
    width, height = int(frame["w"]), int(frame["h"])
    if "fl_x" in frame:
        fx = float(frame["fl_x"])
    else:
        fx = 0.5 * width / math.tan(0.5 * float(frame["camera_angle_x"]))
    fy = float(frame.get("fl_y", fx))
    cx, cy = float(frame.get("cx", width / 2)), float(frame.get("cy", height / 2))
    pose = np.array(frame["transform_matrix"], np.float64)
    if pose.shape != (4, 4):
        raise ValueError(f"transform_matrix has shape {pose.shape}, not (4, 4)")
    world_to_camera = _inverse(pose @ _OPENGL_TO_OPENCV)
    return Camera(width, height, fx, fy, cx, cy, world_to_camera, _lens(frame))


def find_transforms(root: Path) -> list[Path]:
    """The files of a scene folder that name its frames, first those for training; empty if there are none."""
    if (root / "transforms.json").is_file():
        return [root / "transforms.json"]
    split = [root / "transforms_train.json", root / "transforms_test.json"]
    return [path for path in split if path.is_file()] if split[0].is_file() else []


def read_nerfstudio(root: Path, paths: Sequence[Path]) -> Capture:
    """Read a nerfstudio scene. Intrinsics may stand in each frame or once for all.

    The poses and the points named by `ply_file_path` share one frame: nerfstudio applies
    `applied_transform` to both before writing them, so neither is changed here.

    Args:
        root: Scene folder, to which the paths in the files are relative.
        paths: From `find_transforms`; the frames of a second one are held out.

    Raises:
        InputError: a file is damaged, lacks an entry, names a file outside the scene, or uses a camera model
            that is not supported.
    """
    read = [_read_frames(root, path) for path in paths]
    files = [file for frames in read for file, _ in frames]
    bases = {file.parts[0] if len(file.parts) > 1 else "" for file in files}
    base = bases.pop() if len(bases) == 1 else ""

    def key(file: PurePosixPath) -> str:
        return image_key(file.relative_to(base).as_posix())

    shots = [Shot(key(file), camera) for frames in read for file, camera in frames]
    held_out = frozenset(key(file) for frames in read[1:] for file, _ in frames)
    folders = image_folders(root, base) if base else {1: root}
    notes = []
    points = None
    if named := read_json(paths[0], "export it again").get("ply_file_path"):
        cloud = root / inside(root, str(named), paths[0])
        if cloud.is_file():
            points = read_points(cloud)
        else:
            notes.append(f"{cloud} is missing: points are triangulated instead")
    return Capture("nerfstudio", shots, folders, points, notes, held_out)


def _read_frames(root: Path, path: Path) -> list[tuple[PurePosixPath, Camera]]:
    """Images below the scene folder that a file names, with their cameras."""
    contents = read_json(path, "export it again")
    frames = contents.get("frames") if isinstance(contents, dict) else None
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{path}: it lists no frames; export it again")
    read: list[tuple[PurePosixPath, Camera]] = []
    size: dict[str, int] = {}
    for number, frame in enumerate(frames):
        try:
            name, entries = str(frame["file_path"]), {**contents, **frame}
            file = inside(root, name, path)
            if not {"w", "h"} <= entries.keys():
                size = size or _size_of(root / file)
            read.append((PurePosixPath(file), _camera({**size, **entries})))
        except KeyError as error:
            raise InputError(f"{path}: frame {number} lacks {error}; export it again") from None
        except (TypeError, ValueError, ArithmeticError) as error:
            raise InputError(f"{path}: frame {number}: {error}") from None
    return read


def _size_of(file: Path) -> dict[str, int]:
    """Width and height of an image that may be named without its ending [px]; empty if there is none."""
    named = [file, *(file.with_name(file.name + suffix) for suffix in sorted(IMAGE_SUFFIXES))]
    found = next((path for path in named if path.is_file()), None)
    if found is None:
        return {}
    height, width = read_image(found).shape[:2]
    return {"w": width, "h": height}
