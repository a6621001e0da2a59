"""The .sog file of PlayCanvas: a zip of WebP images, one pixel a gaussian, and a meta.json."""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

from diga3d_warp.errors import InputError
from diga3d_warp.scene.formats.rows import Announced
from diga3d_warp.scene.photographs.decoding import read_header

META = "meta.json"
CODEBOOK = 256
"""Entries of each codebook."""

_META_MOST = 1 << 24  # bytes; codebooks take 20 kB
_PREFIX = 1 << 16  # bytes of an image in which its size stands
_LAYERS = ("means", "scales", "quats", "sh0", "shN")


def read_sog_header(path: Path) -> Announced:
    """Read what a .sog announces, and check that its images are there and large enough.

    Raises:
        InputError: the file is no .sog, damaged, or of version 1.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if archive.getinfo(META).file_size > _META_MOST:
                raise ValueError(f"{META} is too large")
            meta = json.loads(archive.read(META))
            return _checked(meta, archive, path)
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RecursionError, RuntimeError, zipfile.BadZipFile,
            zlib.error, EOFError) as error:  # fmt: skip
        reason = " ".join(str(error).split())[:100]
        raise InputError(
            f"{path}: cut short or damaged, or no .sog file ({reason}); export it again"
        ) from error


def _checked(meta: Any, archive: zipfile.ZipFile, path: Path) -> Announced:
    if not isinstance(meta, dict):
        raise ValueError(f"{META} is no object")
    if (version := meta.get("version", 1)) != 2:
        raise InputError(f"{path}: version {version} of .sog is not known; export it as a .ply")
    count = meta["count"]
    if not isinstance(count, int) or isinstance(count, bool) or count < 0:
        raise ValueError("its count is no number")
    for layer in {"scales", "sh0", "shN"} & meta.keys():
        if len(meta[layer]["codebook"]) != CODEBOOK:
            raise ValueError(f"the codebook of {layer} has not {CODEBOOK} entries")
    for layer in _LAYERS:
        for name in meta[layer]["files"] if layer in meta or layer != "shN" else ():
            with archive.open(name) as file:
                width, height, _ = read_header(file.read(_PREFIX), f"{path}: {name}")
            if width * height < count and not name.startswith("shN_centroids"):
                raise ValueError(f"{name} has {width} x {height} px for {count} gaussians")
    return Announced(count, meta.get("model") == "antialiased" or meta.get("antialias") is True)
