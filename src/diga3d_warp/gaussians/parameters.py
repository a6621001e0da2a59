"""Gaussians: the parameters of a splat, as they are optimised and as they are stored."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import torch


@dataclass(eq=False)
class Gaussians:
    """N anisotropic 3D gaussians, in the raw form that optimisers and .ply files hold.

    Attributes:
        means: World positions [scene units], shape (N, 3).
        log_scales: Logarithms of standard deviations along the axes [log scene units], shape (N, 3).
        quaternions: Rotations (w, x, y, z), not necessarily of unit length, shape (N, 4).
        opacity_logits: Opacity is their sigmoid, shape (N,).
        sh: Spherical harmonics, shape (N, K, 3) with K = 1, 4, 9 or 16; colour is max(0, 0.5 + SH).

    All are float32 on one device.
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
    def load_ply(cls, path: Path | str) -> Gaussians:
        """Read a 3DGS .ply; see `gaussians.ply.read_ply`."""
        from diga3d_warp.gaussians.ply import read_ply

        return read_ply(Path(path)).gaussians

    def save_ply(self, path: Path | str) -> None:
        """Write a 3DGS .ply; see `gaussians.ply.write_ply`."""
        from diga3d_warp.gaussians.ply import write_ply

        write_ply(Path(path), self)
