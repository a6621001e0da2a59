"""Implausible calibrations are noted: another unit, another origin; plausible ones are not."""

import numpy as np
import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Camera, Distortion
from diga3d_warp.scene.checks.calibration import (
    calibration_notes,
    check_sizes,
    field_of_view,
    fits,
    unreached_share,
)
from diga3d_warp.splatting.optics import optics_of


def camera(
    focal: float = 128.0, cx: float = 80.0, cy: float = 60.0, fy: float | None = None, lens=None
) -> Camera:
    return Camera(160, 120, focal, fy or focal, cx, cy, torch.eye(4), lens)


@pytest.mark.parametrize(
    ("odd", "said"),
    [
        (camera(cx=-3.2, cy=1.5), r"principal point (-3.2, 1.5) px lies outside an image of 160 x 120 px"),
        (camera(cx=0.5, cy=0.5), "lies far from the middle of"),
        (camera(cy=110.0), "lies far from the middle of"),
        (camera(4.2), "a focal length of 4.2 px gives 160 x 120 px a field of view of 174 degrees"),
        (camera(1e5), "field of view of 0.0917 degrees"),
        (camera(0.8, lens=Distortion("fisheye", (0.0,) * 4)), "focal lengths are in pixels"),
        (
            camera(lens=Distortion("brown", (-0.9, 0.0, 0.0, 0.0))),
            "of the image, and the rest shows nothing: check its coefficients",
        ),
        (
            camera(60.0, lens=Distortion("brown5", (0.0, 0.0, 0.0, 0.0, -1.0))),
            "the lens model reaches no more than",
        ),
        (
            camera(40.0, lens=Distortion("fisheye", (0.0,) * 4)),
            "the lens model reaches no more than 64% of the image",
        ),
        (camera(fy=96.0), "focal lengths of 128 and 96 px mean pixels that are not square"),
    ],
)
def test_odd_cameras_are_noted_once(odd, said):
    (note,) = calibration_notes({"a": camera(), "b": odd, "c": odd})
    assert note.startswith("b: ") and said in note and note.endswith(", and 1 more of 3 cameras likewise")
    assert "\n" not in note


def test_plausible_cameras_are_not_noted():
    fisheye = Distortion("fisheye", (0.0,) * 4)
    plausible = [camera(), camera(35.0), camera(9000.0), camera(cx=70.0, cy=75.0), camera(fy=126.0)]
    plausible += [camera(64.0, lens=fisheye), camera(105.0, lens=Distortion("brown", (-0.2, 0.1, 0.0, 0.0)))]
    assert calibration_notes({str(number): each for number, each in enumerate(plausible)}) == []


@pytest.mark.parametrize(
    "lens",
    [
        Distortion("brown", (-0.9, 0.0, 0.0, 0.0)),
        Distortion("brown5", (0.3, -0.2, 0.0, 0.0, -0.9)),
        Distortion("fisheye", (-0.9, 0.0, 0.0, 0.0)),
        Distortion("fisheye", (0.0,) * 4),
    ],
)
def test_the_share_that_a_lens_does_not_reach_is_that_of_pixels_without_a_ray(lens):
    bent = camera(48.0, lens=lens)
    rays = optics_of(bent).rays
    assert 0.02 < unreached_share(bent) < 0.98
    assert unreached_share(bent) == pytest.approx(1.0 - np.isfinite(rays).all(axis=1).mean(), abs=0.01)


def test_field_of_view():
    assert field_of_view(camera(80.0)) == pytest.approx(90.0)
    assert field_of_view(camera(80.0, lens=Distortion("fisheye", (0.0,) * 4))) == pytest.approx(
        114.6, abs=0.1
    )


@pytest.mark.parametrize(
    "size", [(160, 120), (80, 60), (3, 2), (4, 3), (20, 15), (53, 40), (160, 118), (161, 121)]
)
def test_copies_of_any_size_fit(size):
    assert fits(camera(), *size)


@pytest.mark.parametrize("size", [(120, 160), (120, 120), (160, 90), (2, 4), (12, 16), (160, 113)])
def test_other_aspect_ratios_do_not_fit(size):
    assert not fits(camera(), *size)


def test_every_scale_fits():
    for scale in range(1, 1000):
        assert fits(camera(), max(round(0.16 * scale), 1), max(round(0.12 * scale), 1))


def test_views_too_small_to_fit_are_refused():
    views = {"a": camera(), "b": camera().resized(16, 12)}
    check_sizes(views, 0.1)
    with pytest.raises(
        InputError, match=r"image c: 3 x 2 px are too few to fit, .*use --image-scale 0.11 or more"
    ):
        check_sizes({**views, "c": camera().resized(3, 2)}, 0.02)
    with pytest.raises(InputError, match="use larger photographs"):
        check_sizes({**views, "c": camera().resized(8, 8)}, 1.0)
