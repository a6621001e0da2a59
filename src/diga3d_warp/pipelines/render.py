"""Render a run along a path: a video, or a folder of frames."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from tqdm import tqdm

from diga3d_warp.config import Accuracy, Effects
from diga3d_warp.errors import InputError, cannot_write
from diga3d_warp.evaluation.paths import fly_through
from diga3d_warp.evaluation.record import CAMERAS, RESULT, read_manifest, run_effects
from diga3d_warp.files import to_bytes, whole_file, write_image
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.pipelines.run_folder import check_apart
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.layouts.cameras_file import load_cameras
from diga3d_warp.scene.photographs.images import BACKGROUND
from diga3d_warp.splatting.render import render

if TYPE_CHECKING:
    import cv2

FRAME_RATE = 30.0
"""Frames a second of a video."""

CODECS = {".webm": "VP80", ".mp4": "mp4v", ".avi": "MJPG"}
"""Codec by ending, each one that OpenCV's wheels can write. VP80 is the one that plays in every browser."""


OTHER_MEDIA = (
    *(".mov", ".mkv", ".m4v", ".mpg", ".mpeg", ".wmv", ".flv", ".ogv", ".3gp", ".gif", ".apng"),
    *(".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".exr"),
)
"""Endings by which a user means a video or a picture that is not written here, not a folder."""


def render_path(
    folder: Path,
    out: Path | None = None,
    *,
    path: str = "spline",
    frames: int = 120,
    size: tuple[int, int] | None = None,
    accuracy: Accuracy = Accuracy.STANDARD,
) -> Path:
    """Render the result of a run along a camera path.

    Args:
        folder: The run folder.
        out: A video (.webm, .mp4, .avi), or a folder for frames named 0000.png and so on, which may hold
            nothing else; RUN/path.webm if None.
        path: "spline", a smooth flight through the training views, or "views", each of them in turn.
        frames: Number of frames of a spline.
        size: Width and height of a frame [px]; those of the first view if None. The horizontal field of view
            stays. A video takes even sizes only: an odd row or column is cut off.
        accuracy: Accuracy of the rendering.

    Returns:
        The video, or the folder of the frames.

    Raises:
        InputError: the folder holds no finished run, or `out` cannot be written.
    """
    manifest = read_manifest(folder)
    effects = run_effects(manifest)
    if not (folder / RESULT).is_file():
        raise InputError(f"{folder} has no {RESULT}: finish the run with --resume first")
    out = folder / "path.webm" if out is None else out
    film = _is_film(out)
    views = _fitted_cameras(folder)
    cameras = fly_through(views, frames) if path == "spline" else views
    width, height = size or (cameras[0].width, cameras[0].height)
    framed = [_framed(camera, width, height) for camera in cameras]
    if not film:
        _check_frames(out, len(framed), manifest["settings"])
    elif min(width, height) < 2:
        raise InputError(f"a video of {width} x {height} px has no even size: give a larger --size")
    pictures = _render(folder / RESULT, framed, effects, accuracy)
    if film:
        write_video(out, pictures, len(framed), width, height)
    else:
        _write_frames(out, pictures)
    return out


def render_flight(folder: Path, splat: str, frames: int, longest: int) -> Iterator[np.ndarray]:
    """Frames of a splat of a run along the smooth flight through its views, RGB, shape (H, W, 3), uint8.

    Args:
        folder: The run folder.
        splat: `RESULT` or `SOURCE`.
        frames: Number of frames.
        longest: Longest side of a frame [px]; those of smaller views stay as they are.

    Raises:
        InputError: the folder holds no run, or no camera of a fitted view.
    """
    cameras = fly_through(_fitted_cameras(folder), frames)
    scale = min(1.0, longest / max(cameras[0].width, cameras[0].height))
    width, height = (max(round(side * scale), 2) for side in (cameras[0].width, cameras[0].height))
    framed = [_framed(camera, width, height) for camera in cameras]
    return _render(folder / splat, framed, run_effects(read_manifest(folder)), Accuracy.STANDARD)


def _fitted_cameras(folder: Path) -> list[Camera]:
    views = list(load_cameras(folder / CAMERAS).train.values())
    if not views:
        raise InputError(f"{folder / CAMERAS} holds no camera of a fitted view: finish the run with --resume")
    return views


def _is_film(out: Path) -> bool:
    """Whether `out` is a video; else it is a folder, whose name may hold dots.

    Raises:
        InputError: it ends as a video or picture that is not written here.
    """
    ending = out.suffix.lower()
    if out.is_dir():
        return False
    if ending in OTHER_MEDIA:
        raise InputError(f"{out} ends in {out.suffix}: give {', '.join(CODECS)}, or a folder for frames")
    return ending in CODECS


def _check_frames(out: Path, count: int, settings: Mapping[str, Any]) -> None:
    """Refuse a folder for frames that holds other things: photographs are often called 0000.png, too.

    Raises:
        InputError: it belongs to the run's capture, or holds something that these frames do not replace.
    """
    if settings.get("scene"):
        check_apart(out, Path(settings["scene"]), Path(settings["masks"]) if settings.get("masks") else None)
    names = {f"{index:04d}.png" for index in range(count)}
    try:
        others = sorted(entry.name for entry in out.iterdir() if entry.name not in names)
    except FileNotFoundError:
        return
    except OSError as error:
        raise cannot_write(out, error) from error
    if others:
        raise InputError(f"{out} holds other things ({others[0]}): give a new or empty folder for frames")


def open_video(path: Path, size: tuple[int, int]) -> cv2.VideoWriter:
    """A video file open for writing, or an unopened writer where OpenCV cannot.

    Args:
        path: Ends in one of `CODECS`.
        size: Width and height of a frame [px], both even.
    """
    import cv2

    codec = cv2.VideoWriter.fourcc(*CODECS[path.suffix.lower()])
    # OpenCV tells stderr that VP80 "is not supported" in .webm, then writes it well: that line only alarms.
    kept = os.dup(2)
    with Path(os.devnull).open("w") as silence:
        os.dup2(silence.fileno(), 2)
        try:
            return cv2.VideoWriter(str(path), codec, FRAME_RATE, size)
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def _framed(camera: Camera, width: int, height: int) -> Camera:
    """The camera with another image size, its horizontal field of view and square pixels kept."""
    scale = width / camera.width
    return Camera(
        width=width,
        height=height,
        fx=camera.fx * scale,
        fy=camera.fy * scale,
        cx=camera.cx * scale,
        cy=camera.cy * scale + (height - camera.height * scale) / 2,
        world_to_camera=camera.world_to_camera,
        distortion=camera.distortion,
        near=camera.near,
    )


def _render(ply: Path, cameras: list[Camera], effects: Effects, accuracy: Accuracy) -> Iterator[np.ndarray]:
    gaussians = Gaussians.load_ply(ply)
    for camera in tqdm(cameras, desc="render", unit="frame"):
        with torch.no_grad():
            seen = render(gaussians, camera, effects=effects, accuracy=accuracy, background=BACKGROUND)
            yield to_bytes(seen.color)


def _write_frames(out: Path, pictures: Iterable[np.ndarray]) -> None:
    for index, picture in enumerate(pictures):
        write_image(out / f"{index:04d}.png", picture)


def write_video(out: Path, pictures: Iterable[np.ndarray], count: int, width: int, height: int) -> None:
    """Write a whole video, or none.

    Args:
        out: Ends in one of `CODECS`.
        pictures: Frames, RGB, shape (height, width, 3), uint8. An odd row or column is cut off.
        count: Number of frames.
        width: Width of a frame [px], at least 2.
        height: Height of a frame [px], at least 2.

    Raises:
        InputError: it cannot be written, or not whole.
    """
    even = (width // 2 * 2, height // 2 * 2)
    with whole_file(out) as partial:
        video = open_video(partial, even)
        if not video.isOpened():
            raise InputError(f"{out} cannot be written as video here: give a folder for frames instead")
        try:
            for picture in pictures:
                video.write(np.ascontiguousarray(picture[: even[1], : even[0], ::-1]))
        finally:
            video.release()
        written = _frames_in(partial)
        if written < count:  # OpenCV does not tell of a full disk
            raise InputError(
                f"only {written} of {count} frames of {out} could be written: make room there, or give a "
                "folder for frames"
            )


def _frames_in(path: Path) -> int:
    """Number of frames of a video that can be read."""
    import cv2

    video = cv2.VideoCapture(str(path))
    count = 0
    while video.grab():
        count += 1
    video.release()
    return count
