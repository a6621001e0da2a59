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

NEAR, LOW_PASS, MARGIN = 0.01, 0.3, 1.3
ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN = 0.99, 1 / 255, 1e-4


@dataclass(frozen=True)
class Splats:
    """Projected gaussians: centers (N, 2), depths (N,), covariances (N, 2, 2), opacities (N,), drawn (N,)."""

    centers: torch.Tensor
    depths: torch.Tensor
    covariances: torch.Tensor
    opacities: torch.Tensor
    drawn: torch.Tensor

    @property
    def conics(self) -> torch.Tensor:
        """Inverse covariances (xx, xy, yy), shape (N, 3)."""
        inverse = torch.linalg.inv(self.covariances)
        return torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], -1)


@dataclass(frozen=True)
class Image:
    """A blended image.

    `certain` (H, W) is False where a comparison was so close that float32 may decide it otherwise.
    """

    color: torch.Tensor
    depth_sum: torch.Tensor
    transmittance: torch.Tensor
    certain: torch.Tensor


def distort(x: torch.Tensor, y: torch.Tensor, camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    """Lens distortion as COLMAP documents it (OPENCV and OPENCV_FISHEYE)."""
    if camera.distortion is None:
        return x, y
    k = camera.distortion.coefficients
    if camera.distortion.kind == "brown":
        k1, k2, p1, p2 = k
        r2 = x**2 + y**2
        radial = 1 + k1 * r2 + k2 * r2**2
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


def project(means, log_scales, quaternions, opacity_logits, pose: torch.Tensor, camera: Camera) -> Splats:
    """EWA projection with a 4 x 4 `pose` in place of the camera's own."""
    p = means @ pose[:3, :3].T + pose[:3, 3]
    z = p[:, 2]
    opacities = torch.sigmoid(opacity_logits)
    drawn = (z >= NEAR) & (opacities >= ALPHA_MIN) & ((quaternions**2).sum(1) >= 1e-8)
    z = torch.where(drawn, z, torch.ones_like(z))
    x, y = p[:, 0] / z, p[:, 1] / z
    low, high = field_of_view(camera)
    xj, yj = x.clamp(low[0], high[0]), y.clamp(low[1], high[1])
    lens = distort_jacobian(xj, yj, camera) * torch.tensor([[camera.fx], [camera.fy]], dtype=p.dtype)
    zero, one = torch.zeros_like(z), torch.ones_like(z)
    perspective = torch.stack([one, zero, -xj, zero, one, -yj], -1).reshape(-1, 2, 3) / z[:, None, None]
    to_image = lens @ perspective @ pose[:3, :3]
    spread = rotations(quaternions) @ torch.diag_embed(log_scales.exp())
    covariances = to_image @ spread @ spread.mT @ to_image.mT + LOW_PASS * torch.eye(2, dtype=p.dtype)
    u, v = distort(x, y, camera)
    centers = torch.stack([camera.fx * u + camera.cx, camera.fy * v + camera.cy], -1)
    return Splats(centers, z, covariances, opacities, drawn)


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


def composite(centers, conics, depths, opacities, colors, drawn, width: int, height: int) -> Image:
    """Blend all gaussians in every pixel, nearest first, with the cut-offs of 3DGS."""
    order = torch.argsort(depths, stable=True)
    order = order[drawn[order]]
    columns = torch.arange(width, dtype=torch.float64) + 0.5
    rows = torch.arange(height, dtype=torch.float64) + 0.5
    dx = centers[order, 0] - columns.expand(height, width)[..., None]
    dy = centers[order, 1] - rows[:, None].expand(height, width)[..., None]
    xx, xy, yy = conics[order].unbind(1)
    raw = opacities[order] * torch.exp(-0.5 * (xx * dx**2 + yy * dy**2) - xy * dx * dy)
    alpha = raw.clamp_max(ALPHA_MAX)
    alpha = torch.where(alpha < ALPHA_MIN, 0.0, alpha)
    after = torch.cumprod(1 - alpha, -1)
    alpha = torch.where(after < TRANSMITTANCE_MIN, 0.0, alpha)
    after_drawn = torch.cumprod(1 - alpha, -1)
    before = torch.cat([torch.ones_like(after_drawn[..., :1]), after_drawn], -1)
    weights = alpha * before[..., :-1]

    close = (raw / ALPHA_MIN - 1).abs() < 1e-3
    close |= (raw / ALPHA_MAX - 1).abs() < 1e-4
    close |= (after / TRANSMITTANCE_MIN - 1).abs() < 1e-2
    return Image(weights @ colors[order], weights @ depths[order], before[..., -1], ~close.any(-1))


def render(parameters, pose: torch.Tensor, background: torch.Tensor, camera: Camera, degree: int):
    """Colour, alpha, expected depth and `certain`, for parameters in the order of `Gaussians`."""
    means, log_scales, quaternions, opacity_logits, sh = parameters
    splats = project(means, log_scales, quaternions, opacity_logits, pose, camera)
    colors = shade(means, sh, pose, degree)
    image = composite(
        splats.centers, splats.conics, splats.depths, splats.opacities, colors, splats.drawn,
        camera.width, camera.height,
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
