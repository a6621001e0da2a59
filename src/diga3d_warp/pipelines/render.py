"""Render a run along a path: a video, or a folder of frames."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from tqdm import tqdm

from diga3d_warp.config import Accuracy, Effects
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.paths import fly_through
from diga3d_warp.evaluation.record import CAMERAS, RESULT, read_manifest, run_effects
from diga3d_warp.files import to_bytes, whole_file, write_image
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.cameras_file import load_cameras
from diga3d_warp.scene.images import BACKGROUND
from diga3d_warp.splatting.render import render

if TYPE_CHECKING:
    import cv2

FRAME_RATE = 30.0
"""Frames a second of a video."""

CODECS = {".webm": "VP80", ".mp4": "mp4v", ".avi": "MJPG"}
"""Codec by ending, each one that OpenCV's wheels can write. VP80 is the one that plays in every browser."""


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
        out: A video (.webm, .mp4, .avi), or a folder for frames named 0000.png and so on; RUN/path.webm if
            None.
        path: "spline", a smooth flight through the training views, or "views", each of them in turn.
        frames: Number of frames of a spline.
        size: Width and height of a frame [px]; those of the first view if None. The horizontal field of view
            stays. A video takes even sizes only: an odd row or column is cut off.
        accuracy: What to give up for time.

    Returns:
        Where the video or the frames are.

    Raises:
        InputError: the folder holds no finished run, or `out` cannot be written.
    """
    effects = run_effects(read_manifest(folder))
    if not (folder / RESULT).is_file():
        raise InputError(f"{folder} has no {RESULT}: finish the run with --resume first")
    out = folder / "path.webm" if out is None else out
    if out.suffix and out.suffix not in CODECS and not out.is_dir():
        raise InputError(f"{out} ends in {out.suffix}: give {', '.join(CODECS)}, or a folder for frames")
    views = list(load_cameras(folder / CAMERAS).train.values())
    cameras = fly_through(views, frames) if path == "spline" else views
    width, height = size or (cameras[0].width, cameras[0].height)
    framed = [_framed(camera, width, height) for camera in cameras]
    pictures = _render(folder / RESULT, framed, effects, accuracy)
    if out.suffix in CODECS:
        _write_video(out, pictures, width, height)
    else:
        _write_frames(out, pictures)
    return out


def open_video(path: Path, size: tuple[int, int]) -> cv2.VideoWriter:
    """A video file open for writing, or an unopened writer where OpenCV cannot.

    Args:
        path: Ends in one of `CODECS`.
        size: Width and height of a frame [px], both even.
    """
    import cv2

    codec = cv2.VideoWriter.fourcc(*CODECS[path.suffix])
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


def _write_video(out: Path, pictures: Iterable[np.ndarray], width: int, height: int) -> None:
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
