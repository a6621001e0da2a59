"""The .ksplat file of GaussianSplats3D: sections of gaussians, at one of three levels of compression.

After a header of 4096 bytes come headers of 1024 bytes, one for each section, then the sections. A section
holds buckets, whose centres positions refer to from level 1 on, and rows: position, scale, rotation, colour
with opacity, and coefficients above degree 0, band by band, each band red, then green, then blue.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from diga3d_warp.errors import InputError
from diga3d_warp.scene.formats.quantised import constant_harmonics, log_scales, logits
from diga3d_warp.scene.formats.rows import SplatContent, SplatRows

_HEADER = np.dtype(
    {
        "names": ["major", "minor", "sections", "splats", "level", "sh_min", "sh_max"],
        "formats": ["u1", "u1", "<u4", "<u4", "<u2", "<f4", "<f4"],
        "offsets": [0, 1, 4, 16, 20, 36, 40],
        "itemsize": 4096,
    }
)
_SECTION = np.dtype(
    {
        "names": ["splats", "most", "bucket_size", "buckets", "block", "bucket_bytes", "range", "full",
                  "partial", "degree"],
        "formats": ["<u4", "<u4", "<u4", "<u4", "<f4", "<u2", "<u4", "<u4", "<u4", "<u2"],
        "offsets": [0, 4, 8, 12, 16, 20, 24, 32, 36, 40],
        "itemsize": 1024,
    }
)  # fmt: skip
_LEVELS = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))
"""Types of positions, of scales and rotations, and of coefficients."""
_POSITION_RANGE = 32767  # of files that do not say
_SH_RANGE = (-1.5, 1.5)  # of files that do not say
_COEFFICIENTS = (0, 3, 8, 15)


@dataclass(frozen=True, eq=False)
class _Section:
    """Where a section lies and how its rows are laid out."""

    header: np.void
    start: int
    layout: np.dtype

    @property
    def bucket_bytes(self) -> int:
        entry = self.header
        return int(entry["bucket_bytes"]) * int(entry["buckets"]) + 4 * int(entry["partial"])

    @property
    def end(self) -> int:
        return self.start + self.bucket_bytes + int(self.header["most"]) * self.layout.itemsize


def count_ksplat(path: Path) -> int:
    """Gaussians in a .ksplat file.

    Raises:
        InputError: it is no .ksplat, or shorter than it announces.
    """
    _, sections = _sections(path)
    return sum(int(section.header["splats"]) for section in sections)


def read_ksplat(path: Path) -> SplatContent:
    """Read a .ksplat file.

    Raises:
        InputError: it is no .ksplat, or shorter than it announces.
    """
    header, sections = _sections(path)
    degree = max((int(section.header["degree"]) for section in sections), default=0)
    parts = [_read_section(path, header, section, degree) for section in sections]
    parts = [part for part in parts if len(part)]
    if not parts:
        raise InputError(f"{path}: holds no gaussians; export the splat again")
    names = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
    return SplatContent(SplatRows(*(np.concatenate([getattr(p, name) for p in parts]) for name in names)))


def _sections(path: Path) -> tuple[np.void, list[_Section]]:
    size = path.stat().st_size
    damaged = InputError(f"{path}: cut short or damaged, or no .ksplat file; export it again")
    if size < _HEADER.itemsize:
        raise damaged
    header = np.fromfile(path, _HEADER, 1)[0]
    version = (int(header["major"]), int(header["minor"]))
    if version[0] != 0 or version[1] < 1 or header["level"] >= len(_LEVELS):
        raise damaged
    start = _HEADER.itemsize + int(header["sections"]) * _SECTION.itemsize
    if start > size:
        raise damaged
    sections = []
    for entry in np.fromfile(path, _SECTION, int(header["sections"]), offset=_HEADER.itemsize):
        if entry["degree"] >= len(_COEFFICIENTS) or entry["splats"] > entry["most"]:
            raise damaged
        position, shape, harmonics = _LEVELS[int(header["level"])]
        layout = np.dtype(
            [
                ("mean", position, 3),
                ("scale", shape, 3),
                ("rotation", shape, 4),
                ("color", "u1", 4),
                ("rest", harmonics, 3 * _COEFFICIENTS[int(entry["degree"])]),
            ]
        )
        section = _Section(entry, start, layout)
        if section.end > size:
            raise damaged
        sections.append(section)
        start = section.end
    return header, sections


def _read_section(path: Path, header: np.void, section: _Section, degree: int) -> SplatRows:
    count = int(section.header["splats"])
    table = np.fromfile(path, section.layout, count, offset=section.start + section.bucket_bytes)
    means = table["mean"].astype(np.float64)
    if header["level"] > 0:
        span = int(section.header["range"]) or _POSITION_RANGE
        means = (means - span) * (float(section.header["block"]) / 2 / span) + _bucket_centers(path, section)
    sh = np.zeros((count, _COEFFICIENTS[degree] + 1, 3), np.float32)
    sh[:, 0] = constant_harmonics(table["color"][:, :3] / 255)
    rest = table["rest"].astype(np.float64)
    if header["level"] == 2:
        low, high = float(header["sh_min"]) or _SH_RANGE[0], float(header["sh_max"]) or _SH_RANGE[1]
        rest = low + rest / 255 * (high - low)
    for first, last in pairwise(_COEFFICIENTS[: int(section.header["degree"]) + 1]):
        band = rest[:, 3 * first : 3 * last].reshape(count, 3, last - first)
        sh[:, 1 + first : 1 + last] = band.transpose(0, 2, 1)
    return SplatRows(
        means=means,
        log_scales=log_scales(table["scale"]),
        quaternions=table["rotation"].astype(np.float32),
        opacity_logits=logits(table["color"][:, 3]),
        sh=sh,
    )


def _bucket_centers(path: Path, section: _Section) -> np.ndarray:
    """The centre of each row's bucket, shape (N, 3): full buckets come first, the others have own lengths."""
    entry = section.header
    count, full, partial = int(entry["splats"]), int(entry["full"]), int(entry["partial"])
    damaged = InputError(f"{path}: damaged: its buckets do not hold its gaussians; export it again")
    if entry["bucket_bytes"] != 12 or full + partial > entry["buckets"]:
        raise damaged
    lengths = np.fromfile(path, "<u4", partial, offset=section.start).astype(np.int64)
    centers = np.fromfile(path, "<f4", 3 * int(entry["buckets"]), offset=section.start + 4 * partial)
    whole = full * int(entry["bucket_size"])
    if whole + lengths.sum() < count:
        raise damaged
    ends = np.concatenate([np.arange(1, full + 1) * int(entry["bucket_size"]), whole + lengths.cumsum()])
    which = np.searchsorted(ends, np.arange(count), side="right")
    return centers.reshape(-1, 3)[which].astype(np.float64)
