"""nerfstudio captures: transforms.json, with poses in OpenGL axes (x right, y up, z backwards)."""

from __future__ import annotations

import math
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.files import read_json
from diga3d_warp.scene.camera import Camera, Distortion
from diga3d_warp.scene.capture import Capture, Shot, image_folders, image_key, inside
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


def read_nerfstudio(root: Path, path: Path) -> Capture:
    """Read a nerfstudio scene. Intrinsics may stand in each frame or once for all.

    The poses and the points named by `ply_file_path` share one frame: nerfstudio applies
    `applied_transform` to both before writing them, so neither is changed here.

    Args:
        root: Scene folder, to which the paths in the file are relative.
        path: The transforms.json file.

    Raises:
        InputError: the file is damaged, lacks an entry, names a file outside the scene, or uses a camera
            model that is not supported.
    """
    contents = read_json(path, "export it again")
    frames = contents.get("frames") if isinstance(contents, dict) else None
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{path}: it lists no frames; export it again")
    files, cameras = [], []
    for number, frame in enumerate(frames):
        try:
            name = str(frame["file_path"])
            cameras.append(_camera({**contents, **frame}))
        except KeyError as error:
            raise InputError(f"{path}: frame {number} lacks {error}; export it again") from None
        except (TypeError, ValueError, ArithmeticError) as error:
            raise InputError(f"{path}: frame {number}: {error}") from None
        files.append(PurePosixPath(inside(root, name, path)))

    bases = {file.parts[0] if len(file.parts) > 1 else "" for file in files}
    base = bases.pop() if len(bases) == 1 else ""
    shots = [
        Shot(image_key(file.relative_to(base).as_posix()), camera)
        for file, camera in zip(files, cameras, strict=True)
    ]
    folders = image_folders(root, base) if base else {1: root}
    notes = []
    points = None
    if named := contents.get("ply_file_path"):
        cloud = root / inside(root, str(named), path)
        if cloud.is_file():
            points = read_points(cloud)
        else:
            notes.append(f"{cloud} is missing: points are triangulated instead")
    return Capture("nerfstudio", shots, folders, points, notes)
