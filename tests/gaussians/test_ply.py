"""The .ply of a splat: exact, readable by others, and refused in one line where it is not usable."""

from __future__ import annotations

from pathlib import Path

import gsply
import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from diga3d_warp.errors import InputError
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.gaussians.ply import read_ply, write_ply
from scenes import random_gaussians

STANDARD = [
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
    *(f"f_rest_{k}" for k in range(45)),
    *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
]
"""The properties that the original viewer expects, in its order."""


def same(a: Gaussians, b: Gaussians) -> None:
    for (name, mine), (_, theirs) in zip(a.named(), b.named(), strict=True):
        assert mine.dtype == theirs.dtype == torch.float32
        torch.testing.assert_close(mine, theirs, rtol=0, atol=0, msg=name)


def vertices(path: Path) -> np.ndarray:
    return np.array(PlyData.read(path)["vertex"].data)


def rewrite(path: Path, rows: np.ndarray, name: str = "vertex", **form) -> None:
    PlyData([PlyElement.describe(rows, name)], **form).write(path)


@pytest.fixture
def splat() -> Gaussians:
    return random_gaussians(50, seed=3)


@pytest.fixture
def file(tmp_path, splat) -> Path:
    write_ply(tmp_path / "splat.ply", splat)
    return tmp_path / "splat.ply"


def test_round_trip_is_exact(file, splat):
    content = read_ply(file)
    same(content.gaussians, splat)
    assert content.notes == []
    assert [entry.name for entry in file.parent.iterdir()] == ["splat.ply"], "no temporary file stays"


def test_the_header_is_that_of_3dgs(file):
    header = file.read_bytes().split(b"end_header\n")[0].decode("ascii").splitlines()
    assert header[:3] == ["ply", "format binary_little_endian 1.0", "element vertex 50"]
    assert header[3:] == [f"property float {name}" for name in STANDARD]
    assert file.stat().st_size == len("\n".join(header)) + len("\nend_header\n") + 50 * 4 * len(STANDARD)


def test_plyfile_reads_the_same_values(file, splat):
    rows = vertices(file)
    assert list(rows.dtype.names) == STANDARD
    columns = {
        "means": rows[["x", "y", "z"]],
        "log_scales": rows[["scale_0", "scale_1", "scale_2"]],
        "quaternions": rows[["rot_0", "rot_1", "rot_2", "rot_3"]],
    }
    for name, values in columns.items():
        np.testing.assert_array_equal(np.array(values.tolist(), np.float32), getattr(splat, name))
    np.testing.assert_array_equal(rows["opacity"], splat.opacity_logits)
    for channel in range(3):
        np.testing.assert_array_equal(rows[f"f_dc_{channel}"], splat.sh[:, 0, channel])
        for k in range(15):
            np.testing.assert_array_equal(rows[f"f_rest_{15 * channel + k}"], splat.sh[:, 1 + k, channel])
    assert not any(rows[name].any() for name in ("nx", "ny", "nz"))


def test_gsply_reads_the_same_values(file, splat):
    data = gsply.plyread(file)
    np.testing.assert_array_equal(data.means, splat.means)
    np.testing.assert_array_equal(data.scales, splat.log_scales)
    np.testing.assert_array_equal(data.quats, splat.quaternions)
    np.testing.assert_array_equal(data.opacities, splat.opacity_logits)
    np.testing.assert_array_equal(data.sh0, splat.sh[:, 0])
    np.testing.assert_array_equal(data.shN, splat.sh[:, 1:])


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_lower_degrees_are_filled_up_with_zeros(tmp_path, degree):
    splat = random_gaussians(20, degree=degree)
    splat.save_ply(tmp_path / "splat.ply")
    rows = vertices(tmp_path / "splat.ply")
    assert list(rows.dtype.names) == STANDARD
    read = Gaussians.load_ply(tmp_path / "splat.ply")
    coefficients = (degree + 1) ** 2
    torch.testing.assert_close(read.sh[:, :coefficients], splat.sh, rtol=0, atol=0)
    assert read.sh.shape == (20, 16, 3)
    assert not read.sh[:, coefficients:].any()


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_files_of_lower_degree_are_read(file, splat, degree):
    rows, per_channel = vertices(file), (degree + 1) ** 2 - 1
    kept = [15 * channel + k for channel in range(3) for k in range(per_channel)]
    others = [name for name in rows.dtype.names if not name.startswith("f_rest_")]
    layout = [(name, "f4") for name in [*others, *(f"f_rest_{k}" for k in range(3 * per_channel))]]
    short = np.zeros(len(rows), layout)
    for name in others:
        short[name] = rows[name]
    for place, k in enumerate(kept):
        short[f"f_rest_{place}"] = rows[f"f_rest_{k}"]
    rewrite(file, short)
    read = Gaussians.load_ply(file)
    torch.testing.assert_close(read.sh, splat.sh[:, : per_channel + 1], rtol=0, atol=0)
    torch.testing.assert_close(read.quaternions, splat.quaternions, rtol=0, atol=0)


@pytest.mark.parametrize(
    "form", [{"text": True}, {"byte_order": ">"}, {"byte_order": "<"}], ids=["ascii", "big", "little"]
)
def test_other_orders_of_properties_and_bytes_are_read(file, splat, form):
    rows = vertices(file)
    names = [name for name in reversed(rows.dtype.names) if not name.startswith("n")]
    shuffled = np.empty(len(rows), [(name, "f8" if name == "opacity" else "f4") for name in names])
    for name in names:
        shuffled[name] = rows[name]
    rewrite(file, shuffled, **form)
    same(Gaussians.load_ply(file), splat)


def test_unusable_rows_are_left_out_with_a_note(file, splat):
    rows = vertices(file).copy()
    rows["x"][3] = np.nan
    rows["f_rest_44"][7] = np.inf
    rows["opacity"][8] = -np.inf
    for k in range(4):
        rows[f"rot_{k}"][[11, 12]] = 0.0
    rewrite(file, rows)
    content = read_ply(file)
    assert content.notes == [
        "splat.ply: left out 3 gaussians with NaN or infinite values",
        "splat.ply: left out 2 gaussians whose quaternion is zero",
    ]
    keep = torch.ones(50, dtype=torch.bool)
    keep[[3, 7, 8, 11, 12]] = False
    same(content.gaussians, splat.select(keep))


def only_nan(path: Path) -> None:
    rows = vertices(path).copy()
    rows["y"] = np.nan
    rewrite(path, rows)


def without(*gone: str):
    def change(path: Path) -> None:
        rows = vertices(path)
        names = [name for name in rows.dtype.names if name not in gone]
        kept = np.empty(len(rows), [(name, "f4") for name in names])
        for name in names:
            kept[name] = rows[name]
        rewrite(path, kept)

    return change


def renamed(path: Path) -> None:
    path.write_bytes(path.read_bytes().replace(b"f_rest_44\n", b"f_rest_45\n"))


def twice(path: Path) -> None:
    path.write_bytes(path.read_bytes().replace(b"property float ny\n", b"property float nx\n"))


def compressed(path: Path) -> None:
    names = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
    rewrite(path, np.zeros(4, [(name, "u4") for name in names]))


def cloud(path: Path) -> None:
    rewrite(path, np.zeros(4, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("red", "u1")]))


BAD_FILES = {
    "missing": (lambda path: path.unlink(), "no such file; give the path of a 3DGS .ply"),
    "folder": (lambda path: (path.unlink(), path.mkdir()), "no such file"),
    "empty": (lambda path: path.write_bytes(b""), "export it again"),
    "text": (lambda path: path.write_text("hello"), "not a .ply file"),
    "half a header": (lambda path: path.write_bytes(path.read_bytes()[:100]), "header is missing"),
    "truncated": (lambda path: path.write_bytes(path.read_bytes()[:-1]), "cut short or damaged"),
    "no rows": (lambda path: random_gaussians(0).save_ply(path), "holds no gaussians, it has 0 rows"),
    "only NaN": (only_nan, "none of its 50 gaussians is usable"),
    "point cloud": (cloud, "holds no gaussians, property f_dc_0 is missing"),
    "compressed": (compressed, "a compressed .ply: export it uncompressed"),
    "faces first": (lambda path: rewrite(path, np.zeros(3, [("x", "f4")]), "face"), "first element"),
    "no rot_3": (without("rot_3"), "property rot_3 is missing"),
    "no z": (without("z"), "property z is missing"),
    "no f_dc_2": (without("f_dc_2"), "property f_dc_2 is missing"),
    "odd harmonics": (without("f_rest_44"), "44 properties f_rest_* fit no degree"),
    "gap in harmonics": (renamed, "property f_rest_44 is missing"),
    "property twice": (twice, "export it again"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_unusable_files_are_one_line(file, case):
    damage, said = BAD_FILES[case]
    damage(file)
    with pytest.raises(InputError) as caught:
        read_ply(file)
    line = str(caught.value)
    assert line.startswith(f"{file}: ") and said in line and "\n" not in line


def test_a_place_that_cannot_be_written_is_one_line(tmp_path, splat):
    (tmp_path / "file").write_text("kept")
    with pytest.raises(InputError, match="cannot be written") as caught:
        splat.save_ply(tmp_path / "file" / "splat.ply")
    assert "\n" not in str(caught.value)
    assert (tmp_path / "file").read_text() == "kept"


def test_a_failed_write_keeps_the_old_file(file, splat, monkeypatch):
    before = file.read_bytes()
    full = OSError(28, "No space left on device")

    def no_space(self, target):
        raise full

    monkeypatch.setattr(Path, "replace", no_space)
    with pytest.raises(InputError, match="no space left on device"):
        splat.select(torch.arange(5)).save_ply(file)
    assert file.read_bytes() == before
    assert [entry.name for entry in file.parent.iterdir()] == ["splat.ply"]
