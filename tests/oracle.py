"""A plain renderer in float64 torch, from the formulas of the papers; its gradients are torch's own.

It shares nothing with the kernels: the covariance is inverted in its textbook form, harmonics come from
Legendre polynomials, lenses are differentiated by autograd, and every pixel looks at every gaussian.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.polynomial.legendre import Legendre
from numpy.polynomial.polynomial import Polynomial

from diga3d_warp.scene.camera import Camera
from diga3d_warp.splatting.optics import optics_of

NEAR, LOW_PASS, ANTIALIASED_LOW_PASS, MARGIN = 0.01, 0.3, 0.1, 1.3
ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN = 0.99, 1 / 255, 1e-4
VISIBLE = 1e-5
"""A comparison with a smaller threshold may fall either way: no test looks that closely."""


@dataclass(frozen=True)
class Splats:
    """Projected gaussians: centers (N, 2), depths (N,), covariances (N, 2, 2), opacities (N,), drawn (N,),
    slopes of depth (N, 2)."""

    centers: torch.Tensor
    depths: torch.Tensor
    covariances: torch.Tensor
    opacities: torch.Tensor
    drawn: torch.Tensor
    slopes: torch.Tensor

    @property
    def conics(self) -> torch.Tensor:
        """Inverse covariances (xx, xy, yy), shape (N, 3)."""
        inverse = torch.linalg.inv(self.covariances)
        return torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], -1)

    def meets(self, camera: Camera, slack: float, alpha_min: float = ALPHA_MIN) -> torch.Tensor:
        """Which boxes, wider by `slack` px on each side, hold a pixel centre's row and column, shape (N,)."""
        reach = (2 * torch.log(self.opacities / alpha_min)).clamp_min(0).sqrt()
        half = reach[:, None] * self.covariances.diagonal(dim1=1, dim2=2).sqrt() + slack
        size = self.centers.new_tensor([camera.width, camera.height])
        return ((self.centers + half >= 0.5) & (self.centers - half <= size - 0.5)).all(1)


@dataclass(frozen=True)
class Image:
    """A blended image.

    `certain` (H, W) is False where a comparison was so close that float32 may decide it otherwise. `weights`
    (H, W, N) are those of the gaussians by index. `median_depth` is where transmittance falls below a half.
    """

    color: torch.Tensor
    depth_sum: torch.Tensor
    transmittance: torch.Tensor
    certain: torch.Tensor
    weights: torch.Tensor
    median_depth: torch.Tensor


def conics(factors: torch.Tensor) -> torch.Tensor:
    """Inverse covariances L L^T as (xx, xy, yy) of their Cholesky factors (l11, l21, l22), shape (N, 3)."""
    l11, l21, l22 = factors.unbind(1)
    return torch.stack([l11**2, l11 * l21, l21**2 + l22**2], -1)


def distort(x: torch.Tensor, y: torch.Tensor, camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    """Lens distortion as COLMAP documents it (OPENCV, FULL_OPENCV up to k3, and OPENCV_FISHEYE)."""
    if camera.distortion is None:
        return x, y
    k = camera.distortion.coefficients
    if camera.distortion.kind in ("brown", "brown5"):
        k1, k2, p1, p2, k3 = [*k, 0.0][:5]
        r2 = x**2 + y**2
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
            y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y**2),
        )
    r = (x**2 + y**2).sqrt()
    theta = torch.atan(r)
    bent = theta * (1 + k[0] * theta**2 + k[1] * theta**4 + k[2] * theta**6 + k[3] * theta**8)
    return x * bent / r, y * bent / r


def distort_jacobian(x: torch.Tensor, y: torch.Tensor, camera: Camera) -> torch.Tensor:
    """d distorted / d (x, y), shape (N, 2, 2), by differentiating `distort`."""

    def both(values: torch.Tensor) -> torch.Tensor:
        return torch.stack(distort(values[0], values[1], camera))

    return torch.func.vmap(torch.func.jacrev(both))(torch.stack([x, y], -1))


def field_of_view(camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    """Undistorted (x, y) beyond which the Jacobian is not followed: the image's, widened by the margin."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    target = torch.tensor(
        np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy]).reshape(2, -1)
    )
    point = target.clone()
    for _ in range(200):  # fixed point: enough for the mild lenses of these tests
        point = point + 0.7 * (target - torch.stack(distort(point[0], point[1], camera)))
    low, high = point.min(1).values, point.max(1).values
    margin = (MARGIN - 1) * (high - low) / 2
    return low - margin, high + margin


def rotations(quaternions: torch.Tensor) -> torch.Tensor:
    """Rotation matrices (N, 3, 3) of (w, x, y, z): 1 + 2 w [v] + 2 [v]^2, [v] the cross product's."""
    q = quaternions / quaternions.norm(dim=1, keepdim=True)
    w, x, y, z = q.unbind(1)
    zero = torch.zeros_like(w)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)
    return torch.eye(3, dtype=q.dtype) + 2 * w[:, None, None] * cross + 2 * cross @ cross


def project(
    means, log_scales, quaternions, opacity_logits, pose: torch.Tensor, camera: Camera, *,
    footprint: str = "affine", antialias: bool = False, alpha_min: float = ALPHA_MIN,
) -> Splats:  # fmt: skip
    """Projection with a 4 x 4 `pose` in place of the camera's own."""
    p = means @ pose[:3, :3].T + pose[:3, 3]
    z = p[:, 2]
    opacities = torch.sigmoid(opacity_logits)
    drawn = (z >= NEAR) & (opacities >= alpha_min) & ((quaternions**2).sum(1) >= 1e-8)
    z = torch.where(drawn, z, torch.ones_like(z))
    p = torch.cat([p[:, :2], z[:, None]], 1)
    x, y = p[:, 0] / z, p[:, 1] / z
    low, high = field_of_view(camera)
    xj, yj = x.clamp(low[0], high[0]), y.clamp(low[1], high[1])
    focal = camera.intrinsics[:2]
    lens = distort_jacobian(xj, yj, camera) * focal[:, None]
    zero, one = torch.zeros_like(z), torch.ones_like(z)
    perspective = torch.stack([one, zero, -xj, zero, one, -yj], -1).reshape(-1, 2, 3) / z[:, None, None]
    spread = pose[:3, :3] @ rotations(quaternions) @ torch.diag_embed(log_scales.exp())
    across = lens @ perspective @ spread
    centers = pixels(p, camera)
    covariances = across @ across.mT
    if footprint == "unscented":
        inside = (x == xj) & (y == yj)
        moments = sigma_moments(p, spread, across, camera)
        centers = torch.where(inside[:, None], centers + moments[0], centers)
        covariances = torch.where(inside[:, None, None], moments[1], covariances)
        across = torch.where(inside[:, None, None], moments[2], across)
    sharp = covariances
    covariances = sharp + (ANTIALIASED_LOW_PASS if antialias else LOW_PASS) * torch.eye(2, dtype=p.dtype)
    if antialias:
        opacities = opacities * (torch.linalg.det(sharp) / torch.linalg.det(covariances)).clamp_min(0).sqrt()
        drawn = drawn & (opacities >= alpha_min)
    with_depth = (across @ spread[:, 2, :, None])[..., 0]
    slopes = torch.linalg.solve(covariances, with_depth)
    return Splats(centers, z, covariances, opacities, drawn, slopes)


def rays(means: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
    """(x/z, y/z) of points (N, 3), shape (N, 2)."""
    p = means @ pose[:3, :3].T + pose[:3, 3]
    return p[:, :2] / p[:, 2:]


def pixels(p: torch.Tensor, camera: Camera) -> torch.Tensor:
    """Pixel positions of points in camera space (..., 3)."""
    u, v = distort(p[..., 0] / p[..., 2], p[..., 1] / p[..., 2], camera)
    return torch.stack([u, v], -1) * camera.intrinsics[:2] + camera.intrinsics[2:]


def sigma_moments(p: torch.Tensor, spread: torch.Tensor, across: torch.Tensor, camera: Camera):
    """Shift of the mean (N, 2), covariance (N, 2, 2) and odd parts (N, 2, 3) of the image of gaussians.

    Fits u(t) = u0 + o t / h + e t^2 / 3 to three points on each axis, h = sqrt(3) where they are far enough
    from the camera; for a standard normal t, t has variance 1, t^2 has mean 1 and variance 2. Columns of
    `spread` (N, 3, 3) are the axes in camera space.
    """
    axes = spread.mT
    reach = 0.5 * p[:, None, 2] / axes[..., 2].abs()
    h = reach.clamp_max(math.sqrt(3))[..., None]
    ends = [p[:, None] + sign * h * axes for sign in (1, -1)]
    to_ends = [pixels(end, camera) - pixels(p, camera)[:, None] for end in ends]
    valid = torch.stack([(e[..., :2] / e[..., 2:]).norm(dim=-1) < optics_of(camera).radius_max for e in ends])
    valid = valid.all(0)[..., None]
    odd = torch.where(valid, (to_ends[0] - to_ends[1]) / (2 * h), across.mT)
    even = torch.where(valid, (to_ends[0] + to_ends[1]) / 6, torch.zeros_like(odd))
    return even.sum(1), odd.mT @ odd + 2 * even.mT @ even, odd.mT


def harmonics(directions: torch.Tensor, degree: int) -> torch.Tensor:
    """Real spherical harmonics with the Condon-Shortley phase, shape (N, (degree + 1)^2).

    Y_l^m = K d^m/dz^m P_l(z) Re (x + i y)^m, and Im for m < 0, on unit directions.
    """
    x, y, z = directions.unbind(1)
    values = []
    for band in range(degree + 1):
        for order in range(-band, band + 1):
            m = abs(order)
            polynomial = Legendre.basis(band).convert(kind=Polynomial).deriv(m).coef
            along = sum(float(c) * z**k for k, c in enumerate(polynomial))
            around = torch.complex(x, y) ** m
            scale = math.sqrt(
                (2 * band + 1) / (4 * math.pi) * math.factorial(band - m) / math.factorial(band + m)
            )
            scale *= (-1) ** m * (math.sqrt(2) if m else 1)
            values.append(scale * along * (around.imag if order < 0 else around.real))
    return torch.stack(values, -1)


def shade(means: torch.Tensor, sh: torch.Tensor, pose: torch.Tensor, degree: int) -> torch.Tensor:
    """Colours max(0, 0.5 + SH), shape (N, 3)."""
    eye = -pose[:3, :3].T @ pose[:3, 3]
    directions = torch.nn.functional.normalize(means - eye, dim=1)
    terms = (degree + 1) ** 2
    return (0.5 + torch.einsum("nk,nkc->nc", harmonics(directions, degree), sh[:, :terms])).clamp_min(0)


def composite(
    centers, conics, depths, opacities, colors, drawn, width: int, height: int, *,
    alpha_min: float = ALPHA_MIN, transmittance_min: float = TRANSMITTANCE_MIN, extents=None, slopes=None,
) -> Image:  # fmt: skip
    """Blend all gaussians in every pixel, nearest first, with the cut-offs of 3DGS.

    Gaussians end at the borders of their boxes if half widths and heights, `extents` (N, 2), are given. With
    `slopes` (N, 2), the change of depth per pixel, each pixel has an order of its own.
    """
    columns = torch.arange(width, dtype=torch.float64) + 0.5
    rows = torch.arange(height, dtype=torch.float64) + 0.5
    dx = centers[:, 0] - columns.expand(height, width)[..., None]
    dy = centers[:, 1] - rows[:, None].expand(height, width)[..., None]
    xx, xy, yy = conics.unbind(1)
    raw = opacities * torch.exp(-0.5 * (xx * dx**2 + yy * dy**2) - xy * dx * dy)
    raw = torch.where(drawn, raw, 0.0)
    if extents is not None:
        raw = torch.where((dx.abs() <= extents[:, 0]) & (dy.abs() <= extents[:, 1]), raw, 0.0)
    alpha = raw.clamp_max(ALPHA_MAX)
    alpha = torch.where(alpha < alpha_min, 0.0, alpha)

    near = torch.argsort(depths, stable=True)
    z = depths.expand(height, width, -1).detach()
    if slopes is not None:
        z = z - slopes[:, 0] * dx.detach() - slopes[:, 1] * dy.detach()
    order = near[torch.argsort(z[..., near], dim=-1, stable=True)]
    alpha = alpha.gather(-1, order)
    after = torch.cumprod(1 - alpha, -1)
    alpha = torch.where(after < transmittance_min, 0.0, alpha)
    after_drawn = torch.cumprod(1 - alpha, -1)
    before = torch.cat([torch.ones_like(after_drawn[..., :1]), after_drawn], -1)
    weights = torch.zeros_like(alpha).scatter(-1, order, alpha * before[..., :-1])
    falls = (before[..., :-1] >= 0.5) & (before[..., 1:] < 0.5)
    median_depth = (falls * depths[order]).sum(-1)

    close = ((raw / ALPHA_MAX - 1).abs() < 1e-4).any(-1)
    close |= ((after / 0.5 - 1).abs() < 1e-4).any(-1)
    if alpha_min > VISIBLE:
        close |= ((raw / alpha_min - 1).abs() < 1e-3).any(-1)
    if transmittance_min > VISIBLE:
        close |= ((after / transmittance_min - 1).abs() < 1e-2).any(-1)
    if extents is not None:
        close |= (((dx.abs() - extents[:, 0]).abs() < 1e-4) | ((dy.abs() - extents[:, 1]).abs() < 1e-4)).any(
            -1
        )
    if slopes is not None:
        drawn_z = torch.where(alpha > 0, z.gather(-1, order), torch.inf).sort(-1).values
        close |= ((drawn_z[..., 1:] - drawn_z[..., :-1]) < 1e-5 * drawn_z[..., :-1]).any(-1)
    return Image(weights @ colors, weights @ depths, before[..., -1], ~close, weights, median_depth)


def render(
    parameters, pose: torch.Tensor, background: torch.Tensor, camera: Camera, degree: int, *,
    footprint: str = "affine", alpha_min: float = ALPHA_MIN, transmittance_min: float = TRANSMITTANCE_MIN,
    pixel_order: bool = False,
):  # fmt: skip
    """Colour, alpha, expected depth and `certain`, for parameters in the order of `Gaussians`."""
    means, log_scales, quaternions, opacity_logits, sh = parameters
    splats = project(
        means, log_scales, quaternions, opacity_logits, pose, camera,
        footprint=footprint, alpha_min=alpha_min,
    )  # fmt: skip
    colors = shade(means, sh, pose, degree)
    image = composite(
        splats.centers, splats.conics, splats.depths, splats.opacities, colors, splats.drawn,
        camera.width, camera.height, alpha_min=alpha_min, transmittance_min=transmittance_min,
        slopes=splats.slopes if pixel_order else None,
    )  # fmt: skip
    alpha = 1 - image.transmittance
    color = image.color + image.transmittance[..., None] * background
    return color, alpha, image.depth_sum / alpha.clamp_min(1e-6), image.certain


def weighted_sum(parts, certain: torch.Tensor) -> torch.Tensor:
    """A loss in which every number of every image (H, W, ...) has a random weight of its own.

    A plain mean would hide errors that cancel. Pixels that are not `certain` (H, W) have weight zero.
    """
    random = torch.Generator().manual_seed(7)
    total = torch.zeros((), dtype=parts[0].dtype, device=parts[0].device)
    for part in parts:
        weights = torch.randn(part.shape, generator=random)
        weights[~certain] = 0.0
        total = total + (part * weights.to(part)).sum()
    return total
