"""Seeded scenes on which accuracy is measured: an easy one, and one for each difficulty of splatting.

All are drawn from the distributions of `bench.garden`, with half its gaussians a pixel and a sixth of its
overdraw, so that the exact renderer takes seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.bench.garden import Garden
from diga3d_warp.errors import InputError
from diga3d_warp.evaluation.record import CAMERAS, RESULT
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.camera import Camera, Distortion
from diga3d_warp.scene.layouts.cameras_file import load_cameras
from diga3d_warp.scene.load import load_scene

SIZE = (320, 240)
"""Width and height of the images [px]. Of a real capture the middle of a view is taken, its splats as large
in pixels as they are."""

EASY = Garden(count=16_000, width=SIZE[0], height=SIZE[1], radius=5.0, flatness=2.0)
"""Splats of 7 px at 3 standard deviations, none of them thin or near."""

NEAR = Garden(
    count=80, width=SIZE[0], height=SIZE[1], radius=12.0, flatness=1.0, nearest=0.05, farthest=0.5,
    opacity_least=0.1, opacity_most=0.5, seed=1,
)  # fmt: skip
"""Splats of about 200 px within half a unit of the camera, as those that float before a fitted scene."""

NEEDLES = Garden(count=16_000, width=SIZE[0], height=SIZE[1], radius=14.0, flatness=1.0, seed=2)
THINNEST, THINNER = 3.0, 6.0
"""Needles' two shorter axes are shorter than the longest by e to between these."""

LENS = Distortion("fisheye", (0.05, -0.02, 0.003, 0.0))
FOCAL = 0.5
"""Focal length of the wide-angle camera [image widths]: its corners lie about 70 degrees off the axis."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A scene with its camera.

    Attributes:
        name: Name of the scene.
        gaussians: The scene.
        camera: Camera of the rendering.
    """

    name: str
    gaussians: Gaussians
    camera: Camera


def subjects() -> list[Subject]:
    """The built-in scenes, the same bytes at every call."""
    return [
        Subject("easy", EASY.gaussians(), EASY.camera),
        Subject("near-camera", EASY.gaussians().joined(NEAR.gaussians()), EASY.camera),
        Subject("needles", _needles(), NEEDLES.camera),
        Subject("wide-angle", *_wide_angle()),
    ]


def _needles() -> Gaussians:
    gaussians = NEEDLES.gaussians()
    random = np.random.default_rng(NEEDLES.seed + 1)
    shorter = random.uniform(THINNEST, THINNER, (len(gaussians), 2)).astype(np.float32)
    gaussians.log_scales[:, 1:] = gaussians.log_scales[:, :1] - torch.from_numpy(shorter)
    return gaussians


def _wide_angle() -> tuple[Gaussians, Camera]:
    """The easy scene spread evenly over the image of a fisheye camera, sizes kept against the distance."""
    width, height = SIZE
    flat, focal = EASY.gaussians(), FOCAL * width
    z = flat.means[:, 2:]
    # Where the pinhole camera of the easy scene shows a gaussian, this one does.
    bent = flat.means[:, :2] / z * EASY.camera.fx / focal
    angle = bent.norm(dim=1, keepdim=True)
    directions = torch.cat([bent / angle * angle.sin(), angle.cos()], dim=1)
    gaussians = replace(
        flat,
        means=directions * z,
        log_scales=flat.log_scales + float(np.log(EASY.camera.fx / focal)),
    )
    pose = torch.eye(4, dtype=torch.float64)
    return gaussians, Camera(width, height, focal, focal, width / 2, height / 2, pose, LENS)


def captured(folder: Path) -> Subject:
    """The middle of the middle view of a run, or of a capture with a splat.

    Raises:
        InputError: the folder holds no splat with cameras.
    """
    if (folder / RESULT).is_file() and (folder / CAMERAS).is_file():
        ply, cameras = folder / RESULT, list(load_cameras(folder / CAMERAS).train.values())
    else:
        scene = load_scene(folder)
        if scene.splat is None:
            raise InputError(f"{folder} holds no splat: make one with `diga3d fit`, and give its run folder")
        ply, cameras = scene.splat, [view.camera for view in scene.views]
    if not cameras:
        raise InputError(f"{folder} has no camera of a training view: give the folder of a finished run")
    return Subject(folder.name, Gaussians.load_ply(ply), middle(cameras[len(cameras) // 2]))


def middle(camera: Camera) -> Camera:
    """The middle of a camera's image, at most `SIZE`."""
    width, height = min(camera.width, SIZE[0]), min(camera.height, SIZE[1])
    left, top = (camera.width - width) // 2, (camera.height - height) // 2
    return replace(camera, width=width, height=height, cx=camera.cx - left, cy=camera.cy - top)
