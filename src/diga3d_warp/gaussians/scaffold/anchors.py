"""Scaffold: anchors whose features decode to gaussians for each camera."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from diga3d_warp.files import write_arrays
from diga3d_warp.gaussians.parameters import Gaussians, channel_factors
from diga3d_warp.gaussians.representation import Drawn
from diga3d_warp.gaussians.scaffold.decoder import VIEW, Decoder, Shapes, view_of
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.project import project

ANCHORS = "scaffold.npz"
"""Name of the file of anchors in the folder of a stage."""

REACH_SHARE = 1.0 / 3.0
"""Standard deviation of the gaussian that stands for an anchor in culling [distance of its farthest border]:
its box ends at 3 standard deviations or more."""

BORDER = 3.33
"""Border of a gaussian [standard deviations]: sqrt(2 ln 255), where the most opaque falls below 1/255."""

BY_ROW = ("means", "features", "offsets", "log_spans", "log_sizes", "tints")
"""Parameters with a row for each anchor."""


@dataclass(eq=False)
class Scaffold:
    """N anchors of k gaussians each (Lu et al. 2024), and the networks that decode them.

    Attributes:
        means: Positions of the anchors [scene units], shape (N, 3).
        features: shape (N, F).
        offsets: Positions of the gaussians relative to their anchor [its spans], shape (N, k, 3).
        log_spans: Logarithms of the unit of the offsets [log scene units], shape (N, 3).
        log_sizes: Logarithms of the largest standard deviations that a gaussian of the anchor can have [log
            scene units], shape (N, 3).
        tints: Factors of the decoded colours, shape (N, 3); 1 unless an edit has changed the light.
        parts: Part of the decoder that decodes each anchor, shape (N,), int64.
        closed: Gaussians that an edit has taken out, shape (N, k), bool.
        decoder: The networks.
        reach: Distance that they see as a half, see `view_of` [scene units].
        voxel: Side of the first voxels [scene units].
    """

    means: torch.Tensor
    features: torch.Tensor
    offsets: torch.Tensor
    log_spans: torch.Tensor
    log_sizes: torch.Tensor
    tints: torch.Tensor
    parts: torch.Tensor
    closed: torch.Tensor
    decoder: Decoder
    reach: float
    voxel: float

    coefficients = 1
    """Harmonics of the gaussians that are drawn: their colours are decoded for the camera already."""

    def __len__(self) -> int:
        return len(self.means)

    @property
    def slots(self) -> int:
        """Gaussians k of an anchor."""
        return self.offsets.shape[1]

    def named(self) -> Iterator[tuple[str, torch.Tensor]]:
        """Parameter names and tensors; those of the decoder begin with "decoder."."""
        for name in BY_ROW:
            yield name, getattr(self, name)
        for name, weight in self.decoder.named():
            yield f"decoder.{name}", weight

    def with_parameters(self, named: Mapping[str, torch.Tensor]) -> Scaffold:
        """The same anchors with other parameters, by the names of `named`."""
        weights = {name.removeprefix("decoder."): value for name, value in named.items()}
        rows: dict[str, Any] = {name: named[name] for name in BY_ROW}
        return replace(self, **rows, decoder=Decoder.of(weights))

    @property
    def scales(self) -> torch.Tensor:
        """Standard deviations of usual gaussians of each anchor [scene units], shape (N, 3)."""
        return 0.5 * torch.exp(self.log_sizes)

    @property
    def opacities(self) -> torch.Tensor:
        """Opacity of the most opaque gaussian of each anchor, the mean over views along the axes, (N,)."""
        with torch.no_grad():
            found = torch.zeros(len(self), dtype=self.means.dtype, device=self.means.device)
            for axis in range(3):
                for sign in (-1.0, 1.0):
                    view = self.means.new_zeros(len(self), VIEW)
                    view[:, axis], view[:, 3] = sign, 0.5
                    for part, rows in self._by_part(torch.arange(len(self), device=view.device)):
                        raw = self.decoder.activations(part, self.features[rows], view[rows])
                        raw = torch.where(self.closed[rows], -1.0, raw)
                        found[rows] += torch.tanh(raw.amax(dim=1).clamp(min=0.0)) / 6.0
            return found

    def drawn_in(self, camera: Camera) -> Drawn:
        """The gaussians that a camera may show, and the anchor of each; gradients reach all parameters."""
        rows = self.near(camera)
        pose = camera.world_to_camera
        eye = (-pose[:3, :3].T @ pose[:3, 3]).to(self.means)
        view = view_of(self.means[rows], eye, self.reach)
        decoded, owners, slots = [], [], []
        for part, among in self._by_part(rows):
            anchors = rows[among]
            shapes = self.decoder.decode(part, self.features[anchors], view[among], self.closed[anchors])
            owner = anchors[shapes.slots // self.slots]
            decoded.append(shapes)
            owners.append(owner)
            slots.append(owner * self.slots + shapes.slots % self.slots)
        if not decoded:
            return Drawn(self._nothing(), rows, rows)
        return self._placed(decoded, torch.cat(owners), torch.cat(slots))

    def _placed(self, decoded: Sequence[Shapes], owners: torch.Tensor, slots: torch.Tensor) -> Drawn:
        _, logits, colors, shares, quaternions = (torch.cat(each) for each in zip(*decoded, strict=True))
        offsets = self.offsets.reshape(-1, 3)[slots]
        gaussians = Gaussians(
            means=self.means[owners] + offsets * torch.exp(self.log_spans[owners]),
            log_scales=self.log_sizes[owners] + shares,
            quaternions=quaternions,
            opacity_logits=logits,
            sh=((colors * self.tints[owners] - 0.5) / C0)[:, None],
        )
        return Drawn(gaussians, owners, slots)

    def _nothing(self) -> Gaussians:
        """No gaussian; gradients reach the parameters as zeros."""
        rotations = self.log_sizes.new_zeros(0, 4) * self.tints[:0, :1]
        return Gaussians(
            self.means[:0], self.log_sizes[:0], rotations, self.tints[:0, 0].contiguous(),
            self.tints[:0, None].contiguous(),
        )  # fmt: skip

    def seen_from(self, camera: Camera) -> Gaussians:
        """The gaussians that a camera may show."""
        return self.drawn_in(camera).gaussians

    @torch.no_grad()
    def near(self, camera: Camera) -> torch.Tensor:
        """Anchors that an image may show, shape (M,), int64; those with broken numbers are left out.

        A sphere around each anchor and all its gaussians stands for it, and is culled as a gaussian is. One
        that reaches the plane of the camera has no such image, and is kept.
        """
        if len(self) == 0:
            return torch.zeros(0, dtype=torch.int64, device=self.means.device)
        spans, sizes = torch.exp(self.log_spans), torch.exp(self.log_sizes).amax(dim=1)
        radius = (self.offsets * spans[:, None]).norm(dim=2).amax(dim=1) + BORDER * sizes
        log_scales = torch.log(REACH_SHARE * radius)[:, None].expand(-1, 3)
        quaternions = self.means.new_tensor([1.0, 0.0, 0.0, 0.0]).expand(len(self), 4)
        seen = project(self.means, log_scales, quaternions, self.means.new_full((len(self),), 8.0), camera)
        pose = camera.world_to_camera.to(self.means)
        beside = (self.means @ pose[2, :3] + pose[2, 3]).abs() <= radius
        whole = self.features.isfinite().all(dim=1) & (radius < math.inf)
        return torch.nonzero((seen.visible | beside) & whole)[:, 0]

    def _by_part(self, rows: torch.Tensor) -> Iterator[tuple[int, torch.Tensor]]:
        """For each part of the decoder the places in `rows` (M,) of its anchors, if it has any."""
        of = self.parts[rows]
        for part in range(len(self.decoder)):
            among = torch.nonzero(of == part)[:, 0]
            if len(among):
                yield part, among

    def select(self, rows: torch.Tensor) -> Scaffold:
        """The rows of a boolean mask (N,) or an index (M,), copied; parts that decode none are left out."""
        kept, parts = torch.unique(self.parts[rows], return_inverse=True)
        chosen: dict[str, Any] = {name: getattr(self, name).detach()[rows].clone() for name in BY_ROW}
        closed = self.closed[rows].clone()
        return replace(self, **chosen, parts=parts, closed=closed, decoder=self.decoder.parts(kept))

    def joined(self, other: Gaussians) -> Scaffold:
        """These anchors followed by those that stand for gaussians, which get a part of the decoder."""
        from diga3d_warp.gaussians.scaffold.encode import encoded  # which makes scaffolds itself

        if len(other) == 0:
            return self.detached()
        return self.with_anchors(encoded(other, self.reach, self.slots, self.features.shape[1]))

    def with_anchors(self, added: Scaffold) -> Scaffold:
        """These anchors followed by others, each decoded as before, copied."""
        rows: dict[str, Any] = {
            name: torch.cat([getattr(self, name).detach(), getattr(added, name).detach()]) for name in BY_ROW
        }
        parts = torch.cat([self.parts, added.parts + len(self.decoder)])
        closed = torch.cat([self.closed, added.closed])
        decoder = self.decoder.joined(added.decoder)
        return replace(self, **rows, parts=parts, closed=closed, decoder=decoder)

    def detached(self) -> Scaffold:
        """A copy that shares nothing and carries no gradient."""
        named = {name: tensor.detach().clone() for name, tensor in self.named()}
        whole = self.with_parameters(named)
        return replace(whole, parts=self.parts.clone(), closed=self.closed.clone())

    def parted(self, free: torch.Tensor) -> Scaffold:
        """The same anchors, where some in `free` (N,) decoded by a part of their own that others do not use.

        Fitting these parts changes none of the other anchors.
        """
        parts, decoder = self.parts.clone(), self.decoder
        for part in torch.unique(self.parts[free]).tolist():
            if (~free & (self.parts == part)).any():
                parts[free & (self.parts == part)] = len(decoder)
                decoder = decoder.joined(decoder.parts(torch.tensor([part])))
        return replace(self.detached(), parts=parts, decoder=decoder)

    def divided(self, taken: torch.Tensor, shown: torch.Tensor) -> Scaffold:
        """Anchors of which some gaussians are taken and others are not, as two anchors that share them.

        Nothing looks different. The second anchors, at the end, have the taken gaussians.

        Args:
            taken: Which gaussians are, shape (N * k,), bool.
            shown: Which of them count, shape (N * k,), bool.
        """
        taken, shown = taken.view(-1, self.slots), shown.view(-1, self.slots) & ~self.closed
        mixed = (taken & shown).any(dim=1) & (~taken & shown).any(dim=1)
        whole = self.detached()
        copies = whole.select(mixed)
        whole.closed[mixed] |= taken[mixed]
        copies.closed |= ~taken[mixed]
        rows: dict[str, Any] = {
            name: torch.cat([getattr(whole, name), getattr(copies, name)]) for name in BY_ROW
        }
        parts = torch.cat([whole.parts, whole.parts[mixed]])
        return replace(whole, **rows, parts=parts, closed=torch.cat([whole.closed, copies.closed]))

    def brightened(self, rows: torch.Tensor, factor: torch.Tensor | float) -> Scaffold:
        """A copy with the colours of some anchors multiplied, see `Representation.brightened`."""
        changed = self.detached()
        changed.tints[rows] = changed.tints[rows] * channel_factors(factor).to(self.tints)
        return changed

    def plain(self, cameras: Sequence[Camera]) -> Gaussians:
        """As gaussians that look the same from these cameras, as far as one colour each can."""
        from diga3d_warp.gaussians.scaffold.bake import bake  # which draws scaffolds itself

        return bake(self, cameras, coefficients=1).gaussians

    def save(self, folder: Path, *, antialiased: bool = False) -> None:
        """Write `scaffold.npz` into a folder; see `storage.load_anchors`."""
        named = {name: tensor.detach().cpu().numpy() for name, tensor in self.named()}
        lengths = {"reach": np.array(self.reach), "voxel": np.array(self.voxel)}
        fixed = {name: getattr(self, name).cpu().numpy() for name in ("parts", "closed")}
        write_arrays(folder / ANCHORS, **named, **fixed, **lengths)
