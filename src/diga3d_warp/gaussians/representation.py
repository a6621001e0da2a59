"""What a fit and an edit need of a scene, whether it is gaussians or anchors that decode to gaussians."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol, Self

import torch

from diga3d_warp.scene.camera import Camera

if TYPE_CHECKING:
    from diga3d_warp.gaussians.parameters import Gaussians


class Drawn(NamedTuple):
    """The gaussians that one camera is shown.

    Attributes:
        gaussians: M gaussians.
        owners: Row of the representation that each of them belongs to, shape (M,), int64; None if they are
            the rows themselves.
        slots: Number of each among all gaussians that the rows can have, shape (M,), int64; None if they are
            the rows themselves.
    """

    gaussians: Gaussians
    owners: torch.Tensor | None = None
    slots: torch.Tensor | None = None

    def by_row(self, values: torch.Tensor, count: int) -> torch.Tensor:
        """Values of the gaussians (M, ...) summed over those of each row, shape (count, ...)."""
        if self.owners is None:
            return values
        return values.new_zeros(count, *values.shape[1:]).index_add_(0, self.owners, values)

    def of_rows(self, values: torch.Tensor) -> torch.Tensor:
        """Values of the rows (N, ...) for each of the gaussians, shape (M, ...)."""
        return values if self.owners is None else values[self.owners]


class Representation(Protocol):
    """A scene of N rows, each of which is drawn as one gaussian (`Gaussians`) or as several (`Scaffold`).

    Masks are lifted to rows, and edits delete, hold, recolour and add rows.
    """

    @property
    def means(self) -> torch.Tensor:
        """Position of each row [scene units], shape (N, 3)."""

    @property
    def opacities(self) -> torch.Tensor:
        """Opacity of each row in [0, 1], of anchors that of their most opaque gaussian, shape (N,)."""

    @property
    def scales(self) -> torch.Tensor:
        """Standard deviations of each row [scene units], shape (N, 3)."""

    @property
    def coefficients(self) -> int:
        """Spherical harmonics of the gaussians that are drawn."""

    @property
    def slots(self) -> int:
        """Gaussians that a row can have."""

    def __len__(self) -> int: ...

    def named(self) -> Iterator[tuple[str, torch.Tensor]]:
        """Parameter names and tensors."""

    def drawn_in(self, camera: Camera) -> Drawn:
        """The gaussians that a camera is shown, and whose they are; gradients reach all parameters."""

    def seen_from(self, camera: Camera) -> Gaussians:
        """The gaussians that a camera is shown."""

    def select(self, rows: torch.Tensor) -> Self:
        """The rows of a boolean mask (N,) or an index (M,), copied."""

    def joined(self, other: Gaussians) -> Self:
        """These rows followed by those that stand for other gaussians, copied."""

    def detached(self) -> Self:
        """A copy that shares nothing and carries no gradient."""

    def divided(self, taken: torch.Tensor, shown: torch.Tensor) -> Self:
        """The same scene with rows of which some gaussians are taken and others are not as two rows each.

        Args:
            taken: Which gaussians are, shape (N * slots,), bool.
            shown: Which of them count, shape (N * slots,), bool.
        """

    def brightened(self, rows: torch.Tensor, factor: torch.Tensor | float) -> Self:
        """A copy with the colours of some rows multiplied.

        Args:
            rows: Mask of the rows, shape (N,), bool.
            factor: One number, or one for each of the M rows (M,), or for each of their channels (M, 3).
        """

    def plain(self, cameras: Sequence[Camera]) -> Gaussians:
        """As gaussians that look the same from these cameras, as far as harmonics can."""

    def save(self, folder: Path, *, antialiased: bool = False) -> None:
        """Write a file that `storage.load` reads into a folder.

        Args:
            folder: Of a stage.
            antialiased: Whether it was fitted with anti-aliasing.
        """
