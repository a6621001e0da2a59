"""Names: what stays inside the scene, what a view is called, and what can be printed."""

from __future__ import annotations

import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.scene.photographs.names import image_key, inside, listed, view_names


def test_notes_are_short_however_many_images():
    names = [f"photograph_{number:05d}" for number in range(1200)]
    assert listed(names).endswith("photograph_00007 and 1192 more")


def test_listed_names_can_be_printed():
    text = listed(["a\nb", "B\udcfcro", "\udc81\x1b[31m"])
    assert text.isprintable() and "Büro" in text
    text.encode()


@pytest.mark.parametrize(
    ("keys", "names"),
    [
        (["a", "b"], ["a", "b"]),
        (["front/1", "back/1", "2"], ["front_1", "back_1", "2"]),
        (["a/b_c", "a_b/c", "x/b_c", "y/c"], ["a_b_c", "a_b_c_2", "x_b_c", "y_c"]),
        (["IMG", "img"], ["IMG", "img_2"]),
        ([".hidden", ".."], ["hidden", "_"]),
        (["a\nb", "tab\t"], ["a_b", "tab_"]),
    ],
)
def test_view_names_are_file_names(keys, names):
    assert [*view_names(keys).values()] == names


def test_long_names_leave_room_for_endings():
    first, second = view_names(["é" * 120, "/".join(["x" * 90] * 4)]).values()
    assert len(first.encode()) <= 200 and len(second.encode()) <= 200


@pytest.mark.parametrize(
    "name",
    [
        "../a.jpg",
        "..\\a.jpg",
        "/etc/a.jpg",
        "C:\\a.jpg",
        "x/../../a.jpg",
        "//host/a.jpg",
    ],
)
def test_paths_that_leave_the_scene(tmp_path, name):
    with pytest.raises(InputError, match="leaves the scene folder"):
        inside(tmp_path, name, tmp_path / "transforms.json")


@pytest.mark.parametrize("name", ["", " ", "a\0b", "x" * 300, "/" + "é" * 200 + "/a.jpg"])
def test_names_that_no_file_has(tmp_path, name):
    with pytest.raises(InputError, match="is no name of a file"):
        inside(tmp_path, name, tmp_path / "transforms.json")


def test_paths_of_another_machine_end_in_the_scene(tmp_path):
    (tmp_path / "images" / "x").mkdir(parents=True)
    (tmp_path / "images" / "x" / "a.jpg").touch()
    source = tmp_path / "transforms.json"
    for name in ("/data/room/images/x/a.jpg", "D:\\room\\images\\x\\a.jpg", "../room/images/x/a.jpg"):
        assert inside(tmp_path, name, source) == "images/x/a.jpg"
    assert inside(tmp_path, "/data/x/a", source, [tmp_path / "images"]) == "x/a"
    assert inside(tmp_path, "./images//x/./b.jpg", source) == "images/x/b.jpg"


def test_keys_lose_known_endings_only():
    assert image_key("a/IMG.2.JPG") == "a/IMG.2"
    assert image_key("a/IMG.2") == "a/IMG.2"
    assert image_key("a.HEIC") == "a"
    assert image_key("cafe\u0301.png") == "caf\u00e9"
