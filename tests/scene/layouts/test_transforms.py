"""transforms.json in its dialects: what is read, what is refused in one line, and what is noted."""

from __future__ import annotations

import json
import math
from pathlib import Path, PurePosixPath

import numpy as np
import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.scene.camera import Distortion, look_at
from diga3d_warp.scene.layouts.transforms import Transforms, read_frames

PATH = Path("scene/transforms.json")
POSE = look_at(np.array([1.0, -2.0, 0.5]), np.zeros(3))
MATRIX = np.linalg.inv(POSE) @ np.diag([1.0, -1.0, -1.0, 1.0])


def frame(**changes) -> dict:
    given = {"file_path": "images/a.png", "transform_matrix": MATRIX.tolist(), **changes}
    return {name: value for name, value in given.items() if value is not ...}


def read(*frames: dict, sizes=(160, 120), **contents) -> Transforms:
    """Frames of a file with 160 x 120 px and a focal length of 128 px, but for `contents`."""
    given = {"w": 160, "h": 120, "fl_x": 128.0, **contents, "frames": list(frames or [frame()])}
    whole = json.loads(json.dumps({name: value for name, value in given.items() if value is not ...}))
    return read_frames(Path("scene"), PATH, whole, lambda files: dict.fromkeys(files, sizes) if sizes else {})


def camera(**contents):
    return read(**contents).frames[0].camera


def refused(match: str, *frames: dict, **contents) -> None:
    with pytest.raises(InputError, match=match) as caught:
        read(*frames, **contents)
    assert str(caught.value).startswith(f"{PATH}: ") and "\n" not in str(caught.value)


def test_a_plain_frame():
    transforms = read(frame(mask_path="masks/a.png"))
    (only,) = transforms.frames
    assert only.file == PurePosixPath("images/a.png") and only.mask == Path("scene/masks/a.png")
    found = only.camera
    assert (found.width, found.height, found.fx, found.fy, found.cx, found.cy) == (160, 120, 128, 128, 80, 60)
    np.testing.assert_allclose(found.pose, POSE, atol=1e-12)
    assert found.distortion is None and transforms.notes == []


@pytest.mark.parametrize(
    ("matrix", "noted"),
    [
        (MATRIX[:3], False),
        (MATRIX.ravel(), False),
        (MATRIX[:3].ravel(), False),
        (MATRIX.astype(str), False),
        (MATRIX.round(3), False),
        (MATRIX * [0.3, 0.3, 0.3, 1.0], True),
    ],
    ids=["3x4", "flat", "flat 3x4", "text", "few digits", "scaled"],
)
def test_forms_of_a_pose(matrix, noted):
    transforms = read(frame(transform_matrix=matrix.tolist()))
    np.testing.assert_allclose(transforms.frames[0].camera.pose, POSE, atol=2e-3)
    rotation = transforms.frames[0].camera.pose[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert [note for note in transforms.notes if "scale" in note] == list(transforms.notes)
    assert bool(transforms.notes) == noted


@pytest.mark.parametrize(
    ("matrix", "match"),
    [
        (MATRIX.T.tolist(), "its last row is .*, not 0 0 0 1: it is transposed"),
        (MATRIX[:2].tolist(), r"transform_matrix: it has shape \(2, 4\)"),
        ((MATRIX * [-1, 1, 1, 1]).tolist(), "mirror image"),
        ((MATRIX * [2, 1, 1, 1]).tolist(), "not a rotation"),
        ((MATRIX * [0, 0, 0, 1]).tolist(), "not a rotation"),
        ((MATRIX * 2).tolist(), "last row is 0 0 0 2"),
        ((MATRIX * np.nan).tolist(), "last row is nan"),
        ((MATRIX[:3] * [1, 1, 1, np.inf]).tolist(), "not finite"),
        ((MATRIX * [1, 1, 1, 1e300]).tolist(), "last row|scale the scene down"),
        ([[1, 2], [3]], "not a table of numbers"),
        ({"rotation": 1}, "not a table of numbers"),
        ("text", "not a table of numbers"),
        ([], r"shape \(0,\)"),
        (None, "transform_matrix is missing"),
        (..., "transform_matrix is missing"),
    ],
)
def test_poses_that_are_none(matrix, match):
    refused(f"frame 0: .*{match}", frame(transform_matrix=matrix))


def test_a_pose_far_beyond_any_scene():
    matrix = MATRIX.copy()
    matrix[0, 3] = 1e300
    refused("frame 0: .*scale the scene down", frame(transform_matrix=matrix.tolist()))


@pytest.mark.parametrize(
    ("entries", "focals"),
    [
        ({"fl_y": 96.0}, (128.0, 96.0)),
        ({"fl_x": "128.0", "fl_y": None}, (128.0, 128.0)),
        ({"fl_x": ..., "fl_y": 96}, (96.0, 96.0)),
        ({"fl_x": ..., "camera_angle_x": math.pi / 2}, (80.0, 80.0)),
        ({"fl_x": ..., "camera_angle_x": math.pi / 2, "camera_angle_y": math.pi / 2}, (80.0, 60.0)),
        ({"fl_x": ..., "camera_angle_y": math.pi / 2}, (60.0, 60.0)),
        ({"fl_x": ..., "x_fov": 90.0, "y_fov": 90.0}, (80.0, 60.0)),
    ],
)
def test_focal_lengths(entries, focals):
    found = camera(**entries)
    np.testing.assert_allclose((found.fx, found.fy), focals)


def test_the_focal_length_of_a_frame_wins():
    transforms = read(
        frame(),
        frame(camera_angle_x=math.pi / 2),
        frame(fl_x=50.0, fl_y=40.0),
        fl_y=129.0,
        camera_angle_y=0.87,
    )
    focals = [(each.camera.fx, each.camera.fy) for each in transforms.frames]
    np.testing.assert_allclose(focals, [(128, 129), (80, 80), (50, 40)])
    assert transforms.notes == [
        f"{PATH}: the focal length of a frame along one axis is used for both (1 of 3 frames)"
    ]


def test_two_focal_lengths_that_disagree_are_noted():
    assert read(camera_angle_x=2 * math.atan(80 / 128.0)).notes == []
    assert "fl_x and camera_angle_x disagree: fl_x is used" in read(camera_angle_x=0.5).notes[0]


@pytest.mark.parametrize("angle", [0.0, -0.5, 3.2, 60.0])
def test_angles_that_are_none(angle):
    refused(
        r"camera_angle_x is .*, not an angle between 0 and pi \(it is in radians\)",
        fl_x=...,
        camera_angle_x=angle,
    )


def test_each_image_has_its_own_size():
    sizes = {"images/a.png": (160, 120), "images/b.png": (120, 160), "images/c.png": None}
    frames = [frame(file_path=name, camera_angle_x=math.pi / 2) for name in sizes]
    contents = {"frames": frames, "w": None}
    transforms = read_frames(
        Path("scene"), PATH, contents, lambda files: {file: sizes[str(file)] for file in files[:2]}
    )
    found = [
        (each.camera.width, each.camera.height, each.camera.fx, each.camera.cx) for each in transforms.frames
    ]
    assert found[:2] == [(160, 120, pytest.approx(80), 80), (120, 160, pytest.approx(60), 60)]
    refused("frame 0: w and h are missing, and so is the image", w=..., sizes=None)


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        ({"w": "160.0", "h": "120.0"}, (160, 120, 80, 60)),
        ({"w": 160.2, "h": 119.6}, (160, 120, 80, 60)),
        ({"cx": None, "cy": None}, (160, 120, 80, 60)),
        ({"cx": "81.5", "cy": 59}, (160, 120, 81.5, 59)),
    ],
)
def test_sizes_and_principal_points(entries, expected):
    found = camera(**entries)
    assert (found.width, found.height, found.cx, found.cy) == expected


@pytest.mark.parametrize("value", ["wide", "", [160], {"px": 160}, True, float("nan"), float("inf"), 10**400])
@pytest.mark.parametrize("name", ["w", "fl_x", "cx", "k1", "camera_angle_y"])
def test_numbers_that_are_none(name, value):
    refused(f"frame 0: {name} is .*, not a number; export it again", **{name: value})


@pytest.mark.parametrize(
    ("entries", "match"),
    [
        ({"w": 0}, "sees nothing"),
        ({"h": -120}, "sees nothing"),
        ({"fl_x": -128.0}, "sees nothing"),
        ({"fl_x": 1e9}, r"within 1e\+06 px"),
        ({"w": 10**9}, "no image has"),
        ({"cx": 1e9}, r"within 1e\+06 px"),
        ({"k1": 1e9}, "up to 100"),
        ({"camera_model": 5}, "camera_model is 5, not a text"),
        ({"is_fisheye": "maybe"}, "is_fisheye is 'maybe', neither true nor false"),
        ({"is_fisheye": [1]}, "neither true nor false"),
    ],
)
def test_cameras_that_are_none(entries, match):
    refused(f"frame 0: .*{match}", **entries)


K = {"k1": 0.1, "k2": 0.2, "p1": 0.01, "p2": 0.02}
BROWN = Distortion("brown", (0.1, 0.2, 0.01, 0.02))
RADIAL = Distortion("brown", (0.1, 0.0, 0.0, 0.0))
FISHEYE = Distortion("fisheye", (0.1, 0.2, 0.3, 0.4))


@pytest.mark.parametrize(
    ("entries", "lens", "said"),
    [
        (K, BROWN, ""),
        ({"camera_model": "OPENCV", **K}, BROWN, ""),
        ({"camera_model": "opencv", **K, "k3": 0.3}, Distortion("brown5", (0.1, 0.2, 0.01, 0.02, 0.3)), ""),
        ({"camera_model": "FULL_OPENCV", **K, "k5": 0, "k6": "0.0"}, BROWN, ""),
        ({"camera_model": "RADIAL", "k1": 0.1}, RADIAL, ""),
        ({"camera_model": "PINHOLE", "k1": 0.1}, RADIAL, "is PINHOLE: read as OPENCV"),
        ({"camera_model": "PINHOLE", "k1": 0.0}, None, ""),
        ({"is_fisheye": True, "k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4}, FISHEYE, ""),
        ({"is_fisheye": 1, "p1": 0.0, "k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4}, FISHEYE, ""),
        ({"is_fisheye": False, "k1": 0.1}, RADIAL, ""),
        *(({"camera_model": name, "k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4}, FISHEYE, "")
          for name in ("SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")),
        ({"camera_model": "OPENCV_FISHEYE", "k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4}, FISHEYE, ""),
        ({"camera_model": "FISHEYE"}, Distortion("fisheye", (0.0, 0.0, 0.0, 0.0)), ""),
        ({"camera_model": "OPENCV", "is_fisheye": True, "k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4}, FISHEYE,
         "is_fisheye is on though camera_model is OPENCV"),
    ],
)  # fmt: skip
def test_lenses(entries, lens, said):
    transforms = read(**entries)
    assert transforms.frames[0].camera.distortion == lens
    assert said in "".join(transforms.notes) and bool(transforms.notes) == bool(said)


def test_each_frame_has_its_own_lens():
    transforms = read(frame(camera_model="OPENCV_FISHEYE", k1=0.1), frame(k1=0.2), camera_model="OPENCV")
    assert [each.camera.distortion.kind for each in transforms.frames] == ["fisheye", "brown"]


@pytest.mark.parametrize(
    ("entries", "match"),
    [
        ({"k4": 0.1}, "k4 is supported for fisheye lenses only; undistort the images"),
        ({"is_fisheye": True, "p1": 0.1}, "p1 and p2 are not supported for a fisheye"),
        ({"k5": 0.1}, "k5 is 0.1: that part of a lens is not supported; undistort"),
        ({"b1": -2.5}, "b1 is -2.5"),
        ({"s1": 1e-3}, "s1 is 0.001"),
        ({"distortion_params": [0.1, 0, 0, 0]}, "distortion_params is"),
        ({"ftheta_p1": 0.2}, "ftheta_p1"),
        ({"equirectangular": True}, "equirectangular is True"),
        ({"camera_model": "FISHEYE624"}, "camera_model 'FISHEYE624' is not supported"),
        ({"camera_model": "THIN_PRISM_FISHEYE"}, "camera_model .* is not supported; undistort the images"),
    ],
)
def test_lenses_that_are_not_supported(entries, match):
    refused(f"frame 0: {match}", **entries)
    refused(f"frame 0: {match}", frame(**entries))


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ({"rolling_shutter": [0.0, 0.0, 0.03, 0.0]}, "rolling_shutter is not followed"),
        ({"transform_matrix_end": MATRIX.tolist()}, "transform_matrix_end is not followed"),
        ({"fisheye_crop_radius": 70.0}, "fisheye_crop_radius is not used"),
        ({"white_transparent": True}, "white_transparent is not used"),
        (
            {"distortion_maps": ["a.npy"], "vignette": 0.5},
            "entries that are not read: distortion_maps, vignette",
        ),
    ],
)
def test_what_is_not_used_is_noted(entries, said):
    for transforms in (read(**entries), read(frame(**entries), frame())):
        assert [said in note for note in transforms.notes] == [True]


def test_what_changes_nothing_is_not_noted():
    quiet = {
        "aabb_scale": 16, "applied_transform": MATRIX[:3].tolist(), "orientation_override": "none",
        "up": [0, 0, 1], "rolling_shutter": [0.0, 0.0, 0.0, 0.0], "k5": 0.0, "distortion_params": [0.0] * 6,
        "is_panorama": False, "n_frames": 1, "white_transparent": False,
    }  # fmt: skip
    assert (
        read(frame(sharpness=20.0, depth_file_path="d.png", colmap_im_id=3, rotation=0.01), **quiet).notes
        == []
    )


@pytest.mark.parametrize(
    ("contents", "match"),
    [
        ([], "lists no frames"),
        ("frames", "lists no frames"),
        ({"frames": {}}, "lists no frames"),
        ({"frames": []}, "lists no frames"),
        ({"frames": [3]}, "frame 0 is 3, not an object"),
        ({"frames": [None]}, "frame 0 is None, not an object"),
        ({"frames": [frame(file_path=7)]}, "frame 0: file_path is 7, not a text"),
        ({"frames": [frame(file_path="")]}, "frame 0: file_path is missing"),
        ({"frames": [frame(file_path="a\0b")]}, "frame 0: file_path is missing"),
        (
            {"frames": [frame(mask_path=[])], "w": 9, "h": 9, "fl_x": 9},
            r"frame 0: mask_path is \[\], not a text",
        ),
        ({"frames": [frame(mask_path="../m.png")], "w": 9, "h": 9, "fl_x": 9}, "leaves the scene"),
    ],
)
def test_contents_of_another_form(contents, match):
    with pytest.raises(InputError, match=match) as caught:
        read_frames(Path("scene"), PATH, contents, lambda files: {})
    assert str(PATH) in str(caught.value) and "\n" not in str(caught.value)


NAMES = (
    *("camera_model", "is_fisheye", "k1", "k4", "p1", "w", "fl_x", "cx", "camera_angle_x", "x_fov", "s1"),
    *("file_path", "mask_path", "transform_matrix", "rolling_shutter", "n_frames"),
)


def test_any_value_in_any_place_is_read_or_refused():
    """Every entry in turn holds something else: no error but the one line."""
    values = [
        None,
        True,
        -1,
        1e308,
        float("nan"),
        10**30,
        "",
        "\ud800",
        "7",
        [],
        [[]],
        {},
        {"a": [1]},
        [[1]] * 4,
    ]
    names = [*NAMES, "odd"]
    for name in names:
        for value in values:
            for contents in ({"frames": [frame(**{name: value})]}, {"frames": [frame()], name: value}):
                try:
                    read_frames(
                        Path("scene"), PATH, {"w": 9, "h": 9, "fl_x": 9.0, **contents}, lambda files: {}
                    )
                except InputError as error:
                    assert "\n" not in str(error) and str(error).encode()
