"""The .spz file of Niantic: 16 to 64 bytes a gaussian before compression.

Versions 1 to 3 are one gzip stream, version 4 a header and zstd streams. Positions are fixed-point numbers of
24 bits. The format documents x right, y up, z backwards, but most writers keep the axes of the .ply they
convert, so nothing is turned here.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from diga3d_warp.errors import InputError
from diga3d_warp.scene.formats.rows import Announced

_MAGIC = b"NGSP"
_GZIP = b"\x1f\x8b"
_FIELDS = struct.Struct("<4sIIBBB")  # magic, version, gaussians, degree, fractional bits, flags
_ANTIALIASED = 1
_FLAGS_AT = 14  # byte of the header
_LEAST = 16  # bytes of a gaussian before compression
_DEFLATE_MOST = 1032  # bytes that one compressed byte can stand for
_PREFIX = 1 << 16


def read_spz_header(path: Path) -> Announced:
    """Read the header of an .spz.

    Raises:
        InputError: the file is no .spz, of an unknown version, or too short for what it announces.
    """
    with path.open("rb") as file:
        start = file.read(_PREFIX)
    damaged = InputError(f"{path}: cut short or damaged, or no .spz file; export it again")
    zipped = start.startswith(_GZIP)
    if zipped:
        try:
            start = zlib.decompressobj(31).decompress(start, _FIELDS.size)
        except zlib.error:
            raise damaged from None
    if len(start) < _FIELDS.size:
        raise damaged
    magic, version, count, _, _, flags = _FIELDS.unpack(start[: _FIELDS.size])
    if magic != _MAGIC:
        raise damaged
    if version not in (range(1, 4) if zipped else range(4, 5)):
        raise InputError(f"{path}: version {version} of .spz is not known; export it as a .ply")
    if zipped and count * _LEAST > path.stat().st_size * _DEFLATE_MOST:
        raise InputError(f"{path}: cut short or damaged: too small for {count} gaussians; export it again")
    return Announced(count, bool(flags & _ANTIALIASED))


def with_antialiased(data: bytes) -> bytes:
    """The same .spz of version 3, marked as anti-aliased."""
    raw = bytearray(zlib.decompress(data, 31))
    raw[_FLAGS_AT] |= _ANTIALIASED
    packed = zlib.compressobj(9, zlib.DEFLATED, 31)
    return packed.compress(bytes(raw)) + packed.flush()
