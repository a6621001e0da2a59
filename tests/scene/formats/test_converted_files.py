"""Damaged and foreign .spz and .sog files: one line, whatever the library that converts them does."""

from __future__ import annotations

import io
import json
import struct
import subprocess
import zipfile
import zlib

import pytest

from diga3d_warp.errors import InputError
from diga3d_warp.scene.formats import conversion
from diga3d_warp.scene.formats.read import read_splat
from diga3d_warp.scene.formats.write import write_splat
from scenes import random_gaussians

pytest.importorskip("gsply")
pytest.importorskip("gaussforge")


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, bytes]:
    """A whole file of each format."""
    folder = tmp_path_factory.mktemp("whole")
    rows = random_gaussians(120, seed=2, degree=0).rows()
    for form in ("spz", "sog"):
        write_splat(folder / f"whole.{form}", rows, form)
    return {form: (folder / f"whole.{form}").read_bytes() for form in ("spz", "sog")}


def refused(path, data: bytes, said: str = "export") -> None:
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_splat(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ") and said in line and "\n" not in line


def spz(change) -> bytes:
    """An .spz with its header changed."""

    def of(whole: bytes) -> bytes:
        raw = bytearray(zlib.decompress(whole, 31))
        change(raw)
        packed = zlib.compressobj(9, zlib.DEFLATED, 31)
        return packed.compress(bytes(raw)) + packed.flush()

    return of


DAMAGED_SPZ = {
    "empty": (lambda whole: b"", "cut short or damaged, or no .spz"),
    "text": (lambda whole: b"hello" * 99, "cut short or damaged, or no .spz"),
    "half": (lambda whole: whole[: len(whole) // 2], "cut short or damaged"),
    "last byte": (lambda whole: whole[:-12], "cut short or damaged"),
    "not gzip": (lambda whole: b"\x1f\x8b" + whole[9:], "cut short or damaged"),
    "magic": (spz(lambda raw: raw.__setitem__(0, 7)), "or no .spz"),
    "version": (spz(lambda raw: struct.pack_into("<I", raw, 4, 9)), "version 9 of .spz is not known"),
    "huge count": (spz(lambda raw: struct.pack_into("<I", raw, 8, 2**32 - 1)), "too small for 4294967295"),
    "more than there are": (spz(lambda raw: struct.pack_into("<I", raw, 8, 130)), "cut short or damaged"),
    "no gaussians": (spz(lambda raw: struct.pack_into("<I", raw, 8, 0)), "holds no gaussians"),
    "version 4, huge": (
        lambda whole: struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 2**32 - 1, 0, 12, 0, 5, 32),
        "4294967295 gaussians need",
    ),
    "version 4, cut": (
        lambda whole: struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 100, 0, 12, 0, 5, 32),
        "cut short or damaged",
    ),
}


@pytest.mark.parametrize("case", DAMAGED_SPZ)
def test_damaged_spz(tmp_path, files, case):
    damage, said = DAMAGED_SPZ[case]
    refused(tmp_path / "a.spz", damage(files["spz"]), said)


def sog(change):
    """A .sog with its meta.json or its images changed."""

    def of(whole: bytes) -> bytes:
        output = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(whole)) as source, zipfile.ZipFile(output, "w") as target:
            entries = {entry.filename: source.read(entry) for entry in source.infolist()}
            meta = json.loads(entries["meta.json"])
            changed = change(meta, entries)
            entries["meta.json"] = json.dumps(meta if changed is None else changed).encode()
            for name, content in entries.items():
                target.writestr(name, content)
        return output.getvalue()

    return of


def without(name: str):
    def change(meta, entries):
        del entries[name]

    return change


def cut_image(meta, entries):
    entries["quats.webp"] = entries["quats.webp"][: len(entries["quats.webp"]) // 2]


def noise_image(meta, entries):
    whole = entries["scales.webp"]
    entries["scales.webp"] = whole[:30] + bytes(range(256)) * 3 + whole[60:]


DAMAGED_SOG = {
    "empty": (lambda whole: b"", "no .sog file"),
    "text": (lambda whole: b"hello" * 99, "no .sog file"),
    "half": (lambda whole: whole[: len(whole) // 2], "no .sog file"),
    "no meta.json": (lambda whole: whole.replace(b"meta.json", b"meta.jso_"), "no .sog file"),
    "missing image": (sog(without("scales.webp")), "no .sog file"),
    "foreign meta": (sog(lambda meta, entries: [1, 2]), "no .sog file"),
    "version 1": (sog(lambda meta, entries: meta.pop("version") and None), "version 1 of .sog is not known"),
    "huge count": (sog(lambda meta, entries: meta.update(count=10**12)), "for 1000000000000 gaussians"),
    "count is text": (sog(lambda meta, entries: meta.update(count="many")), "its count is no number"),
    "no means": (sog(lambda meta, entries: meta.pop("means") and None), "no .sog file"),
    "files is a number": (sog(lambda meta, entries: meta["sh0"].update(files=3)), "no .sog file"),
    "short codebook": (
        sog(lambda meta, entries: meta["scales"].update(codebook=[1.0])),
        "the codebook of scales",
    ),
    "cut image": (sog(cut_image), "export it again"),
    "noise in an image": (sog(noise_image), None),
}


@pytest.mark.parametrize("case", DAMAGED_SOG)
def test_damaged_sog(tmp_path, files, case):
    """Where damage leaves a file that can be read, it is read; nothing else than one line may come of it."""
    damage, said = DAMAGED_SOG[case]
    path = tmp_path / "a.sog"
    if said is not None:
        refused(path, damage(files["sog"]), said)
        return
    path.write_bytes(damage(files["sog"]))
    try:
        read_splat(path)
    except InputError as error:
        assert "\n" not in str(error)


def test_a_crash_of_the_library_is_one_line(tmp_path, files, monkeypatch):
    def crash(*arguments, **options):
        return subprocess.CompletedProcess(arguments, -11, b"", b"")

    monkeypatch.setattr(conversion.subprocess, "run", crash)
    refused(tmp_path / "a.spz", files["spz"], "cut short or damaged; export it again")


def test_a_library_that_hangs_is_one_line(tmp_path, files, monkeypatch):
    def hang(command, timeout, **options):
        raise subprocess.TimeoutExpired(command, timeout)

    monkeypatch.setattr(conversion.subprocess, "run", hang)
    refused(tmp_path / "a.spz", files["spz"], "cannot be converted within 60 s")


def test_a_splat_larger_than_memory_is_one_line(tmp_path, files, monkeypatch):
    class Memory:
        available = 100_000

    monkeypatch.setattr("diga3d_warp.scene.formats.read.psutil.virtual_memory", Memory)
    refused(tmp_path / "a.spz", files["spz"], "120 gaussians need 0.0 GiB of memory, and only")
