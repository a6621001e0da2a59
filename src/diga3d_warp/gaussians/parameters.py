"""Gaussians: the parameters of a splat, as they are optimised and as they are stored."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.gaussians.representation import Drawn
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.formats.positions import needs_double
from diga3d_warp.scene.formats.read import read_splat
from diga3d_warp.scene.formats.rows import SplatRows
from diga3d_warp.scene.formats.standard_ply import write_ply

PLY = "point_cloud.ply"
"""Name of the file of gaussians in the folder of a stage."""


def channel_factors(factor: torch.Tensor | float) -> torch.Tensor:
    """Factors of colours, given for all rows, each row or each channel, in a shape that multiplies (M, 3)."""
    factors = torch.as_tensor(factor)
    return factors if factors.ndim == 2 else factors.reshape(-1, 1)


@dataclass(eq=False)
class Gaussians:
    """N anisotropic 3D gaussians, in the raw form that optimisers and .ply files hold.

    Attributes:
        means: World positions [scene units], shape (N, 3).
        log_scales: Logarithms of standard deviations along the axes [log scene units], shape (N, 3).
        quaternions: Rotations (w, x, y, z), not necessarily of unit length, shape (N, 4).
        opacity_logits: Opacity is their sigmoid, shape (N,).
        sh: Spherical harmonics, shape (N, K, 3) with K = 1, 4, 9 or 16; colour is max(0, 0.5 + SH).

    All are float32 on one device; means are float64 where float32 cannot hold them, as in UTM coordinates.
    """

    means: torch.Tensor
    log_scales: torch.Tensor
    quaternions: torch.Tensor
    opacity_logits: torch.Tensor
    sh: torch.Tensor

    def __len__(self) -> int:
        return len(self.means)

    def named(self) -> Iterator[tuple[str, torch.Tensor]]:
        """Parameter names and tensors, in the order of the fields."""
        for entry in fields(self):
            yield entry.name, getattr(self, entry.name)

    @property
    def opacities(self) -> torch.Tensor:
        """Opacities in (0, 1), shape (N,)."""
        return torch.sigmoid(self.opacity_logits)

    @property
    def scales(self) -> torch.Tensor:
        """Standard deviations [scene units], shape (N, 3)."""
        return torch.exp(self.log_scales)

    @property
    def coefficients(self) -> int:
        """Spherical harmonics of each gaussian."""
        return self.sh.shape[1]

    slots = 1
    """Gaussians that a row has."""

    def divided(self, taken: torch.Tensor, shown: torch.Tensor) -> Gaussians:
        """The gaussians themselves: none can be divided."""
        return self

    def drawn_in(self, camera: Camera) -> Drawn:
        """All gaussians: they are the same from every camera."""
        return Drawn(self)

    def seen_from(self, camera: Camera) -> Gaussians:
        """The gaussians themselves."""
        return self

    def select(self, rows: torch.Tensor) -> Gaussians:
        """The rows of a boolean mask (N,) or an index (M,), copied."""
        return Gaussians(*(tensor.detach()[rows].clone() for _, tensor in self.named()))

    def joined(self, other: Gaussians) -> Gaussians:
        """These gaussians followed by others with as many harmonics, copied."""
        return Gaussians(
            *(
                torch.cat([mine.detach(), theirs.detach()])
                for (_, mine), (_, theirs) in zip(self.named(), other.named(), strict=True)
            )
        )

    def brightened(self, rows: torch.Tensor, factor: torch.Tensor | float) -> Gaussians:
        """A copy with the colours of some rows multiplied, see `Representation.brightened`."""
        changed = self.detached()
        scale = channel_factors(factor).to(self.sh)
        # Harmonics are offsets from mid-grey: colour = 0.5 + C0 * first + ...
        sh = changed.sh[rows] * scale[:, None]
        sh[:, 0] += 0.5 * (scale - 1.0) / C0
        changed.sh[rows] = sh
        return changed

    def plain(self, cameras: Sequence[Camera]) -> Gaussians:
        """The gaussians themselves."""
        return self

    def detached(self) -> Gaussians:
        """A copy that shares nothing and carries no gradient."""
        return Gaussians(*(tensor.detach().clone() for _, tensor in self.named()))

    def requires_grad_(self, required: bool = True) -> Gaussians:
        """Mark every parameter as (not) carrying gradient, in place."""
        for _, tensor in self.named():
            tensor.requires_grad_(required)
        return self

    def to(self, device: torch.device | str) -> Gaussians:
        """The same gaussians on another device."""
        return Gaussians(*(tensor.to(device) for _, tensor in self.named()))

    @classmethod
    def from_rows(cls, rows: SplatRows) -> Gaussians:
        """Gaussians of the rows of a splat file, positions rounded to float32 where that holds them."""
        arrays = (getattr(rows, entry.name) for entry in fields(cls))
        means, *others = (torch.from_numpy(np.array(array)) for array in arrays)
        return cls(means, *(tensor.float() for tensor in others)).with_fitting_means()

    def with_fitting_means(self) -> Gaussians:
        """The same gaussians, means in the type of the others unless float32 would move them visibly."""
        rows = self.rows()
        if needs_double(rows.means, rows.log_scales):
            return self
        return replace(self, means=self.means.to(self.sh.dtype))

    def rows(self) -> SplatRows:
        """The rows of a splat file, copied."""
        means, *others = (tensor.detach().cpu().numpy() for _, tensor in self.named())
        return SplatRows(means.astype(np.float64), *(array.astype(np.float32) for array in others))

    @classmethod
    def load_ply(cls, path: Path | str, *, every_row: bool = False) -> Gaussians:
        """Read a splat file; a 3DGS .ply, or another format of `scene.formats`.

        What cannot be drawn is mended or left out with a warning, unless `every_row` asks for all rows just
        as they were written.

        Raises:
            InputError: the file is missing, damaged or holds no gaussian that is usable.
        """
        content = read_splat(Path(path), every_row=every_row)
        for note in content.notes:
            warnings.warn(note, stacklevel=2)
        return cls.from_rows(content.rows)

    def save(self, folder: Path, *, antialiased: bool = False) -> None:
        """Write `point_cloud.ply` into a folder."""
        self.save_ply(folder / PLY, antialiased=antialiased)

    def save_ply(
        self,
        path: Path | str,
        *,
        antialiased: bool = False,
        surround: int = 0,
    ) -> None:
        """Write a 3DGS .ply; see `scene.formats.standard_ply.write_ply`.

        x, y and z are written as double where float32 cannot hold them.
        """
        rows = self.rows()
        double = needs_double(rows.means, rows.log_scales)
        write_ply(
            Path(path), rows, positions="double" if double else "float", antialiased=antialiased,
            surround=surround,
        )  # fmt: skip
