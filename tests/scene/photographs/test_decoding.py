"""Image files: sizes checked before decoding, formats named, every kind of pixel read, memory bounded."""

from __future__ import annotations

import io
import struct
import threading
import zlib
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import psutil
import pytest
from PIL import Image, ImageOps

from diga3d_warp.errors import InputError
from diga3d_warp.scene.photographs import decoding, images
from diga3d_warp.scene.photographs.decoding import LIMITS, decode, read_header, turned
from diga3d_warp.scene.photographs.images import (
    Photograph,
    Wanted,
    read_image,
    read_photograph,
    read_photographs,
)

COLORS = cv2.resize(
    np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8),
    (48, 36),
    interpolation=cv2.INTER_CUBIC,
)


def png_that_announces(width: int, height: int) -> bytes:
    """A PNG of a few bytes whose rows are missing."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    rows = zlib.compress(bytes(1000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def encoded(kind: str, image: Image.Image | None = None, **options) -> bytes:
    buffer = io.BytesIO()
    (image or Image.fromarray(COLORS)).save(buffer, format=kind, **options)
    return buffer.getvalue()


def test_a_decompression_bomb_is_refused_by_its_header(tmp_path, monkeypatch):
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
    path = tmp_path / "bomb.png"
    path.write_bytes(png_that_announces(30000, 30000))
    for read in (read_photograph, read_image, lambda path: decode(path.read_bytes(), path)):
        with pytest.raises(InputError, match=r"bomb\.png: 30000 x 30000 px; images of more than 250 million"):
            read(path)
    (refused,) = read_photographs([Wanted(path)], False)
    assert isinstance(refused, InputError)


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF", "WEBP", "BMP", "GIF", "JPEG2000", "AVIF", "PPM"])
def test_the_size_is_read_from_the_header(kind):
    assert read_header(encoded(kind))[:2] == (48, 36)


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF", "WEBP"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation(kind, orientation):
    """Stored pixels, turned, are what a viewer shows."""
    image = Image.fromarray(COLORS)
    exif = image.getexif()
    exif[0x0112] = orientation
    data = encoded(kind, image, exif=exif, **({"quality": 95} if kind == "JPEG" else {"lossless": True}))
    swapped = kind == "TIFF" and orientation >= 5
    assert read_header(data)[:2] == ((36, 48) if swapped else (48, 36))
    assert read_header(data).orientation == (1 if kind == "TIFF" else orientation)
    with Image.open(io.BytesIO(data)) as stored:
        shown = np.asarray(ImageOps.exif_transpose(stored).convert("RGB")).astype(float)
    upright = turned(decode(data, "x"), read_header(data).orientation)[..., ::-1]
    assert upright.shape == shown.shape and np.abs(upright - shown).mean() < 2.0


@pytest.mark.parametrize("orientation", [0, 9, 65535])
def test_an_orientation_that_is_none(orientation):
    image = Image.fromarray(COLORS)
    exif = image.getexif()
    exif[0x0112] = orientation
    assert read_header(encoded("JPEG", image, exif=exif)).orientation == 1
    assert read_header(encoded("PNG", image, exif=exif)).orientation == 1


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"\0\0\0\x18ftypheic\0\0\0\0mif1heic", "the file is HEIC, which is not read; convert it to .jpg"),
        (b"\x76\x2f\x31\x01\2\0\0\0", "the file is OpenEXR"),
        (b"\0\0\0\x18ftypmp42", "the file is video, which is not read; cut it into frames"),
        (b"version https://git-lfs.github.com/spec/v1\n", "a pointer of Git LFS, not the image"),
        (b"<!DOCTYPE html><html>", "the file is a web page, not the image"),
        (b"#?RADIANCE\n", "the file is Radiance HDR"),
        (b"hello", "not readable as an image; copy it again"),
        (b"", "not readable as an image; copy it again"),
        (b"BM" + bytes(3), "not readable as an image; copy it again"),
        (b"II*\0" + b"\xff" * 40, "not readable as an image; copy it again"),
    ],
)
def test_what_is_no_image_is_named(tmp_path, data, said):
    (tmp_path / "a.jpg").write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_photograph(tmp_path / "a.jpg")
    assert said in str(caught.value) and "\n" not in str(caught.value)


def stored_forms() -> dict[str, bytes]:
    picture = Image.fromarray(COLORS)

    def of_opencv(array: np.ndarray) -> bytes:
        return cv2.imencode(".tif", array[..., ::-1])[1].tobytes()

    return {
        "CMYK JPEG": encoded("JPEG", picture.convert("CMYK"), quality=98, subsampling=0),
        "CMYK TIFF": encoded("TIFF", picture.convert("CMYK")),
        "palette PNG": encoded("PNG", picture.quantize(256)),
        "GIF": encoded("GIF", picture.quantize(256)),
        "WebP": encoded("WEBP", lossless=True),
        "16-bit PNG": cv2.imencode(".png", COLORS[..., ::-1].astype(np.uint16) * 257)[1].tobytes(),
        "16-bit TIFF": of_opencv(COLORS.astype(np.uint16) * 257),
        "float TIFF": of_opencv((COLORS / 255.0).astype(np.float32)),
        "double TIFF": of_opencv(COLORS / 255.0),
        "progressive JPEG": encoded("JPEG", quality=98, progressive=True, subsampling=0),
    }


@pytest.mark.parametrize("form", stored_forms())
def test_stored_forms(tmp_path, capfd, form):
    path = tmp_path / "a.tif"
    path.write_bytes(stored_forms()[form])
    tolerance = 12.0 if form in ("palette PNG", "GIF") else 2.0
    for pixels in (read_photograph(path).pixels, read_image(path)):
        assert pixels.dtype == np.uint8 and pixels.shape == COLORS.shape
        assert np.abs(pixels.astype(float) - COLORS).mean() < tolerance
    half = read_photograph(path, 0.5).pixels
    assert np.abs(half.astype(float) - images.resize_image(COLORS, 0.5)).mean() < tolerance
    assert capfd.readouterr().err == "", "nothing of OpenCV on the terminal"


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF"])
def test_grey(tmp_path, kind):
    (tmp_path / "a.png").write_bytes(encoded(kind, Image.fromarray(COLORS).convert("L")))
    pixels = read_photograph(tmp_path / "a.png").pixels
    grey = np.asarray(Image.fromarray(COLORS).convert("L")).astype(float)
    assert pixels.shape == COLORS.shape
    assert np.abs(pixels - grey[..., None]).mean() < 2.0


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (COLORS.astype(np.float32), "floats from 0 to 255; map them to"),
        (np.where(COLORS > 100, np.nan, 0.5).astype(np.float32), "floats from nan to nan"),
        (COLORS.astype(np.int32), "the image holds int32 numbers"),
    ],
)
def test_numbers_that_are_no_colours(tmp_path, values, said):
    (tmp_path / "a.tif").write_bytes(cv2.imencode(".tif", values)[1].tobytes())
    with pytest.raises(InputError, match=said):
        read_photograph(tmp_path / "a.tif")


def test_large_photographs_are_decoded_one_at_a_time(tmp_path, monkeypatch):
    """Two small ones at once, a large one alone."""
    lock, now, most = threading.Lock(), 0, 0
    sizes = {"a": (30, 20), "b": (30, 20), "c": (60, 40), "d": (30, 20), "e": (60, 40), "f": (30, 20)}
    for name, size in sizes.items():
        (tmp_path / f"{name}.png").write_bytes(encoded("PNG", Image.new("RGB", size)))

    def read(path, *_) -> Photograph:
        nonlocal now, most
        taken = int(np.prod(sizes[path.stem]))
        with lock:
            now += taken
            most = max(most, now)
        threading.Event().wait(0.02)
        with lock:
            now -= taken
        return Photograph(np.zeros((*sizes[path.stem][::-1], 3), np.uint8))

    monkeypatch.setattr(images, "read_photograph", read)
    monkeypatch.setattr(images, "LIMITS", replace(LIMITS, at_once=1200))
    files = sorted(tmp_path.iterdir())
    found = list(read_photographs([Wanted(file) for file in files], False))
    assert [photograph.pixels.shape[1] for photograph in found] == [sizes[f.stem][0] for f in files]
    assert most == 2400, "the larger one alone, although it is over the bound"


def test_a_large_jpeg_is_decoded_smaller(tmp_path, monkeypatch):
    """The same picture as one that is decoded whole and then shrunk, but for rounding."""
    smooth = cv2.resize(COLORS, (320, 240), interpolation=cv2.INTER_CUBIC)
    path = tmp_path / "a.jpg"
    for size, scale, decoded in (((320, 240), 0.25, 80), ((320, 240), 0.3, 160), ((319, 240), 0.25, 319)):
        path.write_bytes(encoded("JPEG", Image.fromarray(smooth[:, : size[0]]), quality=98))
        whole = read_photograph(path, scale).pixels
        with monkeypatch.context() as patch:
            patch.setattr(decoding, "LIMITS", replace(LIMITS, at_once=1000))
            assert decode(path.read_bytes(), path, scale).shape[1] == decoded
            small = read_photograph(path, scale).pixels
        assert small.shape == whole.shape == (round(240 * scale), round(size[0] * scale), 3)
        assert np.abs(small.astype(float) - whole).mean() < 1.5


def test_photographs_that_do_not_fit_into_memory(tmp_path, monkeypatch):
    (tmp_path / "a.png").write_bytes(encoded("PNG"))
    wanted = [Wanted(tmp_path / "a.png", scale) for scale in (1.0, 0.5)]
    needed = 3 * 48 * 36 * 1.25
    for free, fits in ((needed + 1, True), (needed - 1, False)):
        monkeypatch.setattr(psutil, "virtual_memory", lambda free=free: SimpleNamespace(available=free))
        with nullcontext() if fits else pytest.raises(InputError, match="2 photographs such as"):
            images.check_memory([*wanted, Wanted(tmp_path / "absent.png")] if fits else wanted)


def test_a_folder_in_place_of_a_file(tmp_path):
    (tmp_path / "a.jpg").mkdir()
    with pytest.raises(InputError, match=r"a\.jpg: not readable"):
        read_photograph(tmp_path / "a.jpg")
    assert decoding.LIMITS is LIMITS
