"""Formats of other programs, from bytes laid out as those programs do."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from plyfile import PlyData, PlyElement

from diga3d_warp.errors import InputError
from diga3d_warp.scene.formats.read import read_splat
from diga3d_warp.scene.formats.recognise import splat_format

DC = 0.28209479177387814


def test_rows_of_a_splat_file(tmp_path):
    row = struct.pack("<6f8B", 1.5, -2.0, 3.25, 0.5, 2.0, 0.0, 255, 0, 51, 204, 128, 0, 128, 128)
    (tmp_path / "a.splat").write_bytes(row + row[:24] + bytes([0, 0, 0, 255, 255, 128, 128, 128]))
    content = read_splat(tmp_path / "a.splat")
    rows = content.rows
    assert content.notes == ["a.splat: 2 gaussians of zero scale are flat"]
    np.testing.assert_array_equal(rows.means, [[1.5, -2.0, 3.25]] * 2)
    np.testing.assert_allclose(np.exp(rows.log_scales[:, :2]), [[0.5, 2.0]] * 2, rtol=1e-6)
    np.testing.assert_allclose(rows.sh[0, 0] * DC + 0.5, [1.0, 0.0, 0.2], atol=1e-6)
    opacities = 1 / (1 + np.exp(-rows.opacity_logits))
    np.testing.assert_allclose(opacities, [0.8, 254.75 / 255], atol=1e-6)
    np.testing.assert_allclose(rows.quaternions, [[0, -1, 0, 0], [127 / 128, 0, 0, 0]])


@pytest.mark.parametrize("colors", [True, False], ids=["color bounds", "no color bounds"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_rows_of_a_compressed_ply(tmp_path, colors, order):
    """Of SuperSplat's first form, without bounds of colours, and of the present one."""
    names = [f"{end}_{each}{axis}" for each in ("", "scale_") for end in ("min", "max") for axis in "xyz"]
    bounds = [-1.0, -2.0, -3.0, 3.0, 2.0, 1.0, -8.0, -8.0, -8.0, 0.0, 0.0, 0.0]
    if colors:
        names += [f"{end}_{channel}" for end in ("min", "max") for channel in "rgb"]
        bounds += [0.0, 0.0, 0.0, 2.0, 2.0, 2.0]
    chunk = np.array([tuple(bounds), tuple(b + 1 for b in bounds)], [(name, "f4") for name in names])
    packed = np.zeros(300, [(f"packed_{name}", "u4") for name in ("position", "rotation", "scale", "color")])
    packed["packed_position"] = (2047 << 21) | (1023 << 11) | 0
    packed["packed_scale"] = (0 << 21) | (1023 << 11) | 2047
    packed["packed_color"] = (255 << 24) | (0 << 16) | (51 << 8) | 204
    identity = sum(511 << shift for shift in (20, 10, 0))  # nearest to zero: 511 / 1023 - 0.5
    packed["packed_rotation"] = [identity | (k % 4) << 30 for k in range(300)]
    sh = np.full(300, 128, [(f"f_rest_{k}", "u1") for k in range(9)])
    sh["f_rest_1"] = 255
    sh["f_rest_3"] = 0
    elements = [PlyElement.describe(sh, "sh"), PlyElement.describe(packed, "vertex")]
    PlyData([*elements, PlyElement.describe(chunk, "chunk")], byte_order=order).write(tmp_path / "a.ply")
    assert splat_format(tmp_path / "a.ply") == "compressed-ply"
    rows = read_splat(tmp_path / "a.ply").rows
    assert len(rows) == 300
    np.testing.assert_allclose(rows.means[[0, 255, 256]], [[3, 2, -3], [3, 2, -3], [4, 3, -2]])
    np.testing.assert_allclose(rows.log_scales[[0, 256]], [[-8, 0, 0], [-7, 1, 1]], atol=1e-6)
    np.testing.assert_allclose(np.abs(rows.quaternions[:4]), np.eye(4), atol=1e-3)
    span = 2.0 if colors else 1.0
    np.testing.assert_allclose(rows.sh[0, 0] * DC + 0.5, [span, 0.0, 0.2 * span], atol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-rows.opacity_logits[0])), 0.8, atol=1e-6)
    np.testing.assert_allclose(rows.sh[0, 1:, 0], [1 / 64, 4.0, 1 / 64], atol=1e-6)
    np.testing.assert_allclose(rows.sh[0, 1:, 1], [-4.0, 1 / 64, 1 / 64], atol=1e-6)


def ksplat(level: int, degree: int, sections: int = 2, partial: bool = True) -> tuple[bytes, dict]:
    """A .ksplat as GaussianSplats3D lays it out, and the parameters in it."""
    generator = np.random.default_rng(level)
    header = bytearray(4096)
    per, coefficients = 10, (0, 9, 24, 45)[degree]
    struct.pack_into("<BBxxIIII", header, 0, 0, 1, sections, sections, per * sections, per * sections)
    struct.pack_into("<H", header, 20, level)
    struct.pack_into("<2f", header, 36, -2.0, 2.0)
    heads, bodies, truth = b"", b"", {name: [] for name in ("mean", "scale", "rotation", "color", "rest")}
    for _ in range(sections):
        buckets = generator.normal(size=(4, 3)).astype("<f4") * 10
        lengths = (3, 1) if partial else ()  # two full buckets of three, two that are not full
        member = np.repeat(np.arange(4), [3, 3, 3, 1])
        head = bytearray(1024)
        counts = (4, 5.0, 12, 32767, 0, 2, 2) if level else (0, 0.0, 0, 1, 0, 0, 0)
        struct.pack_into("<4IfHxxIIIIH", head, 0, per, per, 3, *counts, degree)
        heads += bytes(head)
        rotation = generator.normal(size=(per, 4))
        rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
        scale, color = generator.random((per, 3)) + 0.1, generator.integers(1, 255, (per, 4))
        rest = generator.uniform(-1, 1, (per, coefficients))
        if level:
            stored = generator.integers(0, 65535, (per, 3))
            mean = (stored - 32767.0) * (2.5 / 32767) + buckets[member]
            bodies += struct.pack("<2I", *lengths) + buckets.tobytes()
        else:
            stored = mean = generator.normal(size=(per, 3)).astype("<f4")
        kind = "<f2" if level else "<f4"
        packed = np.rint((rest + 2) / 4 * 255).astype("u1") if level == 2 else rest.astype(kind)
        for k in range(per):
            bodies += stored[k].astype("<u2" if level else "<f4").tobytes() + scale[k].astype(kind).tobytes()
            bodies += rotation[k].astype(kind).tobytes() + color[k].astype("u1").tobytes()
            bodies += packed[k].tobytes()
        for name, values in zip(truth, (mean, scale, rotation, color, rest), strict=True):
            truth[name].append(values)
    return bytes(header) + heads + bodies, {name: np.concatenate(v) for name, v in truth.items()}


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_rows_of_a_ksplat(tmp_path, level, degree):
    data, truth = ksplat(level, degree)
    (tmp_path / "a.ksplat").write_bytes(data)
    content = read_splat(tmp_path / "a.ksplat")
    rows = content.rows
    assert content.notes == []
    np.testing.assert_allclose(rows.means, truth["mean"], atol=1e-5)
    np.testing.assert_allclose(np.exp(rows.log_scales), truth["scale"], rtol=1e-6 if level == 0 else 1e-3)
    np.testing.assert_allclose(rows.quaternions, truth["rotation"], atol=1e-6 if level == 0 else 1e-3)
    np.testing.assert_allclose((rows.sh[:, 0] * DC + 0.5) * 255, truth["color"][:, :3], atol=1e-3)
    opacities = 255 / (1 + np.exp(-rows.opacity_logits))
    np.testing.assert_allclose(opacities, truth["color"][:, 3], atol=1e-3)
    # Bands one after another, each red, then green, then blue.
    bands = np.split(truth["rest"], [9, 24], axis=1)[:degree] if degree else []
    rest = [band.reshape(len(rows), 3, -1).transpose(0, 2, 1) for band in bands]
    expected = np.concatenate(rest, axis=1) if rest else np.zeros((len(rows), 0, 3))
    np.testing.assert_allclose(rows.sh[:, 1:], expected, atol=(1e-6, 1e-3, 1e-2)[level])


def damaged_ksplat(change) -> bytes:
    data = bytearray(ksplat(1, 1)[0])
    change(data)
    return bytes(data)


def put(kind: str, at: int, value: int):
    return lambda data: struct.pack_into(kind, data, at, value)


SECTION = 4096

DAMAGED = {
    "empty.ksplat": (b"", "cut short or damaged"),
    "text.ksplat": (b"hello" * 2000, "cut short or damaged"),
    "cut.ksplat": (ksplat(1, 1)[0][:-1], "cut short or damaged"),
    "sections.ksplat": (damaged_ksplat(put("<I", 4, 2**32 - 1)), "cut short or damaged"),
    "most.ksplat": (damaged_ksplat(put("<I", SECTION + 4, 2**32 - 1)), "cut short or damaged"),
    "splats.ksplat": (damaged_ksplat(put("<I", SECTION, 2**32 - 1)), "cut short or damaged"),
    "level.ksplat": (damaged_ksplat(put("<H", 20, 9)), "cut short or damaged"),
    "degree.ksplat": (damaged_ksplat(put("<H", SECTION + 40, 9)), "cut short or damaged"),
    "buckets.ksplat": (damaged_ksplat(put("<I", SECTION + 12, 2**32 - 1)), "cut short or damaged"),
    "full.ksplat": (damaged_ksplat(put("<I", SECTION + 32, 4)), "do not hold its gaussians"),
    "lengths.ksplat": (damaged_ksplat(put("<I", 4096 + 2048, 0)), "do not hold its gaussians"),
    "empty.splat": (b"", "holds no gaussians, it has 0 rows"),
    "cut.splat": (bytes(33), "33 bytes are no whole rows of 32"),
    "text.splat": (b"hello world, " * 32, "gaussian"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_files_are_one_line(tmp_path, name):
    data, said = DAMAGED[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_splat(tmp_path / name)
    line = str(caught.value)
    assert line.startswith(f"{tmp_path / name}: ") and said in line and "\n" not in line


def compressed(tmp_path, **counts):
    sizes = {"chunk": 1, "vertex": 5, "sh": 5, **counts}
    names = [f"{end}_{each}{axis}" for each in ("", "scale_") for end in ("min", "max") for axis in "xyz"]
    tables = {
        "chunk": np.zeros(sizes["chunk"], [(name, "f4") for name in names]),
        "vertex": np.zeros(
            sizes["vertex"], [(f"packed_{n}", "u4") for n in ("position", "rotation", "scale", "color")]
        ),
        "sh": np.zeros(sizes["sh"], [(f"f_rest_{k}", "u1") for k in range(9)]),
    }
    PlyData([PlyElement.describe(table, name) for name, table in tables.items()]).write(tmp_path / "a.ply")
    return tmp_path / "a.ply"


@pytest.mark.parametrize(
    ("counts", "said"),
    [
        ({"chunk": 0}, "0 chunks are too few for 5 gaussians"),
        ({"vertex": 300, "sh": 300}, "1 chunks are too few for 300 gaussians"),
        ({"sh": 4}, "has 4 rows of 9 coefficients, which fit no degree of 5 gaussians"),
        ({"vertex": 0, "sh": 0}, "0 rows"),
    ],
)
def test_damaged_compressed_plys_are_one_line(tmp_path, counts, said):
    path = compressed(tmp_path, **counts)
    with pytest.raises(InputError) as caught:
        read_splat(path)
    assert str(caught.value).startswith(f"{path}: ") and said in str(caught.value)


def test_a_cut_compressed_ply_is_one_line(tmp_path):
    path = compressed(tmp_path)
    whole = path.read_bytes()
    end = whole.index(b"end_header\n") + 11
    for length in range(end, len(whole), 13):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match="cut short or damaged"):
            read_splat(path)
