"""Reads back what a run wrote, held to the form it was written in.

A file that is cut, empty, foreign or of another form is refused in one line that says what to delete. Arrays
are never unpickled: a pickle can run code.
"""

from __future__ import annotations

import math
import tokenize
import types
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Any,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

from diga3d_warp.errors import InputError, cannot_read
from diga3d_warp.files import read_json

if TYPE_CHECKING:
    import numpy as np

Form = TypeVar("Form")

# What NumPy raises on a damaged array, whose header it reads as Python.
_DAMAGED_ARRAY = (ValueError, EOFError, SyntaxError, MemoryError, tokenize.TokenError)

STAGES = "stages"
"""Folder in a run folder that holds a folder for each stage."""


def read_state(path: Path, form: type[Form], remedy: str | None = None) -> Form:
    """JSON data as a run wrote it.

    Args:
        path: The file.
        form: A TypedDict, or another type that `misfit` knows.
        remedy: Remedy in the error; by default `compute_again`.

    Raises:
        InputError: the file is absent, not JSON, or of another form.
    """
    remedy = remedy or compute_again(path)
    data = read_json(path, remedy)
    wrong = misfit(data, form)
    if wrong is not None:
        raise InputError(f"{path} is damaged ({wrong}): {remedy}")
    return data


def misfit(data: Any, form: Any, place: str = "") -> str | None:
    """Description of the first mismatch between JSON data and a form; None if it matches.

    Args:
        data: As `json.loads` gives it.
        form: A TypedDict, list[...], dict[str, ...], Literal[...], a union, bool, int, str, None, Any, or
            float, which takes whole numbers, too, but neither NaN nor infinity. Keys that a TypedDict does
            not name are left alone.
        place: Where the data stands, such as "stages[2]".
    """
    origin, options = get_origin(form), get_args(form)
    parts: Iterable[tuple[str, Any, Any]] = ()
    if form is Any:
        fits = True
    elif origin in (Union, types.UnionType):
        fits = any(misfit(data, option) is None for option in options)
    elif origin is Literal:
        fits = data in options
    elif origin is list:
        fits = isinstance(data, list)
        parts = ((f"{place}[{i}]", value, options[0]) for i, value in enumerate(data)) if fits else ()
    elif origin is dict:
        fits = isinstance(data, dict)
        parts = ((_inner(place, key), value, options[1]) for key, value in data.items()) if fits else ()
    elif is_typeddict(form):
        fits = isinstance(data, dict)
        missing = sorted(form.__required_keys__ - data.keys()) if fits else ()
        if missing:
            return f"{_inner(place, missing[0])} is missing"
        hints = get_type_hints(form)
        parts = ((_inner(place, k), data[k], hints[k]) for k in hints if k in data) if fits else ()
    elif form is float:
        fits = isinstance(data, (int, float)) and not isinstance(data, bool) and math.isfinite(data)
    elif form in (None, type(None)):
        fits = data is None
    else:
        fits = isinstance(data, form) and (form is bool or not isinstance(data, bool))
    if not fits:
        return f"{place or 'the whole'} is {_shown(data)}"
    return next((wrong for name, value, hint in parts if (wrong := misfit(value, hint, name))), None)


def _inner(place: str, key: str) -> str:
    return f"{place}.{key}" if place else key


def _shown(data: Any) -> str:
    """Data in a few words."""
    if isinstance(data, (dict, list)):
        return "a list" if isinstance(data, list) else "a table"
    text = repr(data)
    return text if len(text) <= 40 else f"{text[:37]}..."


def read_array(path: Path, remedy: str | None = None) -> np.ndarray:
    """An array that `files.write_array` wrote.

    Raises:
        InputError: the file is absent, cut short, no array, or holds Python objects.
    """
    import numpy as np

    remedy = remedy or compute_again(path)
    try:
        with path.open("rb") as stream:
            return np.lib.format.read_array(stream, allow_pickle=False)
    except OSError as error:
        raise cannot_read(path, error, remedy) from error
    except _DAMAGED_ARRAY as error:
        raise InputError(f"{path} is damaged (not a whole array of numbers): {remedy}") from error


def read_arrays(path: Path, remedy: str | None = None) -> Mapping[str, np.ndarray]:
    """Arrays that `files.write_arrays` wrote, by name.

    Raises:
        InputError: the file is absent, cut short, no archive of arrays, or holds Python objects.
    """
    import numpy as np

    remedy = remedy or compute_again(path)
    try:
        with zipfile.ZipFile(path) as archive:
            arrays = {}
            for name in archive.namelist():
                with archive.open(name) as stream:
                    arrays[name.removesuffix(".npy")] = np.lib.format.read_array(stream, allow_pickle=False)
            return arrays
    except (*_DAMAGED_ARRAY, RuntimeError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} is damaged (not whole arrays of numbers): {remedy}") from error
    except OSError as error:
        raise cannot_read(path, error, remedy) from error


def read_pixels(path: Path, remedy: str | None = None) -> np.ndarray:
    """A picture that `files.write_image` wrote, RGB, shape (H, W, 3), uint8.

    Raises:
        InputError: the file is absent or not whole.
    """
    import cv2

    return _decoded(path, cv2.IMREAD_COLOR_RGB, remedy)


def read_picture(path: Path, remedy: str | None = None) -> np.ndarray:
    """The same as floats in [0, 1], shape (H, W, 3), float32."""
    import numpy as np

    return read_pixels(path, remedy).astype(np.float32) / 255.0


def read_plane(path: Path, remedy: str | None = None) -> np.ndarray:
    """A picture of one channel, shape (H, W), uint8.

    Raises:
        InputError: as `read_pixels`.
    """
    import cv2

    return _decoded(path, cv2.IMREAD_GRAYSCALE, remedy)


def read_mask(path: Path, remedy: str | None = None) -> np.ndarray:
    """A mask, shape (H, W), bool.

    Raises:
        InputError: as `read_pixels`.
    """
    return read_plane(path, remedy) > 127


def _decoded(path: Path, flags: int, remedy: str | None) -> np.ndarray:
    import cv2
    import numpy as np

    remedy = remedy or compute_again(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise cannot_read(path, error, remedy) from error
    # Only a whole PNG ends like this; of one cut short OpenCV decodes what there is.
    whole = data.endswith(b"IEND\xaeB`\x82")
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if whole else None
    if pixels is None:
        raise InputError(f"{path} is damaged (not a whole picture): {remedy}")
    return pixels


def compute_again(path: Path) -> str:
    """Remedy for a damaged file of a run: delete its stage, or the file itself, and resume."""
    for folder in [path, *path.parents]:
        if folder.parent.name == STAGES:
            return f"delete {folder} and use --resume to compute it again"
    return f"delete {path} and use --resume to write it again"
