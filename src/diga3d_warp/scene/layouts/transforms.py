"""Frames of a transforms.json: files, cameras and masks, as nerfstudio, instant-ngp and Blender write them.

Intrinsics may be given for each frame or once for all; those of a frame take precedence. Entries that are not
read are noted, and refused if they describe lens distortion: nothing is ignored silently.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera, Distortion
from diga3d_warp.scene.layouts.entries import Entries, abridged
from diga3d_warp.scene.photographs.names import inside
from diga3d_warp.scene.poses import affine, without_scale, world_to_camera

_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0])

_PINHOLE = ("PINHOLE", "SIMPLE_PINHOLE")
_BROWN = (*_PINHOLE, "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "PERSPECTIVE")
_FISHEYE = ("SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE")

_SIZE = ("w", "h")
_FOCAL = tuple(f"{name}{axis}" for axis in "xy" for name in ("fl_", "camera_angle_")) + ("x_fov", "y_fov")
_LENS = ("camera_model", "is_fisheye", "k1", "k2", "k3", "k4", "p1", "p2")
_READ = frozenset(
    ("frames", "file_path", "transform_matrix", "mask_path", "ply_file_path", "cx", "cy")
    + ("train_filenames", "val_filenames", "test_filenames", *_SIZE, *_FOCAL, *_LENS)
)
# Further lens coefficients of OpenCV, Metashape, COLMAP and Blender, refused unless zero.
_BENDING = (
    *("k5", "k6", "p3", "p4", "s1", "s2", "s3", "s4", "b1", "b2", "sx1", "sy1", "omega", "skew"),
    *("shift_x", "shift_y", "distortion_params", "distortion", "distortion_coefficients"),
    *("ftheta_p0", "ftheta_p1", "ftheta_p2", "ftheta_p3", "ftheta_p4"),
    *("latlong", "equirectangular", "is_panorama"),
)
# What else changes the image or how it is used, and what is done instead.
_UNUSED = {
    "rolling_shutter": "is not followed: each photograph is taken as exposed at once",
    "transform_matrix_start": "is not followed: cameras do not move during an exposure",
    "transform_matrix_end": "is not followed: cameras do not move during an exposure",
    "fisheye_crop_radius": "is not used: the whole image is fitted; mask what lies beyond it",
    "white_transparent": "is not used: white is a colour; give images with alpha instead",
    "black_transparent": "is not used: black is a colour; give images with alpha instead",
    "n_frames": "is not used: all frames are read",
    "from_na": "is not followed: axes are taken as nerfstudio's",
}
# What changes nothing here: bounds, orientation and scale for training, depth, statistics and origin.
_HARMLESS = frozenset(
    ("aabb", "aabb_scale", "render_aabb", "scale", "offset", "up", "applied_transform", "applied_scale")
    + ("orientation_override", "auto_scale_poses", "avglen", "totp", "sharpness", "rotation", "envmap")
    + ("sharpness_discard_threshold", "importance_sampling", "n_extra_learnable_dims", "fix_premult")
    + ("enable_depth_loading", "enable_ray_loading", "integer_depth_scale", "depth_unit_scale_factor")
    + ("depth_path", "depth_file_path", "depth_format", "normal_file_path", "driver_parameters")
    + ("colmap_im_id", "camera_id", "cam_id", "image_id", "frame_id", "id", "index", "sensor_id", "label")
    + ("time", "timestamp", "blur_score", "manual_keyframe", "camera_label", "camera_path", "date", "version")
)


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame.

    Attributes:
        file: Its image, relative to the scene folder, as the file names it: perhaps without an ending.
        camera: Calibrated camera.
        mask: File of the mask that it names; None if it names none.
    """

    file: PurePosixPath
    camera: Camera
    mask: Path | None


@dataclass(frozen=True, eq=False)
class Transforms:
    """Contents of a transforms.json.

    Attributes:
        frames: All frames, in the order of the file.
        notes: What was guessed or is not used, one line each.
    """

    frames: Sequence[Frame]
    notes: Sequence[str]


def read_frames(
    root: Path,
    path: Path,
    contents: Any,
    sizes_of: Callable[[Sequence[PurePosixPath]], Mapping[PurePosixPath, tuple[int, int]]],
) -> Transforms:
    """Read the frames of a file.

    Args:
        root: Scene folder, to which paths in the file are relative.
        path: The file, for error lines.
        contents: Its contents.
        sizes_of: From images, which may be named without their ending, to width and height [px] of those that
            are there. Asked for images whose size the file does not give.

    Raises:
        InputError: an entry is missing, of another type, or names a file outside the scene; or the camera
            model is not supported.
    """
    frames = contents.get("frames") if isinstance(contents, dict) else None
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{path}: it lists no frames; export it again")
    files = [_file(root, path, number, frame) for number, frame in enumerate(frames)]
    without = [
        file
        for file, frame in zip(files, frames, strict=True)
        if any(Entries(frame, contents).get(name) is None for name in _SIZE)
    ]
    sizes = sizes_of(without) if without else {}
    # Frames whose image is missing are left out later; any size will do.
    usual = next(iter(sizes.values()), None)
    read, said = [], Counter[str]()
    for number, (file, frame) in enumerate(zip(files, frames, strict=True)):
        notes: list[str] = []
        try:
            camera = _camera(frame, contents, sizes.get(file, usual), notes)
            mask = Entries(frame).text("mask_path")
        except InputError as error:
            raise InputError(f"{path}: frame {number}: {error}") from None
        said.update(list(dict.fromkeys(notes)))
        read.append(Frame(file, camera, root / inside(root, mask, path) if mask else None))
    notes = [
        f"{path}: {note}" + (f" ({count} of {len(read)} frames)" if count < len(read) else "")
        for note, count in said.items()
    ]
    return Transforms(read, [*notes, *_unread(path, contents, frames)])


def _file(root: Path, path: Path, number: int, frame: Any) -> PurePosixPath:
    if not isinstance(frame, dict):
        raise InputError(f"{path}: frame {number} is {abridged(frame)}, not an object; export it again")
    try:
        name = Entries(frame).text("file_path")
    except InputError as error:
        raise InputError(f"{path}: frame {number}: {error}") from None
    if name is None or "\0" in name:
        raise InputError(f"{path}: frame {number}: file_path is missing; export it again")
    return PurePosixPath(inside(root, name, path))


def _camera(
    frame: Mapping[str, Any], contents: Mapping[str, Any], size: tuple[int, int] | None, notes: list[str]
) -> Camera:
    entries = Entries(frame, contents)
    given = [entries.number(name) for name in _SIZE]
    if None in given and size is None:
        raise InputError("w and h are missing, and so is the image; export it again")
    width, height = (
        round(number) if number is not None else known
        for number, known in zip(given, size or (0, 0), strict=True)
    )
    fx, fy = _focals([frame, contents], width, height, notes)
    cx, cy = entries.number("cx"), entries.number("cy")
    pose = _pose(entries, notes)
    return Camera(
        width, height, fx, fy, width / 2 if cx is None else cx, height / 2 if cy is None else cy,
        torch.from_numpy(pose), _lens(entries, notes),
    )  # fmt: skip


def _pose(entries: Entries, notes: list[str]) -> np.ndarray:
    table = entries.table("transform_matrix")
    try:
        matrix, scale = without_scale(affine(table))
    except InputError as error:
        raise InputError(f"transform_matrix: {error}") from None
    if scale != 1.0:
        notes.append("the rotations of transform_matrix hold a scale, which is left out")
    return world_to_camera(matrix[:, :3] @ _OPENGL_TO_OPENCV, matrix[:, 3])


def _focals(
    objects: Sequence[Mapping[str, Any]], width: int, height: int, notes: list[str]
) -> tuple[float, float]:
    """Focal lengths [px]: those of the frame if it has any, else those of the file.

    As in instant-ngp, one axis alone stands for both.
    """
    given = [(_focal(Entries(each), "x", width, notes), _focal(Entries(each), "y", height, notes))
             for each in objects]  # fmt: skip
    fx, fy = next((pair for pair in given if pair != (None, None)), (None, None))
    if fx is None and fy is None:
        raise InputError("fl_x or camera_angle_x is missing; export it again")
    if (fx is None or fy is None) and None not in given[-1]:
        notes.append("the focal length of a frame along one axis is used for both")
    along_x = fx if fx is not None else fy
    along_y = fy if fy is not None else fx
    assert along_x is not None and along_y is not None
    return along_x, along_y


# Focal lengths that are given twice may differ by this much, ratio: angles are written with few digits.
_FOCAL_TOLERANCE = 0.01


def _focal(entries: Entries, axis: str, pixels: int, notes: list[str]) -> float | None:
    """A focal length [px], given as such or by a field of view; None if absent."""
    found: dict[str, float] = {}
    if (number := entries.number(f"fl_{axis}")) is not None:
        found[f"fl_{axis}"] = number
    for name, unit in ((f"camera_angle_{axis}", 1.0), (f"{axis}_fov", math.pi / 180.0)):
        angle = entries.number(name)
        if angle is not None:
            if not 0.0 < angle * unit < math.pi:
                limit = "pi (it is in radians)" if unit == 1.0 else "180 degrees"
                raise InputError(f"{name} is {angle:g}, not an angle between 0 and {limit}; export it again")
            found[name] = 0.5 * pixels / math.tan(0.5 * angle * unit)
    if not found:
        return None
    (name, focal), *others = found.items()
    for other, number in others:
        if abs(number - focal) > _FOCAL_TOLERANCE * abs(focal):
            notes.append(f"{name} and {other} disagree: {name} is used")
    return focal


def _lens(entries: Entries, notes: list[str]) -> Distortion | None:
    model = (entries.text("camera_model") or "").upper()
    fisheye = entries.flag("is_fisheye")
    if model and model not in (*_BROWN, *_FISHEYE):
        raise InputError(
            f"camera_model {abridged(model)} is not supported; undistort the images, or use PINHOLE, OPENCV "
            "or OPENCV_FISHEYE"
        )
    for name in _BENDING:
        if _bends(entries.get(name)):
            raise InputError(
                f"{name} is {abridged(entries.get(name))}: that part of a lens is not supported; undistort "
                "the images"
            )
    k1, k2, k3, k4, p1, p2 = (entries.number(name) or 0.0 for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    if fisheye or model in _FISHEYE:
        if p1 or p2:
            raise InputError("p1 and p2 are not supported for a fisheye lens; undistort the images")
        if fisheye and model in _BROWN:
            notes.append(f"is_fisheye is on though camera_model is {model}: lenses are taken as fisheyes")
        return Distortion("fisheye", (k1, k2, k3, k4))
    if k4:
        raise InputError("k4 is supported for fisheye lenses only; undistort the images")
    lens = Distortion.brown(k1, k2, p1, p2, k3)
    if lens is not None and model in _PINHOLE:
        notes.append(f"lens coefficients are given though camera_model is {model}: read as OPENCV")
    return lens


def _bends(value: Any) -> bool:
    """Whether a value is anything but zero, false or absent, or a list of these."""
    return any(map(_is_set, value if isinstance(value, list) else [value]))


def _is_set(value: Any) -> bool:
    try:
        return float(value) != 0.0
    except (TypeError, ValueError, OverflowError):
        return bool(value)


def _unread(path: Path, contents: Mapping[str, Any], frames: Sequence[Mapping[str, Any]]) -> list[str]:
    """Notes on entries that are not used."""
    given = {name: value for each in (*frames, contents) for name, value in each.items() if _bends(value)}
    if given.get("n_frames") == len(frames):
        del given["n_frames"]
    notes = [f"{path}: {name} {what}" for name, what in _UNUSED.items() if name in given]
    known = _READ | _HARMLESS | set(_UNUSED) | set(_BENDING)
    if unknown := sorted(abridged(name)[1:-1] for name in given if name not in known):
        rest = f" and {len(unknown) - 8} more" if len(unknown) > 8 else ""
        notes.append(f"{path}: entries that are not read: {', '.join(unknown[:8])}{rest}")
    return notes
