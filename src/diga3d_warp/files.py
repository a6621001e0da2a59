"""Files that are whole or absent: written under a temporary name, then renamed. `state` reads them back."""

from __future__ import annotations

import io
import json
import math
import os
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from diga3d_warp.errors import InputError, cannot_read, explained

IS_WINDOWS = os.name == "nt"

NAME_BYTES = 200
"""Bytes of a file's stem that its temporary name keeps: most systems take names of 255 bytes, and the
temporary name is longer than the file's own."""

RENAME_WAITS = (0.05, 0.2, 0.5, 1.0)
"""Pauses [s] before a rename is tried again on Windows, which refuses it while a virus scanner or an indexer
holds the file open."""


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; rename it to `path` once the block has ended without an error.

    A process that dies within the block leaves the old file as it was. The temporary name keeps the
    ending, which some writers choose their format by. What stands under that name already is removed: a
    killed process left it, or it is a link that leads elsewhere.

    Raises:
        InputError: the folder cannot be made or the file cannot be put in place.
    """
    partial = temporary_name(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.unlink(missing_ok=True)
        yield partial
        sync(partial)
        put_in_place(partial, path)
    except OSError as error:
        if error.filename == str(partial):
            error.filename = str(path)
        raise explained(error, lambda named: named in (path, *path.parents), path) from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def temporary_name(path: Path) -> Path:
    """Where `whole_file` writes."""
    stem = path.stem.encode("utf-8", "surrogateescape")[:NAME_BYTES].decode("utf-8", "ignore")
    return path.with_name(f".{stem}.partial{path.suffix}")


def put_in_place(source: Path, target: Path) -> None:
    """Rename a file, or a folder to a name that is free."""
    for wait in RENAME_WAITS if IS_WINDOWS else ():
        try:
            source.replace(target)
            return
        except PermissionError:
            time.sleep(wait)
    source.replace(target)


def write_text(path: Path, text: str) -> None:
    """Write a whole UTF-8 text file, or none. What UTF-8 cannot say, parts of odd file names, is escaped."""
    with whole_file(path) as partial:
        partial.write_bytes(text.encode("utf-8", "backslashreplace"))


def write_json(path: Path, data: Any) -> None:
    """Write a whole JSON file, or none.

    Raises:
        InputError: `data` holds NaN or infinity, which JSON cannot say; or the file cannot be written.
    """
    try:
        text = json.dumps(data, indent=2, allow_nan=False)
    except ValueError:
        place = not_finite(data)
        if place is None:
            raise
        raise InputError(
            f"{path} cannot be written ({place} is not a finite number): what was computed has diverged; "
            "try other settings, such as fewer iterations or another --seed"
        ) from None
    write_text(path, text + "\n")


def not_finite(data: Any, place: str = "") -> str | None:
    """Path of the first NaN or infinity in JSON data, such as "curve[3].loss"; None if there is none."""
    if isinstance(data, float):
        return None if math.isfinite(data) else place or "it"
    entries: list[tuple[str, Any]] = []
    if isinstance(data, dict):
        entries = [(f"{place}.{key}" if place else str(key), value) for key, value in data.items()]
    elif isinstance(data, (list, tuple)):
        entries = [(f"{place}[{index}]", value) for index, value in enumerate(data)]
    return next((found for name, value in entries if (found := not_finite(value, name))), None)


def read_json(path: Path, remedy: str) -> Any:
    """Read a JSON file, in UTF-8 or UTF-16, with or without a byte order mark.

    Bytes that are neither, as names of files in a code page, stay in texts as `surrogateescape` keeps them.

    Args:
        path: The file.
        remedy: Remedy in the error if it is absent or damaged.

    Raises:
        InputError: the file is absent or not JSON.
    """
    try:
        data = path.read_bytes()
        return json.loads(data.decode(json.detect_encoding(data), "surrogateescape"))
    except OSError as error:
        raise cannot_read(path, error, remedy) from error
    except RecursionError as error:
        raise InputError(f"{path} is nested too deep for JSON: {remedy}") from error
    except ValueError as error:
        raise InputError(f"{path} is not valid JSON ({error}): {remedy}") from error


def write_array(path: Path, array: Any) -> None:
    """Write a whole .npy file, or none. An array or a tensor."""
    with whole_file(path) as partial:
        partial.write_bytes(_npy(array))


def write_arrays(path: Path, **arrays: Any) -> None:
    """Write a whole .npz file, or none. Unlike NumPy's, it holds no time: same arrays, same bytes."""
    with whole_file(path) as partial, zipfile.ZipFile(partial, "w") as archive:
        for name, array in arrays.items():
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), _npy(array), zipfile.ZIP_DEFLATED)


def _npy(array: Any) -> bytes:
    """An array or tensor in NumPy's format.

    Not written straight to the file: on a full disk NumPy raises an error that does not say so.
    """
    import numpy as np

    buffer = io.BytesIO()
    np.save(buffer, np.asarray(array), allow_pickle=False)
    return buffer.getvalue()


def write_image(path: Path, image: Any) -> None:
    """Write a whole PNG file, or none.

    Args:
        path: Ends with .png.
        image: RGB in [0, 1] (H, W, 3) as floats, RGB (H, W, 3) as uint8, or a mask (H, W) as bool. An array
            or a tensor. Floats are rounded, and clipped to [0, 1].
    """
    import cv2

    pixels = to_bytes(image)
    encoded, data = cv2.imencode(".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels)
    assert encoded, "PNG encoding takes any 8-bit image"
    with whole_file(path) as partial:
        partial.write_bytes(data.tobytes())


def to_bytes(image: Any) -> Any:
    """An image or mask as uint8, the same shape: floats in [0, 1] are rounded, True becomes 255."""
    import numpy as np

    array = np.asarray(image.detach().cpu() if hasattr(image, "detach") else image)
    if array.dtype == np.uint8:
        return array
    if array.dtype == bool:
        return array.astype(np.uint8) * 255
    return np.rint(np.clip(array, 0.0, 1.0) * 255.0).astype(np.uint8)


def sync(path: Path) -> None:
    """Ask the system to put a file, or a folder with everything in it, on the disk."""
    for entry in [path] if path.is_file() else [*path.rglob("*"), path]:
        if entry.is_file():
            # Windows syncs only what is open for writing; elsewhere a file may be read-only.
            with entry.open("r+b" if IS_WINDOWS else "rb") as stream:
                os.fsync(stream.fileno())
        elif not IS_WINDOWS:  # which cannot open a folder
            _sync_folder(entry)


def _sync_folder(folder: Path) -> None:
    opened = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # some network file systems cannot
            os.fsync(opened)
    finally:
        os.close(opened)
