"""State files: read back as they were written, or refused in one line that says what to delete."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal, TypedDict

import numpy as np
import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.files import write_array, write_arrays, write_image, write_json
from diga3d_warp.state import misfit, read_array, read_arrays, read_mask, read_pixels, read_state


class Needed(TypedDict):
    name: str
    sizes: list[int]


class Entry(Needed, total=False):
    share: float | None
    kind: Literal["a", "b"]
    more: dict[str, Any]


GOOD = {"name": "x", "sizes": [1, 2], "share": 1, "kind": "b", "more": {"k": [None]}, "extra": 3}


def test_data_of_the_form_fits():
    assert misfit(GOOD, Entry) is None
    assert misfit([GOOD], list[Entry]) is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"name": 3}, "name is 3"),
        ({"sizes": [1, "2"]}, "sizes[1] is '2'"),
        ({"sizes": [True]}, "sizes[0] is True"),
        ({"sizes": {}}, "sizes is a table"),
        ({"share": float("nan")}, "share is nan"),
        ({"share": "x" * 80}, "share is '" + "x" * 36 + "..."),
        ({"kind": "c"}, "kind is 'c'"),
        ({"more": []}, "more is a list"),
    ],
)
def test_what_does_not_fit_is_named(change, said):
    assert misfit({**GOOD, **change}, Entry) == said


def test_a_missing_key_is_named():
    assert misfit({"name": "x"}, Entry) == "sizes is missing"
    assert misfit([{"name": "x"}], list[Entry]) == "[0].sizes is missing"
    assert misfit(None, Entry) == "the whole is None"


@pytest.fixture
def stage(tmp_path) -> Path:
    return tmp_path / "run" / "stages" / "fit"


def test_what_is_written_is_read_back(stage):
    array, mask = np.arange(6, dtype=np.float32).reshape(2, 3), np.eye(4, dtype=bool)
    pixels = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    write_json(stage / "entry.json", GOOD)
    write_array(stage / "array.npy", array)
    write_arrays(stage / "arrays.npz", array=array, mask=mask)
    write_image(stage / "mask.png", mask)
    write_image(stage / "sub" / "picture.png", pixels)
    assert read_state(stage / "entry.json", Entry) == GOOD
    assert np.array_equal(read_array(stage / "array.npy"), array)
    assert np.array_equal(read_arrays(stage / "arrays.npz")["mask"], mask)
    assert np.array_equal(read_mask(stage / "mask.png"), mask)
    assert np.array_equal(read_pixels(stage / "sub" / "picture.png"), pixels)


def halved(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def objects(path: Path) -> None:
    held = np.array([{"a": 1}, None], dtype=object)
    with path.open("wb") as stream:
        (np.savez if path.suffix == ".npz" else np.save)(stream, held, allow_pickle=True)


SPOIL = {
    "halved": halved,
    "empty": lambda path: path.write_bytes(b""),
    "foreign": lambda path: path.write_bytes(b"\x80\x04\x95 a pickle\n" * 40),
    "nested too deep": lambda path: path.write_text("[" * 100_000),
    "objects": objects,
    "absent": lambda path: path.unlink(),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
}


@pytest.mark.parametrize("how", SPOIL)
def test_a_spoilt_file_is_one_line_that_says_what_to_delete(stage, how):
    array = np.random.default_rng(0).random((20, 20, 3), np.float32)
    write_json(stage / "entry.json", GOOD)
    write_array(stage / "array.npy", array)
    write_arrays(stage / "arrays.npz", array=array)
    write_image(stage / "masks" / "picture.png", array)
    readers = {
        "entry.json": lambda path: read_state(path, Entry),
        "array.npy": read_array,
        "arrays.npz": read_arrays,
        "masks/picture.png": read_pixels,
    }
    for name, read in readers.items():
        SPOIL[how](stage / name)
        with pytest.raises(InputError) as error:
            read(stage / name)
        said = str(error.value)
        assert said.startswith(f"{stage / name} ") and "\n" not in said
        assert said.endswith(f": delete {stage} and use --resume to compute it again")


def test_what_stands_outside_of_stages_is_deleted_itself(tmp_path):
    with pytest.raises(InputError, match=rf"delete {tmp_path / 'a.json'} and use --resume"):
        read_state(tmp_path / "a.json", Entry)


def test_json_of_another_form_is_named(stage):
    write_json(stage / "entry.json", {**GOOD, "name": None})
    with pytest.raises(InputError, match=r"entry\.json is damaged \(name is None\): delete"):
        read_state(stage / "entry.json", Entry)
    (stage / "entry.json").write_text(json.dumps({**GOOD, "share": float("inf")}))
    with pytest.raises(InputError, match=r"share is inf"):
        read_state(stage / "entry.json", Entry)
