"""Scene: a capture in memory, with calibrated views, masks and sparse points."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch

from diga3d_warp.scene.camera import Camera
from diga3d_warp.scene.extent import middle_and_extent


@dataclass(frozen=True, eq=False)
class View:
    """One photograph with its camera.

    Attributes:
        name: File name of the image without folder and ending; unique within a scene.
        camera: Camera at the size of the image.
        pixels: The photograph, over `images.BACKGROUND` where it is transparent, shape (H, W, 3), uint8 RGB.
            Kept in 8 bits: 71 views of 720 x 1280 take 0.2 GB so, and 0.8 GB as floats.
        mask: The user's object mask, shape (H, W), bool; None if this view has none. Masks that a run derives
            from it have names of their own (`pipelines.clearing.Masks`).
        alpha: Opacity of the photograph, shape (H, W), uint8; None where it is opaque everywhere.
        orientation: EXIF orientation by which viewers turn `pixels`; 1 if they show them as they are here.
    """

    name: str
    camera: Camera
    pixels: np.ndarray
    mask: np.ndarray | None = None
    alpha: np.ndarray | None = None
    orientation: int = 1

    @property
    def image(self) -> torch.Tensor:
        """The photograph as float32 RGB in [0, 1], shape (H, W, 3), made anew at each call."""
        return torch.from_numpy(self.pixels).to(torch.float32) / 255.0

    @property
    def opacity(self) -> np.ndarray:
        """`alpha`, or 255 everywhere, shape (H, W), uint8."""
        return np.full(self.pixels.shape[:2], 255, np.uint8) if self.alpha is None else self.alpha

    def with_mask(self, mask: np.ndarray | None) -> View:
        """The same view with another mask, shape (H, W), bool."""
        return replace(self, mask=mask)


@dataclass(frozen=True, eq=False)
class Points:
    """Sparse points of a reconstruction.

    Attributes:
        positions: World space [scene units], shape (P, 3), float64.
        colors: RGB, shape (P, 3), uint8.
        tracks: Names of the images that each point was found in; empty where that is not known.
    """

    positions: np.ndarray
    colors: np.ndarray
    tracks: Sequence[frozenset[str]] = ()

    def __len__(self) -> int:
        return len(self.positions)

    def without(self, images: Set[str]) -> Points:
        """The points that two images or more show that are not among these; needs `tracks`."""
        keep = np.array([len(track - images) >= 2 for track in self.tracks], bool)
        tracks = [track for track, kept in zip(self.tracks, keep, strict=True) if kept]
        return Points(self.positions[keep], self.colors[keep], tracks)


@dataclass(frozen=True)
class Reading:
    """How a capture was read: arguments of `load_scene`, which a run keeps for later commands.

    Attributes:
        image_scale: Size of the views, relative to the largest images of the capture.
        masks: Folder of the masks, if it was given.
        hold_out: Every such view is held out; 0 for none.
        mask_ids: Numbers of the objects that the masks are read for; all if empty.
    """

    image_scale: float = 1.0
    masks: Path | None = None
    hold_out: int = 8
    mask_ids: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Scene:
    """A capture, ready to fit.

    Attributes:
        path: Folder or file that was read.
        kind: The layout that was recognised: "colmap", "nerfstudio", "llff", "splat" or "images".
        views: Training views.
        test_views: Views held out for testing; never fitted.
        points: Sparse points, world space.
        notes: Assumptions and omissions of the reader, one line each: missing images, repaired masks.
        splat: The splat .ply that the scene came with, if it came with one.
        ground_truth: True if `test_views` show the scene without the object, as those of SPIn-NeRF, 360-USID
            and Inpaint360GS.
        reading: The arguments of `load_scene`.
        mask_problem: Why the masks found are not used; None if they are.
        may_be_seen: Whether `splat` may have been trained on `test_views`: it came without its own split.
    """

    path: Path
    kind: str
    views: Sequence[View]
    test_views: Sequence[View]
    points: Points
    notes: Sequence[str] = field(default_factory=tuple)
    splat: Path | None = None
    ground_truth: bool = False
    reading: Reading = Reading()
    mask_problem: str | None = None
    may_be_seen: bool = False

    @property
    def extent(self) -> float:
        """Size of the capture [scene units]: 1.1 times the radius of its camera centres, as in 3DGS
        (`getNerfppNorm`), without cameras far from all others; see `extent.middle_and_extent`.

        The unit of position learning rates, of the near plane and of working units.
        """
        return middle_and_extent(self.centers, self.points.positions)[1]

    @property
    def centers(self) -> np.ndarray:
        """Camera centres of the training views [scene units], shape (V, 3), float64."""
        return np.stack([view.camera.center for view in self.views])

    def with_cameras(self, change: Callable[[Camera], Camera]) -> Scene:
        """The same scene with `change` applied to the camera of every view."""

        def changed(view: View) -> View:
            return replace(view, camera=change(view.camera))

        return replace(self, views=[*map(changed, self.views)], test_views=[*map(changed, self.test_views)])

    def without_lens(self) -> Scene:
        """The same scene with pinhole cameras of the same intrinsics."""
        return self.with_cameras(Camera.without_lens)

    def with_alpha(self, known: bool) -> Scene:
        """The same scene with an alpha in every view, or in none, as if all were opaque."""

        def spelled(view: View) -> View:
            return replace(view, alpha=view.opacity if known else None)

        return replace(self, views=[*map(spelled, self.views)], test_views=[*map(spelled, self.test_views)])

    def with_masks(self, masks: Sequence[np.ndarray | None]) -> Scene:
        """The same scene with one mask per training view, in their order."""
        return replace(self, views=[v.with_mask(m) for v, m in zip(self.views, masks, strict=True)])
