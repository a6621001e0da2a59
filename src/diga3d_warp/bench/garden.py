"""A seeded scene with the statistics of the garden capture, on which kernels are timed.

Gaussians are spread evenly over the image and in the logarithm of depth, needles and flat ones among them.
Their sizes are chosen in the image and follow sqrt(pixels / count), so that another size or number covers the
image as often.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from diga3d_warp.config import TILE
from diga3d_warp.gaussians.parameters import Gaussians
from diga3d_warp.kernels.harmonics import C0
from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.composite import bin_projection
from diga3d_warp.splatting.project import Projection, project

DEGREE = 3
"""Of the harmonics, as in a trained splat."""


@dataclass(frozen=True)
class Garden:
    """Number of gaussians, image size, and the distributions from which gaussians are drawn.

    The defaults reach the figures of the garden capture: a median radius of 10 px at 3 standard deviations,
    and about 390,000 pairs of gaussians and tiles of 16 px.

    Attributes:
        count: Number of gaussians.
        width, height: Image size [px].
        radius: Median of the longest axis at 3 standard deviations [px], at 120,000 gaussians on 648 x 420.
        radius_spread: Standard deviation of the logarithm of that axis.
        flatness: The two shorter axes are shorter by e^-u, u even in [0, this].
        margin: Part of the image's width and height by which gaussians lie beyond each border, where a
            camera sees only some of them.
        nearest, farthest: Ends of the depths [scene units].
        opacity_least, opacity_most: Ends of the opacities.
        seed: Seed of all random numbers.
    """

    count: int = 120_000
    width: int = 648
    height: int = 420
    radius: float = 11.5
    radius_spread: float = 0.3
    flatness: float = 5.0
    margin: float = 0.04
    nearest: float = 2.0
    farthest: float = 20.0
    opacity_least: float = 0.2
    opacity_most: float = 0.95
    seed: int = 0

    @property
    def camera(self) -> Camera:
        """A camera at the origin, its focal length three quarters of the width."""
        focal = 0.75 * self.width
        return Camera(
            self.width, self.height, focal, focal, 0.5 * self.width, 0.5 * self.height,
            torch.eye(4, dtype=torch.float64),
        )  # fmt: skip

    def gaussians(self) -> Gaussians:
        """The gaussians, the same bytes for the same settings."""
        random, count, camera = np.random.default_rng(self.seed), self.count, self.camera
        places = random.uniform(-self.margin, 1.0 + self.margin, (count, 2))
        depths = np.exp(random.uniform(np.log(self.nearest), np.log(self.farthest), count))[:, None]
        rays = (places - 0.5) * [self.width / camera.fx, self.height / camera.fy]
        fineness = np.sqrt(self.width * self.height / self.count / (648 * 420 / 120_000))
        longest = self.radius * fineness * np.exp(self.radius_spread * random.normal(size=(count, 1)))
        axes = longest * np.exp(-random.uniform(0.0, self.flatness, (count, 3)) * [0.0, 1.0, 1.0])
        opacities = random.uniform(self.opacity_least, self.opacity_most, count)
        sh = 0.1 * random.normal(size=(count, (DEGREE + 1) ** 2, 3))
        sh[:, 0] = random.uniform(-0.5, 0.5, (count, 3)) / C0
        return Gaussians(
            means=_single(np.concatenate([rays * depths, depths], axis=1)),
            log_scales=_single(np.log(axes / 3.0 * depths / camera.fx)),
            quaternions=_single(random.normal(size=(count, 4))),
            opacity_logits=_single(np.log(opacities / (1.0 - opacities))),
            sh=_single(sh),
        )


def _single(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(values.astype(np.float32))


@dataclass(frozen=True)
class Statistics:
    """Workload of a rasteriser on a scene.

    Attributes:
        drawn: Gaussians that touch a tile of the image.
        median_radius: Of drawn gaussians' longer axes at 3 standard deviations [px].
        tile_pairs: Pairs of a tile and a gaussian that its box touches.
        listed_pairs: Pairs of a pixel and a gaussian that its tile lists; pixels beyond the image's border
            are not counted.
    """

    drawn: int
    median_radius: float
    tile_pairs: int
    listed_pairs: int


def project_into(gaussians: Gaussians, camera: Camera) -> Projection:
    """The gaussians in the image plane."""
    return project(
        gaussians.means, gaussians.log_scales, gaussians.quaternions, gaussians.opacity_logits, camera
    )


def statistics(projection: Projection, camera: Camera) -> Statistics:
    """Workload of a rasteriser on a projected scene."""
    bins = bin_projection(projection, camera.width, camera.height)
    listed = np.diff(bins.starts.numpy().astype(np.int64)).reshape(bins.rows, bins.columns)
    wide = np.minimum(TILE, camera.width - TILE * np.arange(bins.columns))
    high = np.minimum(TILE, camera.height - TILE * np.arange(bins.rows))
    drawn = projection.visible
    l11, l21, l22 = projection.factors.detach()[drawn].double().unbind(1)
    xx, xy, yy = l11**2, l11 * l21, l21**2 + l22**2
    # The smaller eigenvalue of the inverse covariance is the inverse of the larger variance.
    smaller = 0.5 * (xx + yy) - (0.25 * (xx - yy) ** 2 + xy**2).sqrt()
    return Statistics(
        drawn=int((np.diff(bins.first.numpy()) > 0).sum()),
        median_radius=float(3.0 * smaller.rsqrt().median()),
        tile_pairs=bins.pair_count,
        listed_pairs=int((listed * high[:, None] * wide).sum()),
    )
