"""COLMAP's camera models: their numbers and parameters, and conversion to and from `Camera`."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera, Distortion

MODELS = {
    "SIMPLE_PINHOLE": (0, "f cx cy"),
    "PINHOLE": (1, "fx fy cx cy"),
    "SIMPLE_RADIAL": (2, "f cx cy k1"),
    "RADIAL": (3, "f cx cy k1 k2"),
    "OPENCV": (4, "fx fy cx cy k1 k2 p1 p2"),
    "OPENCV_FISHEYE": (5, "fx fy cx cy k1 k2 k3 k4"),
    "FULL_OPENCV": (6, "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6"),
    "FOV": (7, "fx fy cx cy omega"),
    "SIMPLE_RADIAL_FISHEYE": (8, "f cx cy k1"),
    "RADIAL_FISHEYE": (9, "f cx cy k1 k2"),
    "THIN_PRISM_FISHEYE": (10, "fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1"),
    "RAD_TAN_THIN_PRISM_FISHEYE": (11, "fx fy cx cy k1 k2 k3 k4 k5 k6 p1 p2 s1 s2 s3 s4"),
    "SIMPLE_DIVISION": (12, "f cx cy k"),
    "DIVISION": (13, "fx fy cx cy k"),
    "SIMPLE_FISHEYE": (14, "f cx cy"),
    "FISHEYE": (15, "fx fy cx cy"),
    "EUCM": (16, "fx fy cx cy alpha beta"),
    "EQUIRECTANGULAR": (17, "w h"),
}
"""COLMAP's number of each model and its parameters, of version 4.2 (sensor/models.h)."""

_INTRINSICS = frozenset(("f", "fx", "fy", "cx", "cy"))
_BROWN = ("k1", "k2", "p1", "p2", "k3")
_FISHEYE = ("k1", "k2", "k3", "k4")
REMEDY = "undistort the images with `colmap image_undistorter`"


def parameter_count(model: str) -> int:
    """Number of parameters of a model."""
    return len(MODELS[model][1].split())


def camera_from_model(model: str, width: int, height: int, parameters: Sequence[float]) -> Camera:
    """A camera at the origin from COLMAP's model name and parameters.

    Larger models are read if their further coefficients are zero: FULL_OPENCV up to k3, as Metashape exports
    it, and fisheyes up to k4.

    Raises:
        InputError: the model is unknown or has distortion that is not supported, or the count of
            parameters does not fit it.
    """
    if model not in MODELS:
        raise InputError(f"camera model {model} is not known; {REMEDY}")
    names = MODELS[model][1].split()
    if len(parameters) != len(names):
        raise InputError(f"camera model {model} takes {len(names)} parameters, not {len(parameters)}")
    given = dict(zip(names, parameters, strict=True))
    if "cx" not in given:
        raise InputError(
            f"camera model {model} is not supported; cut perspective images out of the panoramas"
        )
    followed = _FISHEYE if model.endswith("FISHEYE") else _BROWN
    for name, value in given.items():
        if value and name not in (*_INTRINSICS, *followed) and not (name == "beta" and not given["alpha"]):
            raise InputError(f"camera model {model} with {name} = {value:g} is not supported; {REMEDY}")
    lens = [given.get(name, 0.0) for name in followed]
    distortion = Distortion("fisheye", tuple(lens)) if followed is _FISHEYE else Distortion.brown(*lens)
    fx = given.get("fx", given.get("f", 0.0))
    fy = given.get("fy", fx)
    return Camera(width, height, fx, fy, given["cx"], given["cy"], torch.eye(4), distortion)


def colmap_lens(camera: Camera) -> tuple[str, list[float]]:
    """COLMAP's name and parameters of a camera's lens: PINHOLE, OPENCV, FULL_OPENCV or OPENCV_FISHEYE."""
    focal_and_center = [camera.fx, camera.fy, camera.cx, camera.cy]
    lens = camera.distortion
    if lens is None:
        return "PINHOLE", focal_and_center
    if lens.kind == "brown5":
        return "FULL_OPENCV", [*focal_and_center, *lens.coefficients, 0.0, 0.0, 0.0]
    model = "OPENCV" if lens.kind == "brown" else "OPENCV_FISHEYE"
    return model, [*focal_and_center, *lens.coefficients]
