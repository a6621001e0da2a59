"""The .ply file of 3DGS: what SuperSplat, the original viewer and most engines open.

One vertex a gaussian: x y z, nx ny nz (zeros), f_dc_0..2, f_rest_0..44, opacity (logit), scale_0..2 (log),
rot_0..3 (w x y z), all float32, little-endian. f_rest runs over coefficients first and channels second:
15 values of red, then green, then blue.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.config import SPLATTING
from diga3d_warp.errors import InputError
from diga3d_warp.files import whole_file
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.scene.ply import read_vertices

REST = 15
"""Coefficients above degree 0 in a file. The original viewer wants all 15 of degree 3; lower degrees are
filled up with zeros."""


@dataclass(frozen=True, eq=False)
class PlyContent:
    """What a .ply held.

    Attributes:
        gaussians: The readable gaussians.
        notes: What was left out, one line each.
    """

    gaussians: Gaussians
    notes: list[str] = field(default_factory=list)


def write_ply(path: Path, gaussians: Gaussians) -> None:
    """Write gaussians as a standard 3DGS .ply, through a temporary file that is renamed at the end.

    Raises:
        InputError: the folder cannot be written to.
    """
    columns = _column_names(3 * REST)
    columns[3:3] = ["nx", "ny", "nz"]
    count = len(gaussians)
    arrays = {name: tensor.detach().cpu().numpy() for name, tensor in gaussians.named()}
    sh = arrays["sh"]
    rest = np.zeros((count, REST, 3), np.float32)
    rest[:, : sh.shape[1] - 1] = sh[:, 1:]
    blocks = {
        "x": arrays["means"],
        "f_dc_0": sh[:, 0],
        "f_rest_0": rest.transpose(0, 2, 1).reshape(count, 3 * REST),
        "opacity": arrays["opacity_logits"][:, None],
        "scale_0": arrays["log_scales"],
        "rot_0": arrays["quaternions"],
    }
    table = np.zeros((count, len(columns)), "<f4")
    for first, block in blocks.items():
        start = columns.index(first)
        table[:, start : start + block.shape[1]] = block
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    header += [f"property float {name}" for name in columns] + ["end_header", ""]
    with whole_file(path) as partial, partial.open("wb") as file:
        file.write("\n".join(header).encode("ascii"))
        table.tofile(file)


def read_ply(path: Path) -> PlyContent:
    """Read a 3DGS .ply with properties in any order and harmonics of degree 0 to 3.

    Rows that hold NaN or infinity, or a quaternion without direction, are left out and noted: drawn, they
    would spoil the image.

    Raises:
        InputError: the file is missing, truncated, not a .ply of gaussians, or holds none that is usable.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the path of a 3DGS .ply")
    vertices = read_vertices(path)
    names = vertices.dtype.names or ()
    rest_count = sum(name.startswith("f_rest_") for name in names)
    missing = [name for name in _column_names(rest_count) if name not in names]
    if missing:
        hint = " (a compressed .ply: export it uncompressed)" if "packed_position" in names else ""
        raise InputError(f"{path}: holds no gaussians, property {missing[0]} is missing{hint}")
    if rest_count not in (0, 9, 24, 45):
        raise InputError(
            f"{path}: {rest_count} properties f_rest_* fit no degree; 0, 9, 24 or 45 are expected"
        )
    if len(vertices) == 0:
        raise InputError(f"{path}: holds no gaussians, it has 0 rows; export the splat again")

    def block(*columns: str) -> np.ndarray:
        return np.stack([vertices[name] for name in columns], axis=1).astype(np.float32)

    means = block("x", "y", "z")
    scales = block(*(f"scale_{k}" for k in range(3)))
    quaternions = block(*(f"rot_{k}" for k in range(4)))
    opacities = block("opacity")
    dc = block("f_dc_0", "f_dc_1", "f_dc_2")[:, None]
    if rest_count:
        rest = block(*(f"f_rest_{k}" for k in range(rest_count))).reshape(len(means), 3, rest_count // 3)
        sh = np.concatenate([dc, rest.transpose(0, 2, 1)], axis=1)
    else:
        sh = dc

    finite = np.ones(len(means), bool)
    for values in (means, scales, quaternions, opacities, sh.reshape(len(means), -1)):
        finite &= np.isfinite(values).all(axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        directed = (quaternions.astype(np.float64) ** 2).sum(axis=1) >= SPLATTING.quaternion_min
    notes = []
    if not finite.all():
        notes.append(f"{path.name}: left out {int((~finite).sum())} gaussians with NaN or infinite values")
    if not directed[finite].all():
        bad = int((~directed & finite).sum())
        notes.append(f"{path.name}: left out {bad} gaussians whose quaternion is zero")
    keep = finite & directed
    if not keep.any():
        raise InputError(f"{path}: none of its {len(means)} gaussians is usable; export the splat again")
    tensors = [torch.from_numpy(v[keep].copy()) for v in (means, scales, quaternions, opacities[:, 0], sh)]
    return PlyContent(Gaussians(*tensors), notes)


def _column_names(rest_count: int) -> list[str]:
    """Names of the properties that hold parameters, in the standard order."""
    names = ["x", "y", "z", *(f"f_dc_{k}" for k in range(3)), *(f"f_rest_{k}" for k in range(rest_count))]
    return [*names, "opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
