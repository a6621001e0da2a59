"""COLMAP's text files as editors and programs leave them: the same content, or one line with its number."""

from __future__ import annotations

import codecs
from pathlib import Path

import numpy as np
import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.scene.colmap.files import read_cameras, read_images, read_points

CAMERAS = "# a comment\n1 PINHOLE 160 120 128.0 128.5 80.0 60.0\n2 SIMPLE_RADIAL 160 120 130 80 60 0.01\n"
POSES = ["1 0 0 0 1.5 2 3", "0.70710678 0.70710678 0 0 0 1 2", "0.5 0.5 0.5 0.5 -1 0 1"]
NAMES = ["a.jpg", "left/view one.jpg", "003"]
IMAGES = [
    f"{i + 1} {pose} {1 + i % 2} {name}" for i, (pose, name) in enumerate(zip(POSES, NAMES, strict=True))
]
OBSERVED = ["12.5 33 -1 80.25 7.75 4", "", "12 33 -1 13 34 5 14 35 6 15 36 7"]
POINTS = "1 0.5 0.25 1 10 20 30 0.5 1 0 2 0\n2 1 2 3 255 0 128 0.1\n"
PLAIN = "\n".join(line for pair in zip(IMAGES, OBSERVED, strict=True) for line in pair) + "\n"


def read(tmp_path: Path, text: str | bytes, stem: str = "images"):
    path = tmp_path / f"{stem}.txt"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return {"cameras": read_cameras, "images": read_images, "points3D": read_points}[stem](path)


FORMS = {
    "plain": PLAIN,
    "no last line end": PLAIN.rstrip("\n"),
    "without observations": "\n".join(IMAGES),
    "only some observations": "\n".join([IMAGES[0], *IMAGES[1:], OBSERVED[2]]),
    "blank first line": "\n" + PLAIN,
    "blank lines everywhere": PLAIN.replace("\n", "\n\n\n"),
    "comments everywhere": "# x\n" + PLAIN.replace("\n", "\n# 1 0 0 0 1 a\n  # y\n"),
    "spaces and tabs": "\n".join(f"  {line.replace(' ', chr(9), 9)}  " for line in PLAIN.split("\n")),
    "Windows": PLAIN.replace("\n", "\r\n"),
    "Windows twice": PLAIN.replace("\n", "\r\r\n"),
    "old Macintosh": PLAIN.replace("\n", "\r"),
    "byte order mark": codecs.BOM_UTF8 + PLAIN.encode(),
    "UTF-16": PLAIN.encode("utf-16"),
    "UTF-16, big end first": codecs.BOM_UTF16_BE + PLAIN.encode("utf-16-be"),
}


@pytest.mark.parametrize("form", FORMS)
def test_images(tmp_path, form):
    images = read(tmp_path, FORMS[form])
    assert [name for name, _, _ in images] == NAMES
    assert [camera for _, camera, _ in images] == [1, 2, 1]
    np.testing.assert_allclose(images[0][2], [[1, 0, 0, 1.5], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    np.testing.assert_allclose(images[1][2][:3, :3], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-7)
    np.testing.assert_allclose(images[2][2][:3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]])


@pytest.mark.parametrize("mark", [b"", codecs.BOM_UTF8, codecs.BOM_UTF16_LE])
def test_cameras_and_points(tmp_path, mark):
    encoding = "utf-16-le" if mark == codecs.BOM_UTF16_LE else "utf-8"
    cameras = read(tmp_path, mark + ("\n" + CAMERAS.replace("160", "160.0")).encode(encoding), "cameras")
    assert {number: (camera.width, camera.fx, camera.fy) for number, camera in cameras.items()} == {
        1: (160, 128.0, 128.5),
        2: (160, 130.0, 130.0),
    }
    points, notes = read(tmp_path, mark + POINTS.encode(encoding), "points3D")
    np.testing.assert_array_equal(points.positions, [[0.5, 0.25, 1], [1, 2, 3]])
    np.testing.assert_array_equal(points.colors, [[10, 20, 30], [255, 0, 128]])
    assert notes == []


def test_names_keep_bytes_that_are_not_utf_8(tmp_path):
    (only,) = read(tmp_path, f"1 {POSES[0]} 1 ".encode() + b"B\xfcro.jpg\n\n")
    assert only[0].encode("utf-8", "surrogateescape") == b"B\xfcro.jpg"


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("what\n", 1),
        (PLAIN + "# x\n\nwhat\n", 9),
        ("12.5 33 -1\n" + PLAIN, 1),
        (f"{IMAGES[0]}\n1 2 3\n4 5 6\n", 3),
        (f"{IMAGES[0]}\n1 2 3 4\n", 2),
        (f"# x\n1 {POSES[0]} 1\n", 2),
        (f"1 {POSES[0]} one a.jpg\n", 1),
        (f"1 {POSES[0].replace('1.5', '1,5')} 1 a.jpg\n", 1),
        (PLAIN[: len(IMAGES[0]) + len(OBSERVED[0]) + 20], 3),
    ],
)
def test_damaged_lines_of_images(tmp_path, text, number):
    with pytest.raises(InputError, match=rf"images\.txt: line {number}: cannot read '.*'; copy") as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("stem", "text", "match"),
    [
        ("cameras", CAMERAS + "3 PINHOLE wide 120 1 1 1 1", "line 4: cannot read '3 PINHOLE wide"),
        ("cameras", "1 PINHOLE 160.5 120 1 1 1 1", "line 1: cannot read"),
        ("cameras", "1 PINHOLE", "line 1: cannot read"),
        ("cameras", "1 PINHOLE inf 120 1 1 1 1", "line 1: cannot read"),
        (
            "cameras",
            "1 PINHOLE 160 120 128 128 80",
            "camera 1: camera model PINHOLE takes 4 parameters, not 3",
        ),
        ("cameras", "1 PINHOLE 160 120 nan 128 80 60", "camera 1: .*not finite"),
        ("cameras", "1 PINHOLE -160 120 128 128 80 60", "camera 1: .*sees nothing"),
        ("cameras", "1 OPENCV 160 120 128 128 80 60 1e9 0 0 0", "camera 1: .*up to 100"),
        ("cameras", b"1 PINH\xd6LE 160 120 1 1 1 1", r"line 1: cannot read '1 PINH\\\\xd6LE"),
        ("cameras", b"\0\1\2", "the file is not text"),
        (
            "images",
            f"1 {POSES[0].replace('1 0 0 0', '0 0 0 0')} 1 a.jpg",
            "the pose of 'a.jpg' is not a rotation",
        ),
        ("images", f"1 {POSES[0].replace('1.5', 'nan')} 1 a.jpg", "the pose of 'a.jpg' is not a rotation"),
        ("images", f"1 {POSES[0].replace('1 0', '9 0')} 1 a.jpg", "the pose of 'a.jpg' is not a rotation"),
        ("points3D", "1 0.5 0.25 1 10 20\n", "line 1: cannot read"),
        ("points3D", "1 0.5 0.25 1 10 20 red 0.5\n", "line 1: cannot read"),
        ("points3D", "1 0.5 0.25 1 10 20 -1 0.5\n", "a colour is -1, not 0 to 255"),
        ("points3D", f"1 0.5 0.25 1 10 20 {'9' * 400} 0.5\n", "a colour is inf, not 0 to 255"),
        ("points3D", "1 0.5 0.25 1 10 20 nan 0.5\n", "a colour is nan, not 0 to 255"),
        ("points3D", "# x\n1 0,5 0.25 1 10 20 30 0.5\n", "line 2: cannot read"),
    ],
)
def test_damaged_files(tmp_path, stem, text, match):
    with pytest.raises(InputError, match=rf"{stem}\.txt: {match}") as caught:
        read(tmp_path, text, stem)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("colors", "expected", "noted"),
    [
        (("158.0 170.0 146.0", "0.0 255.0 1.0"), [[158, 170, 146], [0, 255, 1]], "from 0 to 255"),
        (("0.5 1.0 0.0", "0.2 0.1 1"), [[128, 255, 0], [51, 26, 255]], "from 0 to 1,"),
        (("1 0 1", "0 1 0"), [[1, 0, 1], [0, 1, 0]], None),
        (("1e2 2.5e1 0", "0 1 0"), [[100, 25, 0], [0, 1, 0]], "from 0 to 255"),
        (("65535 0 1", "0 257 514"), [[255, 0, 0], [0, 1, 2]], "from 0 to 65535"),
    ],
)
def test_colors_of_points(tmp_path, colors, expected, noted):
    text = "".join(f"{i} 0 0 {i} {color} 0.5\n" for i, color in enumerate(colors))
    points, notes = read(tmp_path, text, "points3D")
    np.testing.assert_allclose(points.colors, expected, atol=1)
    assert [bool(noted) and noted in note for note in notes] == [True] * bool(noted)


def test_no_points(tmp_path):
    points, notes = read(tmp_path, "# none\n", "points3D")
    assert len(points) == 0 and points.colors.shape == (0, 3) and notes == []
