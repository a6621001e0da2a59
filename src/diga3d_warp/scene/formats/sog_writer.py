"""Writes the .sog file of PlayCanvas, version 2: WebP images of one pixel a gaussian.

Written here because GaussForge compares each gaussian's harmonics with 65536 others ten times: minutes for
100,000 gaussians, hours for a million.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from typing import Any

import numpy as np

from diga3d_warp.scene.formats.codebooks import scalar_codebook, vector_codebook
from diga3d_warp.scene.formats.quantised import OTHERS, bytes_of_logits
from diga3d_warp.scene.formats.rows import SplatRows
from diga3d_warp.scene.formats.sog import CODEBOOK, META

PALETTE = 1 << 16
"""Most different harmonics: an index takes 16 bits."""

PALETTE_COLUMNS = 64
"""Entries of the palette in one row of its image."""

SIDE = 4
"""Images have sides of a multiple of this [px]."""


def encode_sog(rows: SplatRows, antialiased: bool) -> bytes:
    """The bytes of a .sog.

    Args:
        rows: Finite, with unit quaternions.
        antialiased: Whether they were fitted with Mip-Splatting's 2D filter.
    """
    images: dict[str, np.ndarray] = {}
    meta: dict[str, Any] = {"version": 2, "count": len(rows)}
    meta |= {"antialias": True, "model": "antialiased"} if antialiased else {"antialias": False}

    logs = np.sign(rows.means) * np.log1p(np.abs(rows.means))
    low, high = logs.min(axis=0), logs.max(axis=0)
    share = (logs - low) / np.maximum(high - low, np.finfo(np.float64).tiny)
    steps = np.rint(share * 65535).astype(np.uint16)
    images["means_l"], images["means_u"] = (steps & 0xFF).astype(np.uint8), (steps >> 8).astype(np.uint8)
    meta["means"] = {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]}

    images["quats"] = _smallest_three(rows.quaternions)
    meta["quats"] = {"files": ["quats.webp"]}

    book, images["scales"] = scalar_codebook(rows.log_scales, CODEBOOK)
    meta["scales"] = {"codebook": book.tolist(), "files": ["scales.webp"]}

    book, colors = scalar_codebook(rows.sh[:, 0], CODEBOOK)
    images["sh0"] = np.column_stack([colors, bytes_of_logits(rows.opacity_logits)])
    meta["sh0"] = {"codebook": book.tolist(), "files": ["sh0.webp"]}

    encoded = {f"{name}.webp": _webp(_square(pixels)) for name, pixels in images.items()}
    rest = rows.sh[:, 1:]
    if rest.shape[1]:
        palette, labels = vector_codebook(np.ascontiguousarray(rest.reshape(len(rest), -1)), PALETTE)
        book, codes = scalar_codebook(palette, CODEBOOK)
        meta["shN"] = {
            "count": len(palette),
            "bands": math.isqrt(rows.sh.shape[1]) - 1,
            "codebook": book.tolist(),
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        }
        encoded["shN_centroids.webp"] = _webp(_palette_image(codes.reshape(len(palette), -1, 3)))
        columns = np.column_stack([labels & 0xFF, labels >> 8, np.zeros_like(labels)]).astype(np.uint8)
        encoded["shN_labels.webp"] = _webp(_square(columns))

    output = io.BytesIO()
    with zipfile.ZipFile(output, "w") as archive:  # images are compressed already
        for name, content in {**encoded, META: json.dumps(meta).encode("ascii")}.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return output.getvalue()


def _smallest_three(quaternions: np.ndarray) -> np.ndarray:
    """The three smallest components and 252 plus the place of the largest, shape (N, 4), uint8."""
    place = np.abs(quaternions).argmax(axis=1)
    signed = quaternions * np.where(np.take_along_axis(quaternions, place[:, None], axis=1) < 0, -1.0, 1.0)
    smallest = np.take_along_axis(signed, OTHERS[place], axis=1) * math.sqrt(2)
    codes = np.rint((smallest * 0.5 + 0.5).clip(0, 1) * 255)
    return np.column_stack([codes, 252 + place]).astype(np.uint8)


def _square(columns: np.ndarray) -> np.ndarray:
    """Rows as the pixels of an image about as high as wide, shape (H, W, C), filled up with zeros."""
    width = math.ceil(math.sqrt(len(columns)) / SIDE) * SIDE
    height = math.ceil(len(columns) / width / SIDE) * SIDE
    pixels = np.zeros((height * width, columns.shape[1]), np.uint8)
    pixels[: len(columns)] = columns
    return pixels.reshape(height, width, -1)


def _palette_image(codes: np.ndarray) -> np.ndarray:
    """Entries (M, K, 3) side by side, 64 to a row, shape (H, 64 K, 3)."""
    height = math.ceil(len(codes) / PALETTE_COLUMNS)
    pixels = np.zeros((height * PALETTE_COLUMNS, *codes.shape[1:]), np.uint8)
    pixels[: len(codes)] = codes
    return pixels.reshape(height, -1, 3)


def _webp(pixels: np.ndarray) -> bytes:
    """RGB or RGBA pixels as a lossless WebP; colours under an alpha of zero may be lost."""
    import cv2

    swapped = np.ascontiguousarray(pixels[..., [2, 1, 0, 3][: pixels.shape[2]]])
    encoded, data = cv2.imencode(".webp", swapped, [cv2.IMWRITE_WEBP_QUALITY, 101])
    assert encoded, "WebP takes any 8-bit image of up to 16383 px a side"
    return data.tobytes()
