"""Files that are whole or absent: written under a temporary name, then renamed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from diga3d_warp.errors import InputError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; rename it to `path` once the block has ended without an error.

    A process that dies within the block leaves the old file as it was. The temporary name keeps the
    ending, which some writers choose their format by.

    Raises:
        InputError: the folder cannot be made or the file cannot be put in place.
    """
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(path, error) from error
    try:
        yield partial
        sync(partial)
        partial.replace(path)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        partial.unlink(missing_ok=True)


def cannot_write(path: Path, error: OSError) -> InputError:
    """The one line for a file or folder that the system refuses to write."""
    reason = (error.strerror or str(error)).lower()
    return InputError(f"{path} cannot be written ({reason}): make room there or choose another place")


def write_text(path: Path, text: str) -> None:
    """Write a whole UTF-8 text file, or none."""
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def write_json(path: Path, data: Any) -> None:
    """Write a whole JSON file, or none.

    Raises:
        ValueError: `data` holds NaN or infinity, which JSON cannot say.
    """
    write_text(path, json.dumps(data, indent=2, allow_nan=False) + "\n")


def read_json(path: Path, remedy: str) -> Any:
    """Read a JSON file.

    Args:
        path: The file.
        remedy: What would mend it if it is absent or broken, for the error line.

    Raises:
        InputError: the file is absent or not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path} cannot be read ({(error.strerror or '').lower()}): {remedy}") from error
    except ValueError as error:
        raise InputError(f"{path} is not valid JSON ({error}): {remedy}") from error


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
    """Ask the system to put a file, or every file under a folder, on the disk."""
    for file in [path] if path.is_file() else path.rglob("*"):
        if file.is_file():
            with file.open("rb") as stream:
                os.fsync(stream.fileno())
